"""One person's problem between two bounds: as a line while it is solved, and as a table."""

from __future__ import annotations

from typing import Any

import click
from rich.table import Table

from .console import print_table

ENDED = {"gap": "", "time": "; the time is up", "memory": "; the memory is full", "stalled": "; rounding"}


def line_of(lower: float, upper: float) -> str:
    """Say how far a search has come."""
    gap = (upper - lower) / abs(lower) if lower else 0.0
    return f"lower {lower:.5f}  upper {upper:.5f}  gap {gap:.2e}"


def show_bounds(record: dict[str, Any]) -> None:
    """Print a record of `policy`."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    what = f"{record['states']:,} states, {record['hidden']} hidden pairs"
    if record["frontier"]:
        what += f"; {record['frontier']:,} of the states are a frontier"
    click.echo(what)
    for name, label in (
        ("value_never", "nothing, ever"), ("value_always", "always a suggestion"), ("lower", "policy, at least"),
        ("upper", "any policy, at most"), ("value_qmdp", "beta and theta seen"),
    ):  # fmt: skip
        table.add_row(label, f"{record[name]:.4f}")
    print_table(table)
    ended = ENDED[record["stopped"]]
    if record["stopped"] == "stalled" and record["frontier"]:
        ended = "; the bounds where the states break off allow no more"
    click.echo(
        f"gap {100 * record['gap']:.3g} %, {record['alpha_vectors']:,} alpha vectors, {record['seconds']:.1f} s{ended}"
    )
