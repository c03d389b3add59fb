"""One person's assistance problem as a POMDP, in a task of any size, and its solutions with certified bounds."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
