"""Exports to other programs: POMDP file formats, pomdp-py objects, Gymnasium and PettingZoo environments."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
