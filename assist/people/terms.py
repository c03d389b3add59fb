"""Terms: what else than cost speaks for a choice, as numbers that a person's weights multiply.

People do not choose by cost-to-go alone. With terms f_j and weights w_j they choose with

    P(a | x, m) proportional to exp(-beta Q(x, a) + sum_j w_j f_j(x, a, m)),

m being what they did last: the ground action, and the state in which they took it. A term is a function of a
`Situation`, which has no domain in it: a log's steps are one (`learning`), and so are all states of a task with what
may have come before them. Four are given, and anybody's own is a function like them.

goals       how many more goal facts hold after the action than before it
arguments   the share of the action's arguments that are arguments of the last action, too
name        whether the action has the name of the last action
back        whether the action leads back to the state in which the last action was taken
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo
from planner.system.arrays import read_only

from .decision import Floats

Ints = NDArray[np.int64]

NOTHING_YET = -1
"""The last action, and the state in which it was taken, before the first choice of an episode."""

BLOCK = 1 << 16  # states whose values are unpacked at a time


@dataclass(frozen=True)
class Vocabulary:
    """The words of M ground actions, as numbers; a last row stands for no action at all.

    Attributes
    ----------
    name : int array, shape (M + 1,)
        The action's name; -1 in the last row.
    arguments : int array, shape (M + 1, W)
        Its arguments, each once, filled from the left; -1 in empty places.
    """

    name: Ints
    arguments: Ints

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, actions: Sequence[str]) -> Vocabulary:
        """Read ground actions, each `(name arg ...)`."""
        words = [action[1:-1].split() for action in actions]
        number: dict[str, int] = {}
        rows = [[number.setdefault(word, len(number)) for word in dict.fromkeys(row[1:])] for row in words]
        names: dict[str, int] = {}
        name = np.array([*(names.setdefault(row[0], len(names)) for row in words), -1], dtype=np.int64)
        arguments = np.full((len(rows) + 1, max(map(len, rows), default=0)), -1, dtype=np.int64)
        for place, row in enumerate(rows):
            arguments[place, : len(row)] = row
        return cls(name, arguments)


@dataclass(frozen=True)
class Situation:
    """Choices that people have, and what came before; N rows of up to A choices.

    Attributes
    ----------
    names : tuple of str
        The task's ground actions in PDDL.
    words : Vocabulary
        Of these.
    state : int array, shape (N,)
    applicable : bool array, shape (N, A)
        Which slots hold a choice.
    actions : int array, shape (N, A)
        Ground action of each slot; negative where there is none, or the person can only stand still.
    targets : int array, shape (N, A)
        The state after each choice.
    goals : int array, shape (N,)
        How many goal facts hold in the state.
    goals_after : int array, shape (N, A)
        How many hold after each choice.
    last : int array, shape (N,)
        The ground action that the person took last in this episode, `NOTHING_YET` at its first choice.
    previous : int array, shape (N,)
        The state in which they took it, `NOTHING_YET` likewise.
    """

    names: tuple[str, ...]
    words: Vocabulary
    state: Ints
    applicable: NDArray[np.bool_]
    actions: Ints
    targets: Ints
    goals: Ints
    goals_after: Ints
    last: Ints
    previous: Ints

    def __post_init__(self) -> None:
        read_only(self)


class Term(Protocol):
    """Any function of this form."""

    def __call__(self, s: Situation, /) -> Floats:
        """Give a number for each choice, shape (N, A); what it says of empty slots does not matter."""
        ...


def goals(s: Situation) -> Floats:
    """Count the goal facts that a choice gains, less those that it loses, shape (N, A)."""
    return (s.goals_after - s.goals[:, None]).astype(np.float64)


def arguments(s: Situation) -> Floats:
    """Give the share of a choice's arguments that the last action had, too, shape (N, A); 0 where it has none."""
    own, last = s.words.arguments[s.actions], s.words.arguments[s.last]
    held = own >= 0
    shared = held & (own[:, :, :, None] == last[:, None, None, :]).any(axis=3)
    return np.asarray(shared.sum(axis=2) / np.maximum(held.sum(axis=2), 1), dtype=np.float64)


def name(s: Situation) -> Floats:
    """Tell whether a choice has the name of the last action, shape (N, A): 1 or 0."""
    known = (s.last >= 0)[:, None] & (s.actions >= 0)
    return np.where(known, s.words.name[s.actions] == s.words.name[s.last][:, None], 0.0)


def back(s: Situation) -> Floats:
    """Tell whether a choice leads back to the state in which the last action was taken, shape (N, A): 1 or 0."""
    return ((s.targets == s.previous[:, None]) & (s.previous >= 0)[:, None]).astype(np.float64)


TERMS: Mapping[str, Term] = MappingProxyType({"goals": goals, "arguments": arguments, "name": name, "back": back})
"""The terms that are given, by name."""


def features(situation: Situation, terms: Mapping[str, Term] = TERMS) -> Floats:
    """Give all terms of all choices, shape (N, A, J), 0 in empty slots.

    Parameters
    ----------
    situation : Situation
    terms : mapping of str to callable
        The J terms.

    Raises
    ------
    ValueError
        A term that gives no finite number for each choice.
    """
    result = np.zeros((*situation.applicable.shape, len(terms)))
    for place, (called, term) in enumerate(terms.items()):
        value = np.asarray(term(situation), dtype=np.float64)
        if value.shape != situation.applicable.shape:
            raise ValueError(f"term '{called}': shape {value.shape}; expected {situation.applicable.shape}")
        if not np.isfinite(value[situation.applicable]).all():
            raise ValueError(f"term '{called}': expected a finite number for each choice")
        result[:, :, place] = np.where(situation.applicable, value, 0.0)
    return result


def goals_met(costs: CostToGo, states: ArrayLike) -> Ints:
    """Count the goal facts that hold in states, shape (N,).

    Parameters
    ----------
    costs : CostToGo
        Of their task, as a table or on demand.
    states : int array, shape (N,)
    """
    numbers = np.asarray(states, dtype=np.int64).reshape(-1)
    variables, wanted = np.array(costs.task.goal, dtype=np.int64).reshape(-1, 2).T
    blocks = [numbers[first : first + BLOCK] for first in range(0, len(numbers), BLOCK)]
    met = [(costs.values(block)[:, variables] == wanted).sum(axis=1) for block in blocks]
    return np.concatenate(met) if met else np.zeros(0, dtype=np.int64)
