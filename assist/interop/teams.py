"""Teams for environments: the caller chooses the robots' actions and when an episode begins.

The dynamics are those of `assist.simulation`: the same random numbers and the same actions have the same outcome. Each
team has its own clock, so that one team may begin an episode while others continue theirs.
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
from ..people.hidden_type import drawn_goals, mean_over_goals
from ..people.human import Population
from ..person.beliefs import Acts, Seen
from ..person.dynamics import PeopleArrays
from ..simulation.common_random_numbers import from_the_prior
from ..simulation.model_group import ModelGroup, World
from ..simulation.pool import MAX_ENUMERATED, Pool
from ..team.assignment import placed
from ..team.settings import Setting
from ..team.state import BASE, NOBODY, TeamAction, TeamState, by_model


class PoolSource:
    """The pool of an environment: a given one, or people at a task who are drawn with a seed.

    Unless the seed is given, they are those of seed 0 until the first `reset` with a seed, which draws the people of
    `kitassist simulate` with that seed. They stay until the end.

    Parameters
    ----------
    instance : str, Path or Pool
    humans : int
        Number of people in a team.
    people, seed, setting, population, optional
        As in `TeamEnv`; not together with a pool.

    Raises
    ------
    TypeError
        `instance` is something else, such as a list of tasks.
    ValueError
        A parameter has no effect, or `humans` is not between 1 and the size of the pool.
    """

    def __init__(
        self, instance: str | Path | Pool, humans: int, *, people: int | None, seed: int | None,
        setting: Setting | None, population: Population | None,
    ) -> None:  # fmt: skip
        if not isinstance(instance, str | Path | Pool):
            raise TypeError(
                f"instance: expected one task, by its file or name, or a Pool, not what is a {type(instance).__name__}"
            )
        self._options: dict[str, Any] = {"setting": setting, "population": population}
        if isinstance(instance, Pool):
            for name, value in {"people": people, "pool_seed": seed, **self._options}.items():
                if value is not None:
                    raise ValueError(f"{name} has no effect with a pool, which has its own; expected none")
            self._waits, self.pool = False, instance
        else:
            self._waits, self._size = seed is None, max(12, humans) if people is None else people
            self._table = sweep(load(instance), max_states=MAX_ENUMERATED)
            self.pool = self._sample(0 if seed is None else seed)
        self.pool.setting.require_questions(1)
        self.pool.setting.require_effect()
        if not 1 <= humans <= len(self.pool.people):
            raise ValueError(f"humans {humans}: expected 1 to {len(self.pool.people)}, the size of the pool")

    def _sample(self, seed: int) -> Pool:
        return Pool.sample(self._table, self._size, seed=seed, states=MAX_ENUMERATED, **self._options)

    def drawn(self, seed: int | None) -> bool:
        """Draw the pool if this is the first reset with a seed, and return whether it was drawn now."""
        if seed is None or not self._waits:
            return False
        self._waits, self.pool = False, self._sample(seed)
        return True


class Teams:
    """N teams of K people each, with the robots of the pool's setting.

    Attributes
    ----------
    x, finished, erred, theta, ... : arrays, shape (N, K)
        As in `TeamState`; `people` are indices into the pool.
    belief : float array, shape (N, K, H, T), or None
        The belief in each person's type and theta; None without `filters`.
    location, busy_until : int arrays, shape (N, M)
        Where each robot is or is going, and the step of its arrival.
    clock : int array, shape (N,)
        Number of steps of the episode so far.

    Raises
    ------
    ValueError
        The pool is of a truncated task.
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
        pool.setting.require_all_seen("an environment")
        for policy in pool.policies:
            policy.require_enumerated("pool")
        self.pool, self.on_grid = pool, world == "model"
        self.travel, self.fleet = pool.setting.travel(places, distance), pool.setting.fleet
        self.groups = {number: ModelGroup(pool, number, world) for number in range(len(pool.policies))}
        self._row = np.sum([group.row for group in self.groups.values()], axis=0)
        choices = [pool.choices(number) for number in range(len(pool.people))]
        self._initial = np.array([one.initial for one in choices])
        self._at_goal = np.array([one.goal[one.initial] for one in choices])
        self._hidden = np.array([[human.beta, human.theta] for human in pool.people])
        self._prior = np.array([policy.pomdp.prior for policy in pool.policies])
        shape = (teams, places)
        self.people, self.model, self.who, self.x = (np.zeros(shape, dtype=np.int64) for _ in range(4))
        self.beta, self.theta, self.seen = np.zeros(shape), np.zeros(shape), np.zeros(shape, dtype=np.int64)
        self.finished, self.erred = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        self.belief = np.zeros((*shape, *self._prior.shape[1:])) if filters else None
        self.clock = np.zeros(teams, dtype=np.int64)
        self.location, self.busy_until = np.zeros((2, teams, len(self.fleet)), dtype=np.int64)

    def begin(self, rows: NDArray[np.int64], people: NDArray[np.int64], draw: Callable[[int], Floats]) -> None:
        """Begin an episode in some teams.

        Parameters
        ----------
        rows : int array, shape (m,)
        people : int array, shape (m, K)
            Indices into the pool.
        draw : callable
            Returns uniform numbers, shape (m, K), of a kind of `CommonRandomNumbers`. They draw people's goals or, in
            the world "model", their types and theta from the prior.
        """
        self.people[rows], self.model[rows] = people, self.pool.model[people]
        self.beta[rows], self.theta[rows] = np.moveaxis(self._hidden[people], -1, 0)
        self.seen[rows] = 0
        self.x[rows], self.finished[rows], self.erred[rows] = self._initial[people], self._at_goal[people], False
        if self.belief is not None:
            self.belief[rows] = self._prior[self.model[rows]]
        self.location[rows], self.busy_until[rows], self.clock[rows] = BASE, 0, 0
        pomdps = [solved.pomdp for solved in self.pool.policies]
        if self.on_grid:
            _, self.who[rows], self.beta[rows], self.theta[rows] = from_the_prior(pomdps, self.model[rows], draw(0))
        else:
            self.who[rows] = self._row[people]
            if self.pool.goals > 1:
                self.who[rows] += drawn_goals([pomdp.hidden.goals for pomdp in pomdps], self.model[rows], draw(4))

    def free(self) -> NDArray[np.bool_]:
        """Return which robots are not under way, shape (N, M)."""
        return self.busy_until <= self.clock[:, None]

    def reachable(self) -> NDArray[np.bool_]:
        """Return to which people each robot may be sent, shape (N, M, K).

        No person to whom another robot is under way, and none while the robot itself is.
        """
        free = self.free()
        going = np.repeat(free[..., None], self.x.shape[1], axis=-1)
        teams, robots = np.nonzero(~free)
        going[teams, :, self.location[teams, robots]] = False
        return going

    def state(self) -> TeamState:
        """Return the state that team policies read; its step is the largest clock of any team."""
        return TeamState(
            step=int(self.clock.max()), x=self.x, active=~self.finished, erred=self.erred, location=self.location,
            model=self.model, belief=self.belief, policies=self.pool.policies, travel=self.travel,
            free=self.free(), fleet=self.fleet,
        )  # fmt: skip

    def send(self, action: TeamAction) -> tuple[NDArray[np.int64], Floats]:
        """Send the robots; return their action on each person and the costs, both of shape (N, K).

        They are the costs of moving and what an action of each robot costs more than one of the best, in cost units.
        """
        robot, charged = np.zeros_like(self.x), np.zeros(self.x.shape)
        rows, number = sent = np.nonzero(action.person != NOBODY)
        to, origin, does = action.person[sent], self.location[sent], action.robot[sent]
        robot[rows, to] = does
        charged[rows, to] = self.travel.costs_between(number, origin, to)
        self.busy_until[sent] = self.clock[rows] + self.travel.steps_between(number, origin, to)
        self.location[:] = placed(self.location, action.person)
        for model, at in by_model(self.model[rows, to], np.flatnonzero(does > 0), len(self.pool.policies)):
            x, suggested = self.x[rows[at], to[at]], self.pool.policies[model].pomdp.suggested
            charged[rows[at], to[at]] += self.fleet.extra_of(number[at], suggested[x, does[at]] == NOTHING)
        return robot, charged

    def collisions(self, person: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which robots are sent to where another one goes or stays with its task, shape (N, M).

        Of two robots that are sent to a person, the first one goes there. A robot that is not sent makes room.
        """
        refused = np.zeros(person.shape, dtype=bool)
        while True:
            after = np.where((person == NOBODY) | refused, self.location, person)
            moves = after != self.location
            stays = ~moves & (person != NOBODY) & ~refused
            same = (after[:, :, None] == after[:, None]) & (after != BASE)[:, :, None]
            before = np.tri(person.shape[1], k=-1, dtype=bool)  # [m, l]: l is before m
            wrong = moves & (same & (before & moves[:, None] | stays[:, None])).any(axis=2)
            if not wrong.any():
                return refused
            refused |= wrong

    def step(
        self, rows: NDArray[np.int64], robot: NDArray[np.int64], draws: Floats
    ) -> tuple[NDArray[np.int64], Floats]:
        """Let each person who has not finished act once, in some teams.

        Parameters
        ----------
        rows : int array, shape (m,)
        robot : int array, shape (N, K)
            The robot action on each person.
        draws : float array, shape (N, K, 2)
            Uniform numbers for the choices and, in the world "model", for the transitions of theta.

        Returns
        -------
        slot : int array, shape (N, K)
            The slot of each person's action; -1 for people who did not act.
        cost : float array, shape (N, K)
            The cost of robot actions and of people's actions, in cost units.
        """
        there = np.zeros(self.x.shape, dtype=bool)
        there[rows] = ~self.finished[rows]
        charged = np.zeros(self.x.size)
        before, models = self.x.reshape(-1).copy(), []
        people = PeopleArrays.of_teams(self.x, robot, self.who, self.theta, self.seen, draws)
        for number, at in by_model(self.model.reshape(-1), np.flatnonzero(there), len(self.pool.policies)):
            group = self.groups[number]
            models.append((group.model, at))
            charged[at] = group.arrays.robot_costs[people.x[at], people.robot[at]]
            group.act(at, people)
            self.finished.reshape(-1)[at] = group.ended(at, people)
        self.clock[rows] += 1
        acts = Acts(before, people.robot, people.slot, ~self.finished.reshape(-1))
        belief = np.empty((0, 1, 1)) if self.belief is None else self.belief.reshape(-1, *self.belief.shape[2:])
        Seen(people.x, belief, self.erred.reshape(-1)).observe(acts, people.robot, models, lambda _: np.empty(0))
        return people.slot.reshape(self.x.shape), (people.cost + charged).reshape(self.x.shape)


class Sight:
    """Observations of teams for a learner, and masks of possible actions; the first axis of each array is the team.

    Attributes
    ----------
    robots : int
        R, the largest number of robot actions in any state of any model.
    states, models : int
        The number of states of the largest model, and the number of models.
    hidden : tuple of int
        H and T, the shape of a belief.
    largest : float
        The value that stands for the infinite cost-to-go of a dead end: 1 above the largest finite one (cost units).
    """

    def __init__(self, teams: Teams, *, beliefs: bool) -> None:
        self.teams, self.beliefs = teams, beliefs
        pomdps = [policy.pomdp for policy in teams.pool.policies]
        self.hidden, self._prior = pomdps[0].prior.shape, np.array([pomdp.prior for pomdp in pomdps])
        lengths = [len(pomdp.robot_actions) for pomdp in pomdps]
        self.robots = max(pomdp.suggested.shape[1] for pomdp in pomdps)
        self.states, self.models = max(lengths), len(pomdps)
        self._offset = np.cumsum([0, *lengths[:-1]])
        self._count = np.concatenate([pomdp.robot_actions for pomdp in pomdps])
        h = np.concatenate([pomdp.model.choices.goals.h for pomdp in pomdps], axis=1)
        self.largest = float(h[np.isfinite(h)].max()) + 1.0
        self._h = np.where(np.isfinite(h), h, self.largest).astype(np.float32)

    @cached_property
    def _alone(self) -> Floats:
        """Probabilities of doing what each robot action suggests, without it; shape (states of all models, R, H).

        Entry [x, r, h] is the probability that a person of type h chooses the action that robot action r suggests.
        For r = 0, nothing, it is the probability of an optimal action.
        """
        parts = []
        for policy in self.teams.pool.policies:
            pomdp = policy.pomdp
            slot = np.maximum(pomdp.suggested, 0)[:, :, None]
            part = np.zeros((len(slot), self.robots, pomdp.chosen.shape[2]))
            suggests = (pomdp.suggested != NOTHING)[:, :, None]
            part[:, : slot.shape[1]] = np.where(suggests, np.take_along_axis(pomdp.chosen, slot, axis=1), 0.0)
            part[:, 0] = np.where(pomdp.model.choices.goals.optimal[:, :, pomdp.hidden.goal_of], pomdp.chosen, 0.0).sum(
                axis=1
            )
            parts.append(part)
        return np.concatenate(parts).clip(0.0, 1.0)

    @cached_property
    def _alone_at_first(self) -> NDArray[np.float32]:
        """The mean of `_alone` over types under the robot's prior, shape (states of all models, R)."""
        prior = np.concatenate([
            np.broadcast_to(policy.pomdp.prior.sum(axis=1), (len(policy.pomdp.robot_actions), len(policy.pomdp.prior)))
            for policy in self.teams.pool.policies
        ])  # fmt: skip
        return np.einsum("nrb,nb->nr", self._alone, prior).clip(0.0, 1.0).astype(np.float32)

    def mask(self) -> NDArray[np.int8]:
        """Return the mask of robot actions of each person, shape (N, K, R); finished people have only action 0."""
        teams = self.teams
        count = np.where(teams.finished, 1, self._count[self._offset[teams.model] + teams.x])
        return (np.arange(self.robots) < count[:, :, None]).astype(np.int8)

    def _cost_to_go(self, row: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the mean cost-to-go over the goals, shape (N, K), under the beliefs or, without them, the prior."""
        known = self.teams.pool.policies[0].pomdp.hidden
        if len(known.goals) == 1:
            return self._h[0, row]
        belief = self._prior[self.teams.model] if self.teams.belief is None else self.teams.belief
        return mean_over_goals(
            np.moveaxis(self._h[:, row].astype(np.float64), 0, -1), known.marginal(belief, "goal")
        ).astype(np.float32)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the observation of all people, each array of shape (N, K) or (N, K, ...)."""
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
            "cost_to_go": self._cost_to_go(row) * active,
            "erred": (teams.erred & active).astype(np.int8),
            "model": teams.model.copy(),
            "state": teams.x.copy(),
        }
        if self.beliefs and teams.belief is not None:
            seen["belief"] = teams.belief.astype(np.float32).clip(0.0, 1.0)
        return seen
