"""One person's assistance problem, and its solutions between proven bounds."""

from planner.system.lazy_imports import hand_on

__getattr__, __dir__, __all__ = hand_on(__name__, __file__)
