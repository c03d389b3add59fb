"""Estimates of people's parameters, trust rules and goals from recorded actions."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
