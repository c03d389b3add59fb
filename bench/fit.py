"""What is recovered of people from their recorded actions: simulated people whose parameters are known.

    python bench/fit.py COMMAND [--help]

`recover` estimates people with known parameters and counts how many intervals cover them, `information` says how
well anybody could estimate them, `misconceptions` estimates sigma, `time` runs the command on large tasks.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table as Grid
from scipy.stats import spearmanr
from simulated_people import People, observed, record

from assist.learning import (
    Method,
    Observations,
    check,
    fit_misconception,
    fit_population,
    log_likelihood,
    maximum_likelihood,
)
from assist.learning.estimates import largest_beta
from planner import Cache, OnDemand, Table, Task, load, sweep
from planner.storage import write_records

ROOT = Path(__file__).resolve().parent.parent
KITTING = ROOT / "domains" / "kitting"


def uniform(rng: np.random.Generator, low: float, high: float, count: int, distribution: str) -> np.ndarray:
    """Draw numbers between two bounds, evenly or evenly in the logarithm."""
    if distribution == "log-uniform":
        return np.exp(rng.uniform(np.log(low), np.log(high), count))
    return rng.uniform(low, high, count)


def moments(low: float, high: float, distribution: str) -> np.ndarray:
    """Give mean and standard deviation of what `uniform` draws from."""
    if distribution == "log-uniform":
        width = np.log(high / low)
        mean, square = (high - low) / width, (high**2 - low**2) / (2 * width)
    else:
        mean, square = (low + high) / 2, (low**2 + low * high + high**2) / 3
    return np.array([mean, np.sqrt(square - mean**2)])


def best_correlation(
    observations: list[Observations], people: People, low: float, high: float, distribution: str
) -> float:
    """Give the rank correlation with beta that no estimator exceeds on average.

    A rank is the share F(beta) of people below, up to chance. Of all that can be said of it from what was recorded,
    its posterior mean correlates best with it. That mean is taken for granted here by somebody who knows the
    distribution of beta, each person's theta, and eta.
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
    """Give the Cramer-Rao bound on beta's standard error, of people who all have one beta; theta and eta are known."""
    width = 0.01
    beta = people.beta[0] + width * np.array([-1.0, 0.0, 1.0])
    method = Method(lapse=1e-12)  # nobody lapses here
    bend = [
        log_likelihood(o, beta, np.array([theta]), np.array([people.eta]), method).ravel() @ [1.0, -2.0, 1.0]
        for o, theta in zip(observations, people.theta, strict=True)
    ]
    return float(1 / np.sqrt(-np.mean(bend) / width**2))


@click.group()
def main() -> None:
    """Measure what is recovered of people from their recorded actions."""


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "count", type=int, default=200, show_default=True)
@click.option("--episodes", type=int, default=3, show_default=True)
@click.option("--distribution", type=click.Choice(["uniform", "log-uniform"]), default="uniform", show_default=True)
@click.option("--beta", nargs=2, type=float, default=(0.1, 5.0), show_default=True)
@click.option("--theta", nargs=2, type=float, default=(0.3, 0.95), show_default=True)
@click.option("--sigma", type=float, default=0.0, show_default=True)
@click.option("--suggest", type=float, default=0.5, show_default=True, help="Share of steps with a suggestion.")
@click.option("--eta", type=float, help="Tell the fit the rate of the trust update (0.2).")
@click.option("--largest-beta", type=float)
@click.option("--seeds", type=int, default=1, show_default=True)
@click.option("--first-seed", type=int, default=0, show_default=True)
def recover(
    instance: str, count: int, episodes: int, distribution: str, beta: tuple[float, float],
    theta: tuple[float, float], sigma: float, suggest: float, eta: float | None, largest_beta: float | None, seeds: int,
    first_seed: int,
) -> None:  # fmt: skip
    """Estimate people whose parameters are known, and say how many intervals cover them.

    Means and spreads of beta are given for the population fitted, the people recorded as it sees them ("of these"), and
    those people in truth ("true"). Below are their errors over all seeds.
    """
    table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))
    method = Method(eta=eta, largest_beta=largest_beta)
    shown = Grid(
        title=f"{instance}: {count} people, {episodes} episodes, beta {distribution} in {beta}, sigma {sigma:g}"
    )
    for name in (
        "seed", "actions", "seconds", "beta covered", "rank corr.", "at best", "not bounded", "theta covered",
        "eta covered", "family", "mean", "of these", "true", "spread", "of these", "true", "theta mean", "true",
        "spread", "true",
    ):  # fmt: skip
        shown.add_column(name, justify="right")
    drawn_from = moments(*beta, distribution)
    found = []
    for seed in range(first_seed, first_seed + seeds):
        rng = np.random.default_rng(seed)
        people = People(
            uniform(rng, *beta, count, distribution), rng.uniform(*theta, count),
            noise=sigma * rng.standard_normal((count, len(table))) if sigma else None,
        )  # fmt: skip
        observations = observed(table, record(table, people, episodes=episodes, rng=rng, suggest=suggest, most=2000))
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

        told = all(f.theta is not None for f in fits)
        shown.add_row(
            str(seed),
            f"{sum(map(len, observations)):,}",
            f"{seconds:.1f}",
            covered(people.beta, [f.beta.interval for f in fits]),
            f"{spearmanr(people.beta, [f.beta.value for f in fits])[0]:.3f}",
            f"{best:.3f}",
            f"{100 * np.mean([f.beta.open_above for f in fits]):.0f} %",
            covered(people.theta, [f.theta.interval for f in fits]) if told else "-",
            covered(np.full(count, people.eta), [f.eta.interval for f in fits]) if told and eta is None else "-",
            found_population.beta.family,
            *(f"{x:.2f}" for x in np.array(found[-1]).T.ravel()),
            *(
                ["-"] * 4
                if theta_of is None
                else (f"{x:.2f}" for x in (theta_of.mean, people.theta.mean(), theta_of.spread, people.theta.std()))
            ),
        )
    Console(width=220).print(shown)
    fitted, of_these, true = np.array(found).swapaxes(0, 1)
    for name, values, against in (
        ("population against the distribution", fitted, drawn_from),
        ("population against the people drawn", fitted, true),
        ("these people against the people drawn", of_these, true),
        ("the people drawn against the distribution", true, drawn_from),
    ):
        error = 100 * (values / against - 1)
        rms, bias = np.sqrt((error**2).mean(axis=0)), error.mean(axis=0)
        print(
            f"{name}: mean {bias[0]:+.1f} % (rms {rms[0]:.1f}), spread {bias[1]:+.1f} % (rms {rms[1]:.1f}); "
            f"both within 10 % in {(np.abs(error) <= 10).all(axis=1).sum()} of {seeds}"
        )


