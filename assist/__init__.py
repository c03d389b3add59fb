"""From the exact cost-to-go to a robot that assists a team.

The folders, in an order in which each builds on earlier ones:

declare   Declared data: each field has its range and one sentence; texts in each language; reasons of refusals.
people    Models of people: choices, influence and trust, populations, and the belief in a person.
person    One person's assistance problem as a POMDP, in a task of any size, and its solutions with certified bounds.
team      Several people and robots: what a policy receives, the policies, one step of a team, and simulated episodes.
certify   Certified upper bounds on the value of every policy: for a pool of people, or weakly coupled MDPs (`coupled`).
learning  Estimates of people's parameters, trust rules and goals from recorded actions.
drawing   Pictures of tasks, plans and episodes, for any domain; `plots` has figures of results (extra `plots`).
live      The live assistant: one team of real people, action by action, with explanations of its suggestions.
studies   Studies with simulated people (extra `study`), with real people (`userstudy`), and their `reports`.
web       Live sessions and user studies over HTTP (extra `web`).
connect   Other programs: POMDP files, environments for learners, and `bridges` to the protocols of a line.
cli       The command-line program `kitassist`: it parses options, calls the library and prints records and tables.

The default path is people, person, team. This package exports what most users need; each folder exports the
rest.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
