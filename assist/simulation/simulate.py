"""Episodes of a team: several people at work, one robot.

All episodes advance together, one step at a time. Episodes are numbered, and their random numbers are drawn
for a block of them at a time from the seed and the block's number alone: policies meet the same people with
the same luck (common random numbers), and results do not depend on how episodes are divided among processes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..people.human import NOTHING, Floats, perceived_cost, perceived_value
from ..person.qmdp import Arrays
from ..team.pool import Pool
from ..team.state import BASE, NOBODY, TeamPolicy, TeamState, Travel, by_model
from .dynamics import Minds, People, act
from .episodes import Episodes, Trace

World = Literal["people", "model"]

BLOCK = 64
"""Episodes whose random numbers are drawn together."""

TOGETHER = 16_384
"""People who are simulated at a time: what is known of them should stay in the processor's cache."""


@dataclass(frozen=True)
class Presence:
    """When people are there.

    Attributes
    ----------
    joins : int array, shape (K,)
        The step in which the person at each place begins.
    leaves : int array, shape (K,)
        The step in which they are gone, finished or not.
    """

    joins: NDArray[np.int64]
    leaves: NDArray[np.int64]

    @classmethod
    def of(cls, humans: int, joins: ArrayLike = 0, leaves: ArrayLike | None = None) -> Presence:
        """Describe so many people: all from the beginning until they have finished, unless given."""
        never = np.iinfo(np.int64).max
        return cls(
            np.broadcast_to(np.asarray(joins, dtype=np.int64), (humans,)),
            np.broadcast_to(np.asarray(never if leaves is None else leaves, dtype=np.int64), (humans,)),
        )

    def __post_init__(self) -> None:
        if (self.joins < 0).any() or (self.leaves <= self.joins).any():
            raise ValueError("presence: expected people to join at step 0 or later and to leave after that")


def simulate(
    pool: Pool,
    policy: TeamPolicy,
    *,
    humans: int | ArrayLike,
    episodes: Sequence[int] | int,
    seed: int,
    name: str = "policy",
    travel: Travel | None = None,
    presence: Presence | None = None,
    world: World = "people",
    trace: Trace | None = None,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Episodes:
    """Simulate episodes of teams drawn from a pool.

    Parameters
    ----------
    pool : Pool
    policy : callable
        A team policy.
    humans : int, or int array, shape (K,) or (N, K)
        People per team, drawn from the pool without replacement; or who is in the team, at which place, in every
        episode or in each.
    episodes : int or sequence of int
        How many episodes, or their numbers.
    seed : int
    name : str
        What the policy is called in the records.
    travel : Travel, optional
        The way between the places; that of the setting unless given.
    presence : Presence, optional
        When people are there; all from the beginning unless given.
    world : "people" or "model"
        Whether the pool's people act, or others as the robot's models have them: beta and theta drawn from
        the prior, on its grid, with lapses. In the second world a model's bounds hold.
    trace : list, optional
        Every action of every person is appended to it, one dictionary each.
    jobs : int
        Threads that simulate at a time. The policy is then called by several; results do not depend on it.
    progress : callable, optional
        Called with the number of episodes that have been finished since the last call.
    """
    numbers = np.arange(episodes) if isinstance(episodes, int) else np.asarray(episodes, dtype=np.int64)
    teams: NDArray[np.int64] | None = None
    if isinstance(humans, int):
        if not 1 <= humans <= len(pool.people):
            raise ValueError(f"{humans} people per team: expected 1 to {len(pool.people)}, the size of the pool")
        places = humans
    else:
        given = np.asarray(humans, dtype=np.int64)
        if not given.size or given.min() < 0 or given.max() >= len(pool.people):
            raise ValueError(f"team {given.tolist()}: expected numbers of the pool, from 0 to {len(pool.people) - 1}")
        if given.ndim > 2 or (given.ndim == 2 and len(given) != len(numbers)):
            raise ValueError(f"teams, shape {given.shape}: expected one row for each of {len(numbers)} episodes")
        places = given.shape[-1]
        teams = np.broadcast_to(given, (len(numbers), places))
    travel = travel or pool.setting.travel(places)
    presence = presence or Presence.of(places)
    if len(travel) != places or len(presence.joins) != places:
        raise ValueError(f"travel for {len(travel)}, presence for {len(presence.joins)}: expected {places} people")
    together = max(1, TOGETHER // (places * BLOCK)) * BLOCK
    jobs = 1 if trace is not None else jobs  # a trace is in order

    def run(start: int) -> Episodes:
        chunk = numbers[start : start + together]
        own = None if teams is None else teams[start : start + together]
        return _Run(pool, policy, own, chunk, seed, name, travel, presence, world, trace, progress).run()

    starts = range(0, max(1, len(numbers)), together)
    if jobs == 1:
        return Episodes.joined([run(start) for start in starts])
    with ThreadPoolExecutor(jobs) as workers:
        return Episodes.joined(list(workers.map(run, starts)))


class _Luck:
    """The random numbers of some episodes, whatever others are simulated beside them."""

    def __init__(self, seed: int, numbers: NDArray[np.int64], places: int) -> None:
        blocks, self.block = np.unique(numbers // BLOCK, return_inverse=True)
        self.row, self.places = numbers % BLOCK, places
        self.streams = [
            [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, kind, int(b)))) for b in blocks]
            for kind in range(4)
        ]
        self.drawn = np.empty((len(blocks), BLOCK, places))

    def draw(self, kind: int, rows: NDArray[np.int64]) -> Floats:
        """Give uniform numbers for some episodes: 0 who they are in the model, 1 choices, 2 moves of theta."""
        for block in np.unique(self.block[rows]):  # the streams of those that have ended are not missed
            self.streams[kind][block].random(out=self.drawn[block])
        return self.drawn[self.block[rows], self.row[rows]]

    def team(self, pool: int) -> NDArray[np.int64]:
        """Draw K different numbers of a pool, shape (N, K)."""
        order = [stream.permuted(np.tile(np.arange(pool), (BLOCK, 1)), axis=1) for stream in self.streams[3]]
        return np.stack(order)[self.block, self.row, : self.places]


