"""Check upper bounds on team policies against simulated policies, in random settings.

    python bench/crosscheck.py [COUNT] [--first N] [--goals] [--jobs N] [--record FILE]

Each setting has a number, which is the seed of everything in it: the task, costs, people, the robot's knowledge,
distances, late joiners, unknown goals, and the method of the bound (on a truncated or the whole task, with prices, with
sample paths).
The bound is compared with the mean return of every shipped policy, simulated in the robot's model. A bound computed on
a truncated task is also compared with a lower bound on the whole task. A mean that exceeds the bound by more than
`ERRORS` standard errors is a violation; it is printed with its setting, and the exit code is 1. `--first N COUNT`
repeats the settings from number N on. Where goals are unknown, policies of a robot that knows them are compared, too.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np
from graphs import graph_task
from tables import Columns, cell, record_option, write_record

from assist.certify.options import BoundOptions
from assist.certify.team_bound import TeamBound, upper_bound
from assist.people.choice_model import ChoiceModel, boltzmann
from assist.people.choices import Choices
from assist.people.decision import Floats, perceived_value
from assist.people.goals import Goals
from assist.people.ranges import Population
from assist.people.state_keys import mix
from assist.people.trust_rules import constant, outcome, outcome_at_disagreement
from assist.person import truncated_bound
from assist.person.settings import Setting
from assist.person.travel import Travel
from assist.team.goal_knowledge import GoalKnowledge
from assist.team.pool import Pool
from assist.team.priority import Priority
from assist.team.schedule import Schedule
from assist.team.simulate import simulate
from assist.team.state import TeamPolicy
from assist.team.whittle import Whittle
from planner import Instance, Table, load, sweep, sweep_goals

DOMAINS = Path(__file__).resolve().parent.parent / "domains"
ERRORS = 4.0
"""Number of standard errors by which a mean must exceed a bound to count as a violation."""
EPISODES = (1_000, 10_000, 100_000)
"""Numbers of simulated episodes for each policy. Where a mean exceeds the bound, larger samples with other random
numbers decide, since a sample without a rare outcome underestimates its standard error.
"""
EPISODES_ON_PART = (32, 320, 3_200, 16_000)
"""The same for policies on truncated tasks, which evaluate states step by step."""
UNSEEN = -math.log(math.erfc(ERRORS / math.sqrt(2)) / 2)
"""With the confidence of `ERRORS` standard errors, an outcome that did not occur in N episodes has a probability below
this number divided by N. In the last and largest sample it is counted with the largest possible cost.
"""
GAP = 0.02
BEYOND = 1e-3
"""Episodes are cut off when all later costs together are at most this share of a step's largest cost. Later steps are
counted with that largest cost.
"""
TASKS = (
    "kitting/tiny", "delivery/one-parcel", "stations/one-bench", "stations/one-way", "gripper/balls-01", "tower/turn",
    "blocks/blocks-3",
)  # fmt: skip
"""Shipped tasks of 8 to 36 states. The second has actions of cost 0, the fourth has dead ends."""
SO_SOON = "with prices of steps all begin at step 0"
"""Part of the message with which priority at a bound's prices refuses people who join late."""


