"""From PDDL files to the exact cost-to-go of every state."""

from .costtogo import CostToGo, MismatchError, astar, cost_to_go, verify
from .fast_downward import FastDownwardError, LimitError, Limits
from .pddl import Instance, InstanceError, PDDLError, find_instances, instance
from .statespace import Packing, StateSpace, explore
from .task import Effect, Operator, Task, Variable, load

__all__ = [
    "CostToGo",
    "Effect",
    "FastDownwardError",
    "Instance",
    "InstanceError",
    "LimitError",
    "Limits",
    "MismatchError",
    "Operator",
    "PDDLError",
    "Packing",
    "StateSpace",
    "Task",
    "Variable",
    "astar",
    "cost_to_go",
    "explore",
    "find_instances",
    "instance",
    "load",
    "verify",
]
