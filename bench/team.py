"""Teams of 1 to 1,000 people: decision time, simulation speed, and certified gaps of policies.

    python bench/team.py latency    time of one decision, and memory, against K
    python bench/team.py rate       person-steps per second against K
    python bench/team.py gap        certified gap against K
    python bench/team.py prices     certified gap of priority at a constant price, and at the bound's price of each step
    python bench/team.py settings   priority compared with Algorithm 1 in 20 settings
    python bench/team.py fluid      many robots, each for a fixed number of people
    python bench/team.py joint      tiny teams whose joint problem can be solved

Each prints a table and writes it as JSON to --out, with a figure except for `prices`, `settings` and `joint`. --record
writes the table for the documentation.
"""

from __future__ import annotations

import json
import statistics
import time
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from joint import joint_bounds
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from tables import Columns, cell, more_option, record_option, write_record

from assist.certify.certificate import Certificate, returns
from assist.certify.relaxed_value import relaxed_value
from assist.certify.team_bound import upper_bound
from assist.cli.options.help import Command
from assist.people.belief import Grid
from assist.people.choices import Choices
from assist.people.human import HumanModel
from assist.people.ranges import Population
from assist.person.pomdp import AssistPOMDP
from assist.person.qmdp import qmdp
from assist.person.settings import Setting
from assist.simulation.pool import Pool
from assist.simulation.simulate import simulate
from assist.team.state import TeamAction, TeamPolicy, TeamState
from planner import load, sweep
from planner.system.limits import peak_memory_mb, processors

KITTING = Path(__file__).resolve().parent.parent / "domains" / "kitting"
SIZES = (1, 3, 10, 30, 100, 300, 1000)
COLOURS = {"attention": "#0072B2", "priority": "#D55E00", "none": "#8C8C8C", "reactive": "#E69F00"}

NAMES = ("attention", "priority")

# K, c_suggest, c_move, travel time, and whether stations are on a line (distance 1 between neighbours).
SETTINGS = [
    (2, 0.5, 0.5, 0.0, False), (4, 0.5, 0.5, 0.0, False), (6, 0.5, 0.5, 0.0, False), (12, 0.5, 0.5, 0.0, False),
    (4, 0.1, 0.5, 0.0, False), (4, 1.0, 0.5, 0.0, False), (4, 0.5, 0.1, 0.0, False), (4, 0.5, 1.0, 0.0, False),
    (4, 0.5, 2.0, 0.0, False), (4, 0.1, 0.0, 0.0, False), (6, 0.2, 1.0, 0.0, True), (4, 0.5, 0.5, 0.0, True),
    (2, 0.5, 0.5, 1.0, False), (4, 0.5, 0.5, 1.0, False), (6, 0.5, 0.5, 1.0, False), (4, 0.2, 0.2, 2.0, False),
    (4, 0.5, 0.5, 2.0, False), (12, 0.5, 0.5, 1.0, False), (4, 0.5, 0.2, 1.0, True), (6, 0.2, 0.2, 1.0, True),
]  # fmt: skip

