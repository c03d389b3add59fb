"""The figure of actions against interventions in a simulation study, for all policies and costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .labels import Note, note_points
from .panels_by_name import MEASURES, instances_of
from .style import THIN, PolicyLook, entry, grid, ink, legend_below, looks, sample, styled

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


@styled
def trade_off_figure(points: DataFrame, published: Mapping[str, float] | None = None, source: str = "") -> Figure:
    """Plot human actions against interventions, for all policies and costs.

    The axes are scaled to the points; much longer intervals are clipped.

    Parameters
    ----------
    points : DataFrame
        Columns `instance`, `policy`, `c_suggest`, `c_move`, and `actions` and `interventions` with `_low` and `_high`
        of each.
    published : mapping of str to float, optional
        Published savings in percent, by the names in `COMPARISONS`. Marks show these savings relative to the policies
        `none` and `reactive` here.
    source : str
        Name of their source.
    """
    from matplotlib import rc_context

    shown = looks(points["policy"])
    instances = instances_of(points)
    figure, axes = grid(len(instances), 2, height=4.2 if len(instances) == 1 else 3.5)
    notes: dict[Axes, list[Note]] = {axis: [] for axis in axes}
    for instance, axis in zip(instances, axes, strict=True):
        here = points[points["instance"] == instance]
        for policy, look in shown.items():
            own = here[here["policy"] == policy].sort_values(["c_move", "c_suggest"])
            if len(own):
                notes[axis] += _curve(axis, look, own)
        stars = _published_points(here, published or {})
        for star in stars:
            axis.plot(star.x, star.y, marker="*", markersize=10, color=star.color, zorder=6)
        notes[axis] += stars
        axis.set_title(instance, loc="left", fontweight="bold")
        axis.set(xlabel=MEASURES["interventions"], ylabel=MEASURES["actions"])
        axis.set_xlim(_around([*here["interventions"], *(star.x for star in stars)]))
        axis.set_ylim(_around([*here["actions"], *(star.y for star in stars)]))
        axis.grid()
    entries: list[Artist] = [sample(name, look) for name, look in shown.items()]
    if any("against" in note.text for own in notes.values() for note in own):
        entries.append(entry(f"savings of {source}, relative to the baselines here", marker="*", markersize=9))
    if np.isfinite(points["actions_high"].to_numpy(dtype=float)).any():
        entries.append(entry("95 % intervals of the mean", **THIN))
    with rc_context({"text.parse_math": True}):  # a text as a marker is a formula
        entries.append(entry("cost of suggesting, of moving", marker="$0,0$", markersize=14, markeredgewidth=0))
    legend_below(figure, entries)
    note_points(figure, notes)
    return figure


def _around(values: Sequence[float]) -> tuple[float, float]:
    """Return the limits of an axis around counts, which are never negative."""
    low, high = min(values), max(values)
    margin = 0.12 * (high - low) or 0.1 * high or 1.0
    return max(low - margin, -0.04 * (high + margin)), high + margin


def _curve(axis: Axes, look: PolicyLook, own: DataFrame) -> list[Note]:
    """Plot one policy's points, with a line for each cost of moving; return notes with the costs of some points."""
    x, y = own["interventions"].to_numpy(), own["actions"].to_numpy()
    indifferent = len({*zip(x, y, strict=True)}) == 1  # costs do not change the policy's actions
    axis.hlines(y, own["interventions_low"], own["interventions_high"], color=look.color, **THIN)
    axis.vlines(x, own["actions_low"], own["actions_high"], color=look.color, **THIN)
    # If both costs vary together, no cost of moving has a line of its own.
    together = own["c_move"].is_unique or own["c_move"].nunique() == 1
    for line in [own] if together else [part for _, part in own.groupby("c_move")]:
        axis.plot(
            line["interventions"], line["actions"], color=look.color, linestyle=look.line, linewidth=1.4,
            marker=look.marker, markeredgecolor=axis.get_facecolor(), markeredgewidth=0.6,
            # A policy that hardly ever helps coincides with 'none', which stays visible behind it.
            markersize=11 if indifferent else 6, zorder=3 if indifferent else 4,
        )  # fmt: skip
    if indifferent:
        return []
    return [
        Note(f"{own['c_suggest'].iloc[i]:g}, {own['c_move'].iloc[i]:g}", x[i], y[i], look.color)
        for i in (range(len(own)) if len(own) <= 6 else (0, len(own) // 2, len(own) - 1))
    ]


def _published_points(points: DataFrame, published: Mapping[str, float]) -> list[Note]:
    """Return notes where published savings lead from the baselines here, as far as both are known."""
    base = {
        policy: points[points["policy"] == policy][["actions", "interventions"]].mean()
        for policy in ("none", "reactive") if (points["policy"] == policy).any()
    }  # fmt: skip
    fewer = published.get("interventions against reactive")
    if fewer is None or "reactive" not in base:  # undefined without interventions of the baseline
        return []
    x = (1 - fewer / 100) * base["reactive"]["interventions"]
    return [
        Note(f"against {policy}", float(x), float((1 - published[name] / 100) * mean["actions"]), ink())
        for policy, mean in base.items() if (name := f"actions against {policy}") in published
    ]  # fmt: skip
