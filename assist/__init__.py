"""From the exact cost-to-go to a robot that assists a team.

The folders, in an order in which each builds on earlier ones:

declare     Declared data: each field of a setting, robot or plan is declared once, with its range and one sentence.
texts       Texts that people read, in each language, and refusals by their keys.
people      Models of people: choices, influence and trust, populations, and the belief in a person.
person      One person's assistance problem as a POMDP, in a task of any size, and its solutions with certified bounds.
learning    Estimates of people's parameters, trust rules and goals from recorded actions.
team        Several people and robots: the state that a policy receives, the policies, and one step of a team.
simulation  Simulated episodes of teams, and the pools of people from whom teams are drawn.
drawing     Pictures of tasks, plans and episodes, for any domain.
explain     Contrastive explanations: why this step, why this person, and why nothing, from h* and beliefs.
live        The live assistant: one team of real people, action by action.
certify     Certified upper bounds on the value of all team policies.
coupled     Weakly coupled problems as arrays: many Markov decision processes that share a resource.
interop     Exports to other programs: POMDP file formats, pomdp-py objects, Gymnasium and PettingZoo environments.
plots       Figures of results (extra `plots`).
study       Studies with simulated people: their description, execution and results (extra `study`).
userstudy   Studies with real people: conditions, assignment, procedure, questionnaires and tables.
reports     Reports of studies: statistics, wording, tables and figures.
web         Live sessions and user studies over HTTP (extra `web`).
bridges     Bridges between a live session and the protocols of a line (extras `mqtt`, `opcua`, `ros2`).
cli         The command-line program `kitassist`: it parses options, calls the library and prints records and tables.

The default path is people, person, team, simulation. This package exports what most users need; each folder exports the
rest.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
