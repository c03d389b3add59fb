"""Other programs: POMDP files, environments for learners, and `bridges` to the protocols of a line."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
