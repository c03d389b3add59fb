"""Choice models that predict real people, and recovery of the weights of simulated people.

    python bench/people.py COMMAND [--help]

`tower` reads recordings of people at the Tower of London from the folder in the environment variable TOWER_RECORDINGS
(`data/tower_of_london/subject_data` of https://github.com/WeiJiMaLab/rush_hour, see `recordings`). It fits choice
models to some people and problems, and predicts other people at other problems. `recover` simulates people with known
weights and measures the coverage of intervals. `huge` times `kitassist compare models` on a log of a task with millions
of states.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from recordings import Solved, make_up, moves_of, problem_text, read_all
from simulated_people import record_with_terms
from tables import cell, record_option, write_record

from assist.learning import Log, Method, observe, observed, replay
from assist.learning.comparison import ratio
from assist.learning.hierarchy import fit_hierarchy, fit_terms, pooled
from assist.learning.logit_likelihood import Likelihood
from assist.learning.observations import EvaluatedStates, Observations
from assist.learning.replay import Recording, situation
from assist.people import TERMS, Situation, Term, features
from planner import Instance, Table, cost_to_go, load
from planner.search.state_space import UNREACHED, plan_lengths

ROOT = Path(__file__).resolve().parent.parent
TOWER = ROOT / "domains" / "tower" / "domain.pddl"
RECORDS = ROOT / "bench" / "records"
LAPSE = 0.01
FOLDS = (6, 4)  # of people, of problems
NEAR = 3  # actions from the goal
WEIGHTS = (0.5, -1.0, 0.6, -1.0), (0.5, 1.0, 0.6, 0.8)  # of simulated people: means, standard deviations


def best(table: Table, s: Situation) -> np.ndarray:
    """Return whether each action begins an optimal plan."""
    q = np.where(s.applicable, np.asarray(table.task.costs)[s.actions] + table.h[s.targets], np.inf)
    return q == q.min(axis=1, keepdims=True)


def settled(table: Table, s: Situation) -> np.ndarray:
    """Return the change in the number of goal facts that hold and can be kept until the goal is reached."""
    rows, sources = table.space.transitions, table.space.sources
    count = np.zeros(len(table), dtype=np.int64)
    for fact in table.task.goal:
        held = table.space.numbering.where([fact])
        kept = held[sources] & held[rows.targets]
        ways = plan_lengths(rows.targets[kept], sources[kept], table.space.goal)
        count += held & (ways != UNREACHED)
    return count[s.targets] - count[s.state][:, None]


def opens(table: Table, s: Situation) -> np.ndarray:
    """Return the largest number of goal facts that the next action can add."""
    rows, sources = table.space.transitions, table.space.sources
    count = sum(table.space.numbering.where([fact]).astype(np.int64) for fact in table.task.goal)
    found = np.zeros(len(table), dtype=np.int64)
    np.maximum.at(found, sources, count[rows.targets] - count[sources])
    return found[s.targets]


def horizon(depth: int, table: Table, s: Situation) -> np.ndarray:
    """Return minus the cost-to-go, limited to `depth`, as perceived by a person who plans only near the goal."""
    return -np.minimum(table.h[s.targets], depth)


def subject(s: Situation) -> np.ndarray:
    """Return whether an action's first argument is that of the last action."""
    first = np.array([*(hash(name[1:-1].split()[1]) for name in s.names), 0])
    return (first[s.actions] == first[s.last][:, None]) & (s.last >= 0)[:, None]


OWN: dict[str, Callable[[Table, Situation], np.ndarray]] = {
    "best": best, "settled": settled, "opens": opens, "horizon-2": partial(horizon, 2),
    "horizon-4": partial(horizon, 4), "subject": lambda _, s: subject(s),
}  # fmt: skip


def context(recording: Recording, solved: Mapping[tuple[str, str], Solved], table: Table) -> dict[str, np.ndarray]:
    """Return further properties of each step, shape (N,): distance to the goal, time taken, and order of the
    problem.
    """
    places = zip(recording.person, recording.episode, strict=True)
    numbers = [solved[recording.people[person], recording.episodes[episode]] for person, episode in places]
    seconds = np.array([one.seconds[step] for one, step in zip(numbers, recording.step, strict=True)])
    return {
        "near": (table.h[recording.state] <= NEAR).astype(float),
        "slow": np.log(np.maximum(seconds, 0.05)),
        "later": np.array([one.order for one in numbers]) / 25,
        "begin": (recording.step == 0).astype(float),
    }


