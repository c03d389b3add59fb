"""A team of several people and one robot: the state that a policy receives, and the policies."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