@main.command()
@click.argument("instances", nargs=-1)
@click.option("--people", "count", type=int, default=200, show_default=True)
@click.option("--episodes", type=int, default=3, show_default=True)
@click.option("--suggest", type=float, default=0.5, show_default=True)
def information(instances: tuple[str, ...], count: int, episodes: int, suggest: float) -> None:
    """Say how well anybody could estimate beta in [0.1, 5] on INSTANCES (kitting/paper), whatever the method.

    The standard errors are the Cramer-Rao bounds for people of that beta. Rank correlations are those that no estimator
    exceeds on average. People's own mistakes are those that nobody suggested to them, in all episodes.
    """
    shown = Grid(title=f"{count} people, {episodes} episodes")
    betas = (1.0, 2.0, 3.0, 5.0)
    for name in (
        "instance", "smallest mistake", "actions, beta 5", *(f"error, beta {b:g}" for b in betas),
        "own mistakes, beta 5", "uniform", "log-uniform",
    ):  # fmt: skip
        shown.add_column(name, justify="right")
    for instance in instances or ("kitting/paper",):
        table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))

        def simulated(beta: np.ndarray, table: Table = table) -> tuple[list[Observations], People]:
            rng = np.random.default_rng(len(beta))
            people = People(beta, rng.uniform(0.3, 0.95, len(beta)))
            return observed(table, record(table, people, episodes=episodes, rng=rng, suggest=suggest)), people

        errors = []
        for beta in betas:
            observations, people = simulated(np.full(count, beta))
            errors.append(f"{standard_error(observations, people):.2f}")
        ranks = []
        for distribution in ("uniform", "log-uniform"):
            drawn = uniform(np.random.default_rng(0), 0.1, 5.0, 5 * count, distribution)
            ranks.append(f"{best_correlation(*simulated(drawn), 0.1, 5.0, distribution):.3f}")
        shown.add_row(
            instance,
            f"{10 / largest_beta(observations, Method()):g}",
            f"{np.mean([len(o) for o in observations]):.0f}",
            *errors,
            f"{np.mean([((o.regret > 0) & (o.chosen != o.suggested)).sum() for o in observations]):.2f}",
            *ranks,
        )
    Console(width=150).print(shown)


