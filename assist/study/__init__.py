"""Experiments with simulated people: what is to be done, and its carrying out (extra `study`)."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
