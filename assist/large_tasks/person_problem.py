"""One person's problem on a task of any size: all of its states, or those that matter to one person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Table
from planner.system.arrays import outline

from ..people.arguments import whole
from ..people.decision import perceived_cost, perceived_cost_to_go
from ..people.human import HumanModel, Mixture, Population
from ..people.memory import choices_of
from ..person.pomdp import AssistPOMDP, Suggestions
from .truncated_task import TruncatedTask

WHOLE = 20_000
"""States of a table up to which all are worked out, and those of a region beyond it."""

ASKED = 200
"""States of a region where each has to be asked for."""


def is_whole(known: CostToGo, states: int | None = None) -> TypeGuard[Table]:
    """Decide whether a person's problem covers all of a task, or only a `TruncatedTask` of it.

    All of it does if every cost-to-go is known and there are at most so many states: then nothing breaks off, the
    value is that of the task, and people's misconceptions and the robot's own actions may lead anywhere. A solver
    keeps much of each state and can do no more than that many. Where each state has to be asked for, nobody knows how
    many there are; so that is a region always.

    Parameters
    ----------
    known : CostToGo
    states : int, optional
        `WHOLE` unless given.
    """
    return isinstance(known, Table) and len(known) <= (WHOLE if states is None else states)


@dataclass(frozen=True)
class PersonProblem:
    """The problem of assisting one person, and where its states are in the task.

    Attributes
    ----------
    known : CostToGo
        The task's cost-to-go.
    pomdp : AssistPOMDP
        Its `frontier` is None if it covers the whole task.
    states : int array, shape (n,)
        The number of each of the problem's states in `known`.
    """

    known: CostToGo
    pomdp: AssistPOMDP
    states: NDArray[np.int64]

    __repr__ = outline

    @classmethod
    def of(
        cls,
        known: CostToGo,
        *,
        states: int | None = None,
        start: int | None = None,
        population: Population | Mixture | None = None,
        eta: float = 0.2,
        lapse: float = 1e-3,
        utility_scale: float = 1.0,
        gamma: float = 0.99,
        c_suggest: float = 1.0,
        suggestions: Suggestions = "optimal",
        execute: bool = False,
        c_execute: float = 1.0,
        sigma: float = 0.0,
        seed: int | np.random.Generator = 0,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> PersonProblem:
        """Set up the problem, on all states or on a region of them as `is_whole` decides.

        What is not listed is as in `AssistPOMDP.of` and `HumanModel`.

        Parameters
        ----------
        known : CostToGo
        states : int, optional
            The most states to work out; 20,000 of a table unless given, 200 where each has to be asked for.
        start : int, optional
            Where a region begins; in the initial state unless given.
        sigma : float
            Size of a misconception, which the robot knows; of a whole task only.
        seed : int or Generator
            From which it is drawn.
        time_limit : float, optional
            Seconds for collecting a region's states.
        progress : callable, optional
            Called with how many of them have been looked at since the last call.

        Raises
        ------
        ValueError
            Parameters that cannot be, or a misconception, executed actions, terms or a choice model on a region.
        """
        if not 0 <= sigma < np.inf:
            raise ValueError(f"sigma {sigma:g}: expected 0 or more")
        states = None if states is None else whole("states", states, 1)
        if is_whole(known, states):
            people = population or Population()
            choices = choices_of(known, people.weights)
            h = perceived_cost_to_go(choices, sigma, np.random.default_rng(seed)) if sigma else choices.h
            model = HumanModel(choices, perceived_cost(choices, h), eta=eta, lapse=lapse, utility_scale=utility_scale)
            pomdp = AssistPOMDP.of(
                model, chooses=people.typical, population=people, gamma=gamma, c_suggest=c_suggest,
                suggestions=suggestions, execute=execute, c_execute=c_execute,
            )  # fmt: skip
            return cls(known, pomdp, choices.of_task(np.arange(len(known))))
        if states is None:
            states = ASKED if known.searches else WHOLE
        own = population is not None and (population.weights or population.chooses is not None)
        for name, given in (
            ("sigma", sigma > 0),
            ("execute", execute),
            ("people who do not choose by cost alone", own),
        ):
            if given:
                raise ValueError(f"{name}: expected a task of at most {states:,} states, and all of them known")
        region = TruncatedTask.of(
            known, start=start, states=states, population=population, time_limit=time_limit, progress=progress
        )
        pomdp = region.problem(
            population=population, eta=eta, lapse=lapse, utility_scale=utility_scale, gamma=gamma,
            c_suggest=c_suggest, suggestions=suggestions,
        )  # fmt: skip
        return cls(known, pomdp, region.states)