# Columns of the tables in the documentation.
LATENCY: Columns = {
    "people": cell("humans", ","), "attention, ms": cell("attention", ".3f"), "priority, ms": cell("priority", ".3f"),
}  # fmt: skip
RATE: Columns = {
    "people in a team": cell("humans", ","), **{name: cell(name, ".2f") for name in ("none", "attention", "priority")},
}  # fmt: skip
GAP: Columns = {
    "instance": cell("instance"), "c_suggest": cell("c_suggest", "g"), "gamma": cell("gamma", "g"),
    "people": cell("humans"), "bound": cell("upper", ".2f"), "priority": cell("priority", ".2f", "stderr"),
    "gap": lambda row: f"**{row['gap %']:.2f} %**", "proven": cell("proven gap %", ".2f"),
    "samples": cell("samples"), "solver": cell("left to solver %", ".2f"),
    "attention": cell("attention gap %", ".2f"), "reactive": cell("reactive gap %", ".2f"),
    "none": cell("none gap %", ".2f"), "if seen": cell("if beta, theta seen %", ".2f"),
}  # fmt: skip
PRICES: Columns = {
    "instance": cell("instance"), "c_suggest": cell("c_suggest", "g"), "gamma": cell("gamma", "g"),
    "people": cell("humans"), "bound": cell("upper", ".2f"), "at one price": cell("priority", ".2f", "stderr"),
    "its gap": lambda row: f"{row['gap %']:.2f} %", "at each step's": cell("priced", ".2f", "its stderr"),
    "gap": lambda row: f"**{row['priced gap %']:.2f} %**", "ahead": cell("ahead", ".2f", "ahead stderr"),
    "solver": cell("left to solver %", ".2f"),
}  # fmt: skip
JOINT: Columns = {
    "c_suggest": cell("c_suggest", "g"), "c_move": cell("c_move", "g"), "pool": cell("seed"),
    "no help": cell("none", ".2f"), "attention": cell("attention", ".3f", "attention stderr"),
    "priority": cell("priority", ".3f", "priority stderr"),
    "the whole problem": lambda row: f"{row['joint lower']:.3f} to {row['joint upper']:.3f}",
    "bound": cell("bound", ".3f"), "sampled": cell("sampled", ".3f", "sampled stderr"),
    **{f"{name} below": lambda row, name=name: _apart(row[name], row) for name in NAMES},
    **{f"{name} above": lambda row, name=name: _apart(row[name], row) for name in ("bound", "sampled")},
}  # fmt: skip
SETTINGS_SHOWN: Columns = {
    "K": cell("K"), "c_suggest": cell("c_suggest", "g"), "c_move": cell("c_move", "g"),
    "travel time": cell("travel time", "g"), "places": cell("places"), "attention": cell("attention", ".2f"),
    "priority ahead": cell("priority ahead", ".3f", "stderr"), "in percent": cell("percent", ".2f"),
    "ahead of attention-never": cell("ahead of attention-never", ".2f", "its stderr"),
}  # fmt: skip
FLUID: Columns = {
    "robots": cell("robots"), "people": cell("people"),
    "return per robot": cell("value per robot", ".2f"),
    "gap": lambda row: f"{row['gap %']:.2f} ± {row['stderr %']:.2f} %",
}  # fmt: skip

out_option = click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build/bench/team"), show_default=True
)
instance_option = click.option(
    "--instance", "instances", multiple=True, default=("paper",), show_default=True, help="Kitting instance."
)
seeds_option = click.option("--seeds", type=click.IntRange(min=1), default=3, show_default=True, help="Pools.")


@click.group()
def main() -> None:
    """Measure teams."""


@cache
def choices_of(name: str) -> Choices:
    return Choices.of(sweep(load(KITTING / f"{name}.pddl")))


def pool_of(name: str, size: int, seed: int, **setting: Any) -> Pool:
    return Pool.sample(choices_of(name), size, seed=seed, setting=Setting(**setting))


def write(out: Path, name: str, rows: list[dict[str, Any]], title: str) -> None:
    """Print rows as a table, and save them."""
    table = Table(*rows[0], title=title)
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))
    Console(width=180).print(table)
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps(rows, indent=2))


def side_by_side(rows: list[dict[str, Any]], figure: str) -> list[dict[str, Any]]:
    """Return one figure of all policies for each team size on the first instance."""
    found: dict[int, dict[str, Any]] = {}
    for row in rows:
        if row["instance"] == rows[0]["instance"]:
            found.setdefault(row["humans"], {"humans": row["humans"]})[row["policy"]] = row[figure]
    return list(found.values())


def _apart(value: float, row: dict[str, Any]) -> str:
    """Format the relative distance of a value to the joint optimum, which is known up to bounds."""
    ends = sorted(100 * abs(value - whole) / abs(whole) for whole in (row["joint lower"], row["joint upper"]))
    return f"{ends[0]:.2f} to {ends[1]:.2f} %"


def draw(out: Path, name: str, width: float, plot: Any) -> None:
    """Draw one figure with one pair of axes."""
    figure = Figure(figsize=(width, 4.2), layout="constrained")
    axis = figure.subplots()
    plot(axis)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.3)
    for kind in ("png", "svg"):
        figure.savefig(out / f"{name}.{kind}", dpi=150)


def watched(policy: TeamPolicy, at: int, seen: list[TeamState]) -> TeamPolicy:
    """Return a policy that stores the team states it receives at one step."""

    def asked(team: TeamState) -> TeamAction:
        if team.step == at:
            seen.append(team)
        return policy(team)

    return asked


