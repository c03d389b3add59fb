"""Summaries of episodes as a table."""

from __future__ import annotations

import click
from rich.table import Table

from ..simulation.episodes import SHOWN, Summary
from .console import print_table


def show_summaries(summaries: list[Summary]) -> None:
    """Print a row for each policy."""
    table = Table(box=None, pad_edge=False)
    for column in ("policy", *SHOWN.values(), "cut off"):
        table.add_column(column.replace("_", " "), justify="left" if column == "policy" else "right")
    for summary in summaries:
        cells = [f"{mean:.2f} ± {error:.2f}" for mean, error in (getattr(summary, name) for name in SHOWN)]
        table.add_row(summary.policy, *cells, f"{summary.cut_off}")
    print_table(table)
    click.echo(f"mean ± standard error over {summaries[0].episodes} episodes")
