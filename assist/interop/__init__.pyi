from .exchange import PolicyFileError as PolicyFileError
from .exchange import PomdpPy as PomdpPy
from .exchange import read_policy as read_policy
from .exchange import to_pomdp_py as to_pomdp_py
from .exchange import write_pomdp as write_pomdp
from .exchange import write_pomdpx as write_pomdpx