class _Run:
    """A chunk of episodes in progress; all arrays have the episodes as their first axis."""

    def __init__(
        self,
        pool: Pool,
        policy: TeamPolicy,
        teams: NDArray[np.int64] | None,
        numbers: NDArray[np.int64],
        seed: int,
        name: str,
        travel: Travel,
        presence: Presence,
        world: World,
        trace: Trace | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.pool, self.policy, self.numbers, self.name = pool, policy, numbers, name
        self.travel, self.presence, self.trace, self.progress = travel, presence, trace, progress
        shape = (len(numbers), len(travel))
        self.luck, self.on_grid = _Luck(seed, numbers, len(travel)), world == "model"
        # In C order, which all arrays made from it inherit: people are changed in place through flat views of them.
        self.people = np.ascontiguousarray(self.luck.team(len(pool.people)) if teams is None else teams)
        self.model = pool.model[self.people]
        self.groups = {number: _Group.of(pool, number, self.on_grid) for number in np.unique(self.model).tolist()}
        # Each person is of one group, and has row 0 in the others.
        row = np.sum([group.row for group in self.groups.values()], axis=0)
        self.who = row[self.people].reshape(-1)
        self.beta = np.array([human.beta for human in pool.people])[self.people]
        self.theta = np.array([human.theta for human in pool.people])[self.people]
        if self.on_grid:
            self._from_the_prior()
        self.sigma = np.array([human.sigma for human in pool.people])[self.people]
        self.first_theta = self.theta.copy()

        self.x = np.array([pool.choices(number).initial for number in range(len(pool.people))])[self.people]
        at_goal = np.array([pool.choices(n).goal[pool.choices(n).initial] for n in range(len(pool.people))])
        self.finished = at_goal[self.people]
        self.erred = np.zeros(shape, dtype=bool)
        self.location = np.full(len(numbers), BASE, dtype=np.int64)
        self.busy_until = np.zeros(len(numbers), dtype=np.int64)
        self.belief: Floats | None = None
        if getattr(policy, "uses_belief", True):
            self.belief = np.array([p.pomdp.prior for p in pool.policies])[self.model]
        self.actions = np.zeros(shape, dtype=np.int64)
        self.costs = np.zeros(shape)
        self.helped = np.zeros(shape, dtype=np.int64)
        self.moves = np.zeros(len(numbers), dtype=np.int64)
        self.steps = np.zeros(len(numbers), dtype=np.int64)
        self.discounted = np.zeros(len(numbers))

    def _from_the_prior(self) -> None:
        """Replace everybody's beta and theta by a draw from their model's prior."""
        drawn = self.luck.draw(0, np.arange(len(self.numbers)))
        for group, solved in enumerate(self.pool.policies):
            rows, grid = self.model == group, solved.pomdp.grid
            cell = np.searchsorted(np.cumsum(solved.pomdp.prior.ravel()), drawn[rows], side="right")
            last = int(np.flatnonzero(solved.pomdp.prior.ravel())[-1])
            b, t = np.divmod(np.minimum(cell, last), len(grid.theta))
            self.beta[rows], self.theta[rows] = grid.beta[b], grid.theta[t]

    def run(self) -> Episodes:
        """Step until all have finished or the limit is reached."""
        ended = 0
        for step in range(self.pool.setting.max_steps):
            to_come = ~self.finished & (step < self.presence.leaves)
            running = np.flatnonzero(to_come.any(axis=1))
            if self.progress is not None and len(to_come) - len(running) > ended:
                self.progress(len(to_come) - len(running) - ended)
                ended = len(to_come) - len(running)
            if not len(running):
                break
            self._step(step, running, to_come & (step >= self.presence.joins))
        if self.progress is not None and ended < len(self.numbers):
            self.progress(len(self.numbers) - ended)
        return Episodes(
            self.name, self.numbers, self.people, self.beta, self.first_theta, self.sigma, self.actions, self.costs,
            self.finished, self.helped, self.helped.sum(axis=1), self.moves, self.steps, self.discounted,
        )  # fmt: skip

    def _step(self, step: int, running: NDArray[np.int64], active: NDArray[np.bool_]) -> None:
        robot, charged = self._robot(step, running, active)
        flat = np.flatnonzero(active)
        before = self.x.copy() if self.trace is not None else self.x
        theta_before = self.theta.copy() if self.trace is not None else self.theta
        slot, spent = np.full(self.x.size, NOTHING), np.zeros(self.x.size)
        luck = np.empty((*self.x.shape, 2))
        for kind in (1, 2) if self.on_grid else (1,):
            luck[running, :, kind - 1] = self.luck.draw(kind, running)
        # Views: people are changed in place.
        belief = np.empty((0, 1, 1)) if self.belief is None else self.belief.reshape(-1, *self.belief.shape[2:])
        people = People(
            self.x.reshape(-1), robot.reshape(-1), self.who, self.beta.reshape(-1), self.theta.reshape(-1),
            luck.reshape(-1, 2), belief, slot, spent, self.erred.reshape(-1),
        )  # fmt: skip
        for number, rows in by_model(self.model.reshape(-1), flat, len(self.pool.policies)):
            group = self.groups[number]
            act(rows, people, group.minds, group.arrays)
            self.finished.reshape(-1)[rows] = group.arrays.goal[self.x.reshape(-1)[rows]]
        cost = spent.reshape(self.x.shape)
        reward = -charged - cost
        self.discounted += self.pool.setting.gamma**step * reward.sum(axis=1)
        self.actions += slot.reshape(self.x.shape) >= 0
        self.costs += cost
        self.steps[running] += 1
        if self.trace is not None:
            self._record(self.trace, step, flat, before, robot, slot, theta_before, reward)

    def _robot(
        self, step: int, running: NDArray[np.int64], active: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], Floats]:
        """Ask the policy, and give what the robot does to each person and what that costs, both of shape (N, K)."""
        robot, charged = np.zeros_like(self.x), np.zeros(self.x.shape)
        free = running[(self.busy_until[running] <= step) & active[running].any(axis=1)]
        if not len(free):
            return robot, charged
        every = slice(None) if len(free) == len(self.x) else free
        team = TeamState(
            step, self.x[every], active[every], self.erred[every], self.location[every], self.model[every],
            None if self.belief is None else _rows(self.belief, every), self.pool.policies, self.travel,
        )  # fmt: skip
        action = self.policy(team)
        team.check(action)
        goes = action.person != NOBODY
        teams, to, does = free[goes], action.person[goes], action.robot[goes]
        origin = self.location[teams]
        charged[teams, to] = self.travel.c_move * self.travel.distance[origin, to]
        self.busy_until[teams] = step + self.travel.steps[origin, to]
        self.moves[teams] += origin != to
        self.location[teams] = to
        robot[teams, to] = does
        for number, rows in by_model(self.model[teams, to], np.flatnonzero(does > 0), len(self.pool.policies)):
            at = (teams[rows], to[rows])
            charged[at] += self.groups[number].arrays.robot_costs[self.x[at], does[rows]]
        self.helped[teams, to] += does > 0
        return robot, charged

    def _record(
        self,
        trace: Trace,
        step: int,
        flat: NDArray[np.int64],
        before: NDArray[np.int64],
        robot: NDArray[np.int64],
        slot: NDArray[np.int64],
        theta_before: Floats,
        reward: Floats,
    ) -> None:
        for i in flat:
            e, k = divmod(int(i), self.x.shape[1])
            pomdp = self.pool.policies[self.model[e, k]].pomdp
            choices, x, r = pomdp.model.choices, int(before[e, k]), int(robot[e, k])
            suggested = int(pomdp.suggested[x, r])
            place = int(pomdp.afterstate[x, r])
            there = self.location[e] != BASE and self.busy_until[e] <= step
            row = {
                "person": f"human-{self.people[e, k] + 1}",
                "episode": f"{self.name}-{self.numbers[e]}",
                "step": step,
                "action": choices.name(place, int(slot[i])) if slot[i] >= 0 else None,
                "suggestion": choices.name(x, suggested) if suggested != NOTHING else None,
                "policy": self.name,
                "place": k,
                "robot_place": int(self.location[e]) if there else None,
                "cost": float(choices.costs[place, slot[i]]) if slot[i] >= 0 else 0.0,
                "cost_to_go": _finite(choices.h[x]),
                "cost_to_go_after": _finite(choices.h[self.x[e, k]]),
                "theta": float(theta_before[e, k]),
                "reward": float(reward[e, k]),
            }
            trace.append(row)


