"""Weakly coupled problems as arrays: many Markov decision processes that share a resource."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
