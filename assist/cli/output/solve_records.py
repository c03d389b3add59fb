"""Output of `solve`: answers as soon as they are known, one line for each instance, and errors."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence

import click

from planner.batch.results_folder import PLANNING, SWEEPING, SolveRecord

from ..terminal.console import print_json

HEADER = ("instance", "status", "cost", "states", "dead ends", "largest h*", "verified", "seconds")
WIDTHS = (0, 10, 8, 13, 9, 10, 8, 8)
"""Least widths of the columns where the lines of several instances are printed one after another."""


class Answers:
    """Records of instances, shown as they become known.

    Attributes
    ----------
    records : dict of (str, str) to SolveRecord
        The latest record of each instance, keyed by instance and domain.
    """

    def __init__(self, instances: Sequence[str], *, as_json: bool) -> None:
        """Show the plan only if there is a single instance; several get a line each, in order of completion."""
        self.records: dict[tuple[str, str], SolveRecord] = {}
        self._alone, self._json = len(instances) == 1, as_json
        self._widths: Sequence[int] = (max(map(len, (*instances, HEADER[0]))), *WIDTHS[1:])
        self._stdout = sys.stdout  # a progress bar replaces sys.stdout
        self._shown = False
        self._finished: set[tuple[str, str]] = set()
        self._said: Counter[str] = Counter()

    def add(self, record: SolveRecord) -> None:
        """Store the final record of an instance, and show it at once if there are several."""
        self._store(record)
        if not self._alone:
            self._finish(record)

    def first(self, record: SolveRecord) -> None:
        """Show what is known of an instance that is not finished: its plan, and what is still being computed."""
        self._store(record)
        if self._json or not self._alone or self._shown:
            return
        if record["note"].endswith(PLANNING):
            click.echo(f"{record['instance']}: cost {_shown(record['cost'])}; A* searches for the plan", err=True)
            return
        self._shown = True
        if record["plan"]:
            self._print("\n".join(record["plan"]))
        if not record["note"].endswith(SWEEPING):
            return  # the complete record follows soon
        known = "unsolvable" if record["cost"] is None else f"cost {_shown(record['cost'])}, by the plan above"
        click.echo(f"{record['instance']}: {known}; computing the cost-to-go of all states", err=True)

    def show(self, records: list[SolveRecord]) -> None:
        """Print what has not been shown of all records at the end."""
        for record in records:
            self._finish(record)
        for note, count in self._said.items():
            if count > 1:
                click.echo(f"{count - 1} other instance{'s' * (count > 2)}: {note}", err=True)
        if self._json:
            print_json(records)

    def _store(self, record: SolveRecord) -> None:
        self.records[_key(record)] = record

    def _finish(self, record: SolveRecord) -> None:
        """Print the faults, the notes and the line of an instance once."""
        if _key(record) in self._finished:
            return
        self._finished.add(_key(record))
        self._tell(record)
        if self._json or (self._alone and record["error"]):
            return
        if self._alone and record["plan"] and not self._shown:
            self._print("\n".join(record["plan"]))
        cells = _cells(record)
        if self._alone:
            self._widths = tuple(max(len(a), len(b)) for a, b in zip(HEADER, cells, strict=True))
        if len(self._finished) == 1:
            self._print(_line(HEADER, self._widths))
        self._print(_line(cells, self._widths))

    def _tell(self, record: SolveRecord) -> None:
        """Print on stderr why an instance was not solved, and what else the user should know; each note once."""
        if (error := record["error"]) is not None:
            line = "" if error["line"] is None else f":{error['line']}"
            click.echo(f"{error['file']}{line}: {error['message']}", err=True)
        elif record["note"]:
            notes = record["note"].split("; ")
            new = [note for note in notes if not self._said[note]]
            self._said.update(notes)
            if new:
                click.echo(f"{record['instance']}: {'; '.join(new)}", err=True)

    def _print(self, text: str) -> None:
        """Print on stdout. On a terminal, the progress bar makes room for lines that are printed through it."""
        click.echo(text, file=sys.stdout if self._stdout.isatty() else self._stdout)


def _key(record: SolveRecord) -> tuple[str, str]:
    return record["instance"], record["domain"]


def _cells(record: SolveRecord) -> tuple[str, ...]:
    numbers = (record[name] for name in ("cost", "states", "dead_ends", "max_cost_to_go", "verified"))
    seconds = record["seconds"].get("total")
    return (
        record["instance"],
        record["status"],
        *("-" if number is None else _shown(number) for number in numbers),
        "-" if seconds is None else f"{seconds:.2f}",
    )


def _shown(number: float) -> str:
    """Return a number for people: exact if it is whole, else with up to four decimals. Records have all digits."""
    return f"{number:,.0f}" if number == int(number) else f"{number:,.4f}".rstrip("0")


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Return a line of columns; names are aligned to the left, numbers to the right."""
    words = (f"{cell:<{n}}" if i < 2 else f"{cell:>{n}}" for i, (cell, n) in enumerate(zip(cells, widths, strict=True)))
    return "  ".join(words)
