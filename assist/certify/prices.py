"""Prices of the robot's attention, optimised by simulation of each person's problem.

The prices are the dual variables of the constraint that M robots attend to at most M people in each step. A stochastic
subgradient method raises the price of a step in which more than M robots would be busy, and lowers it otherwise. Every
price vector gives a valid bound; the method approaches the tightest one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.system.progress import Progress

from ..people.decision import Floats
from ..person.attention_subproblem import AttentionSubproblem
from ..person.each_goal import BoundLimits, TruncatedProblem
from ..person.memory_needed import first_bounds_bytes, policy_bytes, require_room
from ..person.qmdp import QMDP, look_ahead
from ..person.solver import Solution
from ..person.time_expansion import HERE, TimeExpansion
from ..person.travel import Travel
from ..person.truncated_bound import likely
from ..team.pool import Pool
from ..team.simulate import simulate
from ..team.state import TeamAction, TeamState
from .action_prices import supply
from .envelope import Envelope, Lifted, OwnTheta, mean_at_most
from .options import BoundOptions

Ints = NDArray[np.int64]
PersonBound: TypeAlias = Solution | Lifted


@dataclass(frozen=True)
class SubproblemGroup:
    """The people of a team who have the same attention subproblem, all with the same goal.

    Attributes
    ----------
    pool : Pool
    visits : AttentionSubproblem
        Their subproblem at prices of 0; without prices if the task is truncated.
    tail : float array, shape (P * n, H, T)
        Upper bound on the value with free attention, by robot position and task state.
    places : tuple of int
        Their places in the team.
    problem : TruncatedProblem
        The problem of one of them with a robot that is always present, and the relaxations around a truncated task.
    share : float
        Probability that a person at these places has this subproblem: that of a goal, or 1.
    envelope : OwnTheta
        How far their theta comes, and what follows from it.
    """

    pool: Pool
    visits: AttentionSubproblem
    tail: Floats
    places: tuple[int, ...]
    problem: TruncatedProblem
    share: float = 1.0
    envelope: OwnTheta = field(default_factory=OwnTheta)

    @property
    def count(self) -> float:
        """The expected number of these people."""
        return len(self.places) * self.share

    def best(self, visits: AttentionSubproblem, until: float = -math.inf) -> QMDP:
        """Solve the subproblem with observed type and theta, backwards from the steps with free attention.

        With neighbours, sweeps improve the values at these steps until they converge, or until a time on the clock of
        `time.perf_counter()`.
        """
        return self.envelope.solved(visits, self.tail, until)

    def bound(self, best: QMDP, search: Callable[[QMDP], Solution]) -> PersonBound:
        """Return bounds with type and theta out of sight, from the values with both observed and, perhaps, a search."""
        return self.envelope.bound(best, search)

    def with_free_attention(self) -> float:
        """Return an upper bound on the value at any prices: that with free attention and observed beta and theta."""
        pomdp, layout, begin = self.visits.pomdp, self.visits.layout, self.visits.pomdp.model.choices.initial
        value = self.tail[layout.position[begin] * layout.states + layout.x[begin]]
        return mean_at_most(value, self.tail, pomdp)

    def at(self, price: Floats) -> AttentionSubproblem:
        """Return the subproblem at given prices, shape (3, W); the number of steps may differ."""
        alone, entry, steps = self.visits.alone, self.visits.entry, self.visits.entry_steps
        if self.problem.outer is None or not price.size:
            return AttentionSubproblem.of(alone, entry, steps, price)
        kept = likely(alone, price.shape[1], self.problem.pairs)
        visits = AttentionSubproblem.of(alone, entry, steps, price, kept=kept)
        return self.problem.outer.beyond(visits, self.tail)

    def _with_policy(self, price: Floats) -> tuple[AttentionSubproblem, Callable[[int, Ints], QMDP]]:
        """Return a subproblem at these prices, and a function for QMDP's policy in given states at each step."""
        between = self.problem.between
        if between is None:
            visits = self.visits.priced(price)
            best = self.best(visits)
            return visits, lambda *_: best
        visits, values, window = between.visits, dict(between.priced(price[0])), price.shape[1]

        def policy(step: int, states: Ints) -> QMDP:
            own = float(price[0, step]) if step < window else 0.0
            return look_ahead(visits.at_price(own), values[min(step + 1, window)], np.unique(states))

        return visits, policy

    def simulated(self, price: Floats, steps: int, episodes: int, seed: int) -> tuple[Floats, Floats]:
        """Simulate QMDP's policy in the subproblem at these prices, for `steps` steps.

        Return the shares of people who receive attention, a suggestion and an execution at each step with a price,
        shape (3, W), and the return of each episode.
        """
        visits, policy = self._with_policy(price)
        number, acted = np.zeros_like(price), visits.acted()

        def act(team: TeamState) -> TeamAction:
            x, belief = team.known_of(np.arange(len(team.x)))
            action = policy(team.step, x).choose(x, belief)
            if team.step < number.shape[1]:
                # A robot on its way has no other choice than to continue.
                number[0, team.step] += np.sum((action > 0) | (visits.layout.position[team.x[:, 0]] > HERE))
                for count, done in zip(number[1:], acted, strict=True):
                    count[team.step] += np.sum(done[team.x[:, 0], action])
            return team.act(np.zeros_like(action), action[:, None])

        human = replace(self.pool.people[0], h=np.zeros(len(visits.layout)))
        # Travel is part of the subproblem, so that the simulation has none. A person's problem has one robot.
        robot = replace(self.pool.setting.fleet.best, c_move=0.0, travel_time=0.0)
        # Nor is anything asked in it: its goal is known (`person.each_goal`).
        setting = replace(self.pool.setting, max_steps=steps, robots=(robot,), c_ask=None, ask_error=0.0)
        pool = Pool(setting, (human,), (policy(0, np.arange(1)),), np.zeros(1, dtype=np.int64))
        run = simulate(pool, act, humans=[0], episodes=episodes, seed=seed, world="model")
        return number / episodes, run.discounted_return


