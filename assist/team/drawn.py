"""People who are to be drawn for a task: from a population, or certain ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..people.arguments import Seed, entropy, whole
from ..people.choices import Choices
from ..people.human import Human
from ..people.ranges import Population
from ..person.settings import Setting


@runtime_checkable
class Estimated(Protocol):
    """People whose parameters were estimated, such as `assist.learning.FittedPeople`."""

    def simulated(self, setting: Setting) -> tuple[list[Human], Population, Setting]:
        """Return people whose true parameters are the estimates, the population like them, and their setting."""
        ...


@dataclass(frozen=True, eq=False)
class Drawn:
    """People who are to be drawn for a task.

    Attributes
    ----------
    size : int
        Their number.
    terms : tuple of str
        Terms of which they have weights.
    at : callable
        Returns the people for the choices in a task; None stands for any part of any task.
    """

    size: int
    terms: tuple[str, ...]
    at: Callable[[Choices | None], Sequence[Human]]

    @classmethod
    def of_population(cls, population: Population, size: int, seed: Seed) -> Drawn:
        """Return a number of people from a population."""
        size = whole("size", size, 1)
        return cls(size, tuple(population.weights), partial(_drawn, population, size, entropy(seed)))

    @classmethod
    def given(cls, people: Iterable[Human] | Mapping[str, Human]) -> Drawn:
        """Return certain people, with the names of a mapping.

        Raises
        ------
        TypeError
            Somebody is no `Human`.
        """
        if isinstance(people, Mapping):
            every = zip(people, _all_human(people.values()), strict=True)
            people = [replace(human, name=name) for name, human in every]
        them = list(_all_human(people))
        terms = tuple(dict.fromkeys(name for human in them for name in human.weights))
        return cls(whole("number of people", len(them), 1), terms, partial(_given, them))


def _all_human(people: Iterable[Any]) -> Iterator[Human]:
    """Yield people, each of whom is checked."""
    for human in people:
        if not isinstance(human, Human):
            raise TypeError(f"people: expected Human(beta, theta) for each, not what is a {type(human).__name__}")
        yield human


def _drawn(population: Population, size: int, seed: int, choices: Choices | None) -> list[Human]:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    return population.sample(choices, size, rng)


def _given(people: list[Human], choices: Choices | None) -> list[Human]:
    del choices
    return people
