"""Output of `policy` and `bound`: one person's bounds, and a team's bound from sample paths."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from ..terminal.console import print_table

if TYPE_CHECKING:
    from ...certify.team_bound import TeamBound

ENDED = {"gap": "", "time": "; time limit", "memory": "; memory limit", "stalled": "; limit of rounding"}


def line_of(lower: float, upper: float) -> str:
    """Return the bounds and their gap as a line of progress."""
    gap = (upper - lower) / abs(lower) if lower else 0.0
    return f"lower {lower:.5f}  upper {upper:.5f}  gap {gap:.2e}"


def show_bounds(record: dict[str, Any]) -> None:
    """Print a record of `policy`."""
    known, hidden = ("goal, beta and theta", "values") if "goals" in record else ("beta and theta", "pairs")
    what = f"{record['states']:,} states, {record['hidden']} hidden {hidden}"
    if record["frontier"]:
        what += f"; {record['frontier']:,} frontier states"
    click.echo(what)
    least = " (at least)" if record["frontier"] else ""
    labels = (
        ("value_never", f"never suggest{least}"), ("value_always", f"always suggest{least}"),
        ("lower", "policy (lower bound)"),
        ("upper", "any policy (upper bound)"), ("value_qmdp", f"{known} observed (QMDP)"),
    )  # fmt: skip
    print_table(("", ""), [[label, f"{record[name]:.4f}"] for name, label in labels])
    ended = ENDED[record["stopped"]]
    if record["stopped"] == "stalled" and record["frontier"]:
        ended = "; limited by the bounds of frontier states"
    gap = "-" if record["gap"] is None else f"{100 * record['gap']:.3g} %"
    click.echo(f"gap {gap}, {record['alpha_vectors']:,} alpha vectors, {record['seconds']:.1f} s{ended}")


def show_samples(found: TeamBound, *, err: bool = False) -> None:
    """Print what the sample paths add to a team's bound; on stderr with `err`."""
    from ...certify.information_relaxation.confidence import CONFIDENCE, FEWEST

    sampled = found.sampled
    if sampled is None:
        click.echo("there was too little time for a bound from sample paths (--time-limit)", err=err)
    elif not sampled.enough:
        click.echo(
            f"{sampled.paths} sample paths are too few for a bound; {FEWEST} are needed (--samples, --time-limit)"
        )
    else:
        click.echo(
            f"the upper bound comes from {sampled.paths} sample paths and holds with {CONFIDENCE:.0%} confidence; "
            f"{found.proven:.3f} holds with certainty"
        )
