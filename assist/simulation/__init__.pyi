from .belief_trace import beliefs_of_episode as beliefs_of_episode
from .episode import Episode as Episode
from .episodes import Episodes as Episodes
from .episodes import Summary as Summary
from .illustration import Illustration as Illustration
from .pool import Pool as Pool
from .schedule import Schedule as Schedule
from .simulate import simulate as simulate