class Unmoved:
    """People who choose by cost-to-go, and whose trust never changes."""

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Return the probability of each choice, shape (B, n, A)."""
        return boltzmann(choices, q, beta)

    def value(self, choices: Choices, q: Floats) -> Floats:  # noqa: ARG002
        """Return V(x), shape (n,)."""
        return np.zeros(len(choices))


class Doubled(Unmoved):
    """People whose trust moves in the opposite direction, at twice the rate."""

    def value(self, choices: Choices, q: Floats) -> Floats:
        """Return V(x), shape (n,)."""
        return -2 * np.nan_to_num(perceived_value(choices, q), neginf=-1e3)


class Arbitrary:
    """People whose choice probabilities are random numbers for each state and action, to the power of beta."""

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:  # noqa: ARG002
        """Return the probability of each choice, shape (B, n, A)."""
        keys = mix(choices.keys[:, None] ^ (choices.actions + 2).astype(np.uint64))
        liking = (keys >> np.uint64(11)).astype(float) * 2.0**-53 + 0.01
        p = np.where(choices.applicable, liking ** beta[:, None, None], 0.0)
        return p / np.where(choices.applicable.any(axis=1), p.sum(axis=2), 1.0)[:, :, None]


MODELS: dict[str, ChoiceModel] = {"unmoved": Unmoved(), "doubled": Doubled(), "arbitrary": Arbitrary()}


@dataclass(frozen=True)
class Case:
    """A random setting.

    Attributes
    ----------
    number : int
        Seed of the setting.
    task : str
        A shipped task, or "graph" for a random one.
    setting : Setting
    population, prior : Population
    team : tuple of int
        Indices of the team's people in the pool.
    distance : float array, shape (K + 1, K + 1), or None
    joins : tuple of int
        Step in which each person begins.
    part : mapping, or None
        Sizes of the truncated task on which the bound is computed; None: the whole task.
    window : int or None
    paths : int
        Number of sample paths.
    goals : int
        Number of goals, of which each person pursues one.
    """

    number: int
    task: str
    setting: Setting
    population: Population
    prior: Population
    team: tuple[int, ...]
    distance: Floats | None
    joins: tuple[int, ...]
    part: dict[str, int] | None
    window: int | None
    paths: int
    goals: int = 1

    @classmethod
    def of(cls, number: int) -> Case:
        """Draw the setting of a number."""
        rng = np.random.default_rng([number, 4])

        def one(*values: Any) -> Any:
            return values[int(rng.integers(len(values)))]

        def span(most: float) -> tuple[float, float]:
            low, high = np.sort(rng.uniform(0, most, 2)).round(3).tolist()
            return one((low, high), (low, high), (low, low), (0.0, high), (low, most))

        task = one(*TASKS, "graph", "graph", "graph")
        part = None
        if rng.random() < 0.4:
            part = {
                "region": one(1, 2, 4, 8), "seen": one(0, 6, 20_000), "complying": one(4, 600_000),
                "pairs_least": one(3, 8), "pairs": one(8, 20_000), "sweeps": one(1, 3, 20),
                "price_states": one(3, 5_000),
            }  # fmt: skip
        people = one(1, 2, 2, 2, 3, 3, 4)
        execute = part is None and rng.random() < 0.2
        how = one("", "", "", "", *MODELS, *() if part is not None or execute else ("weights",))

        def population() -> Population:
            weights = {"goals": span(1.0), "back": (-1.0, 0.0)} if how == "weights" else {}
            return Population(
                beta=one((0.1, 3.0), span(3.0), span(10.0)), theta=one((0.5, 0.95), span(1.0), span(1.0)),
                sigma=one((0.0, 0.0), (0.1, 1.0), span(2.0)), noise=one("state", "state", "action"), weights=weights,
                chooses=MODELS.get(how),
            )  # fmt: skip

        several = rng.random() < 0.15
        whom = Population.mixed((population(), population()), (0.25, 0.75)) if several else population()
        setting = Setting(
            max_steps=60, gamma=one(0.5, 0.8, 0.9, 0.95), c_suggest=one(0.0, 0.05, 0.2, 0.5), c_move=one(0.0, 0.2, 0.5),
            travel_time=one(0.0, 0.0, 0.0, 0.5, 1.0, 2.0), eta=one(0.0, 0.05, 0.2, 0.8),
            utility_scale=one(1.0, 1.0, 3.0), lapse=one(0.0, 0.0, 1e-3, 0.02, 0.3), knowledge=one("own", "exact"),
            suggestions=one("optimal", "all"), execute=execute, c_execute=one(0.0, 0.5, 1.5),
        )  # fmt: skip
        # Drawn from a generator of its own, so that the other cases of a number stay what they were.
        rules = np.random.default_rng([number, 9])
        if rules.random() < 0.3:
            feedback = ("perceived", "true")[int(rules.integers(2))]
            steps = rules.uniform(0.0, 2.0, 3).round(2).tolist()
            rule = (constant(), outcome(*steps[:2], feedback), outcome_at_disagreement(*steps, feedback))  # type: ignore[arg-type]
            setting = replace(setting, trust=rule[int(rules.integers(3))])
        distance = None
        if rng.random() < 0.3:
            distance = rng.uniform(0, 2, (people + 1, people + 1)).round(2)
            np.fill_diagonal(distance, 0.0)
        late = people > 1 and rng.random() < 0.2
        joins = tuple(int(step) for step in rng.integers(0, 6, people)) if late else (0,) * people
        team = tuple(int(person) for person in rng.integers(0, people, people))
        window = one(None, None, 0, 4, 8)
        sampled = not any(joins) and people < 4 and rng.random() < 0.3
        robots = np.random.default_rng([number, 10])
        if people > 1 and not sampled and robots.random() < 0.25:
            setting = replace(setting, robots=int(robots.integers(2, 4)))
        goals, hidden = np.random.default_rng([number, 11]), 1
        if part is None and not (execute or sampled or how == "weights") and goals.random() < 0.5:
            hidden = int(goals.integers(2, 5))
        return cls(
            number, task, setting, whom, population() if rng.random() < 0.2 and how != "weights" else whom,
            one(team, tuple(range(people))), distance, joins, part, window, 60 if sampled else 0, hidden,
        )  # fmt: skip

    @property
    def late(self) -> bool:
        """Whether a person joins after the first step."""
        return any(self.joins)

    @property
    def travel(self) -> Travel:
        """The distances between people."""
        return self.setting.travel(len(self.team), self.distance)

    def table(self) -> Table:
        """Return the cost-to-go table of the task."""
        if self.task != "graph":
            return shipped(self.task)
        rng = np.random.default_rng([self.number, 7])
        while True:
            nodes = int(rng.integers(3, 9))
            edges = rng.integers(0, nodes, (int(rng.integers(nodes, 3 * nodes)), 2))
            costs = rng.choice([1, 1, 1, 0, 2, 3] if rng.random() < 0.5 else [1, 2, 3, 5], len(edges))
            drawn = [(int(a), int(b), int(c)) for (a, b), c in zip(edges, costs, strict=True) if a != b]
            if drawn:
                table = sweep(graph_task(drawn))
                if 0 < table[table.initial] < math.inf:
                    return table

    def task_of(self, table: Table) -> Table | Goals:
        """Return the task with all goals: its own, and random facts of random states."""
        if self.goals == 1:
            return table
        rng, initial = np.random.default_rng([self.number, 12]), table.values([table.initial])[0]
        tables: list[Table] = []
        while not tables or any(one[one.initial] == 0 for one in tables):
            goals = [table.task.goal]
            while len(goals) < self.goals:  # goals may be the same, or hold in the same states
                values = table.values([int(rng.integers(len(table)))])[0]
                which = rng.permutation(len(values))[: int(rng.integers(1, 3))]
                if (values[which] != initial[which]).any():
                    goals.append(tuple((int(one), int(values[one])) for one in np.sort(which)))
            tables = sweep_goals([replace(table.task, goal=goal) for goal in goals])
        names = [f"goal-{number}" for number in range(self.goals)]
        prior = rng.dirichlet(np.ones(self.goals)).tolist()
        return Goals(dict(zip(names, tables, strict=True)), dict(zip(names, prior, strict=True)))

    def pool(self, table: Table | Goals, **options: Any) -> Pool:
        """Draw the pool of people and solve their POMDPs."""
        return Pool.sample(
            table, max(self.team) + 1, seed=self.number, setting=self.setting, population=self.population,
            prior=self.prior, **options,
        )  # fmt: skip

    def __str__(self) -> str:
        return "\n".join(f"  {one.name}: {getattr(self, one.name)}" for one in fields(self))


@cache
def shipped(name: str) -> Table:
    """Return the cost-to-go table of a shipped task."""
    file = DOMAINS / f"{name}.pddl"
    return sweep(load(Instance(file, file.parent / "domain.pddl")))


@dataclass
class Outcome:
    """The result of checking a setting.

    Attributes
    ----------
    number : int
    upper, slack : float
    best : str
        The policy with the highest mean.
    mean, error : float
        This mean and its standard error.
    seconds : float
    violations : list of str
    kinds : list of str
        Kinds of comparisons that were made.
    refused : int
        Number of policies that are refused by design.
    """

    number: int
    upper: float = math.nan
    slack: float = 0.0
    best: str = ""
    mean: float = -math.inf
    error: float = 0.0
    seconds: float = 0.0
    violations: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    refused: int = 0


EASY = BoundOptions(price_rounds=6, price_episodes=128, belief_episodes=200)
"""Less effort for a bound. This makes the bound looser, but not invalid."""


@contextmanager
def cheaper(part: dict[str, int] | None) -> Iterator[None]:
    """Use the sizes of a case for problems on truncated tasks. This makes a bound looser, but not invalid."""
    smaller = {name: value for name, value in (part or {}).items() if name != "region"}
    with patch.object(truncated_bound, "SIZES", replace(truncated_bound.SIZES, **smaller)):
        yield


def bound_of(case: Case, pool: Pool) -> tuple[float, TeamBound, float]:
    """Return an upper bound on a team's value, the bound it was computed from, and its standard error.

    A late joiner's value is at most that with a robot of their own from then on. The bound U_k of a single person who
    begins at step s is therefore discounted by gamma^s.
    """
    found = upper_bound(
        pool, case.team, travel=case.travel, window=case.window, gap=GAP, paths=case.paths, seed=1, jobs=1, options=EASY
    )
    if not case.late:
        error = 0.0
        if found.sampled is not None and found.upper < found.proven:
            error = found.sampled.stderr
        return found.upper, found, error
    total = 0.0
    for person, step, travel in zip(case.team, case.joins, alone(case.travel), strict=True):
        alone_bound = upper_bound(pool, (person,), travel=travel, gap=GAP, jobs=1, options=EASY)
        total += case.setting.gamma**step * alone_bound.upper
    return total, found, 0.0


def alone(travel: Travel) -> list[Travel]:
    """Return, for each station, the travel of a team of one from the nearest other station."""
    nearest = [np.delete(travel.distance[:, k], k).min() for k in range(len(travel))]
    return [replace(travel, distance=np.array([[0, least], [least, 0]])) for least in nearest]


def policies_of(case: Case, whole: Pool, pool: Pool, found: TeamBound) -> Iterator[tuple[str, Pool, TeamPolicy]]:
    """Yield the shipped policies, each with the pool that it uses."""
    for name in ("none", "reactive", "attention", "attention-never", "priority"):
        yield name, whole, whole.policy(name, case.travel)
    if case.number % 4 == 0:  # it takes a solution for each price; three make another, equally valid policy
        yield "whittle", whole, Whittle.of(whole.policies, case.travel, (0.0, 0.2, 1.0))
    if len(found.price):
        yield "priority at the bound's prices", whole, Priority.of(whole.policies, case.travel, found.price)
    if pool is not whole:
        for name in ("attention", "priority"):
            yield f"{name} on the part", pool, pool.policy(name, case.travel)


@dataclass(frozen=True)
class Value:
    """A lower confidence bound on a policy's mean return, its standard error, and whether it violates a bound."""

    mean: float
    error: float
    violates: bool


