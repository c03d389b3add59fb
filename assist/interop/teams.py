"""Teams that are stepped from outside: whoever steps them chooses what the robots do, and when an episode begins.

The rules are those of `assist.simulation`: with the same luck and the same choices the same happens. Each team has a
clock of its own, so that one may begin again while others go on.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import load, sweep

from ..people.decision import NOTHING, Floats
from ..people.human import Mixture, Population
from ..simulation.common_random_numbers import from_the_prior
from ..simulation.dynamics import PeopleArrays, act
from ..simulation.pool import LARGEST, Pool
from ..simulation.task_view import ModelGroup, World
from ..team.settings import Setting
from ..team.state import BASE, NOBODY, TeamAction, TeamState, by_model


def pool_of(
    instance: str | Path | Pool,
    *,
    size: int,
    seed: int,
    setting: Setting | None,
    population: Population | Mixture | None,
) -> Pool:
    """Draw the people of environments: of a task by its file or name; a pool that is there already stays as it is."""
    if isinstance(instance, Pool):
        return instance
    table = sweep(load(instance), max_states=LARGEST)
    return Pool.sample(table, size, seed=seed, setting=setting, population=population, states=LARGEST)


class Teams:
    """N teams of K people each, and a robot for each of them.

    Attributes
    ----------
    x, finished, erred, theta, ... : arrays, shape (N, K)
        As in `TeamState`; `people` are numbers of the pool.
    belief : float array, shape (N, K, B, T), or None
        None where none is kept (`filters`).
    location, busy_until, clock : int arrays, shape (N,)
        Where the robot is, from which step on it is there, and how many steps the episode has had.
    """

    def __init__(
        self,
        pool: Pool,
        teams: int,
        places: int,
        *,
        distance: ArrayLike | None = None,
        world: World = "people",
        filters: bool = True,
    ) -> None:
        if pool.truncated:
            raise ValueError("pool: expected people on a task that is looked at whole (Pool.sample, `states`)")
        self.pool, self.on_grid = pool, world == "model"
        self.travel = pool.setting.travel(places, distance)
        self.groups = {number: ModelGroup.of_model(pool, number, world) for number in range(len(pool.policies))}
        self._row = np.sum([group.row for group in self.groups.values()], axis=0)
        choices = [pool.choices(number) for number in range(len(pool.people))]
        self._initial = np.array([one.initial for one in choices])
        self._at_goal = np.array([one.goal[one.initial] for one in choices])
        self._hidden = np.array([[human.beta, human.theta] for human in pool.people])
        self._prior = np.array([policy.pomdp.prior for policy in pool.policies])
        shape = (teams, places)
        self.people, self.model, self.who, self.x = (np.zeros(shape, dtype=np.int64) for _ in range(4))
        self.beta, self.theta = np.zeros(shape), np.zeros(shape)
        self.finished, self.erred = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        self.belief = np.zeros((*shape, *self._prior.shape[1:])) if filters else None
        self.location, self.busy_until, self.clock = (np.zeros(teams, dtype=np.int64) for _ in range(3))

    def begin(self, rows: NDArray[np.int64], people: NDArray[np.int64], draw: Callable[[], Floats]) -> None:
        """Begin an episode in some teams.

        Parameters
        ----------
        rows : int array, shape (m,)
        people : int array, shape (m, K)
            Numbers of the pool.
        draw : callable
            Gives uniform numbers, shape (m, K), that decide who people are in the model's world; called in that only.
        """
        self.people[rows], self.model[rows], self.who[rows] = people, self.pool.model[people], self._row[people]
        self.beta[rows], self.theta[rows] = np.moveaxis(self._hidden[people], -1, 0)
        self.x[rows], self.finished[rows], self.erred[rows] = self._initial[people], self._at_goal[people], False
        if self.belief is not None:
            self.belief[rows] = self._prior[self.model[rows]]
        self.location[rows], self.busy_until[rows], self.clock[rows] = BASE, 0, 0
        if self.on_grid:
            pomdps = [solved.pomdp for solved in self.pool.policies]
            self.who[rows], self.beta[rows], self.theta[rows] = from_the_prior(pomdps, self.model[rows], draw())

    def free(self) -> NDArray[np.bool_]:
        """Say which robots are under way to nobody, shape (N,)."""
        return self.busy_until <= self.clock

    def state(self) -> TeamState:
        """Give what the robots know, as team policies read it; the step is that of the team that has had most."""
        return TeamState(
            step=int(self.clock.max()), x=self.x, active=~self.finished, erred=self.erred, location=self.location,
            model=self.model, belief=self.belief, policies=self.pool.policies, travel=self.travel,
        )  # fmt: skip

    def send(self, action: TeamAction) -> tuple[NDArray[np.int64], Floats]:
        """Let robots go and speak; give what they do to each person and what going there costs, shape (N, K)."""
        robot, charged = np.zeros_like(self.x), np.zeros(self.x.shape)
        rows = np.flatnonzero(action.person != NOBODY)
        to, origin = action.person[rows], self.location[rows]
        robot[rows, to] = action.robot[rows]
        charged[rows, to] = self.travel.c_move * self.travel.distance[origin, to]
        self.busy_until[rows] = self.clock[rows] + self.travel.steps[origin, to]
        self.location[rows] = to
        return robot, charged

    def step(self, rows: NDArray[np.int64], robot: NDArray[np.int64], luck: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Let everybody who has not finished act once, in some teams.

        Parameters
        ----------
        rows : int array, shape (m,)
        robot : int array, shape (N, K)
            What is done to each person.
        luck : float array, shape (N, K, 2)
            Uniform numbers: for their choices, and in the model's world for the moves of theta.

        Returns
        -------
        slot : int array, shape (N, K)
            What each did; -1 where they did nothing.
        cost : float array, shape (N, K)
            What the robot's suggestions and people's actions cost.
        """
        there = np.zeros(self.x.shape, dtype=bool)
        there[rows] = ~self.finished[rows]
        charged = np.zeros(self.x.size)
        people = PeopleArrays.of_teams(self.x, robot, self.who, self.theta, luck, self.belief, self.erred)
        for number, at in by_model(self.model.reshape(-1), np.flatnonzero(there), len(self.pool.policies)):
            group = self.groups[number]
            charged[at] = group.arrays.robot_costs[people.x[at], people.robot[at]]
            act(at, people, group.minds, group.arrays)
            self.finished.reshape(-1)[at] = group.arrays.goal[people.x[at]]
        self.clock[rows] += 1
        return people.slot.reshape(self.x.shape), (people.cost + charged).reshape(self.x.shape)


