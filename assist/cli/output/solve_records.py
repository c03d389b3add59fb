"""Output of `solve`: the first answer as soon as it is known, a table at the end, and errors."""

from __future__ import annotations

import sys

import click

from planner.batch.solve_record import PLANNING, SWEEPING, SolveRecord

from ..terminal.console import print_json, print_table


class Answers:
    """Records of instances, shown as they become known.

    Attributes
    ----------
    records : dict of (str, str) to SolveRecord
        The latest record of each instance, keyed by instance and domain.
    """

    def __init__(self, *, alone: bool, as_json: bool) -> None:
        """Show plans only for a single instance (`alone`)."""
        self.records: dict[tuple[str, str], SolveRecord] = {}
        self._alone, self._json = alone, as_json
        self._stdout = sys.stdout  # a progress bar replaces sys.stdout
        self._shown = False

    def add(self, record: SolveRecord) -> None:
        """Store the latest record of an instance."""
        self.records[record["instance"], record["domain"]] = record

    def first(self, record: SolveRecord) -> None:
        """Show what is known of an instance that is not finished: its plan, and what is still being computed."""
        self.add(record)
        if self._json or not self._alone or self._shown:
            return
        if record["note"].endswith(PLANNING):
            click.echo(f"{record['instance']}: cost {record['cost']:,}; A* searches for the plan", err=True)
            return
        self._shown = True
        if record["plan"]:
            # On a terminal, the progress bar makes room for lines that are printed through it.
            click.echo("\n".join(record["plan"]), file=sys.stdout if self._stdout.isatty() else self._stdout)
        if not record["note"].endswith(SWEEPING):
            return  # the complete record follows soon
        known = "unsolvable" if record["cost"] is None else f"cost {record['cost']:,}, by the plan above"
        click.echo(f"{record['instance']}: {known}; computing the cost-to-go of all states", err=True)

    def show(self, records: list[SolveRecord]) -> None:
        """Print all records at the end."""
        tell_errors(records)
        if self._json:
            print_json(records)
        elif len(records) > 1 or not records[0]["error"]:
            show_solutions(records, plan=self._alone and not self._shown)


def tell_errors(records: list[SolveRecord]) -> None:
    """Print on stderr why an instance was not solved, or was solved in its initial state only."""
    for record in records:
        if (error := record["error"]) is not None:
            line = "" if error["line"] is None else f":{error['line']}"
            click.echo(f"{error['file']}{line}: {error['message']}", err=True)
        elif record["note"]:
            click.echo(f"{record['instance']}: {record['note']}", err=True)


def show_solutions(records: list[SolveRecord], *, plan: bool) -> None:
    """Print a row for each instance. With `plan`, print the first instance's plan before the table."""
    if plan and records[0]["plan"]:
        click.echo("\n".join(records[0]["plan"]))
    from rich.table import Table  # imported late because the import is slow

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
