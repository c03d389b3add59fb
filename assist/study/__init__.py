"""Simulation studies: their description, execution and results (extra `study`)."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
