"""One person's assistance problem as a mixed-observability POMDP.

The task's state x is observed; (beta, theta) is hidden on a `Grid`. In each step the robot says nothing,
suggests an action, or executes one itself; then the person acts, and x moves. An `AssistPOMDP` holds the
arrays from which a solver works and gives the two functions that a filter needs: the likelihood of what a
person did, and the belief after it. A `Policy` is what solvers hand on.

The robot's actions in a state are numbered from 0: nothing, then the suggestions, then the executions.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline

from ..people import belief as beliefs
from ..people.belief import Grid
from ..people.choice_model import ChoiceModel, boltzmann, chances, value
from ..people.decision import NOTHING, Floats, trust
from ..people.human import HumanModel, Mixture, Population

Suggestions = Literal["optimal", "all"]

NEVER = 1e-290
"""Chances below this count as 0: those of a person who always or never follows are divided by them."""


def check_costs(gamma: float, **costs: float) -> None:
    """Raise a `ValueError` unless gamma and the costs can be."""
    if not 0 < gamma < 1:
        raise ValueError(f"gamma {gamma:g}: expected 0 < gamma < 1")
    for name, cost in costs.items():
        if not 0 <= cost < np.inf:
            raise ValueError(f"{name} {cost:g}: expected 0 or more")


@dataclass(frozen=True)
class LeafBounds:
    """States at which a problem breaks off, with bounds on what any policy, and some policy, gets from there.

    Attributes
    ----------
    states : int array, shape (m,)
    lower : float array, shape (m, T) or (m, B, T)
        What some policy gets at least, for each theta and whatever beta is, or for each of both. Where only an upper
        bound is wanted it is `upper` (`large_tasks.truncated_bound`): what a solver then gives below is of a problem
        that ends so.
    upper : float array, shape (m,) or (m, B, T)
        What no policy exceeds; for each beta and theta, if that is known.
    floor : float, optional
        What every policy gets at least that says nothing any more.
    away : float array, shape (m, B, T), optional
        What no policy exceeds whose robot has to come first. Where it is given, a team's problem is taken to end here.
    value : float array, shape (m,), optional
        V(x) of eq. 7, what the person expects there; minus the cost-to-go unless given, as of somebody who knows it.
    """

    states: NDArray[np.int64]
    lower: Floats
    upper: Floats
    floor: float | None = None
    away: Floats | None = None
    value: Floats | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        for array in (self.states, self.lower, self.upper, self.away, self.value):
            if array is not None:
                array.flags.writeable = False


@dataclass(frozen=True, kw_only=True)
class AssistPOMDP:
    """The problem of assisting one person.

    Attributes
    ----------
    model : HumanModel
    grid : Grid
        The hidden values, B of beta and T of theta.
    gamma : float
        Discount factor per step, in (0, 1).
    c_suggest, c_execute : float
        Cost of a suggestion, and of executing an action, in the task's cost units.
    prior : float array, shape (B, T)
    robot_actions : int array, shape (n,)
        How many robot actions there are in each state.
    suggested : int array, shape (n, R)
        Slot that each robot action suggests; `NOTHING` in column 0, for executions, and in padding.
    afterstate : int array, shape (n, R)
        The state in which the person then acts: that after an execution, else the state itself.
    robot_costs : float array, shape (n, R)
        Cost of each robot action.
    chosen : float array, shape (n, A, B)
        The person's choice without a suggestion and without lapses.
    unsuggested : float array, shape (n, R, B)
        The chance of all slots but the suggested one, summed: 1 - p would lose its digits where p is almost 1.
    low, weight : int and float arrays, shape (n, R, T)
        Where a robot action moves theta to, as `Grid.shares` gives it.
    frontier : LeafBounds or None
        Where the problem breaks off, if it covers a part of a task only.
    order : int array, or None
        The states that are not final, in the order in which values are best worked out; by cost-to-go unless given.
    """

    model: HumanModel
    grid: Grid
    gamma: float
    c_suggest: float
    c_execute: float
    prior: Floats
    robot_actions: NDArray[np.int64]
    suggested: NDArray[np.int64]
    afterstate: NDArray[np.int64]
    robot_costs: Floats
    chosen: Floats
    unsuggested: Floats
    low: NDArray[np.int64]
    weight: Floats
    frontier: LeafBounds | None = None
    order: NDArray[np.int64] | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        for array in (
            self.prior, self.robot_actions, self.suggested, self.afterstate, self.robot_costs, self.chosen,
            self.unsuggested, self.low, self.weight, self.order,
        ):  # fmt: skip
            if array is not None:
                array.flags.writeable = False

    @classmethod
    def of(
        cls,
        model: HumanModel,
        *,
        chooses: ChoiceModel = boltzmann,
        grid: Grid | None = None,
        population: Population | Mixture | None = None,
        gamma: float = 0.99,
        c_suggest: float = 1.0,
        suggestions: Suggestions = "optimal",
        execute: bool = False,
        c_execute: float = 1.0,
        frontier: LeafBounds | None = None,
    ) -> AssistPOMDP:
        """Set up the problem for a person drawn from a population (the paper's, unless given).

        Parameters
        ----------
        chooses : ChoiceModel
            How people choose, beta being their type; the paper's unless given.
        suggestions : "optimal" or "all"
            Suggest only actions that begin a cheapest way to the goal, or any applicable action.
        execute : bool
            Whether the robot can also do such an action itself, after which the person acts.
        frontier : LeafBounds, optional
            Where the choices break off. Nothing can be executed there.
        """
        check_costs(gamma, c_suggest=c_suggest, c_execute=c_execute)
        if suggestions not in ("optimal", "all"):
            raise ValueError(f"suggestions '{suggestions}': expected 'optimal' or 'all'")
        if execute and frontier is not None:
            raise ValueError("execute: expected a problem of all states, and this one breaks off at a frontier")
        if execute and model.choices.state is not None:
            raise ValueError("execute: expected people without memory, and terms look at what they did last")
        population = population or Population()
        grid = grid or Grid.regular(population)
        choices = model.choices
        offered = choices.optimal if suggestions == "optimal" else choices.applicable & (choices.actions >= 0)
        offered = offered & ~choices.goal[:, None]
        count = offered.sum(axis=1)
        robot_actions = 1 + count * (2 if execute else 1)
        here = np.arange(len(choices))
        shape = (len(choices), int(robot_actions.max(initial=1)))
        suggested = np.full(shape, NOTHING, dtype=np.int64)
        afterstate = np.repeat(here[:, None], shape[1], axis=1)
        robot_costs = np.zeros(shape)
        state, slot = np.nonzero(offered)
        column = np.cumsum(offered, axis=1)[state, slot]
        suggested[state, column] = slot
        robot_costs[state, column] = c_suggest
        if execute:
            afterstate[state, column + count[state]] = choices.targets[state, slot]
            robot_costs[state, column + count[state]] = c_execute

        chosen = np.stack(list(chances(chooses, choices, model.q, grid.beta)), axis=-1)
        chosen[chosen < NEVER] = 0.0
        slots = np.arange(choices.applicable.shape[1])
        unsuggested = np.stack(
            [np.einsum("na,nab->nb", slots != column[:, None], chosen) for column in suggested.T], axis=1
        )
        v = value(chooses, choices, model.q)
        if frontier is not None:  # there a person sees no choices
            v[frontier.states] = -choices.h[frontier.states] if frontier.value is None else frontier.value
        # Without a suggestion the person expects to stay where they are, so that theta does not move.
        after = np.where(
            suggested == NOTHING, here[:, None], np.take_along_axis(choices.targets, np.maximum(suggested, 0), axis=1)
        )
        theta = trust(grid.theta, v[:, None, None], v[after][:, :, None], model.eta, model.utility_scale)
        low, weight = grid.shares(theta)
        return cls(
            model=model, grid=grid, gamma=gamma, c_suggest=c_suggest, c_execute=c_execute, prior=grid.prior(population),
            robot_actions=robot_actions, suggested=suggested, afterstate=afterstate, robot_costs=robot_costs,
            chosen=chosen, unsuggested=unsuggested, low=low, weight=weight, frontier=frontier,
        )  # fmt: skip

    def priced(self, c_suggest: float) -> AssistPOMDP:
        """Return the same problem where a suggestion costs something else."""
        check_costs(self.gamma, c_suggest=c_suggest)
        costs = np.where(self.suggested == NOTHING, self.robot_costs, c_suggest)
        return replace(self, c_suggest=c_suggest, robot_costs=costs)

    @cached_property
    def final(self) -> NDArray[np.bool_]:
        """Where the problem ends, shape (n,): at goals and on the frontier."""
        final = self.model.choices.goal.copy()
        if self.frontier is not None:
            final[self.frontier.states] = True
        final.flags.writeable = False
        return final

    def likelihood(self, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]) -> Floats:
        """Give P(action | x, robot, beta, theta), shape (N, B, T).

        Parameters
        ----------
        x, robot, action : int arrays, shape (N,)
            State, the robot's action (0: nothing), and the slot of what the person did then.
        """
        suggestion, acting = self.suggested[x, robot], self.afterstate[x, robot]
        p = self.chosen[acting, action][:, :, None]
        followed = self.chosen[acting, np.maximum(suggestion, 0)][:, :, None]
        theta = self.grid.theta
        total = theta * followed + (1 - theta) * self.unsuggested[x, robot][:, :, None]
        weight = np.where((action == suggestion)[:, None, None], theta, 1 - theta)
        heard = (suggestion != NOTHING)[:, None, None] & (total > 0)
        influenced = np.divide(
            weight * p, total, out=np.zeros(np.broadcast_shapes(p.shape, total.shape)), where=total > 0
        )
        likelihood = np.where(heard, influenced, p)
        count = self.model.choices.applicable[acting].sum(axis=1)[:, None, None]
        return (1 - self.model.lapse) * likelihood + self.model.lapse / count

    def update(
        self, belief: Floats, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]
    ) -> Floats:
        """Give the beliefs, shape (N, B, T), after people's actions; arguments as in `likelihood`."""
        return beliefs.update(belief, self.likelihood(x, robot, action), self.low[x, robot], self.weight[x, robot])

    @cached_property
    def suggests_optimal(self) -> NDArray[np.bool_]:
        """Which robot actions suggest an optimal action, shape (n, R)."""
        slot = np.maximum(self.suggested, 0)
        suggests = (self.suggested != NOTHING) & np.take_along_axis(self.model.choices.optimal, slot, axis=1)
        suggests.flags.writeable = False
        return suggests

    @cached_property
    def first_optimal(self) -> NDArray[np.int64]:
        """The first robot action of each state that suggests an optimal action, shape (n,); 0: there is none."""
        first = self.suggests_optimal.argmax(axis=1)
        first.flags.writeable = False
        return first

    def suggestion(self, x: int, robot: int) -> str | None:
        """Name in PDDL what a robot action suggests; None for nothing."""
        slot = int(self.suggested[x, robot])
        return None if slot == NOTHING else self.model.choices.name(x, slot)

    def executes(self, x: int, robot: int) -> str | None:
        """Name in PDDL what a robot action executes; None for nothing."""
        if robot == 0 or self.suggested[x, robot] != NOTHING:
            return None
        suggestions = (int(self.robot_actions[x]) - 1) // 2  # the executions come after them, in the same order
        return self.model.choices.name(x, int(self.suggested[x, robot - suggestions]))


class Policy(Protocol):
    """A policy for one person's problem; the methods work on N people at a time."""

    @property
    def pomdp(self) -> AssistPOMDP:
        """The problem."""
        ...

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each robot action, shape (N, R); minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        ...

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each person's problem, shape (N,)."""
        ...

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,)."""
        ...


class Later:
    """One person's policy, worked out when it is first asked for anything but the problem.

    Any thread may ask. What the policy has beyond a `Policy` is an attribute of this one, too.

    Parameters
    ----------
    pomdp : AssistPOMDP
    solver : callable
        Gives the policy for the problem.
    """

    def __init__(self, pomdp: AssistPOMDP, solver: Callable[[AssistPOMDP], Policy]) -> None:
        self.pomdp, self.solver = pomdp, solver
        self._lock, self._solved = threading.Lock(), list[Policy]()

    def __repr__(self) -> str:
        return f"Later({self._solved[0] if self._solved else self.pomdp!r})"

    def prepare(self) -> Policy:
        """Give the policy; worked out once."""
        with self._lock:
            if not self._solved:
                self._solved.append(self.solver(self.pomdp))
            return self._solved[0]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.prepare(), name)

    def q_values(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each robot action, shape (N, R); minus infinity in padding."""
        return self.prepare().q_values(x, belief)

    def value(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Give the value of each person's problem, shape (N,)."""
        return self.prepare().value(x, belief)

    def choose(self, x: NDArray[np.int64], belief: Floats) -> NDArray[np.int64]:
        """Give the best robot action for each person, shape (N,)."""
        return self.prepare().choose(x, belief)


def work_out(policy: Policy) -> None:
    """Work a policy out now, if that is otherwise done when it is first asked."""
    prepare = getattr(policy, "prepare", None)
    if prepare is not None:
        prepare()
