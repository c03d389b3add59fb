"""Sampled values of a table compared with a second exact method, which shares only the grounded task with the sweep.

    PEER_PYTHON=... python bench/symbolic.py INSTANCE [--states 200] [--max-states N] [--memory-limit MB]

In a task with a billion states, A* solves only few states. A symbolic search with decision diagrams counts all states,
and computes the distance of each state of a sample, the one that `solve --verify` uses. PEER_PYTHON is a Python
interpreter with `dd` and CUDD. Tasks must have equal action costs and unconditional effects.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, record_option, write_record

from planner import load, sweep
from planner.costtogo.verification import sample

PEER = Path(__file__).parent / "peers" / "symbolic.py"

COLUMNS: Columns = {
    "instance": lambda row: f"`{row['instance']}`",
    "states": lambda row: f"{row['states']:,}",
    "the same number of states": lambda row: "yes" if row["counted"] == row["states"] else f"{row['counted']:,}",
    "largest h*, both": lambda row: f"{row['largest']}, {row['told']}",
    "sampled states that are equal": lambda row: f"{row['equal']} of {row['sample']}",
    "seconds of the sweep": lambda row: f"{row['seconds']:,.0f}",
    "of the diagrams": lambda row: f"{row['symbolic']:,.0f}",
}


def swept(file: Path, count: int, max_states: int, memory: float | None) -> dict[str, Any]:
    """Sweep an instance; return its task, a sample of states and their values. The table is freed."""
    task = load(file)
    if len({task.costs[operator.action] for operator in task.operators}) > 1:
        raise click.UsageError(f"{file}: its actions have several costs")
    if any(effect.conditions for operator in task.operators for effect in operator.effects):
        raise click.UsageError(f"{file}: it has conditional effects")
    start = time.monotonic()
    table = sweep(task, max_states=max_states, memory_limit_mb=memory)
    seconds = time.monotonic() - start
    states = sample(len(table), table.initial, count, np.random.default_rng(0))
    return {
        "instance": f"{file.parent.name}/{file.stem}",
        "states": len(table),
        "largest": int(table.distance[~table.dead_end].max()),
        "seconds": seconds,
        "values": [None if np.isinf(value) else int(value) for value in table.lookup(np.array(states))],
        "cost": max(task.costs),
        "task": {
            "domains": [len(variable.facts) for variable in task.variables],
            "operators": [
                [list(o.preconditions), [(effect.variable, effect.value) for effect in o.effects]]
                for o in task.operators
            ],
            "initial": list(task.initial),
            "goal": list(task.goal),
            "sample": table.values(states).tolist(),
        },
    }


@click.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@click.option("--states", default=200, show_default=True, help="States to compare.")
@click.option("--max-states", default=50_000_000, show_default=True)
@click.option("--memory-limit", type=float, help="MB for the sweep.")
@click.option("--symbolic-memory", default=6000.0, show_default=True, help="MB for the diagrams.")
@record_option
def main(
    file: Path, states: int, max_states: int, memory_limit: float | None, symbolic_memory: float, record: Path | None
) -> None:
    """Compare sampled values of an instance's table with those of decision diagrams."""
    peer = os.environ.get("PEER_PYTHON")
    if peer is None:
        raise click.UsageError("PEER_PYTHON has to name an interpreter that has dd with CUDD")
    row = swept(file, states, max_states, memory_limit)
    click.echo(f"{row['states']:,} states in {row['seconds']:.0f} s", err=True)
    question = json.dumps({**row.pop("task"), "memory": symbolic_memory * 1e6})
    done = subprocess.run([peer, str(PEER)], input=question, stdout=subprocess.PIPE, text=True, check=True)
    answer = json.loads(done.stdout)
    told = [None if d is None else d * row["cost"] for d in answer["distances"]]
    row.update(
        counted=answer["states"], told=answer["largest"] * row["cost"], sample=states, symbolic=answer["seconds"]
    )
    row["equal"] = sum(a == b for a, b in zip(told, row["values"], strict=True))
    for name, show in COLUMNS.items():
        click.echo(f"{name}: {show(row)}")
    write_record(record, COLUMNS, [row])
    sys.exit(row["equal"] != states or row["counted"] != row["states"] or row["told"] != row["largest"])


if __name__ == "__main__":
    main()