@main.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "count", type=int, default=10, show_default=True)
@click.option("--episodes", "numbers", type=int, multiple=True, default=(3, 10, 30), show_default=True)
def misconceptions(instance: str, count: int, numbers: tuple[int, ...]) -> None:
    """Estimate sigma and h of people whose misconceptions are known."""
    table = sweep(load(ROOT / "domains" / f"{instance}.pddl"))
    shown = Grid(title=f"{instance}: {count} people each, beta 2, medians")
    for name in (
        "episodes", "sigma", "plain beta", "beta", "sigma found", "sigma covered", "corr. of h", "check p < 0.05",
        "seconds each",
    ):  # fmt: skip
        shown.add_column(name, justify="right")
    for episodes in numbers:
        for sigma in (0.0, 0.5, 1.0):
            rng = np.random.default_rng(1)
            noise = sigma * rng.standard_normal((count, len(table)))
            people = People(np.full(count, 2.0), np.full(count, 0.6), noise=noise)
            fits = maximum_likelihood(observed(table, record(table, people, episodes=episodes, rng=rng, most=500)))
            start = time.perf_counter()
            found = [fit_misconception(f) for f in fits]
            seconds = (time.perf_counter() - start) / count
            alike = [
                np.corrcoef(m.perceived - m.cost_to_go, noise[k, m.states])[0, 1]
                for k, m in enumerate(found)
                if sigma and m.sigma > 0
            ]
            p = np.array([c.p for c in (check(f, rng) for f in fits) if c.p is not None])
            shown.add_row(
                str(episodes),
                f"{sigma:g}",
                f"{np.median([f.beta.value for f in fits]):.2f}",
                f"{np.median([m.beta for m in found]):.2f}",
                f"{np.median([m.sigma for m in found]):.2f}",
                f"{100 * np.mean([m.interval[0] <= sigma <= m.interval[1] for m in found]):.0f} %",
                f"{np.mean(alike):.2f}" if alike else "-",
                f"{(p < 0.05).sum()} of {len(p)}",
                f"{seconds:.1f}",
            )
    Console(width=120).print(shown)


def first_actions(rows: list[dict], actions: int) -> list[dict]:
    """Keep each person's first actions."""
    kept: list[dict] = []
    counts: dict[str, int] = {}
    for row in sorted(rows, key=lambda row: (row["person"], int(row["episode"]), row["step"])):
        counts[row["person"]] = counts.get(row["person"], 0) + 1
        if counts[row["person"]] <= actions:
            kept.append(row)
    return kept


def wander(task: Task, count: int, actions: int, rng: np.random.Generator) -> list[dict]:
    """Write down people of whom each follows a cheapest plan but for a share of random actions.

    For tasks that are too large to look up every alternative: one search for each mistake will do.
    """
    asked = OnDemand(task)
    rows: list[dict] = []
    for k, share in enumerate(np.linspace(0.1, 0.7, count)):
        x, plan, episode, step = asked.initial, asked.optimal_plan(), 1, 0
        for _ in range(actions):
            options = asked.choices([x])
            slot = int(rng.integers(len(options.actions)))
            if rng.random() >= share:
                slot = int(np.flatnonzero(options.actions == task.action_index[plan[0]])[0])
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
@click.option("--huge", is_flag=True, help="Also a task of 1.2e9 states, killed on the way and begun again.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/bench/fit"), show_default=True)
def timing(instance: str, count: int, actions: int, huge: bool, out: Path) -> None:
    """Time `kitassist fit` from the PDDL files to the report."""
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    middle = ROOT / "domains" / f"{instance}.pddl"
    table = sweep(load(middle))
    people = People(uniform(rng, 0.1, 3.0, count, "log-uniform"), rng.uniform(0.3, 0.95, count))
    rows = record(table, people, episodes=6, rng=rng, suggest=0.3, most=actions)
    write_records(out / "middle.jsonl", first_actions(rows, actions))
    size, chosen = len(table), first_actions(rows, actions)
    del table
    print(f"{middle.stem}: {size:,} states, {count} people, {len(chosen)} actions")
    run(middle, out / "middle.jsonl", out)
    if huge:
        large = KITTING / "ladder-4x10.pddl"
        write_records(out / "huge.jsonl", wander(load(large), count, actions, rng))
        for file in out.glob("cache/*"):
            file.unlink()
        print(f"{large.stem}: 1,173,311,155 states, {count} people, {count * actions} actions")
        run(large, out / "huge.jsonl", out, kill_after=20)
        run(large, out / "huge.jsonl", out)
        run(large, out / "huge.jsonl", out)


def run(instance: Path, log: Path, out: Path, kill_after: float | None = None) -> None:
    """Run the command; say what it took, and how many states its cache has."""
    command = [str(Path(sys.executable).with_name("kitassist")), "fit", str(instance), str(log), "--jobs", "2"]
    command += ["--out", str(out / "people.jsonl"), "--population", str(out / "population.json")]
    command += ["--figures", str(out / "figures"), "--cache", str(out / "cache")]
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


if __name__ == "__main__":
    main()
