"""Output of `infer`: a file, JSON or a table of the posteriors over goals."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from planner.system import files

from ..terminal.console import print_json, print_table

if TYPE_CHECKING:
    from ...learning.goals import InferredGoals


MOST = 8
"""Goals that have a column each; of more, the three most probable ones are named."""


def show_goals(found: InferredGoals, out: Path | None, *, as_json: bool) -> None:
    """Write and print posteriors."""
    records = found.as_dicts()
    if out:
        files.write_records(out, records)
    if as_json:
        print_json(records)
    else:
        several = len(found.goals) > MOST
        head = ("person", "episode", "actions", "beta", *(["most probable goals"] if several else found.goals))
        print_table(head, _rows_of(found, several=several), left=(0, 1, 4) if several else (0, 1), width=160)


def _rows_of(found: InferredGoals, *, several: bool) -> Iterator[list[str]]:
    """Yield the row of each episode: the posterior at its end, of `several` goals that of the most probable ones."""
    for one in found.episodes:
        posterior = one.posterior[-1]
        cells = [one.person, one.episode, f"{len(one)}", f"{one.beta[-1]:.2f}"]
        if several:
            best = (-posterior).argsort(kind="stable")[:3].tolist()
            cells.append(", ".join(f"{found.goals[goal]} {posterior[goal]:.3f}" for goal in best))
        else:
            cells += [f"{p:.3f}" for p in posterior]
        yield cells
