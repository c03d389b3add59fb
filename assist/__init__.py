"""From the exact cost-to-go to a robot that assists a team.

In the order in which the folders build on each other; the default path is people, person, team, simulation:

people       how people decide: what they can do, their choice, influence and trust, populations, the belief in them
person       one person's assistance problem, and its solutions between proven bounds
learning     what recorded actions tell about people
team         several people and a robot: what a policy is given, and team policies
large_tasks  tasks too large to enumerate: truncated tasks, and policies and bounds on them
simulation   the people from whom teams are drawn, and episodes of a team
live         the live assistant: a team of real people, action by action
certify      bounds on what any team policy can get
drawing      pictures of states, plans and episodes
interop      problems and policies in other programs' formats
plots        figures of results (extra `plots`)
study        experiments with simulated people (extra `study`)
userstudy    experiments with people at the live assistant
reports      what studies found: statistics, tables, figures and reports
web          live sessions and user studies over HTTP (extra `web`)
cli          the command `kitassist`, a file for each of its commands

What most users need is imported from here; each folder exports what else it has.
"""

from planner.system.lazy_imports import lazy_exports

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
