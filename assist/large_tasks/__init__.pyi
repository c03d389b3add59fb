from .leaf_estimates import LeafEstimates as LeafEstimates
from .person_problem import PersonProblem as PersonProblem
from .state_cache import StateCache as StateCache
from .truncated_policy import TruncatedPolicy as TruncatedPolicy
from .truncated_task import TruncatedTask as TruncatedTask
