"""Output of `infer`: a file, JSON or a table of the posteriors over goals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from planner.system import files

from ..terminal.console import print_json, print_table

if TYPE_CHECKING:
    from ...learning.goals import InferredGoals


def show_goals(found: InferredGoals, out: Path | None, *, as_json: bool) -> None:
    """Write and print posteriors."""
    records = found.as_dicts()
    if out:
        files.write_records(out, records)
    if as_json:
        print_json(records)
    else:
        print_table(_table_of(found), width=160)


def _table_of(found: InferredGoals, columns: int = 8) -> Table:
    """Return a table of the posterior at the end of each episode.

    Up to `columns` goals have a column each; of more, the three most probable ones are named.
    """
    table = Table(box=None, pad_edge=False)
    for name in ("person", "episode"):
        table.add_column(name)
    several = len(found.goals) > columns
    for name in ("actions", "beta", *([] if several else found.goals)):
        table.add_column(name, justify="right")
    if several:
        table.add_column("most probable goals")
    for one in found.episodes:
        posterior = one.posterior[-1]
        cells = [one.person, one.episode, f"{len(one)}", f"{one.beta[-1]:.2f}"]
        if several:
            best = (-posterior).argsort(kind="stable")[:3].tolist()
            cells.append(", ".join(f"{found.goals[goal]} {posterior[goal]:.3f}" for goal in best))
        else:
            cells += [f"{p:.3f}" for p in posterior]
        table.add_row(*cells)
    return table
