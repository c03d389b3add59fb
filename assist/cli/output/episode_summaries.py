"""Tables of simulated episodes."""

from __future__ import annotations

import click

from ...studies.reports.compared_policies import PolicyComparison
from ..terminal.console import print_table


def show_comparison(found: PolicyComparison, drawn: int, pool: int) -> None:
    """Print what policies led to, and how they differ; and how many people of the pool were in a team."""
    print_table(*found.means())
    click.echo(found.note() if drawn == pool else f"{found.note()}; {drawn} of {pool} people drawn")
    for line in found.notes():
        click.echo(f"{line} (--c-suggest)")
    for row in found:
        if row.summary.questions is not None:
            click.echo(f"{row.policy}: {row.summary.questions:.2f} questions per episode")
    if len(found) > 1 and found[0].summary.episodes > 1:
        click.echo()
        print_table(*found.differences())
