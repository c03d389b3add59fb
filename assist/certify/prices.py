"""Prices of the robot's attention, looked for by simulating each person's problem.

Where more than one robot would be busy at a step, its price is raised, and lowered where none would: a subgradient
method. Any prices give a sound bound; these give one that is nearly as tight as can be.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner import LimitError
from planner.system.progress import Progress

from ..large_tasks.truncated_bound import OuterRelaxation, TruncatedProblem, likely
from ..large_tasks.truncated_policy import TruncatedPolicy
from ..people.arguments import positive
from ..people.decision import Floats
from ..person.qmdp import QMDP, ahead, highest, improve
from ..person.solver import first_bounds_bytes
from ..simulation.pool import Pool
from ..simulation.simulate import simulate
from ..team.attention import NoAssistance
from ..team.attention_subproblem import HERE, AttentionSubproblem, TimeExpansion, backwards, policy_bytes
from ..team.state import TeamAction, TeamState
from ..team.travel import Travel

ROUNDS = 40
"""Times that prices are changed. The last half's mean is taken."""

STEP = 0.5
"""What a price changes by in the first round, at most, in cost units."""

SAMPLE = 2048
"""Simulated episodes of each person's problem in every round."""

NEGLIGIBLE = 0.01
"""Prices after the last one above this, in cost units, are left out."""

MANY = 5
"""Prices are looked for while more people than these would be at work without a robot."""

LONGEST = 6
"""They end after at most so many times what the longest task takes at best."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class SubproblemKind:
    """People of a team who have the same problem, and how many they are.

    Attributes
    ----------
    pool : Pool
    visits : AttentionSubproblem
        Their problem, at prices of 0; without prices where it is on a part of a task.
    tail : float array, shape (P * n, B, T)
        What it is worth from the step on from which attention is free, by position and state.
    places : tuple of int
        Theirs in the team.
    outer : OuterRelaxation or None
        What is known around the part on which that is, if it is not the whole task.
    between : OuterRelaxation or None
        The same on a smaller region: people are looked at on it while prices are looked for.
    pairs : int
        On how many states, each with one step, people are looked at where there are prices and something is known
        around these.
    """

    pool: Pool
    visits: AttentionSubproblem
    tail: Floats
    places: tuple[int, ...]
    outer: OuterRelaxation | None = None
    between: OuterRelaxation | None = None
    pairs: int = 0

    @property
    def count(self) -> int:
        """How many they are."""
        return len(self.places)

    def best(self, visits: AttentionSubproblem) -> QMDP:
        """Solve the problem with beta and theta seen: backwards from the steps at which attention is free."""
        return backwards(visits, self.tail)

    def at(self, price: Floats) -> AttentionSubproblem:
        """Give the problem at prices of any steps."""
        alone, entry, steps = self.visits.alone, self.visits.entry, self.visits.entry_steps
        if self.outer is None or not len(price):
            return AttentionSubproblem.of(alone, entry, steps, price)
        visits = AttentionSubproblem.of(alone, entry, steps, price, kept=likely(alone, len(price), self.pairs))
        return self.outer.beyond(visits, self.tail)

    def _acting(self, price: Floats) -> tuple[AttentionSubproblem, Callable[[int, Ints], QMDP]]:
        """Give a problem at these prices, and QMDP's policy in some of its states at each step."""
        if self.between is None:
            visits = self.visits.priced(price)
            best = self.best(visits)
            return visits, lambda *_: best
        visits, values = self.between.visits, dict(self.between.priced(price))

        def policy(step: int, states: Ints) -> QMDP:
            own = float(price[step]) if step < len(price) else 0.0
            return ahead(visits.at_price(own), values[min(step + 1, len(price))], np.unique(states))

        return visits, policy

    def simulated(self, price: Floats, steps: int, episodes: int, seed: int) -> tuple[Floats, Floats]:
        """Simulate QMDP's policy in the problem at these prices for so many steps.

        Return the share of people who are attended to at each step that has a price, and each episode's return.
        """
        visits, policy = self._acting(price)
        number = np.zeros(len(price))

        def act(team: TeamState) -> TeamAction:
            x, belief = team.known_of(np.arange(len(team.x)))
            robot = policy(team.step, x).choose(x, belief)
            if team.step < len(price):
                # On its way the robot has no other choice than to go on.
                number[team.step] += np.sum((robot > 0) | (visits.layout.position[team.x[:, 0]] > HERE))
            return TeamAction(np.zeros_like(robot), robot)

        human = replace(self.pool.people[0], h=np.zeros(len(visits.layout)))
        # The way is part of the problem, so that none is left to the simulation.
        setting = replace(self.pool.setting, c_move=0.0, travel_time=0.0, max_steps=steps)
        pool = Pool(setting, (human,), (policy(0, np.arange(1)),), np.zeros(1, dtype=np.int64))
        run = simulate(pool, act, humans=[0], episodes=episodes, seed=seed, world="model")
        return number / episodes, run.discounted_return


