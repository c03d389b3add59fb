"""The figure of policies that were compared under one condition or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .style import THICK, legend_below, looks, panels, sample, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS = {
    "actions": "actions per person",
    "interventions": "interventions per episode",
    "discounted_return": "return (cost units)",
}
"""The measures that are drawn, with the label of each panel."""


@styled
def comparison_figure(comparison: Any) -> Figure:
    """Return the figure of a `PolicyComparison`: a column for each measure, with the interval of each mean.

    Under one condition, a second row has the differences to the baseline in the same episodes, which are known more
    closely than the means. The horizontal axis is what varies: the keys of the pools if there are several, else the
    team size if there are several, else the policy. With several pools and several team sizes there is a row of panels
    for each team size.

    Parameters
    ----------
    comparison : PolicyComparison
        What `assist.studies.reports.compare` returns.
    """
    rows = list(comparison)
    sizes, keys = list(dict.fromkeys(row.humans for row in rows)), list(dict.fromkeys(row.varied for row in rows))
    lines = sizes if len(keys) > 1 else [None]
    paired = len(sizes) == len(keys) == 1 < len(rows)
    figure, axes = panels(len(lines) + paired, len(PANELS), height=2.4, margin=0.8)
    marks = looks(row.policy for row in rows)
    for line, size in enumerate(lines):
        shown = [row for row in rows if size is None or row.humans == size]
        for axis, (name, label) in zip(axes[line], PANELS.items(), strict=True):
            axis.set_ylabel(label)
            axis.grid(axis="y")
            _panel(axis, shown, name, marks, comparison.varied, several=len(sizes) > 1)
        if len(sizes) > 1 and size is not None:
            axes[line][0].set_title(f"{size} people", loc="left", fontweight="bold")
    for axis, (name, label) in zip(axes[-1] if paired else [], PANELS.items(), strict=False):
        axis.set_ylabel(f"{label.partition(' (')[0]},\nminus {comparison.baseline}")
        axis.axhline(0.0, color="0.5", linewidth=1.0)
        axis.grid(axis="y")
        _panel(axis, [row for row in rows if row.differences is not None], name, marks, "", several=False, paired=True)
    legend_below(figure, [sample(name, look) for name, look in marks.items()])
    return figure


def _panel(
    axis: Axes, rows: Sequence[Any], name: str, marks: Any, varied: str, *, several: bool, paired: bool = False
) -> None:
    """Draw one measure of all policies over what varies, or its difference to the baseline."""
    if varied and len({row.varied for row in rows}) > 1:
        places = [row.varied for row in rows]
        axis.set_xlabel(varied)
    elif several:
        places = [row.humans for row in rows]
        axis.set_xlabel("people in a team")
    else:
        places = [row.policy for row in rows]
    numeric = all(isinstance(place, int | float | np.number) for place in places)
    every = list(dict.fromkeys(places))
    at = {place: float(place) if numeric else float(number) for number, place in enumerate(every)}
    axis.set_xticks(list(at.values()), [f"{place:g}" if numeric else str(place) for place in every])
    width = min((b - a for a, b in zip(sorted(at.values()), sorted(at.values())[1:], strict=False)), default=1.0)
    single = places == [row.policy for row in rows]
    for number, (policy, look) in enumerate(marks.items()):
        own = [
            (at[place], (row.differences if paired else row.means)[name])
            for place, row in zip(places, rows, strict=True) if row.policy == policy
        ]  # fmt: skip
        if not own:
            continue
        shift = 0.0 if single else 0.06 * width * (number - (len(marks) - 1) / 2)
        x = np.array([place for place, _ in own]) + shift
        mean = np.array([estimate.value for _, estimate in own])
        ends = np.array([(estimate.low, estimate.high) for _, estimate in own])
        known = np.isfinite(ends).all(axis=1)
        axis.vlines(x[known], *ends[known].T, color=look.color, **THICK)
        axis.plot(x, mean, color=look.color, marker=look.marker, linestyle=look.line, linewidth=1.4, markersize=6)
    if single:
        axis.tick_params(axis="x", rotation=30)
        axis.margins(x=0.15)
