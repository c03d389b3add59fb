"""Figures of a simulation study: team sizes, savings, and kinds of people. Needs the extra `plots`.

Each function takes a data frame with a row for each mark. Published values for comparison are arguments; no function
contains any.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .labels import Note, name_curves
from .panels_by_name import MEASURES, instances_of, named_rows
from .style import (
    BLUE,
    SKY,
    THICK,
    THIN,
    VERMILLION,
    PolicyLook,
    entry,
    grid,
    ink,
    legend_below,
    looks,
    sample,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

COMPARISONS = {
    "actions against none": PolicyLook(BLUE, "o"),
    "actions against reactive": PolicyLook(SKY, "^", (0, (5, 1.5))),
    "interventions against reactive": PolicyLook(VERMILLION, "D", (0, (5, 1.5, 1, 1.5))),
}


@styled
def team_size_figure(cells: DataFrame) -> Figure:
    """Plot actions and interventions against the number of people.

    Parameters
    ----------
    cells : DataFrame
        Columns `instance`, `policy`, `humans`, `measure` (see `MEASURES`), `mean`, `sd`, `low`, `high`, `n`.
    """
    shown = looks(cells["policy"])
    figure, rows = named_rows(instances_of(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.13)
    ends: dict[Axes, list[Note]] = {axis: [] for row in rows for axis in row.values()}
    for instance, row in zip(instances_of(cells), rows, strict=True):
        for measure, axis in row.items():
            own = cells[(cells["instance"] == instance) & (cells["measure"] == measure)]
            for (policy, look), shift in zip(shown.items(), apart, strict=True):
                cell = own[own["policy"] == policy].sort_values("humans")
                if len(cell):
                    x = cell["humans"].to_numpy() + shift
                    _intervals(axis, x, cell, look)
                    axis.plot(x, cell["mean"], color=look.color, linestyle=look.line, linewidth=1.4, zorder=4)
                    ends[axis].append(Note(policy, x[-1], cell["mean"].iloc[-1], look.color))
            _from_nothing(axis, own)
            axis.set_ylabel(MEASURES[measure])
            axis.grid(axis="y")
            _mark_sizes(axis, cells)
    for axis in rows[-1].values():
        axis.set_xlabel("people in the team, K")
    legend_below(figure, _what_bars_mean(cells))
    name_curves(figure, ends)
    return figure


@styled
def category_figure(
    cells: DataFrame,
    categories: Sequence[str],
    published: Sequence[tuple[Sequence[str], float]] = (),
    source: str = "published",
) -> Figure:
    """Plot actions and interventions for kinds of people.

    Parameters
    ----------
    cells : DataFrame
        Columns `instance`, `policy`, `category`, `measure` (see `MEASURES`), `mean`, `sd`, `low`, `high`, `n`.
    categories : sequence of str
        The kinds, in the order in which they are shown.
    published : sequence of (categories, interventions)
        Published means, marked for comparison.
    source : str
        Name of their source.
    """
    shown = looks(cells["policy"])
    place = {name: number for number, name in enumerate(categories)}
    figure, rows = named_rows(instances_of(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.16)
    upright = len(categories) >= 6  # fewer labels fit horizontally
    ticks = [textwrap.fill(name, 24 if upright else max(8, 64 // len(categories))) for name in categories]
    for instance, row in zip(instances_of(cells), rows, strict=True):
        for measure, axis in row.items():
            own = cells[(cells["instance"] == instance) & (cells["measure"] == measure)]
            for (policy, look), shift in zip(shown.items(), apart, strict=True):
                cell = own[own["policy"] == policy]
                _intervals(axis, cell["category"].map(place).to_numpy() + shift, cell, look)
            marked = [(place[name], mean) for names, mean in published for name in names if name in place]
            if measure == "interventions":
                for at, mean in marked:
                    ends = (at - 0.42, at + 0.42)
                    axis.plot(ends, (mean, mean), color=ink(), linestyle="--", linewidth=1.1, zorder=1)
            for boundary in range(1, len(categories)):
                axis.axvline(boundary - 0.5, color=ink(), alpha=0.15, linewidth=0.8)
            axis.set_xlim(-0.5, len(categories) - 0.5)
            axis.margins(y=0.1)
            _from_nothing(axis, own, *(mean for _, mean in marked if measure == "interventions"))
            axis.set_xticks(range(len(categories)), ticks, rotation=90 if upright else 0)
            axis.tick_params(axis="x", length=0, labelsize=8)
            axis.set_ylabel(MEASURES[measure])
            axis.grid(axis="y")
    entries: list[Artist] = [sample(name, look, line=False) for name, look in shown.items()]
    if published:
        values = ", ".join(f"{value:g}" for _, value in published)
        entries.append(entry(f"{source}: {values}", linestyle="--", linewidth=1.1))
    legend_below(figure, [*entries, *_what_bars_mean(cells)])
    return figure


@styled
def benefit_figure(cells: DataFrame, published: Mapping[str, float] | None = None, source: str = "") -> Figure:
    """Plot a policy's savings against the number of people.

    Parameters
    ----------
    cells : DataFrame
        Columns `instance`, `humans`, `comparison` (`COMPARISONS`, or others), `mean`, `low`, `high`, the last three in
        percent.
    published : mapping of str to float, optional
        Published savings over all team sizes, by comparison.
    source : str
        Name of their source.
    """
    names = set(cells["comparison"])
    marked = {name: value for name, value in (published or {}).items() if name in names}
    shown = {name: look for name, look in COMPARISONS.items() if name in names} | looks(names - set(COMPARISONS))
    instances = instances_of(cells)
    figure, axes = grid(len(instances), 2, height=3.2)
    ends: dict[Axes, list[Note]] = {axis: [] for axis in axes}
    for instance, axis in zip(instances, axes, strict=True):
        first = cells["humans"].min() - 0.6
        for (comparison, look), shift in zip(shown.items(), _dodge(len(shown), 0.08), strict=True):
            own = cells[(cells["instance"] == instance) & (cells["comparison"] == comparison)]
            own = own.dropna(subset=["mean"]).sort_values("humans")  # undefined if the baseline is 0
            if len(own):
                x = own["humans"].to_numpy() + shift
                axis.plot(x, own["mean"], color=look.color, linestyle=look.line, linewidth=1.4)
                _bars(axis, x, own["low"], own["high"], look, THICK)
                axis.plot(
                    x, own["mean"], linestyle="none", marker=look.marker, color=look.color, markersize=6, zorder=5
                )
                label = comparison.replace(" against ", "\nagainst ")
                ends[axis].append(Note(label, x[-1], own["mean"].iloc[-1], look.color))
                if comparison in marked:
                    axis.plot(first, marked[comparison], marker="*", markersize=9, color=look.color)
        axis.axhline(0, color=ink(), linewidth=0.8)
        here = cells[cells["instance"] == instance]["mean"].dropna()
        if len(here):
            low, high = axis.get_ylim()
            far = 2 * max(np.ptp([0, *here, *marked.values()]), 10)  # intervals of few pools would squeeze the rest
            axis.set_ylim(max(low, min([0, *here]) - far), min(high, max([0, *here]) + far))
        axis.set_title(instance, loc="left", fontweight="bold")
        axis.set(xlabel="people in the team, K", ylabel="saving, %")
        _mark_sizes(axis, cells)
        axis.grid(axis="y")
    entries = [entry("95 % interval", **THICK)]
    if marked:
        entries.append(entry(f"{source}, over all team sizes", marker="*", markersize=9))
    legend_below(figure, entries)
    name_curves(figure, ends)
    return figure


def _mark_sizes(axis: Axes, cells: DataFrame) -> None:
    """Mark the horizontal axis at the team sizes that there are, or at a selection of many."""
    from matplotlib.ticker import FixedLocator

    axis.xaxis.set_major_locator(FixedLocator(sorted(set(cells["humans"])), nbins=12))


def _dodge(count: int, gap: float) -> Sequence[float]:
    """Return `count` horizontal offsets around 0."""
    gap = min(gap, 0.8 / count)
    return [gap * (i - (count - 1) / 2) for i in range(count)]


def _intervals(axis: Axes, x: Any, cell: DataFrame, look: PolicyLook) -> None:
    """Draw means, their intervals, and standard deviations as thinner bars."""
    mean, sd = (cell[column].to_numpy(dtype=float) for column in ("mean", "sd"))
    _bars(axis, x, mean - sd, mean + sd, look, THIN, zorder=2)
    _bars(axis, x, cell["low"], cell["high"], look, THICK, zorder=3)
    axis.plot(
        x, mean, linestyle="none", marker=look.marker, color=look.color, markersize=6, zorder=5, clip_on=False,
        markeredgecolor=axis.get_facecolor(), markeredgewidth=0.6,
    )  # fmt: skip


def _bars(axis: Axes, x: Any, low: Any, high: Any, look: PolicyLook, how: dict[str, Any], zorder: int = 2) -> None:
    """Draw vertical bars where both ends are known. One episode has no deviation, one pool no interval."""
    ends = np.stack([np.asarray(values, dtype=float) for values in (x, low, high)], axis=1)
    ends = ends[np.isfinite(ends).all(axis=1)]
    if len(ends):
        axis.vlines(*ends.T, color=look.color, **how, zorder=zorder)


def _from_nothing(axis: Axes, cells: DataFrame, *others: float) -> None:
    """Let a panel extend from 0 to above all means and deviations, even if intervals of few pools are longer."""
    tops = cells["mean"].to_numpy(dtype=float) + np.nan_to_num(cells["sd"].to_numpy(dtype=float))
    highest = max([*tops, *others], default=0.0)
    axis.set_ylim(0, min(axis.get_ylim()[1], 1.5 * highest) if highest > 0 else 1)


def _what_bars_mean(cells: DataFrame) -> list[Artist]:
    """Return the legend entries of what `_intervals` draws."""
    fewest, most = int(cells["n"].min()), int(cells["n"].max())
    runs = f"{most} runs" if fewest == most else f"{fewest} to {most} runs"
    what = {
        "high": entry("95 % interval of the mean", **THICK),
        "sd": entry(f"one standard deviation ({runs})", **THIN),
    }
    return [shown for column, shown in what.items() if np.isfinite(cells[column].to_numpy(dtype=float)).any()]
