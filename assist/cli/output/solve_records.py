"""Records of `solve`: the first answer as soon as it is there, a table in the end, and what went wrong in them."""

from __future__ import annotations

import sys

import click

from planner.batch.solve_instance import SWEEPING, SolveRecord

from ..terminal.console import print_json, print_table


class Answers:
    """What is known of instances by now, and is shown as it comes.

    Attributes
    ----------
    records : dict of (str, str) to Record
        The latest of each instance.
    """

    def __init__(self, *, alone: bool, as_json: bool) -> None:
        """Show plans only where an instance is `alone`."""
        self.records: dict[tuple[str, str], SolveRecord] = {}
        self._alone, self._json = alone, as_json
        self._stdout = sys.stdout  # a progress bar puts another one in its place
        self._shown = False

    def add(self, record: SolveRecord) -> None:
        """Take the record of an instance, which may not be the last one."""
        self.records[record["instance"], record["domain"]] = record

    def first(self, record: SolveRecord) -> None:
        """Show cost and plan of an instance on which work goes on."""
        self.add(record)
        if self._json or not self._alone or self._shown:
            return
        self._shown = True
        if record["plan"]:
            # On a terminal the bar makes room for lines that go through it.
            click.echo("\n".join(record["plan"]), file=sys.stdout if self._stdout.isatty() else self._stdout)
        if not record["note"].endswith(SWEEPING):
            return  # the rest follows soon
        known = "unsolvable" if record["cost"] is None else f"cost {record['cost']:,}, by the plan above"
        click.echo(f"{record['instance']}: {known}; going on with all states", err=True)

    def show(self, records: list[SolveRecord]) -> None:
        """Show what there is in the end."""
        tell_errors(records)
        if self._json:
            print_json(records)
        elif len(records) > 1 or not records[0]["error"]:
            show_solutions(records, plan=self._alone and not self._shown)


def tell_errors(records: list[SolveRecord]) -> None:
    """Say on stderr why an instance was not solved, or only its initial state was."""
    for record in records:
        if (error := record["error"]) is not None:
            line = "" if error["line"] is None else f":{error['line']}"
            click.echo(f"{error['file']}{line}: {error['message']}", err=True)
        elif record["note"]:
            click.echo(f"{record['instance']}: {record['note']}", err=True)


def show_solutions(records: list[SolveRecord], *, plan: bool) -> None:
    """Print a row for each instance, before it the plan of the first one if that is wanted."""
    if plan and records[0]["plan"]:
        click.echo("\n".join(records[0]["plan"]))
    from rich.table import Table  # takes its time

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
