from .policyx import PolicyFileError as PolicyFileError
from .policyx import read_policy as read_policy
from .pomdp import write_pomdp as write_pomdp
from .pomdp_py import PomdpPy as PomdpPy
from .pomdp_py import to_pomdp_py as to_pomdp_py
from .pomdpx import write_pomdpx as write_pomdpx
