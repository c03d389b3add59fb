"""A certified upper bound on what any team policy can reach, and with it how far a policy is from the best.

At each step the robot is with one person, or on its way to one. Relaxing that with a price lambda_t >= 0 on every
step of attention takes the team apart (`assist.team.subproblem`):

    J*  <=  sum_t gamma^t lambda_t  +  sum_k V_k(lambda)

where V_k is the most that any policy gets in person k's own problem, in which attention is paid for, and coming costs
what coming from the nearest other place does. That holds for all prices. They are looked for by simulating each
person's problem and raising the price of the steps at which more than one robot would be busy. At the prices found,
each V_k is bounded from above by solving the problem with beta and theta hidden (`assist.person.solver`), so
that knowing people better than one can is no source of looseness.

The bound holds in the robot's model: people drawn from the prior, on its grid, with lapses. In that world policies are
simulated as well.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ..people.human import Floats
from ..person.qmdp import QMDP, qmdp
from ..person.solver import solve
from ..simulation.simulate import simulate
from ..team.attention import NoAssistance
from ..team.pool import Pool
from ..team.state import TeamAction, TeamPolicy, TeamState
from ..team.subproblem import HERE, Visits
from ..team.travel import Travel

ROUNDS = 40
"""Times that prices are changed. The last half's mean is taken."""

STEP = 0.5
"""What a price changes by in the first round, at most, in cost units."""

SAMPLE = 2048
"""Simulated episodes of each person's problem in every round."""

NEGLIGIBLE = 0.01
"""Prices after the last one above this, in cost units, are left out."""

CROWD = 5
"""Prices are looked for while more people than these would be at work without a robot."""

LONGEST = 6
"""They end after at most so many times what the longest task takes at best."""

BEYOND = 1e-6
"""Episodes are cut off where what may come after is worth less than this share of the first step's largest cost."""


Tell = Callable[[str, int, int], None]
"""Called with what is being done, how much of it has been, and of how much."""


@dataclass(frozen=True)
class TeamBound:
    """What no policy for a team exceeds, from the beginning of an episode on.

    Attributes
    ----------
    pool : Pool
    team : tuple of int
        Who is at each place.
    travel : Travel
    upper : float
        Mean discounted return, in cost units.
    slack : float
        By how much `upper` could be lower if each person's problem were solved to the end: the sum of what is
        between the solver's bounds.
    upper_seen : float
        What the bound would be if beta and theta were seen, at the same prices.
    price : float array, shape (W,)
        lambda_t, in cost units.
    seconds : float
    """

    pool: Pool
    team: tuple[int, ...]
    travel: Travel
    upper: float
    slack: float
    upper_seen: float
    price: Floats
    seconds: float

    def relaxed(self, *, episodes: int = 20_000, seed: int = 0) -> tuple[float, float]:
        """Simulate QMDP's policies in the relaxed problem, with a robot for everybody; give mean and standard error.

        The best policies there get no less and the bound no more than `upper`: what of a certificate's gap is below
        this mean is not the solver's but the relaxation's and the policy's.
        """
        horizon = _horizon(self.pool.setting.gamma)
        total, variance = float(self.price @ self.pool.setting.gamma ** np.arange(len(self.price))), 0.0
        kinds = _kinds(self.pool, self.team, self.travel, len(self.price), lambda *_: None)
        for number, kind in enumerate(kinds):  # of independent luck, so that variances add up
            value = kind.simulated(self.price, horizon, episodes, seed + number)[1]
            total += kind.count * float(value.mean())
            variance += kind.count**2 * float(value.var(ddof=1)) / episodes
        return total, math.sqrt(variance)

    def certify(
        self, policy: TeamPolicy, name: str = "policy", *, episodes: int = 20_000, seed: int = 0
    ) -> Certificate:
        """Simulate a policy in the model's world and compare."""
        setting = self.pool.setting
        horizon = _horizon(setting.gamma)
        pool = replace(self.pool, setting=replace(setting, max_steps=horizon))
        run = simulate(
            pool, policy, humans=self.team, episodes=episodes, seed=seed, name=name, travel=self.travel, world="model"
        )
        dearest = max(
            float(p.pomdp.model.choices.costs.max() + p.pomdp.robot_costs.max()) for p in pool.policies
        ) + self.travel.c_move * float(self.travel.distance.max())
        left = (~run.finished).sum(axis=1) * dearest * setting.gamma**horizon / (1 - setting.gamma)
        value = run.discounted_return - left
        mean = float(value.mean())
        return Certificate(
            humans=len(self.team),
            policy=name,
            value=mean,
            value_stderr=float(value.std(ddof=1) / math.sqrt(episodes)),
            upper=self.upper,
            gap_percent=100 * (self.upper - mean) / abs(mean) if mean else 0.0,
            slack_percent=100 * self.slack / abs(mean) if mean else 0.0,
            episodes=episodes,
        )