def groups_of(
    pool: Pool,
    team: tuple[int, ...],
    travel: Travel,
    window: int,
    *,
    with_outer: bool = False,
    memory_limit_mb: float = math.inf,
    until: float = math.inf,
    tell: Progress = lambda *_: None,
) -> list[SubproblemGroup]:
    """Return the groups of a team by their subproblem, with prices of 0 on `window` steps.

    Truncated tasks are smaller, and values of people who see neighbours less tight, if the time until `until`, on the
    clock of `time.perf_counter()`, is short. With `with_outer`, truncated tasks include the outer relaxation.

    Raises
    ------
    LimitError
        The subproblems would exceed the memory limit.
    """
    entries, steps = travel.entry.tolist(), travel.entry_steps.tolist()
    members: dict[tuple[int, float, int], list[int]] = {}
    for k, person in enumerate(team):
        members.setdefault((int(pool.model[person]), entries[k], steps[k]), []).append(k)
    given = list[tuple[TruncatedProblem, float, tuple[int, ...], float, int, OwnTheta]]()
    for done, ((model, entry, entry_steps), of_group) in enumerate(members.items()):
        tell("setting up people's problems", done, len(members))
        room, places = memory_limit_mb / len(members), tuple(of_group)
        # The outer relaxations of all groups are kept in memory, if they are included. An upper bound on a truncated
        # problem is one on that of the whole task (`person.truncated_bound`).
        envelope = Envelope.of(pool, team, places)
        each_goal = pool.policies[model].problem.bounded(
            entry, entry_steps, outer=envelope.outer(with_outer),
            limits=BoundLimits(until, room if with_outer else memory_limit_mb, room).shared(len(members) - done),
        )  # fmt: skip
        given += [(one, chance, places, entry, entry_steps, envelope) for chance, one in each_goal]
    _require_room_for_all([one[0] for one in given], [one[4] for one in given], window, memory_limit_mb)
    groups = list[SubproblemGroup]()
    for one, chance, places, entry, entry_steps, envelope in given:
        alone = one.problem.unattended() if pool.setting.fleet.relays(entry_steps) else one.problem
        free = AttentionSubproblem.of(alone, entry, entry_steps)
        left = until - time.perf_counter()
        tail = envelope.tail(free, time.perf_counter() + left / (len(given) - len(groups)))
        priced = one.outer is None
        visits = AttentionSubproblem.of(alone, entry, entry_steps, np.zeros(window)) if priced else free
        _require_room_for(memory_limit_mb, first_bounds_bytes(visits.pomdp), 1, len(visits.layout), window)
        groups.append(SubproblemGroup(pool, visits, tail, places, one, chance, envelope))
    return groups


