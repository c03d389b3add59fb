"""Models of people: choices, influence and trust, populations, and the belief in a person."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
