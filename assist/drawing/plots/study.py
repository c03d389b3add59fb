"""Figures of a simulation study: team sizes, savings, kinds of people, costs and beliefs. Needs the extra `plots`.

Each function takes a data frame with a row for each mark. Published values for comparison are arguments; no function
contains any.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...team.episode import Episode
from .labels import Note, name_curves, note_points
from .style import (
    BLUE,
    GREEN,
    ORANGE,
    SKY,
    THICK,
    THIN,
    VERMILLION,
    PolicyLook,
    entry,
    ink,
    legend_below,
    looks,
    panels,
    robot_entry,
    sample,
    styled,
    whole_numbers,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

MEASURES = {"actions": "human actions per person", "interventions": "robot interventions per episode"}
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
    figure, rows = _named_rows(_names(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.13)
    ends: dict[Axes, list[Note]] = {axis: [] for row in rows for axis in row.values()}
    for instance, row in zip(_names(cells), rows, strict=True):
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
            whole_numbers(axis.xaxis)
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
    figure, rows = _named_rows(_names(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.16)
    upright = len(categories) >= 6  # fewer labels fit horizontally
    ticks = [textwrap.fill(name, 24 if upright else max(8, 64 // len(categories))) for name in categories]
    for instance, row in zip(_names(cells), rows, strict=True):
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
    instances = _names(points)
    figure, axes = _grid(len(instances), height=4.2 if len(instances) == 1 else 3.5)
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
    instances = _names(cells)
    figure, axes = _grid(len(instances), height=3.2)
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
        whole_numbers(axis.xaxis)
        axis.grid(axis="y")
    entries = [entry("95 % interval", **THICK)]
    if marked:
        entries.append(entry(f"{source}, over all team sizes", marker="*", markersize=9))
    legend_below(figure, entries)
    name_curves(figure, ends)
    return figure


@styled
def belief_figure(beliefs: DataFrame, episode: Episode) -> Figure:
    """Plot the robot's belief about each person over the course of an episode, and the true values.

    Parameters
    ----------
    beliefs, episode
        Results of `beliefs_of_episode`; `beliefs` as a DataFrame.
    """
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    places = sorted(set(beliefs["place"]))
    hidden = {"beta": "expertise β", "theta": "influence θ"}
    people = [episode.people[place] for place in places]
    figure, rows = _named_rows(people, list(hidden), height=1.6, sharey="col")
    for place, row in zip(places, rows, strict=True):
        own = beliefs[beliefs["place"] == place].sort_values("step")
        for name, axis in row.items():
            for step in own["step"][own["robot_here"]]:
                axis.axvspan(step - 0.5, step + 0.5, color=ORANGE, alpha=0.22, linewidth=0)
            known = own.dropna(subset=[f"{name}_mean"])
            axis.fill_between(
                known["step"], known[f"{name}_low"], known[f"{name}_high"], color=BLUE, alpha=0.3, linewidth=0,
                step="mid",
            )  # fmt: skip
            axis.plot(known["step"], known[f"{name}_mean"], color=BLUE, linewidth=1.8)
            axis.plot(own["step"], own[f"{name}_true"], color=ink(), linestyle="--", linewidth=1.2)
            top = 1.0 if name == "theta" else float(np.nanmax(beliefs[["beta_high", "beta_true"]].to_numpy()))
            told = own["step"][own["suggestion"]]
            # Below all values, where marks hide nothing.
            axis.plot(told, np.full(len(told), -0.1 * top), linestyle="none", marker="^", markersize=5, color=GREEN)
            axis.set_ylim(-0.2 * top, 1.06 * top)
            axis.set_ylabel(hidden[name])
            ticks = [0, 0.5, 1] if name == "theta" else MaxNLocator(nbins=4, steps=[1, 2, 5, 10]).tick_values(0, top)
            axis.set_yticks([tick for tick in ticks if 0 <= tick <= 1.06 * top])
            whole_numbers(axis.xaxis)
            axis.grid(axis="y")
    for axis in rows[-1].values():
        axis.set_xlabel("step")
    figure.suptitle(textwrap.fill(f"Episode {episode.episode} under the policy '{episode.policy}'", 100))
    entries = [
        entry("posterior mean", color=BLUE, linewidth=1.8),
        Patch(color=BLUE, alpha=0.3, label="posterior, 5 % to 95 %"),
        entry("true", linestyle="--", linewidth=1.2),
        robot_entry(),
        entry("suggestion", color=GREEN, marker="^", markersize=5),
    ]
    legend_below(figure, entries)
    return figure


def _names(cells: DataFrame) -> list[str]:
    """Return the instances in order of appearance."""
    return list(dict.fromkeys(cells["instance"]))


def _named_rows(
    rows: Sequence[str], columns: Sequence[str], *, height: float, sharey: Any = False
) -> tuple[Figure, list[dict[str, Axes]]]:
    """Return a figure with panels for each row and column, with the name of each row above its first panel."""
    figure, axes = panels(len(rows), len(columns), height=height, sharex="col", sharey=sharey)
    for name, axis in zip(rows, axes[:, 0], strict=True):
        axis.set_title(name, loc="left", fontweight="bold")
    return figure, [dict(zip(columns, row, strict=True)) for row in axes]


def _grid(count: int, *, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with the given number of panels: one, or two in each row."""
    columns = min(count, 2)
    figure, axes = panels(-(-count // columns), columns, height=height, shown=count)
    return figure, list(axes.ravel()[:count])


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


def _around(values: Sequence[float]) -> tuple[float, float]:
    """Return the limits of an axis around counts, which are never negative."""
    low, high = min(values), max(values)
    margin = 0.12 * (high - low) or 0.1 * high or 1.0
    return max(low - margin, -0.04 * (high + margin)), high + margin


def _what_bars_mean(cells: DataFrame) -> list[Artist]:
    """Return the legend entries of what `_intervals` draws."""
    fewest, most = int(cells["n"].min()), int(cells["n"].max())
    runs = f"{most} runs" if fewest == most else f"{fewest} to {most} runs"
    what = {
        "high": entry("95 % interval of the mean", **THICK),
        "sd": entry(f"one standard deviation ({runs})", **THIN),
    }
    return [shown for column, shown in what.items() if np.isfinite(cells[column].to_numpy(dtype=float)).any()]


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
