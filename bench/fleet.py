"""Robots that need help on their way: policies against the Lagrangian bound.

    python bench/fleet.py [--cells M/N] [--instances 100] [--runs 500] [--rollout-runs 100] [--record FILE]
    python bench/fleet.py --export DIR [--cells M/N] [--instances 100]

M operators help N robots. Each robot goes through waypoints 1 to 7, of which 7 is the goal, and may fall into an error,
which it does not leave without help. A step costs 2, or 4 in an error, and .75 more with help. The protocol is that of
"Scalable operator allocation for multi-robot assistance: a restless bandit approach" (Dahiya, Akbarzadeh, Mahajan and
Smith), with discounted costs. Figures are the percentages by which costs exceed the bound, with the standard errors
over instances. Rollout is simulated where an operator has at most five robots; the last column has its difference from
prices on the same runs. Up to four robots, the exact optimum is computed.

`--export` writes the problems as archives that `Agents.load` reads, and `problems.csv` with the bound and, where it is
known, the optimum of each.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, record_option, write_record

from assist.certify.coupled import Agents, bound, joint_optimum, policy, simulate
from assist.certify.coupled.agents import Floats, Ints

GOAL = 7
CELLS = [f"{m}/{m * ratio}" for ratio in (3, 5, 10) for m in (1, 2, 3, 5)]
POLICIES = ("reactive", "benefit", "whittle", "prices")
OPTIMUM_UP_TO = 4
"""Robots up to which the exact optimum is computed: three take 0.1 s, four 3 s, five a minute."""

ROLLOUT_UP_TO = 5
"""Robots per operator up to which rollout is simulated: with more, a step takes too long."""


def _known(name: str):  # type: ignore[no-untyped-def]
    """Return a formatter of a mean and its standard error, or of a dash where there is none."""
    shown = cell(name, ".2f", f"{name}_stderr")
    return lambda row: shown(row) if name in row else "-"


COLUMNS = {
    "M/N": cell("cell"),
    "instances": cell("instances"),
    **{name: _known(name) for name in (*POLICIES, "rollout", "rollout - prices", "optimum")},
}


def fleet(robots: int, rng: np.random.Generator, gamma: float = 0.99) -> Agents:
    """Return a random fleet. State 2 w + e is waypoint w + 1, with an error if e is 1."""
    S = 2 * GOAL
    P, R = np.zeros((robots, 2, S, S)), np.zeros((robots, 2, S))
    for k in range(robots):
        P[k, :, S - 2 :, S - 2] = 1
        for w in range(GOAL - 1):
            normal, error, ahead = 2 * w, 2 * w + 1, 2 * w + 2
            r0, r1 = rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.4)
            if rng.random() < 0.5:
                q0 = rng.uniform(0.2, 0.5)
                stays, after = r1, ahead
            else:
                q0 = rng.uniform(0, np.clip((1 - r0) / (2 - r1), 0.1, 1 - r0))
                stays, after = rng.uniform(0, np.clip(1 - q0 * (1 - r1) / (1 - r0 - q0), 0.1, 0.9)), normal
            P[k, 0, normal, [normal, error, ahead]] = r0, q0, 1 - r0 - q0
            P[k, 1, normal, [normal, ahead]] = r1, 1 - r1
            P[k, 0, error, error] = 1
            P[k, 1, error, error] = stays
            P[k, 1, error, after] += 1 - stays
            R[k, :, normal], R[k, :, error] = (-2, -2.75), (-4, -4.75)
    return Agents(P, R, gamma=gamma)


def reactive(operators: int):  # type: ignore[no-untyped-def]
    """Return the policy that helps robots in an error, the first ones if there are too many."""

    def act(_: int, states: Ints) -> Ints:
        error = (states % 2 == 1) & (states < 2 * GOAL - 2)
        return (error & (np.cumsum(error, axis=1) <= operators)).astype(np.int64)

    return act


def instance(operators: int, robots: int, seed: int) -> Agents:
    """Return the fleet of a cell with a number."""
    return fleet(robots, np.random.default_rng([seed, operators, robots]))


def excess(operators: int, robots: int, seed: int, runs: int, rollout_runs: int) -> dict[str, float]:
    """Return the percentage above the bound of each policy on one instance."""
    agents = instance(operators, robots, seed)
    solved = bound(agents, operators)
    found = {}

    def percent(value: float) -> float:
        return 100 * (solved.upper - value) / -solved.upper

    for name in POLICIES:
        act = reactive(operators) if name == "reactive" else policy(agents, name, operators, solved=solved)
        run = simulate(agents, act, operators, runs=runs, seed=seed, control=solved)
        found[name] = percent(run.value)
    if rollout_runs and robots <= ROLLOUT_UP_TO * operators:
        own, base = (
            percent(simulate(agents, act, operators, runs=rollout_runs, seed=seed, control=solved).value)
            for act in ("rollout", "prices")
        )
        found |= {"rollout": own, "rollout - prices": own - base}
    if robots <= OPTIMUM_UP_TO:
        found["optimum"] = percent(joint_optimum(agents, operators, tolerance=1e-7).value)
    return found


def export(folder: Path, cells: tuple[str, ...], instances: int) -> None:
    """Write problems as archives, with a table of their bounds."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "problems.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "operators", "robots", "bound", "optimum"])
        for name in cells:
            operators, robots = map(int, name.split("/"))
            for seed in range(instances):
                agents = instance(operators, robots, seed)
                known = joint_optimum(agents, operators).value if robots <= OPTIMUM_UP_TO else ""
                written = f"fleet-{operators}-{robots}-{seed:03}.npz"
                agents.save(folder / written)
                table.writerow([written, operators, robots, bound(agents, operators).upper, known])


@click.command()
@click.option("--cells", multiple=True, type=click.Choice(CELLS), help="Operators and robots; default: all.")
@click.option("--instances", type=click.IntRange(min=2), default=100, show_default=True, help="Instances per cell.")
@click.option(
    "--runs", type=click.IntRange(min=2), default=500, show_default=True, help="Runs per instance and policy."
)
@click.option(
    "--rollout-runs", type=click.IntRange(min=0), default=100, show_default=True, help="Runs per instance of rollout."
)
@click.option("--export", "into", type=click.Path(path_type=Path, file_okay=False), help="Write the problems here.")
@record_option
def main(
    cells: tuple[str, ...], instances: int, runs: int, rollout_runs: int, into: Path | None, record: Path | None
) -> None:
    """Compare policies on random fleets."""
    if into is not None:
        export(into, cells or tuple(CELLS), instances)
        return
    rows = []
    for name in cells or CELLS:
        operators, robots = map(int, name.split("/"))
        start = time.perf_counter()
        found = [excess(operators, robots, seed, runs, rollout_runs) for seed in range(instances)]
        row: dict[str, Any] = {"cell": name, "instances": instances}
        shown = []
        for policy_name in found[0]:
            values: Floats = np.array([one[policy_name] for one in found])
            row[policy_name] = values.mean()
            row[f"{policy_name}_stderr"] = values.std(ddof=1) / np.sqrt(instances)
            shown.append(f"{policy_name} {row[policy_name]:.2f} ± {row[f'{policy_name}_stderr']:.2f}")
        rows.append(row)
        write_record(record, COLUMNS, rows)  # a run that is interrupted keeps its finished cells
        print(f"{name}: {', '.join(shown)} ({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
