"""From PDDL files to the exact cost-to-go of every state.

The folders, in an order in which each builds on earlier ones:

system     Services of the operating system and Python: files, processes, threads, limits, progress, compiled code.
pddl       PDDL files: finding, reading, compiling numbers and time away, and validation.
grounding  The grounded task, which Fast Downward's translator derives from PDDL files.
search     The search through all reachable states: with numpy for small tasks, compiled for larger ones.
costtogo   The exact cost-to-go: tables of all states or orbits, single states on demand, and their verification.
batch      Solving many instances, with records that allow a run to be resumed.

`engine` lets unified-planning plan with this package. It exports what most users need.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
