"""Studies: what is to be done, its carrying out, and what was found (extra `study`)."""

from planner.system.lazy_imports import hand_on

__getattr__, __dir__, __all__ = hand_on(__name__, __file__)
