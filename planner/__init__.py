"""From PDDL files to the exact cost-to-go of every state."""

from .costtogo import CostToGo, MismatchError, Table, astar, verify
from .fast_downward import FastDownwardError, LimitError, Limits
from .methods import cost_to_go
from .ondemand import Cache, OnDemand
from .pddl import Instance, InstanceError, PDDLError, find_instances, instance
from .statespace import StateSpace
from .successors import Packing, Successors, Transitions
from .sweep import sweep
from .task import Effect, Operator, Task, Variable, load

__all__ = [
    "Cache",
    "CostToGo",
    "Effect",
    "FastDownwardError",
    "Instance",
    "InstanceError",
    "LimitError",
    "Limits",
    "MismatchError",
    "OnDemand",
    "Operator",
    "PDDLError",
    "Packing",
    "StateSpace",
    "Successors",
    "Table",
    "Task",
    "Transitions",
    "Variable",
    "astar",
    "cost_to_go",
    "find_instances",
    "instance",
    "load",
    "sweep",
    "verify",
]
