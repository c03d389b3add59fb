"""Certified upper bounds on the value of all team policies: of pools, and of arrays of problems (`coupled`)."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
