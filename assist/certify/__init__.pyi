from .bound import TeamBound as TeamBound
from .bound import certify as certify
from .bound import upper_bound as upper_bound
from .certificate import Certificate as Certificate
