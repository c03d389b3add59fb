from .learning.log import read_log as read_log
from .learning.people import fit as fit
from .live.assistant import Assistant as Assistant
from .simulation.simulate import simulate as simulate
from .team.pool import Pool as Pool
