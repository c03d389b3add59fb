"""How people decide: what they can do, how they choose, take advice and come to trust it, and the belief in them."""

from planner.system.lazy_imports import hand_on

__getattr__, __dir__, __all__ = hand_on(__name__, __file__)
