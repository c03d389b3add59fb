"""One person's assistance problem as a POMDP, and its solutions with certified bounds."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
