"""One person's problem between two bounds, as a line while it is solved and as a table; a team's sampled bound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from rich.table import Table

from ..terminal.console import print_table

if TYPE_CHECKING:
    from ...certify.team_bound import TeamBound

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


def show_samples(found: TeamBound) -> None:
    """Print what the sample paths add to a team's bound."""
    from ...certify.information_relaxation.confidence import CONFIDENCE, FEWEST

    sampled = found.sampled
    if sampled is None:
        click.echo("no path was sampled: the time limit ended before the penalty was computed (--time-limit)")
    elif not sampled.enough:
        click.echo(f"{sampled.paths} sample paths are too few for a bound; {FEWEST} are needed (--paths, --time-limit)")
    else:
        click.echo(
            f"the bound is that of {sampled.paths} sample paths, with a confidence of {CONFIDENCE:.0%}; "
            f"{found.proven:.3f} holds in any case"
        )
