from .certificate import Certificate as Certificate
from .computation import BoundOptions as BoundOptions
from .information_relaxation.options import RelaxationOptions as RelaxationOptions
from .team_bound import TeamBound as TeamBound
from .team_bound import certify as certify
from .team_bound import upper_bound as upper_bound