@dataclass(frozen=True)
class Certificate:
    """How far a team policy is from the best, at most.

    Attributes
    ----------
    humans : int
    policy : str
    value, value_stderr : float
        Its mean discounted return, what episodes cut off could still cost included, and the standard error.
    upper : float
        What no policy's exceeds.
    gap_percent : float
        100 (upper - value) / |value|.
    slack_percent : float
        How much of that is left to the solver of single people's problems.
    episodes : int
    """

    humans: int
    policy: str
    value: float
    value_stderr: float
    upper: float
    gap_percent: float
    slack_percent: float
    episodes: int


@dataclass(frozen=True)
class _Kind:
    """People of a team who have the same problem, and how many they are."""

    pool: Pool
    visits: Visits
    tail: QMDP
    count: int

    def best(self, visits: Visits) -> QMDP:
        """Solve the problem with beta and theta seen: backwards from the steps at which attention is free."""
        above = np.zeros((len(visits.x), *visits.pomdp.grid.shape))
        last = visits.step == len(visits.price)
        above[last] = self.tail.value_mdp[visits.position[last] * len(visits.alone.robot_actions) + visits.x[last]]
        return qmdp(visits.pomdp, above=above, tolerance=1e-5)

    def simulated(self, price: Floats, steps: int, episodes: int, seed: int) -> tuple[Floats, Floats]:
        """Simulate QMDP's policy in the problem at these prices for so many steps.

        Return the share of people who are attended to at each step that has a price, and each episode's return.
        """
        visits = self.visits.priced(price)
        policy = self.best(visits)
        number = np.zeros(len(price))

        def act(team: TeamState) -> TeamAction:
            robot = policy.choose(*team.known_of(np.arange(len(team.x))))
            if team.step < len(price):
                # On its way the robot has no other choice than to go on.
                number[team.step] += np.sum((robot > 0) | (visits.position[team.x[:, 0]] > HERE))
            return TeamAction(np.zeros_like(robot), robot)

        human = replace(self.pool.people[0], h=np.zeros(len(visits.x)))
        # The way is part of the problem, so that none is left to the simulation.
        setting = replace(self.pool.setting, c_move=0.0, travel_time=0.0, max_steps=steps)
        pool = Pool(setting, (human,), (policy,), np.zeros(1, dtype=np.int64))
        run = simulate(pool, act, humans=[0], episodes=episodes, seed=seed, world="model")
        return number / episodes, run.discounted_return


def _kinds(pool: Pool, team: tuple[int, ...], travel: Travel, window: int, tell: Tell) -> list[_Kind]:
    """Give a team's kinds, with prices of 0 on so many steps."""
    members = Counter(
        (int(pool.model[person]), float(travel.entry[k]), int(travel.entry_steps[k])) for k, person in enumerate(team)
    )
    kinds = []
    for done, ((model, entry, steps), count) in enumerate(members.items()):
        tell("setting people's problems up", done, len(members))
        alone = pool.policies[model].pomdp
        tail = qmdp(Visits.of(alone, entry, steps).pomdp, tolerance=1e-5)
        kinds.append(_Kind(pool, Visits.of(alone, entry, steps, np.zeros(window)), tail, count))
    return kinds


def _horizon(gamma: float) -> int:
    """Give the step beyond which episodes are cut off."""
    return math.ceil(math.log(BEYOND * (1 - gamma)) / math.log(gamma))


