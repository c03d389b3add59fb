"""A policy whose price of attention is determined anew at every decision, and the time of its live decisions.

    python bench/repriced.py [--people 1000] [--robots 1] [--instance kitting/paper] [--steps 300] [--record FILE]

`bench/robots.py` compares it with the policies of the package. It has its place here, as it gains
nothing over priority, whose price is always the same, in teams of up to 24 people, and 0.2 % in teams of 100.

The price has the form of a period: it is c in the next L steps, and afterwards that of priority. At every decision c
and L minimise the Lagrangian bound from the present states and beliefs,

    M (c - p) (1 + gamma + ... + gamma^(L - 1))  +  sum_k V_k(b_k; c, L),

where p is priority's price, and a constant is left out. V_k is the value of person k's problem with a robot that comes
and goes, with observed beta and theta; it counts every robot as away. The values of all pairs (c, L) are computed in
advance. With c = p the policy is priority; so it is if there are no more people at work than robots.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import click
import numpy as np
from live import act, step
from numpy.typing import NDArray
from tables import Columns, cell, record_option, write_record

from assist.live.assistant import Assistant
from assist.people.decision import Floats
from assist.person.beliefs import Ask
from assist.person.policy import Policy
from assist.person.qmdp import look_ahead, qmdp
from assist.team.attention_subproblem import AttentionSubproblem
from assist.team.by_policy import ByPolicy
from assist.team.priority import Priority, SolvedSubproblem
from assist.team.settings import Setting
from assist.team.state import NOBODY, TeamAction, TeamState
from assist.team.time_expansion import AWAY
from assist.team.travel import Travel
from planner import cost_to_go, load

PRIORITY = 0.15
"""Priority's price, as a multiple of the cost of the cheapest action."""
LEVELS = (0.3, 0.6, 1.0, 1.5)
"""The prices c beside it, as such multiples."""
PERIODS = (2, 4, 6, 9, 12, 16, 20, 26, 34)
"""The numbers of steps L."""


@dataclass(frozen=True, eq=False)
class PeriodValues:
    """One person's problem with a robot that comes and goes, at every price and period.

    Attributes
    ----------
    value : float array, shape (n, B * T, J)
        Values with the robot away.
    solved : tuple of SolvedSubproblem
        The solution of each.
    """

    value: Floats
    solved: tuple[SolvedSubproblem, ...]

    @classmethod
    def of(cls, free: AttentionSubproblem, cheapest: float) -> PeriodValues:
        """Return the values of a subproblem, backwards from the end of each period."""
        after = qmdp(free.at_price(PRIORITY * cheapest))
        policies, values = [after], [after.value_mdp]
        for level in LEVELS:
            problem, value = free.at_price(level * cheapest), after.value_mdp
            for length in range(1, max(PERIODS) + 1):
                policy = look_ahead(problem, value)
                value = policy.q_mdp.max(axis=1)
                if length in PERIODS:
                    policies.append(policy)
                    values.append(value)
        away = free.states(0, AWAY)
        found = np.stack([value[away].reshape(len(away), -1) for value in values], axis=2)
        return cls(found, tuple(SolvedSubproblem.of(free, policy) for policy in policies))

    def expected(self, x: NDArray[np.int64], belief: Floats) -> Floats:
        """Return the expected values, shape (N, J), of people in some states with beliefs, shape (N, B * T)."""
        found = np.empty((len(x), self.value.shape[2]))
        order = x.argsort(kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(x[order])) + 1):
            if len(rows):
                found[rows] = belief[rows] @ self.value[x[rows[0]]]
        return found