class Sight:
    """What a learner sees of teams: arrays with the teams as their first axis, and which actions are possible.

    Attributes
    ----------
    robots : int
        R: the most robot actions in any state of anybody.
    states, models : int
        How many states the largest task has, and how many models of people there are.
    hidden : tuple of int
        B and T, the shape of a belief.
    largest : float
        Above any cost-to-go: what is seen of a dead end.
    """

    def __init__(self, teams: Teams, *, beliefs: bool) -> None:
        self.teams, self.beliefs = teams, beliefs
        pomdps = [policy.pomdp for policy in teams.pool.policies]
        self.hidden = pomdps[0].grid.shape
        lengths = [len(pomdp.robot_actions) for pomdp in pomdps]
        self.robots = max(pomdp.suggested.shape[1] for pomdp in pomdps)
        self.states, self.models = max(lengths), len(pomdps)
        self._offset = np.cumsum([0, *lengths[:-1]])
        self._count = np.concatenate([pomdp.robot_actions for pomdp in pomdps])
        h = np.concatenate([pomdp.model.choices.h for pomdp in pomdps])
        self.largest = float(h[np.isfinite(h)].max()) + 1.0
        self._h = np.where(np.isfinite(h), h, self.largest).astype(np.float32)

    @cached_property
    def _alone(self) -> Floats:
        """How likely each beta does by itself what robot actions suggest, shape (states of all models, R, B)."""
        parts = []
        for policy in self.teams.pool.policies:
            pomdp = policy.pomdp
            slot = np.maximum(pomdp.suggested, 0)[:, :, None]
            part = np.zeros((len(slot), self.robots, pomdp.chosen.shape[2]))
            suggests = (pomdp.suggested != NOTHING)[:, :, None]
            part[:, : slot.shape[1]] = np.where(suggests, np.take_along_axis(pomdp.chosen, slot, axis=1), 0.0)
            part[:, 0] = np.where(pomdp.model.choices.optimal[:, :, None], pomdp.chosen, 0.0).sum(axis=1)
            parts.append(part)
        return np.concatenate(parts).clip(0.0, 1.0)

    @cached_property
    def _alone_at_first(self) -> NDArray[np.float32]:
        """The same for a person of whom only the prior is known, shape (states of all models, R)."""
        prior = np.concatenate([
            np.broadcast_to(policy.pomdp.prior.sum(axis=1), (len(policy.pomdp.robot_actions), len(policy.pomdp.prior)))
            for policy in self.teams.pool.policies
        ])  # fmt: skip
        return np.einsum("nrb,nb->nr", self._alone, prior).clip(0.0, 1.0).astype(np.float32)

    def mask(self) -> NDArray[np.int8]:
        """Say which robot actions each person's state has, shape (N, K, R); only nothing for who has finished."""
        teams = self.teams
        count = np.where(teams.finished, 1, self._count[self._offset[teams.model] + teams.x])
        return (np.arange(self.robots) < count[:, :, None]).astype(np.int8)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Give what is seen of people, each array of shape (N, K) or (N, K, ...)."""
        teams = self.teams
        row = self._offset[teams.model] + teams.x
        active = ~teams.finished
        if self.beliefs and teams.belief is not None:
            beta = teams.belief.sum(axis=3)
            alone = np.einsum("nkrb,nkb->nkr", self._alone[row], beta).clip(0.0, 1.0).astype(np.float32)
        else:
            alone = self._alone_at_first[row]
        seen: dict[str, NDArray[Any]] = {
            "active": active.astype(np.int8),
            "alone": alone * active[:, :, None],
            "cost_to_go": self._h[row] * active,
            "erred": (teams.erred & active).astype(np.int8),
            "model": teams.model.copy(),
            "state": teams.x.copy(),
        }
        if self.beliefs and teams.belief is not None:
            seen["belief"] = teams.belief.astype(np.float32).clip(0.0, 1.0)
        return seen
