from .certificate import Certificate as Certificate
from .team_bound import TeamBound as TeamBound
from .team_bound import certify as certify
from .team_bound import upper_bound as upper_bound
