"""Tables of simulated episodes."""

from __future__ import annotations

import math

import click
from rich.table import Table

from ...person.policy import not_worth_its_cost
from ...simulation.episode import SHOWN
from ...simulation.episodes import Episodes, Summary
from ..terminal.console import print_table


def show_differences(runs: list[Episodes]) -> None:
    """Print how each policy differs from `none`, or else the first one, in the same episodes: 95 % intervals."""
    from ...reports.policy_comparison import DIFFERENCES, MEASURES, comparison_of, shown_interval

    found = comparison_of(runs)
    table = Table(box=None, pad_edge=False)
    table.add_column(f"difference to {found.baseline}")
    for name in DIFFERENCES:
        table.add_column(f"{MEASURES[name]} (95 % interval)", justify="right")
    for row in found:
        if row.differences is not None:
            table.add_row(row.policy, *(shown_interval(row.differences[name]) for name in DIFFERENCES))
    print_table(table)


def _cell(mean: float, error: float) -> str:
    """Format a mean with its standard error; a single episode has no standard error."""
    return f"{mean:.2f}" if math.isnan(error) else f"{mean:.2f} ± {error:.2f}"


def show_summaries(summaries: list[Summary], drawn: int, pool: int) -> None:
    """Print a row for each policy, and how many people of the pool were in a team."""
    table = Table(box=None, pad_edge=False)
    shown = dict(SHOWN)
    if all(summary.costs[0] == summary.actions[0] for summary in summaries):  # each action costs 1
        del shown["costs"]
    if any(summary.executions[0] for summary in summaries):  # otherwise all interventions are suggestions
        shown |= {"suggestions": "suggestions", "executions": "executions"}
    for column in ("policy", *shown.values(), "cut off"):
        table.add_column(column.replace("_", " "), justify="left" if column == "policy" else "right")
    for summary in summaries:
        cells = [_cell(*getattr(summary, name)) for name in shown]
        table.add_row(summary.policy, *cells, f"{summary.cut_off}")
    print_table(table)
    count = summaries[0].episodes
    what = "of one episode" if count == 1 else f"mean ± standard error over {count} episodes"
    click.echo(what if drawn == pool else f"{what}; {drawn} of {pool} people drawn")
    for summary in summaries:
        if summary.c_suggest_too_high is not None:
            click.echo(f"{summary.policy}: {not_worth_its_cost(summary.c_suggest_too_high)} (--c-suggest)")
        if summary.questions is not None:
            click.echo(f"{summary.policy}: {summary.questions:.2f} questions per episode")