def revisits(recording: Recording) -> np.ndarray:
    """Return whether a choice leads to a state visited before in its episode, shape (N, A)."""
    result = np.zeros(recording.targets.shape)
    seen: set[int] = set()
    for row, (step, state) in enumerate(zip(recording.step.tolist(), recording.state.tolist(), strict=True)):
        seen = {state} if step == 0 else seen | {state}
        result[row] = [target in seen for target in recording.targets[row].tolist()]
    return result


CROSSED = {
    "near": ("cost", "best", "goals", "settled"), "slow": ("cost", "best"), "later": ("cost", "best"),
    "begin": ("best", "goals", "settled"),
}  # fmt: skip


@dataclass(frozen=True)
class Data:
    """The choices of all people at all problems, in the order of the likelihood's steps."""

    likelihood: Likelihood
    problem: np.ndarray
    first: np.ndarray


def observations_of(problem: int, every: list[Solved], folder: Path) -> list[Observations]:
    """Write a problem and its log, replay the log, and compute all terms."""
    file = folder / f"problem-{problem}.pddl"
    file.write_text(problem_text(f"problem-{problem}", every[0].initial, every[0].target))
    table = cost_to_go(load(Instance(file, TOWER)))
    solved = {(f"p{one.person:03d}", str(problem)): one for one in every}
    entries = [
        {"person": person, "episode": episode, "step": step, "action": action}
        for (person, episode), one in solved.items()
        for step, action in enumerate(moves_of(one))
    ]
    recording, faults = replay(Log.of(entries), table)
    assert not faults, faults[0]
    here, h = situation(recording, table), table.h
    terms: dict[str, Term] = {**TERMS, **{name: partial(own, table) for name, own in OWN.items()}}
    values = dict(zip(terms, np.moveaxis(features(here, terms), 2, 0), strict=True))
    values["revisit"] = revisits(recording) * recording.applicable
    values["cost"] = np.where(recording.applicable, -(recording.costs + h[recording.targets]), 0.0)
    for name, weight in context(recording, solved, table).items():
        values |= {f"{one} x {name}": values[one] * weight[:, None] for one in CROSSED[name]}
    del values["cost"]
    every = np.arange(len(table))
    known = EvaluatedStates.of(table, every, h, every, len(table))
    return observe(recording, known, table.space.goal, tuple(values), np.stack([*values.values()], axis=2))


def read_data(every: list[Solved]) -> Data:
    """Return the data of all problems."""
    found: list[Observations] = []
    with tempfile.TemporaryDirectory() as folder:
        for problem in sorted({one.problem for one in every}):
            found += observations_of(problem, [one for one in every if one.problem == problem], Path(folder))
    likelihood = Likelihood.of(found, Method(lapse=LAPSE))
    number = {person: place for place, person in enumerate(likelihood.people)}
    person = np.concatenate([np.full(len(o), number[o.person]) for o in found])
    problem = np.concatenate([np.full(len(o), int(o.episodes[0])) for o in found])
    return Data(likelihood, problem[np.argsort(person, kind="stable")], likelihood.steps.begins)


Fold = tuple[np.ndarray, np.ndarray]
"""Steps, shape (N,), that are learned from, and those that are predicted; always whole episodes."""


def held_out(likelihood: Likelihood, folds: Iterable[Fold], *, costs: bool = True) -> np.ndarray:
    """Return the log-probability of each choice, shape (N,), under the estimates from the other folds."""
    result, at = np.full(len(likelihood.steps.person), np.nan), None
    for learned, predicted in folds:
        _, at = pooled(likelihood, learned, at, costs=costs)
        result[predicted] = likelihood.together(predicted).log_probability(at)
    return result