@main.command()
@instance_option
@click.option(
    "--repeat",
    type=click.IntRange(min=1),
    default=51,
    show_default=True,
    help="Number of runs; the median is reported.",
)
@out_option
@record_option
def latency(instances: tuple[str, ...], repeat: int, out: Path, record: Path | None) -> None:
    """Time one decision of a team in its fifth step; all people share one model."""
    rows = []
    for name in instances:
        for humans in SIZES:
            pool = pool_of(name, humans, 0, knowledge="exact")
            for label in ("attention", "priority"):
                policy, seen = pool.policy(label), []
                simulate(pool, watched(policy, 4, seen), humans=humans, episodes=1, seed=0)
                times = []
                for _ in range(repeat):
                    start = time.perf_counter()
                    policy(seen[0])
                    times.append(time.perf_counter() - start)
                peak = peak_memory_mb()
                rows.append(
                    {"instance": name, "policy": label, "humans": humans, "ms": 1e3 * statistics.median(times),
                     "us per person": 1e6 * statistics.median(times) / humans, "peak MB so far": round(peak)}
                )  # fmt: skip
    write(out, "latency", rows, "One decision")
    write_record(record, LATENCY, side_by_side(rows, "ms"))

    def plot(axis: Axes) -> None:
        for label in ("attention", "priority"):
            mine = [row for row in rows if row["policy"] == label and row["instance"] == instances[0]]
            axis.loglog(
                [r["humans"] for r in mine], [r["ms"] for r in mine], marker="o", color=COLOURS[label], label=label
            )
        axis.set(xlabel="people", ylabel="milliseconds for one decision", title=f"{instances[0]}, one shared model")
        axis.legend(frameon=False)

    draw(out, "team_latency", 6.5, plot)


