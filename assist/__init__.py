"""From the exact cost-to-go to a robot that assists a team.

In the order in which the folders build on each other:

people      how people decide: what they can do, their choice, influence and trust, populations, the belief in them
person      one person's assistance problem, and its solutions between proven bounds
learning    what recorded actions tell about people
team        several people and a robot: what a policy is given, team policies, the people from whom teams are drawn
interop     problems and policies in other programs' formats
simulation  episodes of a team
certify     bounds on what any team policy can get
plots       pictures (extra `plots`)
study       studies: what is to be done, its carrying out, what was found (extra `study`)
live        the live assistant: a team of real people, action by action
cli         the command `kitassist`, a file for each of its commands

What most users need is imported from here; each folder exports what else it has.
"""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
