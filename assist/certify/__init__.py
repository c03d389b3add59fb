"""Certified upper bounds on the value of every policy: for a pool of people, or weakly coupled MDPs (`coupled`)."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