@dataclass(frozen=True)
class _Group:
    """The people of one model, as compiled code reads them."""

    number: int
    arrays: Arrays
    minds: Minds
    row: NDArray[np.int64]

    @classmethod
    def of(cls, pool: Pool, number: int, on_grid: bool) -> _Group:
        pomdp = pool.policies[number].pomdp
        model, choices = pomdp.model, pomdp.model.choices
        own = np.flatnonzero(pool.model == number)
        row = np.zeros(len(pool.people), dtype=np.int64)
        if on_grid:  # everybody takes the costs for what the model says
            q = model.q[None]
        else:
            q = np.array([perceived_cost(choices, pool.people[i].h) for i in own])
            row[own] = np.arange(len(own))
        value = np.array([perceived_value(choices, one) for one in q])
        lapse = model.lapse if on_grid else 0.0
        minds = Minds(q, value, choices.h, model.eta / model.utility_scale, lapse, on_grid)
        return cls(number, Arrays.of(pomdp), minds, row)


def _rows(array: Floats, rows: NDArray[np.int64] | slice) -> Floats:
    """Some rows of a large array, copied only if they must be, and then a row at a time."""
    return array[rows] if isinstance(rows, slice) else array.take(rows, axis=0)


def _finite(value: float) -> float | None:
    """A number that JSON can hold: a dead end's cost-to-go is null."""
    return float(value) if math.isfinite(value) else None