def kinds_of(
    pool: Pool,
    team: tuple[int, ...],
    travel: Travel,
    window: int,
    *,
    around: bool = False,
    memory_limit_mb: float = math.inf,
    until: float = math.inf,
    tell: Progress = lambda *_: None,
) -> list[SubproblemKind]:
    """Give a team's kinds, with prices of 0 on so many steps.

    Of tasks that are not looked at whole less is looked at where by `until`, on `time.perf_counter()`'s clock, there
    was no time for more; what is around the part that is looked at is given with `around`, if the robot's way takes no
    time.

    Raises
    ------
    LimitError
        Their problems would take more memory than is allowed.
    """
    entries, steps = travel.entry.tolist(), travel.entry_steps.tolist()
    members: dict[tuple[int, float, int], list[int]] = {}
    for k, person in enumerate(team):
        members.setdefault((int(pool.model[person]), entries[k], steps[k]), []).append(k)
    problems = []
    for done, (model, entry, _) in enumerate(members):
        tell("setting people's problems up", done, len(members))
        share = time.perf_counter() + (until - time.perf_counter()) / (len(members) - done)
        room = memory_limit_mb / len(members)
        # What is around them is kept as well, if it is wanted.
        problems.append(_alone(pool, model, entry, around, share, room if around else memory_limit_mb, room))
    _allow(problems, [steps for _, _, steps in members], window, memory_limit_mb)
    kinds = []
    for one, ((_, entry, entry_steps), places) in zip(problems, members.items(), strict=True):
        free = AttentionSubproblem.of(one.problem, entry, entry_steps)
        tail = highest(free.pomdp)
        improve(free.pomdp, tail, tolerance=1e-5)
        visits = (
            free if one.outer is not None else AttentionSubproblem.of(one.problem, entry, entry_steps, np.zeros(window))
        )
        _refuse_above(memory_limit_mb, first_bounds_bytes(visits.pomdp), 1, len(visits.layout), window)
        kinds.append(SubproblemKind(pool, visits, tail, tuple(places), one.outer, one.between, one.pairs))
    return kinds


def _alone(
    pool: Pool, model: int, entry: float, around: bool, until: float, memory_limit_mb: float, kept_mb: float
) -> TruncatedProblem:  # fmt: skip
    """Give the problem of a model with a robot that is always there: on a region, if the task is not looked at whole.

    Where that breaks off it has bounds of the whole task, so that what is above its value is above that of the task.
    """
    policy = pool.policies[model]
    if isinstance(policy, TruncatedPolicy):
        return policy.bounded(entry, around=around, until=until, memory_limit_mb=memory_limit_mb, kept_mb=kept_mb)
    return TruncatedProblem(policy.pomdp)


def _allow(problems: list[TruncatedProblem], entry_steps: list[int], window: int, limit_mb: float) -> None:
    """Refuse problems that would not fit the memory."""
    needed, states = 0.0, 0
    for one, steps in zip(problems, entry_steps, strict=True):
        alone = one.problem
        timed = window and one.outer is None
        if timed:  # each step has a state or more; to list them takes long
            _refuse_above(limit_mb, policy_bytes(window), len(problems), window, window)
        states = len(TimeExpansion.of(alone, 2 + steps, window if timed else 0))
        slots, robots = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
        needed += policy_bytes(states, slots=slots, robots=robots)
    needed *= 1 + 1 / len(problems)  # one is solved anew in every round
    needed += sum(one.outer.nbytes for one in problems if one.outer is not None)
    _refuse_above(limit_mb, needed, len(problems), states, window)


def _refuse_above(limit_mb: float, needed: float, kinds: int, states: int, window: int) -> None:
    if needed > positive("memory_limit_mb", limit_mb) * 1e6:
        raise LimitError(
            f"{kinds:,} {'problem' if kinds == 1 else 'problems'} of people, each of up to {states:,} states with "
            f"{window} steps of prices, take about {needed / 1e6:,.0f} MB of memory, and {limit_mb:,.0f} MB are "
            "allowed; expected one model for all (knowledge 'exact'), prices on fewer steps (window), or a higher limit"
        )


def window_of(pool: Pool, team: tuple[int, ...], seed: int) -> int:
    """Return the number of steps on which prices are searched.

    A plan's number of actions is estimated as its cost divided by the smallest positive cost. Any number is sound.
    """
    shortest = max(float(c.h[c.initial]) / c.unit for c in map(pool.choices, team))
    alone = simulate(pool, NoAssistance(), humans=list(team), episodes=64, seed=seed, world="model").actions
    steps = np.arange(math.ceil(LONGEST * shortest))
    working = (alone[:, :, None] > steps).sum(axis=1).mean(axis=0)
    return max(math.ceil(2 * shortest), int((working > MANY).sum()))


def search(kinds: list[SubproblemKind], window: int, *, seed: int, deadline: float, tell: Progress) -> Floats:
    """Look for prices until so many rounds are over or, on `time.perf_counter()`'s clock, the deadline is.

    Returns
    -------
    float array, shape (W,)
        The mean of the last half of the rounds, up to the last price that is not negligible.
    """
    price, mean, past, counted = np.zeros(window), np.zeros(window), np.zeros(window), 0
    for round_ in range(ROUNDS):
        tell("looking for prices", round_, ROUNDS)
        # Other luck in every round, so that prices fit people and not a sample of them.
        busy = np.zeros(window)
        for kind in kinds:
            if time.perf_counter() > deadline:
                break
            busy += kind.count * kind.simulated(price, window, SAMPLE, seed + round_)[0]
        else:
            # A subgradient step, for each price as long as its past ones have been short (AdaGrad: Duchi, Hazan and
            # Singer, 2011): where two persons need the robot every now and then, a price has far to go on a slight
            # slope. Relative to how many robots are busy: a large team's first steps, with dozens, would leave all
            # others too short.
            slope = (busy - 1) / np.maximum(busy, 1)
            past += slope**2
            price = np.maximum(0.0, price + STEP * slope / np.sqrt(past + 1e-12))
            if round_ >= ROUNDS // 2:
                mean += price / (ROUNDS - ROUNDS // 2)
                counted += 1
            continue
        break  # what is left of a round that has begun says nothing
    if counted < ROUNDS - ROUNDS // 2:
        mean = mean * (ROUNDS - ROUNDS // 2) / counted if counted else price
    return mean[: int(np.flatnonzero(mean > NEGLIGIBLE).max(initial=-1)) + 1]
