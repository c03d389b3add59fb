"""Recovery of people's parameters from recorded actions of simulated people.

    python bench/fit.py COMMAND [--record FILE [--more]] [--help]

`recover` estimates people with known parameters and measures the coverage of intervals, `information` computes bounds
on any estimator, `misconceptions` estimates sigma, and `time` times the command on large tasks.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table as Grid
from scipy.stats import spearmanr
from simulated_people import People
from simulated_people import record as recorded
from tables import Columns, cell, more_option, record_option, write_record

from assist.learning import (
    Method,
    Observations,
    check,
    fit_misconception,
    fit_population,
    log_likelihood,
    maximum_likelihood,
    observed,
)
from assist.learning.likelihood import largest_beta
from planner import Cache, OnDemand, Table, Task, load, sweep
from planner.system.files import write_records

ROOT = Path(__file__).resolve().parent.parent
KITTING = ROOT / "domains" / "kitting"


def joined(name: str) -> Callable[[dict[str, Any]], str]:
    """Return a formatter that joins the values of all seeds."""
    return lambda row: ", ".join(row[name])


SEEDS: Columns = {
    "instance": cell("instance"), "beta": cell("distribution"), "seed": cell("seed"),
    "beta covered": cell("beta covered"), "rank correlation": cell("rank corr."), "at best": cell("at best"),
    "not bounded above": cell("not bounded"), "theta covered": cell("theta covered"),
}  # fmt: skip
INSTANCES: Columns = {
    "instance": cell("instance"), "actions of a person": joined("each"), "rank correlation": joined("rank corr."),
    "at best": joined("at best"),
}  # fmt: skip
POPULATION: Columns = {
    "beta": cell("distribution"), "": cell("what"), "bias of mean, rms": cell("mean"),
    "bias of spread, rms": cell("spread"), "both within 10 %": cell("near"),
}  # fmt: skip
INFORMATION: Columns = {
    "instance": cell("instance"), "smallest mistake": cell("smallest mistake"),
    "mistakes of their own, beta 5": cell("own mistakes, beta 5"), "Cramér-Rao bound, beta 1": cell("error, beta 1"),
    **{name: cell(f"error, beta {name}") for name in ("2", "3", "5")},
    "best rank correlation, uniform": cell("uniform"), "log-uniform": cell("log-uniform"),
}  # fmt: skip
MISCONCEPTIONS: Columns = {
    **{name: cell(name) for name in ("episodes", "sigma", "plain beta", "beta", "sigma found", "sigma covered")},
    "correlation of found and true h - h*": cell("corr. of h"),
    "check p < 0.05": cell("check p < 0.05"),
}
TIME: Columns = {
    "instance": cell("instance"), "states": cell("states", ","), "run": cell("run"), "seconds": cell("seconds", ".1f"),
    "states in the cache then": cell("kept", ","),
}  # fmt: skip
STATES = 1_173_311_155  # of ladder-4x10, whose table does not fit into memory

BETA_MOMENTS = ("mean", "of these", "true", "spread", "of these ", "true ")
THETA_MOMENTS = ("theta mean", "true theta mean", "theta spread", "true theta spread")


def uniform(rng: np.random.Generator, low: float, high: float, count: int, distribution: str) -> np.ndarray:
    """Draw numbers between two bounds, uniformly or log-uniformly."""
    if distribution == "log-uniform":
        return np.exp(rng.uniform(np.log(low), np.log(high), count))
    return rng.uniform(low, high, count)


def moments(low: float, high: float, distribution: str) -> np.ndarray:
    """Return the mean and standard deviation of the distribution of `uniform`."""
    if distribution == "log-uniform":
        width = np.log(high / low)
        mean, square = (high - low) / width, (high**2 - low**2) / (2 * width)
    else:
        mean, square = (low + high) / 2, (low**2 + low * high + high**2) / 3
    return np.array([mean, np.sqrt(square - mean**2)])


def best_correlation(
    observations: list[Observations], people: People, low: float, high: float, distribution: str
) -> float:
    """Return the largest rank correlation with beta that any estimator has on average.

    The rank of a person is F(beta), the distribution function of beta, up to sampling error. Among all functions of the
    data, the posterior mean of the rank correlates best with it. It is computed here with knowledge of the distribution
    of beta, of each person's theta, and of eta.
    """
    rank = np.linspace(0.0, 1.0, 200)
    if distribution == "log-uniform":
        beta, true = low * (high / low) ** rank, np.log(people.beta / low) / np.log(high / low)
    else:
        beta, true = low + (high - low) * rank, (people.beta - low) / (high - low)
    expected = []
    for o, theta in zip(observations, people.theta, strict=True):
        values = log_likelihood(o, beta, np.array([theta]), np.array([people.eta])).ravel()
        weight = np.exp(values - values.max())
        expected.append(weight @ rank / weight.sum())
    return float(np.corrcoef(true, expected)[0, 1])


def standard_error(observations: list[Observations], people: People) -> float:
    """Return the Cramér-Rao bound on the standard error of beta, for people of equal beta; theta and eta are known."""
    width = 0.01
    beta = people.beta[0] + width * np.array([-1.0, 0.0, 1.0])
    method = Method(lapse=1e-12)  # there are no lapses in these data
    bend = [
        log_likelihood(o, beta, np.array([theta]), np.array([people.eta]), method).ravel() @ [1.0, -2.0, 1.0]
        for o, theta in zip(observations, people.theta, strict=True)
    ]
    return float(1 / np.sqrt(-np.mean(bend) / width**2))


@click.group()
def main() -> None:
    """Measure the recovery of people's parameters from recorded actions."""


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "count", type=int, default=200, show_default=True)
@click.option("--episodes", type=int, default=3, show_default=True)
@click.option("--distribution", type=click.Choice(["uniform", "log-uniform"]), default="uniform", show_default=True)
@click.option("--beta", nargs=2, type=float, default=(0.1, 5.0), show_default=True)
@click.option("--theta", nargs=2, type=float, default=(0.3, 0.95), show_default=True)
@click.option("--sigma", type=float, default=0.0, show_default=True)
@click.option("--suggest", type=float, default=0.5, show_default=True, help="Share of steps with a suggestion.")
@click.option("--eta", type=float, help="Rate of the trust update given to the fit (0.2). Estimated unless given.")
@click.option("--largest-beta", type=float)
@click.option("--seeds", type=int, default=1, show_default=True)
@click.option("--first-seed", type=int, default=0, show_default=True)
@click.option(
    "--rows", "kind", type=click.Choice(["seeds", "instance", "population"]), default="seeds", show_default=True,
    help="Kind of rows in --record.",
)  # fmt: skip
@record_option
@more_option
def recover(
    instance: str, count: int, episodes: int, distribution: str, beta: tuple[float, float],
    theta: tuple[float, float], sigma: float, suggest: float, eta: float | None, largest_beta: float | None, seeds: int,
    first_seed: int, kind: str, record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Estimate people with known parameters, and measure the coverage of intervals.

    Means and standard deviations of beta are printed for the fitted population, for the recorded people as it sees them
    ("of these"), and for their true values ("true"). The errors over all seeds follow.
    """
    table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))
    method = Method(eta=eta, largest_beta=largest_beta)
    drawn_from = moments(*beta, distribution)
    name, found, rows = f"`{instance.removeprefix('kitting/')}`", [], []
    for seed in range(first_seed, first_seed + seeds):
        rng = np.random.default_rng(seed)
        people = People(
            uniform(rng, *beta, count, distribution), rng.uniform(*theta, count),
            noise=sigma * rng.standard_normal((count, len(table))) if sigma else None,
        )  # fmt: skip
        observations = observed(table, recorded(table, people, episodes=episodes, rng=rng, suggest=suggest, most=2000))
        start = time.perf_counter()
        fits = maximum_likelihood(observations, method)
        seconds = time.perf_counter() - start
        found_population = fit_population(observations, method)
        theta_of = found_population.theta
        true_moments = np.array([people.beta.mean(), people.beta.std()])
        fitted = np.array([found_population.beta.mean, found_population.beta.spread])
        found.append((fitted, np.array(found_population.beta.recorded), true_moments))
        best = best_correlation(observations, people, *beta, distribution) if sigma == 0 else float("nan")

        def covered(true: np.ndarray, ends: list[tuple[float, float]]) -> str:
            low, high = np.array(ends).T
            return f"{100 * ((low <= true) & (true <= high)).mean():.1f} %"

        told = all("theta" in f.estimates for f in fits)
        rows.append({
            "instance": name, "distribution": distribution, "seed": str(seed),
            "actions": f"{sum(map(len, observations)):,}", "each": f"{sum(map(len, observations)) / count:.0f}",
            "seconds": f"{seconds:.1f}",
            "beta covered": covered(people.beta, [f.beta_interval for f in fits]),
            "rank corr.": f"{spearmanr(people.beta, [f.estimates['beta'].value for f in fits])[0]:.3f}",
            "at best": f"{best:.3f}",
            "not bounded": f"{100 * np.mean([f.estimates['beta'].open_above for f in fits]):.0f} %",
            "theta covered": covered(people.theta, [f.estimates["theta"].interval for f in fits]) if told else "-",
            "eta covered": covered(np.full(count, people.eta), [f.estimates["eta"].interval for f in fits])
            if told and eta is None
            else "-",
            "family": found_population.beta.family,
            **dict(zip(BETA_MOMENTS, (f"{x:.2f}" for x in np.array(found[-1]).T.ravel()), strict=True)),
            **dict.fromkeys(THETA_MOMENTS, "-"),
        })  # fmt: skip
        if theta_of is not None:
            values = theta_of.mean, people.theta.mean(), theta_of.spread, people.theta.std()
            rows[-1] |= {name: f"{x:.2f}" for name, x in zip(THETA_MOMENTS, values, strict=True)}
    show(
        rows, f"{instance}: {count} people, {episodes} episodes, beta {distribution} in {beta}, sigma {sigma:g}",
        ("instance", "distribution", "each"),
    )  # fmt: skip
    fitted, of_these, true = np.array(found).swapaxes(0, 1)
    errors = []
    for what, values, against in (
        ("`mean`, `spread` against the distribution", fitted, drawn_from),
        ("`mean`, `spread` against the people drawn", fitted, true),
        ("`recorded` against the people drawn", of_these, true),
        ("the people drawn against the distribution", true, drawn_from),
    ):
        error = 100 * (values / against - 1)
        rms, bias = np.sqrt((error**2).mean(axis=0)), error.mean(axis=0)
        near = f"{(np.abs(error) <= 10).all(axis=1).sum()} of {seeds}"
        print(
            f"{what}: mean {bias[0]:+.1f} % (rms {rms[0]:.1f}), spread {bias[1]:+.1f} % (rms {rms[1]:.1f}); "
            f"both within 10 % in {near}"
        )
        moment = {key: f"{bias[at]:.1f}, {rms[at]:.1f}" for at, key in enumerate(("mean", "spread"))}
        errors.append({"distribution": distribution, "what": what, "near": near, **moment})
    match kind:
        case "seeds":
            write_record(record, SEEDS, rows, more=more)
        case "population":
            write_record(record, POPULATION, errors[:-1], more=more)
        case "instance":
            together = {key: [row[key] for row in rows] for key in ("each", "rank corr.", "at best")}
            write_record(record, INSTANCES, [{"instance": name, **together}], more=more)


def show(rows: list[dict[str, Any]], title: str, without: tuple[str, ...] = ()) -> None:
    """Print rows as a table, without some of their entries."""
    shown = Grid(title=title)
    names = [name for name in rows[0] if name not in without]
    for name in names:
        shown.add_column(name, justify="right")
    for row in rows:
        shown.add_row(*(row[name] for name in names))
    Console(width=260).print(shown)


@main.command()
@click.argument("instances", nargs=-1)
@click.option("--people", "count", type=int, default=200, show_default=True)
@click.option("--episodes", type=int, default=3, show_default=True)
@click.option("--suggest", type=float, default=0.5, show_default=True)
@record_option
@more_option
def information(
    instances: tuple[str, ...], count: int, episodes: int, suggest: float, record: Path | None, more: bool
) -> None:
    """Compute bounds on the accuracy of any estimator of beta in [0.1, 5] on INSTANCES (kitting/paper).

    Standard errors are Cramér-Rao bounds for people of this beta. Rank correlations are the largest of any estimator on
    average. "Own mistakes" are mistakes that were not suggested, in all episodes.
    """
    rows, betas = [], (1.0, 2.0, 3.0, 5.0)
    for instance in instances or ("kitting/paper",):
        table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))

        def simulated(beta: np.ndarray, table: Table = table) -> tuple[list[Observations], People]:
            rng = np.random.default_rng(len(beta))
            people = People(beta, rng.uniform(0.3, 0.95, len(beta)))
            return observed(table, recorded(table, people, episodes=episodes, rng=rng, suggest=suggest)), people

        errors = []
        for beta in betas:
            observations, people = simulated(np.full(count, beta))
            errors.append(f"{standard_error(observations, people):.2f}")
        own = np.mean([(o.mistake & (o.chosen != o.suggested)).sum() for o in observations])
        rows.append({
            "instance": f"`{instance.removeprefix('kitting/')}`",
            "smallest mistake": f"{10 / largest_beta(observations, Method()):g}",
            "actions, beta 5": f"{np.mean([len(o) for o in observations]):.0f}",
            **{f"error, beta {beta:g}": error for beta, error in zip(betas, errors, strict=True)},
            "own mistakes, beta 5": f"{own:.2f}",
        })  # fmt: skip
        for distribution in ("uniform", "log-uniform"):
            drawn = uniform(np.random.default_rng(0), 0.1, 5.0, 5 * count, distribution)
            rows[-1][distribution] = f"{best_correlation(*simulated(drawn), 0.1, 5.0, distribution):.3f}"
    show(rows, f"{count} people, {episodes} episodes")
    write_record(record, INFORMATION, rows, more=more)


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "count", type=int, default=10, show_default=True)
@click.option("--episodes", "numbers", type=int, multiple=True, default=(3, 10, 30), show_default=True)
@record_option
def misconceptions(instance: str, count: int, numbers: tuple[int, ...], record: Path | None) -> None:
    """Estimate sigma and h of people whose misconceptions are known."""
    table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))
    rows = []
    for episodes in numbers:
        for sigma in (0.0, 0.5, 1.0):
            rng = np.random.default_rng(1)
            noise = sigma * rng.standard_normal((count, len(table)))
            people = People(np.full(count, 2.0), np.full(count, 0.6), noise=noise)
            fits = maximum_likelihood(observed(table, recorded(table, people, episodes=episodes, rng=rng, most=500)))
            start = time.perf_counter()
            found = [fit_misconception(f) for f in fits]
            seconds = (time.perf_counter() - start) / count
            alike = [
                np.corrcoef(m.perceived - m.cost_to_go, noise[k, m.states])[0, 1]
                for k, m in enumerate(found)
                if sigma and m.sigma > 0
            ]
            p = np.array([c.p for c in (check(f, rng) for f in fits) if c.p is not None])
            rows.append({
                "episodes": str(episodes),
                "sigma": f"{sigma:g}",
                "plain beta": f"{np.median([f.estimates['beta'].value for f in fits]):.2f}",
                "beta": f"{np.median([m.beta for m in found]):.2f}",
                "sigma found": f"{np.median([m.sigma for m in found]):.2f}",
                "sigma covered": f"{100 * np.mean([m.interval[0] <= sigma <= m.interval[1] for m in found]):.0f} %",
                "corr. of h": f"{np.mean(alike):.2f}" if alike else "-",
                "check p < 0.05": f"{(p < 0.05).sum()} of {len(p)}",
                "seconds each": f"{seconds:.1f}",
            })  # fmt: skip
    show(rows, f"{instance}: {count} people each, beta 2, medians")
    write_record(record, MISCONCEPTIONS, rows)


def first_actions(rows: list[dict], actions: int) -> list[dict]:
    """Return each person's first actions."""
    kept: list[dict] = []
    counts: dict[str, int] = {}
    for row in sorted(rows, key=lambda row: (row["person"], int(row["episode"]), row["step"])):
        counts[row["person"]] = counts.get(row["person"], 0) + 1
        if counts[row["person"]] <= actions:
            kept.append(row)
    return kept


def wander(task: Task, count: int, actions: int, rng: np.random.Generator) -> list[dict]:
    """Return the log of people who follow an optimal plan except for a share of random actions.

    This is for tasks that are too large to evaluate every alternative: each mistake needs one search only.
    """
    asked = OnDemand(task)
    rows: list[dict] = []
    for k, share in enumerate(np.linspace(0.1, 0.7, count)):
        x, plan, episode, step = asked.initial, asked.optimal_plan(), 1, 0
        for _ in range(actions):
            options = asked.choices([x])
            slot = int(rng.integers(len(options.actions)))
            if rng.random() >= share:
                slot = int(np.flatnonzero(options.actions == task.numbers_of[plan[0]][0])[0])
            action = task.actions[options.actions[slot]]
            rows.append({"person": f"person-{k + 1:02}", "episode": str(episode), "step": step, "action": action})
            x, step = int(options.targets[slot]), step + 1
            plan = plan[1:] if action == plan[0] else asked.optimal_plan(x)
            if not plan:
                x, plan, episode, step = asked.initial, asked.optimal_plan(), episode + 1, 0
    return rows


@main.command("time")
@click.option("--instance", default="kitting/ladder-2x8", show_default=True)
@click.option("--people", "count", type=int, default=32, show_default=True)
@click.option("--actions", type=int, default=40, show_default=True)
@click.option("--huge", is_flag=True, help="Also run a task of 1.2e9 states, killed once and restarted.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/bench/fit"), show_default=True)
@record_option
def timing(instance: str, count: int, actions: int, huge: bool, out: Path, record: Path | None) -> None:
    """Time `kitassist fit` from the PDDL files to the report."""
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    middle = ROOT / "domains" / f"{instance}.pddl"
    table = sweep(load(middle))
    people = People(uniform(rng, 0.1, 3.0, count, "log-uniform"), rng.uniform(0.3, 0.95, count))
    chosen = first_actions(recorded(table, people, episodes=6, rng=rng, suggest=0.3, most=actions), actions)
    write_records(out / "middle.jsonl", chosen)
    size = len(table)
    del table
    print(f"{middle.stem}: {size:,} states, {count} people, {len(chosen)} actions")
    rows = [
        {
            "instance": f"`{middle.stem}`",
            "states": size,
            "run": "from nothing",
            **run(middle, out / "middle.jsonl", out),
        }
    ]
    if huge:
        large = KITTING / "ladder-4x10.pddl"
        write_records(out / "huge.jsonl", wander(load(large), count, actions, rng))
        for file in out.glob("cache/*"):
            file.unlink()
        print(f"{large.stem}: {STATES:,} states, {count} people, {count * actions} actions")
        for told, kill_after in (("from nothing, killed", 20.0), ("again", None), ("once more", None)):
            took = run(large, out / "huge.jsonl", out, kill_after)
            rows.append({"instance": f"`{large.stem}`", "states": STATES, "run": told, **took})
    write_record(record, TIME, rows)


def run(instance: Path, log: Path, out: Path, kill_after: float | None = None) -> dict[str, Any]:
    """Run the command; return its seconds and the number of states in its cache."""
    command = [str(Path(sys.executable).with_name("kitassist")), "fit", str(instance), str(log), "--jobs", "2"]
    command += ["--out", str(out / "people.jsonl"), "--write-population", str(out / "population.json")]
    command += ["--figures", str(out / "figures"), "--set", f"cache={out / 'cache'}"]
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        process.wait(kill_after)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    seconds = time.perf_counter() - start
    kept = len(Cache(load(instance), out / "cache").read())
    print(f"  exit {process.returncode} after {seconds:.1f} s; {kept:,} states in the cache")
    return {"seconds": seconds, "kept": kept}


if __name__ == "__main__":
    main()