@dataclass(frozen=True, eq=False)
class Repriced:
    """Priority at the price and period that minimise the Lagrangian bound from the present beliefs.

    Attributes
    ----------
    paid : float array, shape (J,)
        What one robot pays at each price and period beyond priority's price, in cost units.
    at_prices : tuple of Priority
        The value of presence at each of them; the first is priority.
    known : ByPolicy of PeriodValues
    """

    paid: Floats
    at_prices: tuple[Priority, ...]
    known: ByPolicy[PeriodValues]
    uses_belief = True

    @classmethod
    def of(cls, policies: Sequence[Policy], travel: Travel) -> Repriced:
        """Return the policy for people with the given policies and travel."""
        cheapest, gamma = min(policy.cheapest for policy in policies), policies[0].pomdp.gamma
        (entry, mean), longest = travel.mean_way, travel.longest_way
        steps = round(mean)
        known = ByPolicy(
            policies,
            lambda policy: PeriodValues.of(
                AttentionSubproblem.of(policy.pomdp, entry, steps, longest=longest), cheapest
            ),
        )
        pairs = [(PRIORITY, 0), *((level, length) for level in LEVELS for length in PERIODS)]

        def at(number: int) -> Priority:
            own = ByPolicy(policies, lambda policy: known[policy].solved[number])
            return Priority(entry, steps, longest, np.array([pairs[number][0] * cheapest]), own)

        paid = [(level - PRIORITY) * cheapest * (1 - gamma**length) / (1 - gamma) for level, length in pairs]
        return cls(np.array(paid), tuple(at(number) for number in range(len(pairs))), known)

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        self.known[policy]

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return priority's action in every team, at its own price."""
        chosen = self.chosen(team)
        if (chosen == chosen[0]).all():
            return self.at_prices[chosen[0]](team)
        person, robot = np.full(team.location.shape, NOBODY), np.zeros(team.location.shape, dtype=np.int64)
        for number in np.unique(chosen).tolist():
            rows = np.flatnonzero(chosen == number)
            action = self.at_prices[number](_of_teams(team, rows))
            person[rows], robot[rows] = action.person, action.robot
        return TeamAction(person, robot)

    def chosen(self, team: TeamState) -> NDArray[np.int64]:
        """Return the number of each team's price and period, shape (N,)."""
        value = team.of_each(self._ask)[:, :, : len(self.paid)]
        bound = np.where(team.active[:, :, None], value, 0.0).sum(axis=1) + team.robots * self.paid
        scarce = team.active.sum(axis=1) > team.robots
        return np.where(scarce, bound.argmin(axis=1), 0)

    @cached_property
    def _ask(self) -> Ask:
        """The question about people; one object, as a live team caches answers by the question."""
        return self._values

    def _values(self, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        policy.pomdp.model.choices.require_one_goal("a price that is determined anew")
        return self.known[policy].expected(x, belief.reshape(len(x), -1))


def _of_teams(team: TeamState, rows: NDArray[np.int64]) -> TeamState:
    """Return the states of some of the teams."""
    of_each = ("x", "active", "erred", "location", "model", "belief", "free")
    return replace(team, **{name: None if (one := getattr(team, name)) is None else one[rows] for name in of_each})


class OnFirstUse:
    """The policy for any team: its data are computed when it is asked first."""

    def __init__(self) -> None:
        self.made: Repriced | None = None

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the action."""
        if self.made is None:
            self.made = Repriced.of(team.policies, team.travel)
        return self.made(team)


COLUMNS: Columns = {
    "task": cell("task"), "people": cell("people", ","), "robots": cell("robots"),
    "set up, s": cell("set up", ".1f"), "observe, median, ms": cell("observe", ".2f"),
    "decision, median, ms": cell("median", ".2f"), "decision, 95 %, ms": cell("high", ".2f"),
}  # fmt: skip


@click.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "sizes", type=click.IntRange(min=1), multiple=True, default=(1000,), show_default=True)
@click.option("--robots", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--steps", type=click.IntRange(min=2), default=300, show_default=True)
@click.option("--before", type=click.IntRange(min=0), default=5, help="Steps of each person before the measurement.")
@record_option
def main(instance: str, sizes: tuple[int, ...], robots: int, steps: int, before: int, record: Path | None) -> None:
    """Measure the time of one live decision, after an action of one person."""
    rows: list[dict[str, Any]] = []
    table = cost_to_go(load(instance))
    for people in sizes:
        begun = time.perf_counter()
        names = [str(number) for number in range(people)]
        desk = Assistant(table, names, policy=OnFirstUse(), setting=Setting(robots=robots))
        desk.recommend()
        row = {"task": instance, "people": people, "robots": robots, "set up": time.perf_counter() - begun}
        rng = np.random.default_rng(0)
        for _ in range(before):
            for name in names:
                desk.observe(*act(desk, name, rng))
        times = 1e3 * np.array([step(desk, names[rng.integers(people)], rng) for _ in range(steps)])[steps // 10 :]
        row["observe"], row["median"] = (float(np.median(times[:, column])) for column in (0, 1))
        row["high"] = float(np.quantile(times[:, 1], 0.95))
        rows.append(row)
        print(", ".join(f"{name} {show(row)}" for name, show in COLUMNS.items()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
