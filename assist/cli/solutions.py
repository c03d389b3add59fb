"""Records of `solve` as a table, and what went wrong in them."""

from __future__ import annotations

import click
from rich.table import Table

from planner.solving import Record

from .console import print_table


def tell_errors(records: list[Record]) -> None:
    """Say on stderr why an instance was not solved, or only its initial state was."""
    for record in records:
        if (error := record["error"]) is not None:
            line = "" if error["line"] is None else f":{error['line']}"
            click.echo(f"{error['file']}{line}: {error['message']}", err=True)
        elif record["note"]:
            click.echo(f"{record['instance']}: {record['note']}", err=True)


def show_solutions(records: list[Record]) -> None:
    """Print a row for each instance, and the plan where there is only one."""
    if len(records) == 1 and records[0]["plan"] is not None:
        click.echo("\n".join(records[0]["plan"]))
    table = Table(box=None, pad_edge=False)
    table.add_column("instance", overflow="fold")
    table.add_column("status")
    for name in ("cost", "states", "dead ends", "largest h*", "verified", "seconds"):
        table.add_column(name, justify="right")
    for r in records:
        numbers = (r["cost"], r["states"], r["dead_ends"], r["max_cost_to_go"], r["verified"])
        cells = ("-" if number is None else f"{number:,}" for number in numbers)
        seconds = r["seconds"].get("total")
        table.add_row(r["instance"], r["status"], *cells, "-" if seconds is None else f"{seconds:.2f}")
    print_table(table)
