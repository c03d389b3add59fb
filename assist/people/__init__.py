"""How people decide: what they can do, how they choose, take advice and come to trust it, and the belief in them."""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
