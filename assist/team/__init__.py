"""Several people and one robot: what a policy is given, the policies, and the people from whom teams are drawn."""

from planner.system.lazy_imports import hand_on

__getattr__, __dir__, __all__ = hand_on(__name__, __file__)