def compared(
    case: Case, pool: Pool, policy: TeamPolicy, upper: float, error: float, goals: GoalKnowledge = "inferred"
) -> Value:
    """Compare a policy with a bound that has a standard error itself."""
    gamma, way = case.setting.gamma, case.travel
    last = math.ceil(math.log(BEYOND * (1 - gamma)) / math.log(gamma)) + max(case.joins)
    limited = replace(pool, setting=replace(pool.setting, max_steps=last))
    dearest = max(float(one.pomdp.model.choices.costs.max() + one.pomdp.robot_costs.max()) for one in pool.policies)
    dearest += float(way.c_move.max()) * float(way.distance.max())
    for episodes in EPISODES if pool.policies[0].problem.region is None else EPISODES_ON_PART:
        run = simulate(
            limited, policy, humans=list(case.team), episodes=episodes, seed=case.number + episodes, travel=way,
            presence=Schedule.of(len(case.team), joins=list(case.joins)), world="model", goals=goals,
        )  # fmt: skip
        returns = run.discounted_return - (~run.finished).sum(axis=1) * dearest * gamma**last / (1 - gamma)
        mean, stderr = float(returns.mean()), float(returns.std(ddof=1) / math.sqrt(episodes))
        over = mean - ERRORS * math.hypot(stderr, error) - upper - 1e-9 * (1 + abs(upper))
        if over <= 0:
            return Value(mean, stderr, False)
    return Value(mean, stderr, over > UNSEEN / episodes * len(case.team) * dearest / (1 - gamma))