@main.command()
@instance_option
@click.option(
    "--repeat", type=click.IntRange(min=1), default=5, show_default=True, help="Number of runs; the median is reported."
)
@click.option("--jobs", type=click.IntRange(min=1), default=processors(), show_default=True, help="Threads.")
@click.option("--people", type=click.IntRange(min=1), default=80_000, show_default=True, help="In all episodes.")
@out_option
@record_option
def rate(instances: tuple[str, ...], repeat: int, jobs: int, people: int, out: Path, record: Path | None) -> None:
    """Simulate teams of several sizes, including belief updates."""
    rows = []
    for name in instances:
        for humans in (1, 4, 12, 100, 1000):
            knowledge = "own" if humans <= 12 else "exact"
            pool = pool_of(name, max(humans, 12), 0, knowledge=knowledge)
            for label in ("none", "attention", "priority"):
                policy = pool.policy(label)
                simulate(pool, policy, humans=humans, episodes=1, seed=0)
                rates, processor = [], []
                for seed in range(repeat):
                    start, used = time.perf_counter(), time.process_time()
                    run = simulate(pool, policy, humans=humans, episodes=max(2, people // humans), seed=seed, jobs=jobs)
                    steps = run.actions.sum() / 1e6
                    rates.append(steps / (time.perf_counter() - start))
                    processor.append(steps / (time.process_time() - used))
                rows.append(
                    {"instance": name, "policy": label, "humans": humans, "knowledge": knowledge,
                     "million person-steps/s": statistics.median(rates),
                     "of processor time": statistics.median(processor)}
                )  # fmt: skip
    write(out, "rate", rows, "Simulation")
    write_record(record, RATE, side_by_side(rows, "million person-steps/s"))

    def plot(axis: Axes) -> None:
        for label in ("none", "attention", "priority"):
            mine = [row for row in rows if row["policy"] == label and row["instance"] == instances[0]]
            axis.semilogx(
                [r["humans"] for r in mine], [r["million person-steps/s"] for r in mine], marker="o",
                color=COLOURS[label], label=label,
            )  # fmt: skip
        axis.set(xlabel="people in the team", ylabel="million person-steps per second", title=instances[0])
        axis.set_ylim(bottom=0)
        axis.legend(frameon=False)

    draw(out, "team_rate", 6.5, plot)


@main.command(cls=Command)
@click.option("--instance", "instances", multiple=True, default=("paper-fixed", "paper"), show_default=True)
@click.option("--gamma", "gammas", type=float, multiple=True, default=(0.95, 0.99), show_default=True)
@click.option("--humans", "sizes", type=int, multiple=True, default=(2, 4, 6, 100), show_default=True)
@click.option("--own", type=int, default=12, show_default=True, help="Larger teams share one model (knowledge exact).")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--time-limit", type=float, default=60.0, show_default=True, help="Seconds for each person's problem.")
@click.option("--gap", type=float, default=5e-4, show_default=True)
@click.option("--c-suggest", type=float, default=1.0, show_default=True)
@click.option(
    "--samples", "paths", type=int, default=0, show_default=True, help="Sample paths for a bound of 95 % confidence."
)
@out_option
@record_option
@more_option
def gap(
    instances: tuple[str, ...], gammas: tuple[float, ...], sizes: tuple[int, ...], own: int, seed: int,
    time_limit: float, gap: float, c_suggest: float, paths: int, out: Path, record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Certify policies of teams of several sizes."""
    rows = []
    for name in instances:
        for gamma in gammas:
            for humans in sizes:
                knowledge = "own" if humans <= own else "exact"
                pool = pool_of(name, humans, seed, gamma=gamma, c_suggest=c_suggest, knowledge=knowledge)
                found = upper_bound(pool, gap=gap, time_limit=time_limit * len(pool.policies), paths=paths)
                certified = {
                    label: found.certify(pool.policy(label), label, episodes=20_000 if humans <= own else 2_000)
                    for label in ("none", "reactive", "attention", "priority")
                }
                best, (relaxed, error) = certified["priority"], relaxed_value(found)
                rows.append(
                    {"instance": name, "c_suggest": c_suggest, "gamma": gamma, "humans": humans, "upper": found.upper,
                     "proven": found.proven, "proven gap %": 100 * (found.proven - best.value) / abs(best.value),
                     "samples": found.sampled.paths if found.sampled else 0, "prices": len(found.price),
                     "alpha": found.sampled.alpha if found.sampled else 0.0,
                     "priority": best.value, "stderr": best.value_stderr, "gap %": best.gap_percent,
                     "attention gap %": certified["attention"].gap_percent,
                     "reactive gap %": certified["reactive"].gap_percent,
                     "none gap %": certified["none"].gap_percent,
                     "left to solver %": best.slack_percent,
                     "relaxed, simulated": relaxed, "its stderr": error,
                     "above priority %": 100 * (relaxed - best.value) / abs(best.value),
                     "if beta, theta seen %": 100 * (found.upper_seen - best.value) / abs(best.value),
                     "seconds": found.seconds}
                )  # fmt: skip
                write(out, "gap", rows, "Certified gap")
    write_record(record, GAP, rows, more=more)

    def plot(axis: Axes) -> None:
        for name, style in zip(instances, ("-", "--", ":"), strict=False):
            for gamma, marker in zip(gammas, ("o", "s", "^"), strict=False):
                mine = [row for row in rows if row["instance"] == name and row["gamma"] == gamma]
                for column, label in (("gap %", "priority"), ("attention gap %", "attention")):
                    axis.plot(
                        [r["humans"] for r in mine], [r[column] for r in mine], linestyle=style, marker=marker,
                        color=COLOURS[label], label=f"{label}, {name}, gamma {gamma:g}",
                    )  # fmt: skip
        axis.set(xlabel="people, one robot", ylabel="certified gap, %", xscale="log")
        axis.set_xticks(sorted(set(sizes)), [str(size) for size in sorted(set(sizes))])
        axis.minorticks_off()
        axis.set_ylim(bottom=0)
        axis.legend(frameon=False, fontsize=8)

    draw(out, "team_gap", 7.5, plot)


@main.command()
@instance_option
@click.option("--gamma", type=float, default=0.99, show_default=True)
@click.option("--humans", "sizes", type=int, multiple=True, default=(6, 12, 100), show_default=True)
@click.option("--own", type=int, default=12, show_default=True, help="Larger teams share one model (knowledge exact).")
@click.option("--c-suggest", type=float, default=1.0, show_default=True)
@click.option("--time-limit", type=float, default=800.0, show_default=True, help="Seconds for each team's bound.")
@click.option("--episodes", type=click.IntRange(min=2), default=4000, show_default=True)
@out_option
@record_option
@more_option
def prices(
    instances: tuple[str, ...], gamma: float, sizes: tuple[int, ...], own: int, c_suggest: float, time_limit: float,
    episodes: int, out: Path, record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Compare priority at the bound's price of each step with priority at a constant price, with common random
    numbers.
    """
    rows = []
    for name in instances:
        for humans in sizes:
            knowledge = "own" if humans <= own else "exact"
            pool = pool_of(name, humans, 0, gamma=gamma, c_suggest=c_suggest, knowledge=knowledge)
            found = upper_bound(pool, gap=5e-4, time_limit=time_limit)
            one, each = (
                returns(pool, policy, found.team, found.travel, episodes=episodes, seed=0)
                for policy in ("priority", found.policy())
            )
            at_one, at_each = (
                Certificate.of(label, some, humans=humans, upper=found.upper, slack=found.slack)
                for label, some in (("priority", one), ("priority, prices of steps", each))
            )
            ahead = each - one
            rows.append(
                {"instance": name, "c_suggest": c_suggest, "gamma": gamma, "humans": humans, "upper": found.upper,
                 "prices": len(found.price), "priority": at_one.value, "stderr": at_one.value_stderr,
                 "gap %": at_one.gap_percent, "priced": at_each.value, "its stderr": at_each.value_stderr,
                 "priced gap %": at_each.gap_percent, "ahead": float(ahead.mean()),
                 "ahead stderr": float(ahead.std(ddof=1) / np.sqrt(episodes)),
                 "left to solver %": at_each.slack_percent, "seconds": found.seconds}
            )  # fmt: skip
            write(out, "prices", rows, "Priority at one price, and at the bound's for each step")
    write_record(record, PRICES, rows, more=more)


@main.command()
@click.option("--instance", default="paper-fixed", show_default=True)
@seeds_option
@click.option("--episodes", type=click.IntRange(min=2), default=2000, show_default=True, help="Of each pool.")
@out_option
@record_option
def settings(instance: str, seeds: int, episodes: int, out: Path, record: Path | None) -> None:
    """Compare priority with Algorithm 1 on the same people and random numbers; people are drawn from the prior."""
    rows = []
    for humans, c_suggest, c_move, travel_time, line in SETTINGS:
        ahead, ahead_never, base = [], [], []
        for seed in range(seeds):
            pool = pool_of(instance, humans, seed, c_suggest=c_suggest, c_move=c_move, travel_time=travel_time)
            places = np.append(np.arange(humans, dtype=float), -1.0)
            distance = np.abs(places[:, None] - places) if line else None
            travel = pool.setting.travel(humans, distance)
            runs = {
                label: simulate(
                    pool, pool.policy(label, travel), humans=list(range(humans)), episodes=episodes, seed=seed,
                    travel=travel, world="model",
                ).discounted_return
                for label in ("attention", "attention-never", "priority")
            }  # fmt: skip
            ahead.append(runs["priority"] - runs["attention"])
            ahead_never.append(runs["priority"] - runs["attention-never"])
            base.append(runs["attention"])
        gain, never, mean = np.concatenate(ahead), np.concatenate(ahead_never), np.concatenate(base).mean()
        error = gain.std(ddof=1) / np.sqrt(len(gain))
        rows.append(
            {"K": humans, "c_suggest": c_suggest, "c_move": c_move, "travel time": travel_time,
             "places": "line" if line else "all at 1", "attention": float(mean), "priority ahead": float(gain.mean()),
             "stderr": float(error), "percent": float(100 * gain.mean() / abs(mean)),
             "ahead of attention-never": float(never.mean()),
             "its stderr": float(never.std(ddof=1) / np.sqrt(len(never)))}
        )  # fmt: skip
    write(out, "settings", rows, f"priority against attention, {instance}")
    write_record(record, SETTINGS_SHOWN, rows)


@main.command(cls=Command)
@click.option("--time-limit", type=float, default=20.0, show_default=True, help="Seconds for each joint problem.")
@click.option("--episodes", type=click.IntRange(min=2), default=100_000, show_default=True)
@click.option("--samples", "paths", type=click.IntRange(min=1), default=400, show_default=True, help="Sample paths.")
@click.option(
    "--settings", type=click.IntRange(min=1), default=5, show_default=True, help="Number of settings, of the five."
)
@out_option
@record_option
def joint(time_limit: float, episodes: int, paths: int, settings: int, out: Path, record: Path | None) -> None:
    """Solve the joint problem of two people on the tiny kit, with 2 betas and 3 thetas each, and compare policies."""
    choices, population = choices_of("tiny"), Population(sigma=(0.5, 1.0))
    grid = Grid(np.array([0.3, 1.5]), np.array([0.0, 0.5, 1.0]))
    rows, cases = [], ((0.05, 0.1, 0), (0.2, 0.3, 0), (0.5, 0.5, 0), (0.05, 0.1, 1), (0.2, 0.3, 1))
    for c_suggest, c_move, seed in cases[:settings]:
        people = population.sample(choices, 2, np.random.default_rng(seed))
        pomdps = [
            AssistPOMDP.of(
                HumanModel.own(choices, human), grid=grid, population=population, gamma=0.95, c_suggest=c_suggest
            )
            for human in people
        ]
        setting = Setting(gamma=0.95, c_suggest=c_suggest, c_move=c_move)
        pool = Pool(setting, tuple(people), tuple(qmdp(pomdp) for pomdp in pomdps), np.arange(2))
        whole, relaxed = joint_bounds(pool, gap=1e-3, time_limit=time_limit), upper_bound(pool, paths=paths)
        certified = {name: relaxed.certify(pool.policy(name), name, episodes=episodes) for name in (*NAMES, "none")}
        row: dict[str, Any] = {"c_suggest": c_suggest, "c_move": c_move, "seed": seed}
        for name in NAMES:
            row |= {name: certified[name].value, f"{name} stderr": certified[name].value_stderr}
        row |= {"none": certified["none"].value, "joint lower": whole.lower, "joint upper": whole.upper}
        row |= {"bound": relaxed.proven, "sampled": relaxed.sampled.mean, "sampled stderr": relaxed.sampled.stderr}
        for name in NAMES:
            row[f"{name} below joint %"] = 100 * (whole.lower - certified[name].value) / abs(whole.lower)
        row["bound above joint %"] = 100 * (relaxed.proven - whole.upper) / abs(whole.upper)
        rows.append(row)
    write(out, "joint", rows, "The whole problem of two people, tiny.pddl, gamma .95")
    write_record(record, JOINT, rows)


@main.command()
@click.option("--instance", default="paper-fixed", show_default=True)
@click.option("--per-robot", type=int, default=6, show_default=True, help="People for each robot.")
@click.option("--episodes", type=click.IntRange(min=2), default=40_000, show_default=True, help="Robots simulated.")
@click.option("--time-limit", type=float, default=120.0, show_default=True)
@out_option
@record_option
def fluid(instance: str, per_robot: int, episodes: int, time_limit: float, out: Path, record: Path | None) -> None:
    """Let m robots serve any of m * n people, and compare with the bound, which is the same for all m."""
    found = upper_bound(pool_of(instance, per_robot, 0, knowledge="exact"), gap=5e-4, time_limit=time_limit)
    rows = []
    for robots in (1, 2, 4, 8, 16, 32, 64):
        people = robots * per_robot
        pool = pool_of(instance, people, 0, knowledge="exact", robots=robots, max_steps=2000)
        travel, runs = pool.setting.travel(people), max(50, episodes // (4 * robots))
        values = returns(pool, "priority", tuple(range(people)), travel, episodes=runs, seed=robots) / robots
        mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(runs))
        rows.append(
            {"robots": robots, "people": people, "value per robot": mean, "upper": found.upper,
             "gap %": 100 * (found.upper - mean) / abs(mean), "stderr %": 100 * error / abs(mean)}
        )  # fmt: skip
    write(out, "fluid", rows, f"{per_robot} people for each robot, {instance}")
    write_record(record, FLUID, rows)

    def plot(axis: Axes) -> None:
        axis.errorbar(
            [r["robots"] for r in rows], [r["gap %"] for r in rows], yerr=[2 * r["stderr %"] for r in rows],
            marker="o", color=COLOURS["priority"],
        )  # fmt: skip
        axis.set(xscale="log", xlabel=f"robots, with {per_robot} people for each", ylabel="gap to the bound, %")
        axis.set_xticks([r["robots"] for r in rows], [str(r["robots"]) for r in rows])
        axis.minorticks_off()
        axis.set_ylim(bottom=0)

    draw(out, "team_fluid", 6.5, plot)


if __name__ == "__main__":
    main()
