"""From the exact cost-to-go to a robot that assists a team.

The folders, in an order in which each builds on earlier ones; the default path is people, person, team, simulation:

declare      fields of settings and plans, declared once: checks, messages, tables of files, options
people       models of people: choices, influence and trust, populations, and beliefs about a person
person       the problem of assisting one person as a POMDP, in a task of any size, and its solutions and bounds
learning     estimates of people's parameters and goals from recorded actions
team         several people and a robot: the state that a policy receives, and team policies
simulation   pools of people from whom teams are drawn, and episodes of teams
live         the live assistant: decisions for a team of real people, action by action
certify      upper bounds on the value of every team policy
drawing      pictures of states, plans and episodes
interop      exports to the formats of other programs, and environments for learners
plots        figures of results (extra `plots`)
study        experiments with simulated people (extra `study`)
userstudy    experiments with real people at the live assistant
reports      results of studies: statistics, tables, figures and reports
web          live sessions and user studies over HTTP (extra `web`)
cli          the command `kitassist`, a file for each of its commands

This package exports what most users need; each folder exports the rest.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
