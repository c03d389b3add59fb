from .leaf_estimates import Estimates as Estimates
from .person_problem import PersonProblem as PersonProblem
from .state_cache import Visited as Visited
from .truncated_policy import WidePolicy as WidePolicy
from .truncated_task import Region as Region
