"""Choices with memory in a task of any size: pairs of a state and a memory as the states of a task.

`remembered` (`people.memory`) has all pairs of a table. A `Remembering` task numbers a pair when somebody may come to
it, so that whatever looks at a task state by state looks at pairs. Pairs whose terms are equal are not merged.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo, Transitions

from .choices import Choices
from .decision import Bools, Floats
from .goals import Goals, first_of, require_possible_terms
from .hidden_type import Ints
from .terms import NOTHING_YET, TERMS, Situation, Vocabulary, features, goals_met


def on_demand(task: CostToGo | Goals, names: Iterable[str]) -> CostToGo | Goals:
    """Return a task with the memory that the terms of people's choices need; the same task without terms.

    Raises
    ------
    ValueError
        People with terms pursue one of several goals.
    """
    names = tuple(names)
    require_possible_terms(task, names)
    return Remembering(first_of(task), names) if names else task


class Remembering(CostToGo):
    """A task whose states are pairs of a state and a person's memory: their last action, and where they took it.

    It is thread-safe. Attributes and methods that are not described here are those of `CostToGo`, for pairs.

    Parameters
    ----------
    known : CostToGo
        Cost-to-go of the task.
    names : iterable of str
        Names of the terms that people's choices have.
    """

    def __init__(self, known: CostToGo, names: Iterable[str]) -> None:
        self.known, self.terms = known, {name: TERMS[name] for name in names}
        self._words = Vocabulary.of(known.task.actions)
        self._number: dict[tuple[int, ...], int] = {}
        self._pairs, self._lock = np.empty((0, 3), dtype=np.int64), threading.Lock()
        self._begin = int(self.without_memory([known.initial])[0])

    @property
    def task(self) -> Any:
        """The task."""
        return self.known.task

    @property
    def initial(self) -> int:
        """The initial state without memory."""
        return self._begin

    @property
    def method(self) -> Literal["sweep", "on-demand"]:
        """Method that computes the cost-to-go."""
        return self.known.method

    @property
    def searches(self) -> bool:
        """Whether `lookup` may run a slow search."""
        return self.known.searches

    def __len__(self) -> int:
        return len(self._number)

    def state_of(self, pairs: ArrayLike) -> Ints:
        """Return the task state of each pair, shape (N,)."""
        return np.asarray(self._pairs[np.asarray(pairs, dtype=np.int64), 0])

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of pairs, shape (N,), as compressed rows."""
        here = self.state_of(states)
        found = self.known.choices(here)
        before = np.repeat(here, np.diff(found.offsets))
        last = self.task.first_of_name[found.actions]
        return found._replace(targets=self._numbered(np.stack([found.targets, last, before], axis=1)))

    def is_goal(self, states: ArrayLike) -> Bools:
        """Return whether each pair's state is a goal state, shape (N,)."""
        return self.known.is_goal(self.state_of(states))

    def lookup(self, states: ArrayLike) -> Floats:
        """Return h* of pairs in the file's unit of cost, shape (N,)."""
        return self.known.lookup(self.state_of(states))

    def whole(self, states: ArrayLike) -> Floats:
        """Return h* of pairs as whole numbers, shape (N,)."""
        return self.known.whole(self.state_of(states))

    def values(self, states: ArrayLike) -> Any:
        """Return the values, shape (N, variables), of the pairs' states."""
        return self.known.values(self.state_of(states))

    def numbers(self, values: ArrayLike) -> Any:
        """Return the pairs without memory, shape (N,), of states with the given values, shape (N, variables)."""
        return self.without_memory(self.known.numbers(values))

    def without_memory(self, states: ArrayLike) -> Ints:
        """Return the pair of each task state without memory, shape (N,)."""
        states = np.asarray(states, dtype=np.int64)
        none = np.full(len(states), NOTHING_YET)
        return self._numbered(np.stack([states, none, none], axis=1))

    def plan_lengths(self, states: ArrayLike) -> Any:
        """Return the least number of actions of an optimal plan, shape (N,)."""
        return self.known.plan_lengths(self.state_of(states))

    def optimal_plan(self, state: int | None = None) -> list[str] | None:
        """Return an optimal plan from a pair (default: the initial one)."""
        return self.known.optimal_plan(int(self.state_of([self._begin if state is None else state])[0]))

    def with_terms(self, choices: Choices, pairs: Ints) -> Choices:
        """Return the choices in some pairs, shape (n,), with the values of terms."""
        state, last, previous = self._pairs[pairs].T
        goals = goals_met(self.known, state)
        situation = Situation(
            choices.names, self._words, state, choices.applicable, choices.actions, state[choices.targets],
            goals, goals[choices.targets], last, previous,
        )  # fmt: skip
        return replace(choices, terms=tuple(self.terms), features=features(situation, self.terms))

    def _numbered(self, pairs: Ints) -> Ints:
        """Return the numbers of pairs, shape (N, 3), of state, last action and its state; new pairs are added."""
        wanted, inverse = np.unique(pairs, axis=0, return_inverse=True)
        rows = list(map(tuple, wanted.tolist()))
        with self._lock:
            new = [row for row in rows if row not in self._number]
            self._number |= zip(new, range(len(self._number), len(self._number) + len(new)), strict=True)
            size = len(self._number)
            if size > len(self._pairs):  # room for twice as many; readers keep the former array
                self._pairs = np.concatenate([self._pairs, np.zeros((size, 3), dtype=np.int64)])
            if new:
                self._pairs[size - len(new) : size] = new
            numbers = np.array([self._number[row] for row in rows], dtype=np.int64)
        return numbers[inverse.reshape(-1)]


@dataclass(frozen=True)
class Memoryless:
    """A task of people without memory; it answers the questions about memory that a `Remembering` task answers."""

    known: CostToGo | Goals

    def state_of(self, pairs: ArrayLike) -> Ints:
        """Return the states themselves, shape (N,)."""
        return np.asarray(pairs, dtype=np.int64)

    def without_memory(self, states: ArrayLike) -> Ints:
        """Return the states themselves, shape (N,)."""
        return np.asarray(states, dtype=np.int64)

    def with_terms(self, choices: Choices, pairs: Ints) -> Choices:
        """Return the choices, which have no terms."""
        del pairs
        return choices


def memory_of(task: CostToGo | Goals) -> Remembering | Memoryless:
    """Return what tells the states of a task apart from what people remember there."""
    return task if isinstance(task, Remembering) else Memoryless(task)
