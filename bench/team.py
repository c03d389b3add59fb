"""Teams of 1 to 1,000 people: decision time, simulation speed, and certified gaps of policies.

    python bench/team.py latency    time of one decision, and memory, against K
    python bench/team.py rate       person-steps per second against K
    python bench/team.py gap        certified gap against K

Each prints a table and writes it as JSON to --out, with a figure. --record writes the table for the documentation.
"""

from __future__ import annotations

import json
import statistics
import time
from functools import cache
from pathlib import Path
from typing import Any

import click
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from tables import Columns, cell, more_option, record_option, write_record

from assist.certify.relaxed_value import relaxed_value
from assist.certify.team_bound import upper_bound
from assist.cli.options.help import Command
from assist.people.choices import Choices
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.state import TeamAction, TeamPolicy, TeamState
from planner import load, sweep
from planner.system.limits import peak_memory_mb, processors

KITTING = Path(__file__).resolve().parent.parent / "domains" / "kitting"
SIZES = (1, 3, 10, 30, 100, 300, 1000)
COLOURS = {"attention": "#0072B2", "priority": "#D55E00", "none": "#8C8C8C", "reactive": "#E69F00"}

NAMES = ("attention", "priority")

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


if __name__ == "__main__":
    main()