def check(case: Case) -> Outcome:
    """Compare the bound of a setting with all shipped policies, and with bounds on the whole task."""
    start = time.perf_counter()
    outcome = Outcome(case.number)
    table = case.table()
    whole = case.pool(case.task_of(table))
    pool = whole if case.part is None else case.pool(table, states=0, region=case.part["region"])
    with cheaper(case.part):
        upper, found, error = bound_of(case, pool)
        outcome.upper, outcome.slack = upper, found.slack
        if case.part is not None:
            travel = alone(case.travel)[0]
            part, everything = (
                upper_bound(one, case.team[:1], travel=travel, gap=GAP, jobs=1, options=EASY) for one in (pool, whole)
            )
            outcome.kinds.append("part against whole")
            if part.upper < everything.upper - everything.slack - 1e-9 * abs(part.upper):
                outcome.violations.append(
                    f"one person: {part.upper:.6f} on a part, at least {everything.upper - everything.slack:.6f} on all"
                )
    policies = list(policies_of(case, whole, pool, found))
    rows: list[tuple[str, Pool, TeamPolicy, GoalKnowledge]] = [(*row, "inferred") for row in policies]
    if case.goals > 1:  # the bound holds for robots that know the goals, too
        rows += [(f"{name}, goals known", one, policy, "known") for name, one, policy in policies if name != "none"]
    for name, one, policy, knows in rows:
        try:
            value = compared(case, one, policy, upper, error, knows)
        except ValueError as refusal:
            if not (case.late and SO_SOON in str(refusal)):
                raise
            outcome.refused += 1
            continue
        mean, stderr = value.mean, value.error
        if value.violates:
            outcome.violations.append(f"{name}: {mean:.6f} ± {stderr:.6f}, upper {upper:.6f} ± {error:.6f}")
        outcome.kinds.append(name)
        if mean > outcome.mean:
            outcome.best, outcome.mean, outcome.error = name, mean, stderr
    outcome.seconds = time.perf_counter() - start
    return outcome


