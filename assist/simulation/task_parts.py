"""The parts of people's tasks that are in use in a simulation: whole tasks, or local problems of large tasks."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from ..person.policy import Policy
from ..team.questions import Questions
from .model_group import Ints, ModelGroup, World
from .pool import Pool


@dataclass(eq=False)
class CachedPart:
    """A policy for some or all states of a task, with the choices of some people there.

    Attributes
    ----------
    policy : Policy
    group : ModelGroup
    states : int array, shape (m,)
        Ascending states in which people may be, if the policy does not cover all.
    spent : int
        Number of other states for which local problems have been built since, for one step each.
    """

    policy: Policy
    group: ModelGroup
    states: Ints
    spent: int = 0

    def has(self, states: Ints, people: Ints, deep: bool) -> bool:
        """Return whether it covers these states and people."""
        return self.policy.rows(states, deep=deep) is not None and bool(np.isin(people, self.group.people).all())


class TaskParts:
    """The parts of people's tasks that are in use, for all episodes of a simulation. It is thread-safe.

    A policy for an enumerated task covers all states. A local problem is used again while all people are in its states:
    in a small task, people soon visit no new states. It is rebuilt with more states if these are not many more than are
    needed, or if as many have been built for single steps since.

    Parameters
    ----------
    pool : Pool
    world : World

    Attributes
    ----------
    questions : Questions or None
        None if the robot does not ask people about their goals.
    """

    def __init__(self, pool: Pool, world: World) -> None:
        self.pool, self.world, setting = pool, world, pool.setting
        self.questions: Questions | None = None
        if setting.c_ask is not None and pool.goals > 1:
            self.questions = Questions(pool.policies, setting.c_ask, setting.ask_error)
        self._kept: dict[int, CachedPart] = {}
        self._lock = threading.Lock()

    def of(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedPart:
        """Return a part with some ascending states and some of the people of a policy.

        A rebuilt local problem has at most four times the needed number of states, unless many were built for single
        steps. All cached problems together have about 20,000 rows, of some kilobytes each.
        """
        with self._lock:
            kept = self._kept.get(number)
            if kept is None:
                return self._kept.setdefault(number, self._built(number, states, people, deep))
            if kept.has(states, people, deep):
                return kept
            more, everybody = np.union1d(kept.states, states), np.union1d(kept.group.people, people)
            size, most = len(kept.policy.pomdp.robot_actions), 20_000 // len(self.pool.policies)
            if len(more) <= max(4 * len(states), kept.spent) and size * len(more) <= most * len(kept.states):
                self._kept[number] = self._built(number, more, everybody, deep)
                return self._kept[number]
            kept.spent += len(states)
            return self._built(number, states, people, deep)

    def _built(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedPart:
        policy = self.pool.policies[number]
        # Where no state takes a search, the states after suggestions are included from the beginning.
        local = policy.local(states, deep=deep or not policy.searches)
        if local.states is None:  # it is built once, for everybody
            people = np.flatnonzero(self.pool.model == number)
        return CachedPart(local, self.group(local, people), states)

    def group(self, policy: Policy, people: Ints) -> ModelGroup:
        """Return the group of some people of a policy."""
        return ModelGroup.of(self.pool, policy.pomdp, people, self.world, policy.states)