def summed_up(likelihood: Likelihood, logs: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Return nats per choice, their standard error over people, and those of each person, shape (K,)."""
    people = len(likelihood.people)
    count = np.bincount(likelihood.steps.person, minlength=people)
    total = np.bincount(likelihood.steps.person, -logs, people)
    return *ratio(total, count), total / np.maximum(count, 1)


def crossed(data: Data, people: int, problems: int) -> Iterable[Fold]:
    """Yield folds that predict some people at some problems from other people at other problems, each pair once."""
    who, what = data.likelihood.steps.person % people, data.problem % problems
    for k in range(people):
        for j in range(problems):
            yield (who != k) & (what != j), (who == k) & (what == j)


FOUR = ("goals", "arguments", "name", "back")
BEST = (*FOUR, "subject", "best", "settled", "opens", "best x near", "cost x near", "goals x near", "settled x near")
MODELS: dict[str, tuple[tuple[str, ...], bool]] = {
    "uniform": ((), False), "best-or-random": (("best",), False), "boltzmann": ((), True),
    **{term: ((term,), True) for term in FOUR}, "terms": (FOUR, True),
    "terms, best-or-random": ((*FOUR, "best"), True),
    "terms, subject": ((*FOUR, "subject"), True),
    "terms, subject, best-or-random": ((*FOUR, "subject", "best"), True),
    "terms, subject, best-or-random, settled": ((*FOUR, "subject", "best", "settled"), True),
    "best model": (BEST, True),
}  # fmt: skip
MORE = {
    "revisit": ("revisit",), "horizon of 2": ("horizon-2",), "horizon of 4": ("horizon-4",),
    "response times": ("cost x slow", "best x slow"), "learning over problems": ("cost x later", "best x later"),
    "first moves": ("best x begin", "goals x begin", "settled x begin"),
}  # fmt: skip
"""Terms that are added to the best model, to see whether they improve it."""


COLUMNS = {
    "model": cell("model"), "parameters": cell("parameters"), "nats per choice": cell("nats", ".3f", "stderr"),
    "less than Boltzmann": cell("less"), "better for": cell("better"),
}  # fmt: skip
COVERED = {
    "people": cell("people"), "seed": cell("seed"), **{name: cell(name, ".0%") for name in ("beta", *TERMS)},
}  # fmt: skip


@click.group()
def main() -> None:
    """Compare choice models on real people, and recover the weights of simulated ones."""


@main.command()
@click.option("--made-up", type=int, metavar="N", help="Use generated sessions of N people instead of recordings.")
@click.option("--quick", is_flag=True, help="Compare the models only, with folds of people.")
@record_option
def tower(made_up: int | None, quick: bool, record: Path | None) -> None:
    """Predict people at the Tower of London."""
    with tempfile.TemporaryDirectory() as made:
        if made_up:
            make_up(Path(made), made_up, 4, np.random.default_rng(0))
        elif "TOWER_RECORDINGS" not in os.environ:
            sys.exit("TOWER_RECORDINGS is not set; expected the folder of the recordings, a .csv file for each person")
        every = read_all(Path(made if made_up else os.environ["TOWER_RECORDINGS"]))
    data = read_data(every)
    likelihood, steps = data.likelihood, data.likelihood.steps
    problems = int(data.problem.max()) + 1
    folds = [*crossed(data, FOLDS[0], 1 if quick else min(FOLDS[1], problems))]
    if quick:
        folds = [(steps.person % FOLDS[0] != k, steps.person % FOLDS[0] == k) for k in range(FOLDS[0])]
    click.echo(
        f"{len(likelihood.people)} people, {problems} problems, {len(every)} solved, {len(steps.person)} choices"
    )
    rows: list[dict[str, object]] = []
    whole = np.ones(len(steps.person), dtype=bool)
    means: dict[str, float] = {}
    references: dict[str, np.ndarray] = {}

    def add(name: str, logs: np.ndarray, parameters: int, kind: str = "", some: np.ndarray = whole) -> None:
        """Add a row; models of a kind are compared with the Boltzmann model of the same kind."""
        mean, error, each = summed_up(replace(likelihood, steps=steps.only(some)), logs[some])
        if name == "boltzmann":
            means[kind], references[kind] = mean, each
        less = f"{100 * (1 - mean / means[kind]):.1f} %" if kind in means and name != "boltzmann" else ""
        better = f"{int((each < references[kind]).sum())} of {len(each)}" if less and some is whole else ""
        shown = f"{name}, {kind}" if kind else name
        rows.append(
            {"model": shown, "parameters": parameters, "nats": mean, "stderr": error, "less": less, "better": better}
        )
        click.echo(f"{shown:42} {mean:.4f} ± {error:.4f} {less} {better}")

    for name, (terms, costs) in MODELS.items():
        add(name, held_out(likelihood.with_terms(terms), folds, costs=costs), len(terms) + costs)
    if not quick:
        for name, extra in MORE.items():
            logs = held_out(likelihood.with_terms((*BEST, *extra)), folds)
            add(f"best model + {name}", logs, len(BEST) + 1 + len(extra))
        for lapse in (0.001, 0.02, 0.05):
            logs = held_out(replace(likelihood, lapse=lapse).with_terms(BEST), folds)
            add(f"best model, lapse {lapse:g}", logs, len(BEST) + 1)
        whom = ~data.first & (steps.person < 160)
        by_person = [((k != steps.person % 4) & whom, (k == steps.person % 4) & whom) for k in range(4)]
        for name in ("uniform", "boltzmann", "best-or-random", "terms", "terms, subject"):
            terms, costs = MODELS[name]
            logs = held_out(likelihood.with_terms(terms), by_person, costs=costs)
            add(name, logs, len(terms) + costs, "160 people, not first moves", whom)
        by_problem = [(data.problem % FOLDS[1] != j, data.problem % FOLDS[1] == j) for j in range(FOLDS[1])]
        for name in ("boltzmann", "terms"):
            own = likelihood.with_terms(MODELS[name][0])
            add(name, held_out(own, by_problem), len(own.terms) + 1, "other problems")
        for name in ("boltzmann", "terms"):
            own = likelihood.with_terms(MODELS[name][0])
            add(name, personal(own, by_problem), len(own.terms) + 1, "other problems, own weights")
    write_record(record, COLUMNS, rows)


def personal(likelihood: Likelihood, folds: Iterable[Fold]) -> np.ndarray:
    """Predict each choice with the person's own weights, fitted to other problems."""
    result = np.zeros(len(likelihood.steps.person))
    for learned, predicted in folds:
        people = fit_hierarchy(replace(likelihood, steps=likelihood.steps.only(learned)), 12)
        result[predicted] = replace(likelihood, steps=likelihood.steps.only(predicted)).log_probability(people.at)
    return result


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", type=int, default=100, show_default=True)
@click.option("--actions", type=int, default=80, show_default=True)
@click.option("--seeds", type=int, default=3, show_default=True)
@record_option
def recover(instance: str, people: int, actions: int, seeds: int, record: Path | None) -> None:
    """Measure the coverage of intervals for the beta and the weights of simulated people."""
    table = cost_to_go(load(ROOT / "domains" / f"{instance}.pddl"))
    rows = []
    for kind in ("with terms", "without terms"):
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            beta = np.exp(rng.uniform(np.log(0.3), np.log(3.0), people))
            weights = np.stack(
                [rng.normal(m, s, people) for m, s in ((0.5, 0.5), (-1, 1), (0.6, 0.6), (-1, 0.8))], axis=1
            )
            weights *= kind == "with terms"
            told = record_with_terms(table, beta, weights, actions, rng)
            fits, _ = fit_terms(observed(table, told, terms=TERMS), Method())
            covered = {"beta": np.mean([_in(fit.beta_interval, true) for fit, true in zip(fits, beta, strict=True)])}
            for j, name in enumerate(TERMS):
                held = [_in(fit.weights_interval[name], w) for fit, w in zip(fits, weights[:, j], strict=True)]
                covered[name] = np.mean(held)
            rows.append({"people": kind, "seed": seed, **covered})
            click.echo(f"{kind} {seed}: {', '.join(f'{name} {100 * c:.0f} %' for name, c in covered.items())}")
    write_record(record, COVERED, rows)


def _in(interval: tuple[float, float], value: float) -> bool:
    return interval[0] <= value <= interval[1]


@main.command()
@click.option("--instance", default="depot/nine-items", show_default=True)
@click.option("--people", type=int, default=32, show_default=True)
@click.option("--actions", type=int, default=30, show_default=True)
def huge(instance: str, people: int, actions: int) -> None:
    """Time `kitassist compare models` on a log of people who choose by terms."""
    file = ROOT / "domains" / f"{instance}.pddl"
    rng = np.random.default_rng(0)
    beta = np.exp(rng.uniform(np.log(0.5), np.log(3.0), people))
    weights = np.tile([0.5, 2.0, 0.6, -1.0], (people, 1))
    table = cost_to_go(load(file))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.jsonl"
        with log.open("w") as lines:
            lines.writelines(json.dumps(e) + "\n" for e in record_with_terms(table, beta, weights, actions, rng))
        command = [
            Path(sys.executable).parent / "kitassist",
            "compare",
            "models",
            file,
            log,
            "--set",
            f"cache={folder}",
        ]
        start = time.perf_counter()
        done = subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True)
        click.echo(done.stdout)
        click.echo(f"{len(table):,} states, {people} people, {actions} actions: {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
