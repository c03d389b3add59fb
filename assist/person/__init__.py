"""One person's assistance problem as a POMDP, and its solutions with certified bounds."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