def _window(pool: Pool, team: tuple[int, ...], seed: int) -> int:
    shortest = max(float(c.h[c.initial]) / float(c.costs[c.applicable].min()) for c in map(pool.choices, team))
    alone = simulate(pool, NoAssistance(), humans=team, episodes=64, seed=seed, world="model").actions
    steps = np.arange(math.ceil(LONGEST * shortest))
    working = (alone[:, :, None] > steps).sum(axis=1).mean(axis=0)
    return max(math.ceil(2 * shortest), int((working > CROWD).sum()))


def upper_bound(
    pool: Pool,
    team: tuple[int, ...] | None = None,
    *,
    travel: Travel | None = None,
    window: int | None = None,
    gap: float = 1e-3,
    time_limit: float | None = None,
    seed: int = 0,
    jobs: int | None = None,
    progress: Tell | None = None,
) -> TeamBound:
    """Bound from above what any policy gets with a team in which all work from the beginning.

    Parameters
    ----------
    pool : Pool
    team : tuple of int, optional
        Who is at each place; the whole pool unless given.
    travel : Travel, optional
        The way between them; that of the setting unless given.
    window : int, optional
        Prices are looked for on so many steps. Unless given, twice what the longest task takes at best; in a crowd, for
        as long as `CROWD` people would still be at work without a robot, but at most `LONGEST` times that.
    gap : float
        Relative gap to which each person's problem is solved.
    time_limit : float, optional
        Seconds for each of these, at the most. The bound is sound however few they are.
    jobs : int, optional
        Problems that are solved at a time; as many as there are processors unless given.
    progress : callable, optional
        As `Tell` says.
    """
    start = time.perf_counter()
    team = tuple(range(len(pool.people))) if team is None else team
    travel = travel or pool.setting.travel(len(team))
    gamma, tell = pool.setting.gamma, progress or (lambda *_: None)
    if window is None:
        window = _window(pool, team, seed)
    kinds = _kinds(pool, team, travel, window, tell)

    price, mean, past = np.zeros(window), np.zeros(window), np.zeros(window)
    for round_ in range(ROUNDS if len(team) > 1 else 0):
        tell("looking for prices", round_, ROUNDS)
        # Other luck in every round, so that prices fit people and not a sample of them.
        busy = np.zeros(window)
        for kind in kinds:
            busy += kind.count * kind.simulated(price, window, SAMPLE, seed + round_)[0]
        # A subgradient step, for each price as long as its past ones have been short (AdaGrad: Duchi, Hazan and
        # Singer, 2011): where two persons need the robot every now and then, a price has far to go on a slight slope.
        # Relative to how many robots are busy: a crowd's first steps, with dozens, would leave all others too short.
        slope = (busy - 1) / np.maximum(busy, 1)
        past += slope**2
        price = np.maximum(0.0, price + STEP * slope / np.sqrt(past + 1e-12))
        if round_ >= ROUNDS // 2:
            mean += price / (ROUNDS - ROUNDS // 2)
    price = mean[: int(np.flatnonzero(mean > NEGLIGIBLE).max(initial=-1)) + 1]

    def one(kind: _Kind) -> tuple[float, float, float]:
        visits = Visits.of(kind.visits.alone, kind.visits.entry, kind.visits.entry_steps, price)
        solution = solve(visits.pomdp, gap=gap, time_limit=time_limit, best=kind.best(visits))
        return solution.upper, solution.upper - solution.lower, solution.value_qmdp

    parts, tell_done = [], 0
    with ThreadPoolExecutor(jobs or os.cpu_count()) as workers:
        for part in workers.map(one, kinds):
            parts.append(part)
            tell_done += 1
            tell("bounding people's problems", tell_done, len(kinds))
    paid = float(price @ gamma ** np.arange(len(price)))
    counts = np.array([kind.count for kind in kinds])
    upper, slack, seen = (float(counts @ column) for column in np.array(parts).T)
    return TeamBound(pool, team, travel, upper + paid, slack, seen + paid, price, time.perf_counter() - start)