def search(
    groups: list[SubproblemGroup],
    window: int,
    options: BoundOptions,
    *,
    seed: int,
    deadline: float,
    tell: Progress,
    extra: Floats,
    on_actions: bool = False,
) -> Floats:
    """Optimise prices by a stochastic subgradient method, until all rounds are done or the deadline has passed.

    Parameters
    ----------
    groups : list of SubproblemGroup
    window : int
        Number of steps with a price.
    options : BoundOptions
        Their numbers of rounds and of simulated episodes in each.
    seed : int
    deadline : float
        Time on the clock of `time.perf_counter()`.
    tell : callable
        Receives progress reports.
    extra : float array, shape (M, 3)
        What each action of a robot costs more than the best robot's.
    on_actions : bool
        Whether actions have prices, too (`certify.action_prices`); otherwise these are 0.

    Returns
    -------
    float array, shape (3, W)
        Mean of the last half of the rounds, in cost units, up to the last price of at least 0.01.
    """
    rounds, shape, rows = options.price_rounds, (3, window), 3 if on_actions else 1
    price, past, later = np.zeros(shape), np.zeros(shape), list[Floats]()
    for round_ in range(rounds):
        tell("optimising prices", round_, rounds)
        # Every round has other random numbers, so that the prices do not overfit one sample.
        busy = np.zeros(shape)
        for group in groups:
            if time.perf_counter() > deadline:
                break
            busy += group.count * group.simulated(price, window, options.price_episodes, seed + round_)[0]
        else:
            # The length of each step is divided by the root of the sum of squared past gradients (AdaGrad: Duchi, Hazan
            # and Singer, 2011). So a price with small gradients, where two people rarely need the robot at once, moves
            # far enough. Gradients are relative to the number of busy robots. Otherwise the first rounds of a large
            # team, with dozens of busy robots, would make all later steps too short. A first step changes a price by at
            # most 0.5 cost units.
            there = supply(price, extra)
            slope = (busy - there) / np.maximum(np.maximum(busy, there), 1e-12)
            slope[rows:] = 0.0
            past += slope**2
            price = np.maximum(0.0, price + 0.5 * slope / np.sqrt(past + 1e-12))
            if round_ >= rounds // 2:
                later.append(price)
            continue
        break  # the rest of an incomplete round is not used
    mean = sum((one / len(later) for one in later), np.zeros(shape)) if later else price
    priced = (mean > 0.01).any(axis=0)
    return mean[:, : int(np.flatnonzero(priced).max(initial=-1)) + 1]


def _require_room_for_all(
    problems: list[TruncatedProblem], entry_steps: list[int], window: int, limit_mb: float
) -> None:
    """Raise a `LimitError` if the subproblems would exceed the memory limit."""
    needed, states = 0.0, 0
    for one, steps in zip(problems, entry_steps, strict=True):
        alone = one.problem
        timed = window and one.outer is None
        if timed:  # each step has at least one state; enumerating them would take long
            _require_room_for(limit_mb, policy_bytes(window), len(problems), window, window)
        states = len(TimeExpansion.of(alone, 2 + steps, window if timed else 0))
        slots, actions = alone.model.choices.applicable.shape[1], 1 + alone.suggested.shape[1]
        needed += policy_bytes(states, slots=slots, actions=actions)
    needed *= 1 + 1 / len(problems)  # in each round, one subproblem is built again
    needed += sum(one.outer.nbytes for one in problems if one.outer is not None)
    _require_room_for(limit_mb, needed, len(problems), states, window)


def _require_room_for(limit_mb: float, needed: float, groups: int, states: int, window: int) -> None:
    """Raise a `LimitError` if the `needed` bytes of some subproblems exceed the limit."""
    require_room(
        f"{groups:,} {'problem' if groups == 1 else 'problems'} of people, each of up to {states:,} states with "
        f"{window} steps of prices, take", needed, limit_mb,
        "one model for all (knowledge 'exact'), prices on fewer steps (window), or a higher limit",
    )  # fmt: skip
