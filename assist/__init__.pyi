from .learning.fit import fit as fit
from .learning.log import read_log as read_log
from .live.assistant import Assistant as Assistant
from .studies.own_code import check as check
from .studies.reports.policy_comparison import compare as compare
from .studies.reports.watched_episode import watch as watch
from .team.pool import Pool as Pool
from .team.simulate import simulate as simulate
