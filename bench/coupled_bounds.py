"""Bounds of weakly coupled problems against the exact joint optimum: by prices, and by sample paths.

    python bench/coupled_bounds.py [--problems 200] [--fleets 20] [--paths 100] [--record FILE]

Random problems have 2, 3 or 4 agents of 2 to 4 states, and fewer units of the resource than agents. Fleets are three
robots and one operator of `fleet.py`. Distances are percentages of the optimum. A bound by samples is what a user gets,
which holds with 95 % confidence; its mean over sample paths is shown, too. A mean that lies more than four standard
errors below the optimum counts as violated.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from fleet import instance
from tables import cell, record_option, write_record

from assist.certify.coupled import Agents, bound, joint_optimum, sampled_bound

COLUMNS = {
    "problems": cell("name"),
    "count": cell("count"),
    "violated": cell("violated"),
    "above the optimum, prices": cell("prices", ".2f", "prices_stderr"),
    "samples (95 %)": cell("samples", ".2f", "samples_stderr"),
    "samples, largest": cell("largest", ".2f"),
    "samples, mean over paths": cell("mean", ".2f", "mean_stderr"),
}


def random_problem(seed: int) -> tuple[str, Agents, int]:
    """Return the name of a random problem's row, the problem, and the units of its resource."""
    rng = np.random.default_rng(seed)
    N, S = 2 + seed % 3, int(rng.integers(2, 5))
    P = rng.dirichlet(np.full(S, 0.6), size=(N, 2, S))
    agents = Agents(P, -rng.exponential(size=(N, 2, S)), initial=rng.integers(S, size=N), gamma=0.9)
    return f"{N} agents", agents, int(rng.integers(1, N))


@click.command()
@click.option("--problems", type=click.IntRange(min=6), default=200, show_default=True, help="Random problems.")
@click.option("--fleets", type=click.IntRange(min=2), default=20, show_default=True, help="Fleets.")
@click.option("--paths", type=click.IntRange(min=30), default=100, show_default=True, help="Sample paths.")
@record_option
def main(problems: int, fleets: int, paths: int, record: Path | None) -> None:
    """Compare bounds with the optimum."""
    cases = [random_problem(seed) for seed in range(problems)]
    cases += [("3 robots, 1 operator", instance(1, 3, seed), 1) for seed in range(fleets)]
    found: dict[str, list[tuple[float, float, float, bool]]] = {}
    for name, agents, units in cases:
        best, solved = joint_optimum(agents, units).value, bound(agents, units)
        sampled = sampled_bound(agents, units, paths=paths, solved=solved)
        low = min(solved.upper, sampled.mean + 4 * sampled.stderr) < best - 1e-6
        prices, samples, mean = (100 * (v - best) / -best for v in (solved.upper, sampled.upper, sampled.mean))
        found.setdefault(name, []).append((prices, samples, mean, low))
    rows: list[dict[str, Any]] = []
    for name, figures in sorted(found.items()):
        *above, violated = np.array(figures).T
        row: dict[str, Any] = {"name": name, "count": len(figures), "violated": int(violated.sum())}
        for column, values in zip(("prices", "samples", "mean"), above, strict=True):
            row |= {column: values.mean(), f"{column}_stderr": values.std(ddof=1) / np.sqrt(len(values))}
        rows.append(row | {"largest": above[1].max()})
        print(", ".join(f"{title} {show(rows[-1])}" for title, show in COLUMNS.items()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
