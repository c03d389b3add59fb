"""Time per state of the sweep as a function of the number of states, on ladders of instances.

    python bench/growth.py [--out DIR] [--repeat N] [--steps N]

The sweep is timed from the grounded task to h* of all states. Reading and grounding the PDDL files, which does not
depend on the number of states, is timed separately. The results are written to `growth.json`, `growth.png` and
`growth.svg`.
"""

from __future__ import annotations

import json
import statistics
import time
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table as Grid

from planner import load, sweep

DOMAINS = Path(__file__).resolve().parent.parent / "domains"
LADDERS = {
    "kitting": ["ladder-2x3", "paper", "ladder-3x5", "ladder-4x6", "ladder-4x7", "ladder-4x8"],
    "gripper": ["balls-03", "balls-05", "balls-08", "balls-10", "balls-13"],
    "blocks": ["blocks-4", "blocks-5", "blocks-6", "blocks-7", "blocks-8"],
}
COLOURS = {"kitting": "#0072B2", "gripper": "#D55E00", "blocks": "#009E73"}


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build/bench/growth"), show_default=True
)
@click.option(
    "--repeat", type=click.IntRange(min=1), default=7, show_default=True, help="Number of runs; the median is reported."
)
@click.option("--steps", type=click.IntRange(min=1), help="Number of instances of each ladder. All unless given.")
def main(out: Path, repeat: int, steps: int | None) -> None:
    """Measure the time per state of the sweep."""
    sweep(load(DOMAINS / "kitting" / "tiny.pddl"))  # loads the compiled code
    rows = []
    grid = Grid("instance", "states", "load s", "sweep s", "microseconds per state", title="Time per state")
    for domain, names in LADDERS.items():
        for name in names[:steps]:
            loads, sweeps, states = [], [], 0
            for _ in range(repeat):
                start = time.perf_counter()
                task = load(DOMAINS / domain / f"{name}.pddl")
                loaded = time.perf_counter()
                states = len(sweep(task))
                loads.append(loaded - start)
                sweeps.append(time.perf_counter() - loaded)
            row = {
                "domain": domain, "instance": name, "states": states,
                "load": statistics.median(loads), "sweep": statistics.median(sweeps),
            }  # fmt: skip
            rows.append(row)
            per_state = 1e6 * row["sweep"] / states
            grid.add_row(
                f"{domain}/{name}", f"{states:,}", f"{row['load']:.3f}", f"{row['sweep']:.4f}", f"{per_state:.3f}"
            )
    Console(width=110).print(grid)
    out.mkdir(parents=True, exist_ok=True)
    (out / "growth.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    draw(rows, out)


def draw(rows: list[dict], out: Path) -> None:
    """Plot microseconds per state against the number of states."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    for domain, marker in zip(LADDERS, "osD", strict=True):
        own = [row for row in rows if row["domain"] == domain]
        states = [row["states"] for row in own]
        axis.plot(
            states,
            [1e6 * row["sweep"] / row["states"] for row in own],
            marker=marker,
            color=COLOURS[domain],
            label=domain,
        )
    axis.axvspan(1e4, 1e7, color="0.94", zorder=0)
    axis.set(xscale="log", yscale="log", xlabel="reachable states", ylabel="microseconds per state (sweep)")
    axis.grid(visible=True, which="major", color="0.85", linewidth=0.8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False)
    for ending in ("png", "svg"):
        figure.savefig(out / f"growth.{ending}", dpi=150)


if __name__ == "__main__":
    main()
