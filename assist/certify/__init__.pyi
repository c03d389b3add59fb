from .certificate import Certificate as Certificate
from .comparison import certify as certify
from .information_relaxation.options import RelaxationOptions as RelaxationOptions
from .options import BoundOptions as BoundOptions
from .options import Effort as Effort
from .team_bound import TeamBound as TeamBound
from .team_bound import upper_bound as upper_bound