def checked(number: int) -> Outcome:
    """Check the setting of a number. An exception counts as a violation, so that the other settings are still
    checked.
    """
    try:
        return check(Case.of(number))
    except Exception as error:  # noqa: BLE001
        return Outcome(number, violations=["".join(traceback.format_exception(error))])


@click.command()
@click.argument("count", type=click.IntRange(1), default=20)
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The number of the first setting.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Settings at a time.")
@click.option("--goals", is_flag=True, help="Only settings in which goals are unknown.")
@record_option
def main(count: int, first: int, jobs: int, goals: bool, record: Path | None) -> None:
    """Check COUNT settings."""
    outcomes = []
    numbers = itertools.islice((n for n in itertools.count(first) if not goals or Case.of(n).goals > 1), count)
    with ProcessPoolExecutor(jobs, get_context("spawn")) as processes:
        for outcome in processes.map(checked, list(numbers)):
            outcomes.append(outcome)
            if outcome.violations:
                print(f"setting {outcome.number}", *outcome.violations, Case.of(outcome.number), sep="\n", flush=True)
    counts = Counter(kind for outcome in outcomes for kind in outcome.kinds)
    for kind, number in counts.most_common():
        print(f"{number:6,} comparisons with {kind}")
    wrong = [outcome.number for outcome in outcomes if outcome.violations]
    cases = [Case.of(outcome.number) for outcome in outcomes]
    row = {
        "settings": len(outcomes),
        "on a part": sum(case.part is not None for case in cases),
        "sampled": sum(case.paths > 0 for case in cases),
        "late joiners": sum(case.late for case in cases),
        "no lapses": sum(case.setting.lapse == 0 for case in cases),
        "execute": sum(case.setting.execute for case in cases),
        "own choice model or terms": sum(bool(case.prior.weights) or case.prior.chooses is not None for case in cases),
        "unknown goals": sum(case.goals > 1 for case in cases),
        "comparisons": counts.total(),
        "refused": sum(outcome.refused for outcome in outcomes),
        "violations": len(wrong),
    }
    print(*(f"{name} {number:,}" for name, number in row.items()), sep=", ")
    write_record(record, COLUMNS, [row])
    if wrong:
        print(f"violations in settings {', '.join(map(str, wrong))}")
        sys.exit(1)


COLUMNS: Columns = {
    name: cell(name, ",")
    for name in (
        "settings", "on a part", "sampled", "late joiners", "no lapses", "execute", "own choice model or terms",
        "unknown goals", "comparisons", "refused", "violations",
    )
}  # fmt: skip


if __name__ == "__main__":
    main()
