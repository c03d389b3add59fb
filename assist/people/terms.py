"""Terms of a choice besides cost-to-go, which have a weight for each person.

With terms f_j and weights w_j, people choose with

    P(a | x, m) proportional to exp(-beta Q(x, a) + sum_j w_j f_j(x, a, m)),

where the memory m is their last ground action and the state in which they took it. A term is a function of a
`Situation`, which does not depend on the domain. The steps of a log are a situation (`learning`), and so are the states
of a task with the memories that are possible there. There are four terms; users can add functions of the same form.

goals       number of goal facts after the action minus the number before it
arguments   share of the action's arguments that are also arguments of the last action
name        1 if the action has the name of the last action, else 0
back        1 if the action leads back to the state in which the last action was taken, else 0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo
from planner.system.arrays import read_only

from .decision import Bools, Floats, Ints
from .state_keys import BLOCK

NOTHING_YET = -1
"""Number of the last action, and of its state, before the first choice of an episode."""


@dataclass(frozen=True)
class Vocabulary:
    """Names and arguments of M ground actions, as numbers; the last row represents no action.

    Attributes
    ----------
    name : int array, shape (M + 1,)
        Number of the action's name; -1 in the last row.
    arguments : int array, shape (M + 1, W)
        Numbers of its distinct arguments, filled from the left; -1 in empty places.
    """

    name: Ints
    arguments: Ints

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, actions: Sequence[str]) -> Vocabulary:
        """Return the vocabulary of ground actions, each `(name arg ...)`."""
        words = [action[1:-1].split() for action in actions]
        number: dict[str, int] = {}
        rows = [[number.setdefault(word, len(number)) for word in dict.fromkeys(row[1:])] for row in words]
        names: dict[str, int] = {}
        name = np.array([*(names.setdefault(row[0], len(names)) for row in words), -1], dtype=np.int64)
        arguments = np.full((len(rows) + 1, max(map(len, rows), default=0)), -1, dtype=np.int64)
        for one, row in enumerate(rows):
            arguments[one, : len(row)] = row
        return cls(name, arguments)


@dataclass(frozen=True)
class Situation:
    """Choices and memories of people: N rows of up to A choices.

    Attributes
    ----------
    names : tuple of str
        The task's ground actions in PDDL notation.
    words : Vocabulary
        Vocabulary of these.
    state : int array, shape (N,)
    applicable : bool array, shape (N, A)
        Whether each slot holds a choice.
    actions : int array, shape (N, A)
        Ground action of each slot; negative in empty slots, and for waiting.
    targets : int array, shape (N, A)
        Successor of each choice.
    goals : int array, shape (N,)
        Number of goal facts that hold in the state.
    goals_after : int array, shape (N, A)
        Number of goal facts that hold after each choice.
    last : int array, shape (N,)
        The person's last ground action in this episode; `NOTHING_YET` at the first choice.
    previous : int array, shape (N,)
        The state in which they took it; `NOTHING_YET` at the first choice.
    """

    names: tuple[str, ...]
    words: Vocabulary
    state: Ints
    applicable: Bools
    actions: Ints
    targets: Ints
    goals: Ints
    goals_after: Ints
    last: Ints
    previous: Ints

    def __post_init__(self) -> None:
        read_only(self)


class Term(Protocol):
    """A term of the choice: a function of a situation."""

    def __call__(self, s: Situation, /) -> Floats:
        """Return a number for each choice, shape (N, A); numbers in empty slots are not used."""
        ...


def goals(s: Situation) -> Floats:
    """Return the number of goal facts that a choice gains minus those that it loses, shape (N, A)."""
    return (s.goals_after - s.goals[:, None]).astype(np.float64)


def arguments(s: Situation) -> Floats:
    """Return the share of a choice's arguments that the last action also had, shape (N, A); 0 without arguments."""
    own, last = s.words.arguments[s.actions], s.words.arguments[s.last]
    held = own >= 0
    shared = held & (own[:, :, :, None] == last[:, None, None, :]).any(axis=3)
    return np.asarray(shared.sum(axis=2) / np.maximum(held.sum(axis=2), 1), dtype=np.float64)


def name(s: Situation) -> Floats:
    """Return 1 if a choice has the name of the last action, else 0, shape (N, A)."""
    known = (s.last >= 0)[:, None] & (s.actions >= 0)
    return np.where(known, s.words.name[s.actions] == s.words.name[s.last][:, None], 0.0)


def back(s: Situation) -> Floats:
    """Return 1 if a choice leads back to the state in which the last action was taken, else 0, shape (N, A)."""
    return ((s.targets == s.previous[:, None]) & (s.previous >= 0)[:, None]).astype(np.float64)


TERMS: Mapping[str, Term] = MappingProxyType({"goals": goals, "arguments": arguments, "name": name, "back": back})
"""The terms by name."""


def features(situation: Situation, terms: Mapping[str, Term] = TERMS) -> Floats:
    """Return all terms of all choices, shape (N, A, J), 0 in empty slots.

    Parameters
    ----------
    situation : Situation
    terms : mapping of str to callable
        The J terms.

    Raises
    ------
    ValueError
        A term does not return a finite number for each choice.
    """
    result = np.zeros((*situation.applicable.shape, len(terms)))
    for number, (called, term) in enumerate(terms.items()):
        value = np.asarray(term(situation), dtype=np.float64)
        if value.shape != situation.applicable.shape:
            raise ValueError(f"term '{called}': shape {value.shape}; expected {situation.applicable.shape}")
        if not np.isfinite(value[situation.applicable]).all():
            raise ValueError(f"term '{called}': expected a finite number for each choice")
        result[:, :, number] = np.where(situation.applicable, value, 0.0)
    return result


def goals_met(costs: CostToGo, states: ArrayLike) -> Ints:
    """Return the number of goal facts that hold in each state, shape (N,).

    Parameters
    ----------
    costs : CostToGo
        Cost-to-go of their task, as a table or on demand.
    states : int array, shape (N,)
    """
    numbers = np.asarray(states, dtype=np.int64).reshape(-1)
    variables, wanted = np.array(costs.task.goal, dtype=np.int64).reshape(-1, 2).T
    blocks = [numbers[first : first + BLOCK] for first in range(0, len(numbers), BLOCK)]
    met = [(costs.values(block)[:, variables] == wanted).sum(axis=1) for block in blocks]
    return np.concatenate(met) if met else np.zeros(0, dtype=np.int64)
