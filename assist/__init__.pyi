from .learning.fit import fit as fit
from .learning.log import read_log as read_log
from .live.assistant import Assistant as Assistant
from .reports.policy_comparison import compare as compare
from .reports.watched_episode import watch as watch
from .simulation.pool import Pool as Pool
from .simulation.simulate import simulate as simulate
from .study.own_code import check as check
