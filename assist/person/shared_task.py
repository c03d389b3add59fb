"""The task of a pool of people of which not all states are enumerated, and what is known of it before a visit."""

from __future__ import annotations

import math

import numpy as np

from planner import CostToGo, Table

from ..people.goals import Goals, each_of, first_of, goals_reached, optimal_for_each
from ..people.memory_on_demand import memory_of
from .assumptions import Assumptions
from .problem_rows import Extent
from .state_cache import StateCache

REGION = {"sweep": 20_000, "orbits": 3_000, "on-demand": 200}
"""Number of states of a policy's truncated task, by the kind of cost-to-go.

A table answers at once; a query by symmetry takes longer, and a search may take seconds.
"""

MOST_STATES = 1 << 62
"""Number of states that an extent has at most, so that it fits the integers of an environment's space."""

SCANNED = 1 << 16
"""Number of states of a table that are looked at together."""

ROWS = 20_000
"""Number of rows, of some kilobytes each, that all policies for the people of a task keep together."""


def lookup_kind(known: CostToGo) -> str:
    """Return how cost-to-go is computed: "sweep" (a table), "orbits" (by symmetry) or "on-demand" (a search)."""
    return "orbits" if known.method == "on-demand" and not known.searches else known.method


def default_size(known: CostToGo | Goals) -> int:
    """Return the number of states of a truncated task for each goal: a share of `REGION`, but at least 1,000 of it."""
    one = REGION[lookup_kind(first_of(known))]
    return max(one // len(each_of(known)), min(one, 1_000))


class SharedTask:
    """The task of a pool of people, and the cache of its visited states.

    Parameters
    ----------
    known : CostToGo or Goals
    size : int, optional
        Number of states of each person's truncated task, for each goal; by default `default_size`.
    policies : int
        Number of policies that keep rows in memory at the same time.
    """

    def __init__(self, known: CostToGo | Goals, size: int | None = None, policies: int = 1) -> None:
        self.known, self.size = known, size or default_size(known)
        self.rows = ROWS // policies
        self.visited = StateCache(known)

    def extent(self, assumed: Assumptions) -> Extent:
        """Return the largest numbers of a person's problem, from all states of a table or from the task's facts.

        Parameters
        ----------
        assumed : Assumptions
            What the robot assumes of the person.
        """
        known, executes = memory_of(self.known).known, assumed.robot.execute
        tables = each_of(known)
        if not all(isinstance(one, Table) for one in tables):
            task = tables[0].task  # no state has more values than the variables
            return Extent(min(math.prod(task.sizes), MOST_STATES), 1 + task.most_at_once * (1 + executes), math.inf)
        states, most, farthest = len(tables[0]), 0, 0.0
        for begin in range(0, states, SCANNED):
            block = np.arange(begin, min(begin + SCANNED, states))
            rows = tables[0].choices(block)
            source = np.repeat(np.arange(len(block)), np.diff(rows.offsets))
            goes_on = ~goals_reached(known, block)[source]
            if assumed.suggestions == "optimal":
                goes_on &= optimal_for_each(known, block, rows)
            most = max(most, int(np.bincount(source[goes_on.any(axis=1)]).max(initial=0)))
            h = np.concatenate([one.lookup(block) for one in tables])
            farthest = max(farthest, float(h[np.isfinite(h)].max(initial=0.0)))
        return Extent(states, 1 + most * (1 + executes), farthest)
