"""The states of a trial with numbers: a search for its cheapest plan, and all reachable ones while none is beyond."""

from __future__ import annotations

import heapq
import re
from fractions import Fraction

import numpy as np

from ..grounding.task import Task, derived
from ..pddl.expressions import Number, whole
from ..pddl.value_sets import Fluent
from ..search.state_registry import RegistrySpace, StateRegistry
from ..search.state_space import Packing, holds
from ..search.successor_generator import Expanded, expanded, packed_operators
from ..system.arrays import Ints
from ..system.errors import UnsuitedError
from ..system.limits import Budget

STATES_AT_A_TIME = 10_000


def stays_within(task: Task, most_states: int) -> bool | None:
    """Return whether no plan of the trial is as cheap if it may end beyond the values; None if that is not known.

    It is also True if there is no plan, and no number can be beyond. The search by increasing cost (Dijkstra) ends
    without an answer once it has met more than `most_states` states, so that a file has the same task everywhere.
    """
    packing = Packing.of(task)
    operators, costs = packed_operators(task, packing), np.asarray(task.costs, dtype=np.int64)
    goal, beyond = packing.condition(task.goal), [packing.condition([fact]) for fact in task.beyond]
    met = StateRegistry(packing.words)
    begin = met.numbers(packing.pack([derived(task, task.initial)])).astype(np.int64)
    least = np.zeros(1, dtype=np.int64)  # cost of the cheapest known way to each state
    waiting: dict[int, list[Ints]] = {0: [begin]}
    queue = [0]
    while queue:
        cost = heapq.heappop(queue)
        done, reached, left = np.zeros(0, dtype=np.int64), False, False
        while cost in waiting:  # actions that cost nothing lead to more states of the same cost
            numbers = np.setdiff1d(np.concatenate(waiting.pop(cost)), done)
            numbers = numbers[least[numbers] == cost]
            done = np.union1d(done, numbers)
            states = met.states(numbers)
            away = np.zeros(len(states), dtype=bool)
            for condition in beyond:
                away |= holds(states, *condition)
            left = left or bool(away.any())
            reached = reached or bool(np.any(holds(states, *goal) & ~away))
            for at in range(0, len(states), STATES_AT_A_TIME):
                part = slice(at, at + STATES_AT_A_TIME)
                for _, actions, after in expanded(operators, states[part][~away[part]]):
                    known, spent = met.numbers(after).astype(np.int64), costs[actions]
                    if len(met) > most_states:
                        return None
                    more = np.full(len(met) - len(least), np.iinfo(np.int64).max, dtype=np.int64)
                    least = np.concatenate((least, more)) if len(more) else least
                    cheaper = cost + spent < least[known]
                    np.minimum.at(least, known, cost + spent)
                    _wait(known[cheaper], cost + spent[cheaper], waiting, queue)
        if reached or left:
            return not left
    return True


def _wait(states: Ints, costs: Ints, waiting: dict[int, list[Ints]], queue: list[int]) -> None:
    """Let states wait until all that cost less are expanded."""
    for cost in np.unique(costs).tolist():
        if cost not in waiting:
            waiting[cost] = []
            heapq.heappush(queue, cost)
        waiting[cost].append(np.unique(states[costs == cost]))


class WatchedStates(RegistrySpace):
    """The states of a trial; its enumeration ends with an `UnsuitedError` once one has a number beyond its values."""

    def __init__(self, task: Task, most_states: int) -> None:
        self.task, self.budget = task, Budget.within(most_states)
        super().__init__(task, self.budget)
        packing = Packing.of(task)
        self._beyond = [packing.condition([fact]) for fact in task.beyond]

    def numbers(self) -> dict[Fluent, set[Number]]:
        """Return the numbers that each fluent has in the states."""
        found: dict[Fluent, set[Number]] = {}
        values = self.index.values(np.arange(len(self)))
        for variable, column in zip(self.task.variables, values.T, strict=True):
            for value in np.unique(column):
                match = re.fullmatch(r"Atom ([^()]+)\((.*)\) = (-?\d[\d./]*)", variable.facts[value])
                if match is not None:
                    fluent = (match[1], *(match[2].split(", ") if match[2] else ()))
                    found.setdefault(fluent, set()).add(whole(Fraction(match[3])))
        return found

    def expand(self, block: range) -> list[Expanded]:
        """Return the successors of a block's states."""
        parts = super().expand(block)
        for _, _, after in parts:
            if any(np.any(holds(after, *condition)) for condition in self._beyond):
                raise UnsuitedError("a number is beyond its values")
        return parts
