"""Pictures of a study: policies, team sizes, kinds of people, costs. Needs the extra `plots`.

Policies differ by colour, marker and line at once, and most lines have their names beside them. Text and axes have
the colours of matplotlib's settings, so that `save` can draw every picture for dark pages as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec
from zlib import crc32

import numpy as np

from planner.storage import atomic

from ..people.human import Floats
from ..simulation.episodes import Episode
from .episode import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, require

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

P = ParamSpec("P")
Note = tuple[str, float, float]
"""Words, and the point that they belong to."""
End = tuple[str, str, float, float]
"""The name and colour of a curve, and where it ends."""

WIDTH = 9.0  # inches
MOST_COSTS = 6  # that are all written beside a policy's points
MEASURES = {"actions": "human actions per person", "interventions": "robot interventions per episode"}
CATEGORIES = (
    "low expertise, low influence",
    "high expertise, low influence",
    "low expertise, high influence",
    "high expertise, high influence",
)

PAPER_SAVINGS = {
    "actions against none": 24.48, "actions against reactive": 12.35, "interventions against reactive": 25.94,
}  # fmt: skip
"""What attention switching saves according to the paper's text, in percent, over all team sizes."""
PAPER_INTERVENTIONS = ((CATEGORIES[:2], 3.86), (CATEGORIES[2:3], 31.685))
"""How many interventions people of some categories got under attention switching, according to the paper's text."""

SETTINGS: dict[Any, Any] = {
    "font.size": 9, "axes.titlesize": 9, "axes.labelsize": 9, "legend.fontsize": 8.5, "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5, "figure.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
    "grid.alpha": 0.3, "legend.frameon": False,
}  # fmt: skip
THICK: dict[str, Any] = {"linewidth": 3, "alpha": 0.75}
THIN: dict[str, Any] = {"linewidth": 0.9, "alpha": 0.6}
DARK = {
    "figure.facecolor": "#16191d", "axes.facecolor": "#16191d", "savefig.facecolor": "auto", "grid.color": "#8a9099",
}  # fmt: skip


@dataclass(frozen=True)
class Look:
    """What a policy looks like in every picture."""

    color: str
    marker: str
    line: Any = "-"


LOOKS = {
    "none": Look(GREY, "s", (0, (1, 1.2))),
    "reactive": Look(ORANGE, "^", (0, (5, 1.5))),
    "attention": Look(BLUE, "o"),
    "attention-never": Look(SKY, "D", (0, (5, 1.5, 1, 1.5))),
    "priority": Look(GREEN, "P"),
}
COMPARISONS = dict(
    zip(
        PAPER_SAVINGS,
        (Look(BLUE, "o"), Look(SKY, "^", (0, (5, 1.5))), Look(VERMILLION, "D", (0, (5, 1.5, 1, 1.5)))),
        strict=True,
    )
)
OTHERS = ((VERMILLION, "v"), (PURPLE, "X"), ("#999933", "<"), ("#A0522D", "p"))
OTHER_LINES = ((0, (3, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))


def looks(policies: Iterable[str]) -> dict[str, Look]:
    """Give each policy its look, in the order in which they are drawn.

    A name that is not known has the look that follows from it, or the next one where another such name of
    the picture has that. They have different colours while there are colours.
    """
    names = set(policies)
    found = {name: look for name, look in LOOKS.items() if name in names}
    for name in sorted(names - set(LOOKS)):
        first = crc32(name.encode())
        taken = set(found.values())
        wheel = (Look(*OTHERS[(first + i) % len(OTHERS)], line) for line in OTHER_LINES for i in range(len(OTHERS)))
        free = (look for look in wheel if look not in taken)
        found[name] = next(free, Look(*OTHERS[first % len(OTHERS)]))
    return found


def _drawn(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw with the settings of all these pictures."""

    @wraps(draw)
    def with_settings(*args: P.args, **kwargs: P.kwargs) -> Figure:
        require()
        from matplotlib import rc_context

        with rc_context(SETTINGS):
            return draw(*args, **kwargs)

    return with_settings


@_drawn
def team_size_figure(cells: DataFrame) -> Figure:
    """Draw actions and interventions against the number of people, as in the paper's first figure.

    Parameters
    ----------
    cells : DataFrame
        With the columns `instance`, `policy`, `humans`, `measure` (see `MEASURES`), `mean`, `sd`, `low`, `high`, `n`.
    """
    from matplotlib.ticker import MaxNLocator

    shown = looks(cells["policy"])
    figure, rows = _panels(_names(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.13)
    ends: dict[Axes, list[End]] = {axis: [] for row in rows for axis in row.values()}
    for instance, row in zip(_names(cells), rows, strict=True):
        for measure, axis in row.items():
            own = cells[(cells["instance"] == instance) & (cells["measure"] == measure)]
            for (policy, look), shift in zip(shown.items(), apart, strict=True):
                cell = own[own["policy"] == policy].sort_values("humans")
                if len(cell):
                    x = cell["humans"].to_numpy() + shift
                    _intervals(axis, x, cell, look)
                    axis.plot(x, cell["mean"], color=look.color, linestyle=look.line, linewidth=1.4, zorder=4)
                    ends[axis].append((policy, look.color, x[-1], cell["mean"].iloc[-1]))
            axis.set_ylim(bottom=0)
            axis.set_ylabel(MEASURES[measure])
            axis.grid(axis="y")
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    _last(rows, "people in the team, K")
    _key(figure, _what_bars_mean(cells))
    _label(figure, ends)
    return figure


@_drawn
def category_figure(cells: DataFrame, paper: Sequence[tuple[Sequence[str], float]] = PAPER_INTERVENTIONS) -> Figure:
    """Draw actions and interventions for kinds of people, as in the paper's second figure.

    Parameters
    ----------
    cells : DataFrame
        With the columns `instance`, `policy`, `category` (see `CATEGORIES`), `measure` (see `MEASURES`), `mean`,
        `sd`, `low`, `high`, `n`.
    paper : sequence of (categories, interventions)
        What is marked for comparison.
    """
    shown = looks(cells["policy"])
    figure, rows = _panels(_names(cells), list(MEASURES), height=2.7)
    apart = _dodge(len(shown), 0.16)
    for instance, row in zip(_names(cells), rows, strict=True):
        for measure, axis in row.items():
            own = cells[(cells["instance"] == instance) & (cells["measure"] == measure)]
            for (policy, look), shift in zip(shown.items(), apart, strict=True):
                cell = own[own["policy"] == policy]
                x = cell["category"].map(CATEGORIES.index).to_numpy() + shift
                _intervals(axis, x, cell, look)
            if measure == "interventions":
                for categories, value in paper:
                    at = [CATEGORIES.index(category) for category in categories]
                    ends = (at[0] - 0.42, at[-1] + 0.42)
                    axis.plot(ends, (value, value), color=_ink(), linestyle="--", linewidth=1.1, zorder=1)
            for boundary in range(1, len(CATEGORIES)):
                axis.axvline(boundary - 0.5, color=_ink(), alpha=0.15, linewidth=0.8)
            axis.set_xlim(-0.5, len(CATEGORIES) - 0.5)
            axis.margins(y=0.1)
            axis.set_ylim(bottom=0)
            axis.set_xticks(range(len(CATEGORIES)), [category.replace(", ", ",\n") for category in CATEGORIES])
            axis.tick_params(axis="x", length=0, labelsize=8)
            axis.set_ylabel(MEASURES[measure])
            axis.grid(axis="y")
    entries: list[Artist] = [_sample(name, look, line=False) for name, look in shown.items()]
    if paper:
        values = "attention in the paper: " + ", ".join(f"{value:g}" for _, value in paper)
        entries.append(_entry(values, linestyle="--", linewidth=1.1))
    _key(figure, [*entries, *_what_bars_mean(cells)])
    return figure


@_drawn
def trade_off_figure(points: DataFrame, paper: Mapping[str, float] | None = None) -> Figure:
    """Draw human actions against interventions, for all policies and costs.

    Parameters
    ----------
    points : DataFrame
        With the columns `instance`, `policy`, `c_suggest`, `c_move`, and `actions` and `interventions` with
        `_low` and `_high` of each.
    paper : mapping of str to float, optional
        `PAPER_SAVINGS`, or others by the same names. Percent of what the policies `none` and `reactive` need here
        is where the savings would lead to.
    """
    shown = looks(points["policy"])
    instances = _names(points)
    figure, axes = _grid(len(instances), 1 if len(instances) == 1 else 2, height=4.2 if len(instances) == 1 else 3.5)
    notes: dict[Axes, list[Note]] = {axis: [] for axis in axes}
    for instance, axis in zip(instances, axes, strict=True):
        here = points[points["instance"] == instance]
        for policy, look in shown.items():
            own = here[here["policy"] == policy].sort_values(["c_move", "c_suggest"])
            if len(own):
                notes[axis] += _curve(axis, look, own)
        if paper:
            notes[axis] += _paper_point(axis, here, paper)
        axis.set_title(instance, loc="left", fontweight="bold")
        axis.set(xlabel=MEASURES["interventions"], ylabel=MEASURES["actions"])
        axis.margins(0.1)
        axis.grid()
    entries: list[Artist] = [_sample(name, look) for name, look in shown.items()]
    if paper:
        entries.append(_entry("the paper's savings, from the baselines here", marker="*", markersize=9))
    entries += [
        _entry("95 % intervals of the mean", **THIN),
        _entry("cost of suggesting, of moving", marker="$0,0$", markersize=14, markeredgewidth=0),
    ]
    _key(figure, entries)
    _note(figure, notes)
    return figure


@_drawn
def belief_figure(beliefs: DataFrame, episode: Episode) -> Figure:
    """Draw what the robot believes about each person in the course of an episode, and what is true.

    Parameters
    ----------
    beliefs, episode
        As `watching.beliefs_of_episode` gives them; `beliefs` as a DataFrame.
    """
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    places = sorted(set(beliefs["place"]))
    hidden = {"beta": "expertise β", "theta": "influence θ"}
    figure, rows = _panels([episode.people[place] for place in places], list(hidden), height=1.6, sharey="col")
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
            axis.plot(own["step"], own[f"{name}_true"], color=_ink(), linestyle="--", linewidth=1.2)
            top = 1.0 if name == "theta" else float(np.nanmax(beliefs[["beta_high", "beta_true"]].to_numpy()))
            told = own["step"][own["suggestion"]]
            # Below all values, where they hide nothing.
            axis.plot(told, np.full(len(told), -0.1 * top), linestyle="none", marker="^", markersize=5, color=GREEN)
            axis.set_ylim(-0.2 * top, 1.06 * top)
            axis.set_ylabel(hidden[name])
            ticks = [0, 0.5, 1] if name == "theta" else MaxNLocator(nbins=4, steps=[1, 2, 5, 10]).tick_values(0, top)
            axis.set_yticks([tick for tick in ticks if 0 <= tick <= 1.06 * top])
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
            axis.grid(axis="y")
    _last(rows, "step")
    figure.suptitle(f"Episode {episode.episode} under the policy '{episode.policy}'")
    entries = [
        _entry("believed, mean", color=BLUE, linewidth=1.8),
        Patch(color=BLUE, alpha=0.3, label="believed, 5 % to 95 %"),
        _entry("true", linestyle="--", linewidth=1.2),
        Patch(color=ORANGE, alpha=0.22, label="the robot is here"),
        _entry("suggestion", color=GREEN, marker="^", markersize=5),
    ]
    _key(figure, entries)
    return figure


@_drawn
def benefit_figure(cells: DataFrame, paper: Mapping[str, float] = PAPER_SAVINGS) -> Figure:
    """Draw what a policy saves against the number of people.

    Parameters
    ----------
    cells : DataFrame
        With the columns `instance`, `humans`, `comparison` (`COMPARISONS`, or any), `mean`, `low`, `high`, the last
        three in percent.
    paper : mapping of str to float
        Savings over all team sizes, by comparison, that are marked beside.
    """
    from matplotlib.ticker import MaxNLocator

    names = set(cells["comparison"])
    shown = {name: look for name, look in COMPARISONS.items() if name in names} | looks(names - set(COMPARISONS))
    instances = _names(cells)
    figure, axes = _grid(len(instances), 1 if len(instances) == 1 else 2, height=3.2)
    ends: dict[Axes, list[End]] = {axis: [] for axis in axes}
    for instance, axis in zip(instances, axes, strict=True):
        first = cells["humans"].min() - 0.6
        for (comparison, look), shift in zip(shown.items(), _dodge(len(shown), 0.08), strict=True):
            own = cells[(cells["instance"] == instance) & (cells["comparison"] == comparison)]
            own = own.dropna(subset=["mean"]).sort_values("humans")  # of nothing no share can be saved
            if len(own):
                x = own["humans"].to_numpy() + shift
                axis.plot(x, own["mean"], color=look.color, linestyle=look.line, linewidth=1.4)
                axis.vlines(x, own["low"], own["high"], color=look.color, **THICK)
                axis.plot(
                    x, own["mean"], linestyle="none", marker=look.marker, color=look.color, markersize=6, zorder=5
                )
                label = comparison.replace(" against ", "\nagainst ")
                ends[axis].append((label, look.color, x[-1], own["mean"].iloc[-1]))
                if comparison in paper:
                    axis.plot(first, paper[comparison], marker="*", markersize=9, color=look.color)
        axis.axhline(0, color=_ink(), linewidth=0.8)
        axis.set_title(instance, loc="left", fontweight="bold")
        axis.set(xlabel="people in the team, K", ylabel="saving, %")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.grid(axis="y")
    entries = [_entry("95 % interval", **THICK)]
    if names & set(paper):
        entries.append(_entry("attention in the paper, over all team sizes", marker="*", markersize=9))
    _key(figure, entries)
    _label(figure, ends, lines=2)
    return figure


def save(figure_of: Callable[[], Figure], folder: Path, name: str) -> list[Path]:
    """Draw a figure twice, for light and for dark pages, and write each as PNG and SVG; return the files.

    The same figure always gives the same files.

    Parameters
    ----------
    figure_of : callable
        Draws it. It is called once for each background.
    folder : Path
    name : str
        The files are `name.png`, `name.svg`, `name-dark.png` and `name-dark.svg`.
    """
    require()
    from matplotlib import rc_context, style

    files = []
    backgrounds: dict[str, list[str | Path | dict[str, Any]]] = {
        "": ["default"], "-dark": ["default", "dark_background", DARK],
    }  # fmt: skip
    for suffix, background in backgrounds.items():
        with style.context(background), rc_context({"svg.hashsalt": name}):
            figure = figure_of()
            for ending, metadata in ((".png", {}), (".svg", {"Date": None})):
                files.append(folder / f"{name}{suffix}{ending}")
                with atomic(files[-1]) as path:
                    figure.savefig(path, dpi=150, metadata=metadata)
                figure.set_layout_engine("none")  # laid out once; that takes a third of the time
    return files


def _ink() -> str:
    """The colour of text on the present background."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def _names(cells: DataFrame) -> list[str]:
    """Give the instances in the order in which they come."""
    return list(dict.fromkeys(cells["instance"]))


def _panels(
    rows: Sequence[str], columns: Sequence[str], *, height: float, sharey: Any = False
) -> tuple[Figure, list[dict[str, Axes]]]:
    """Make panels for each row, whose name is above the first of them, and column."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 0.6 + height * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), len(columns), sharex="col", sharey=sharey, squeeze=False)
    for name, axis in zip(rows, axes[:, 0], strict=True):
        axis.set_title(name, loc="left", fontweight="bold")
    return figure, [dict(zip(columns, row, strict=True)) for row in axes]


def _grid(panels: int, columns: int, *, height: float) -> tuple[Figure, list[Axes]]:
    """Make so many panels, in rows."""
    from matplotlib.figure import Figure

    rows = -(-panels // columns)
    figure = Figure(figsize=(WIDTH, 0.6 + height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[panels:]:
        axis.set_visible(False)
    return figure, list(axes[:panels])


def _last(rows: Sequence[Mapping[str, Axes]], label: str) -> None:
    """Name the axis that all rows share."""
    for axis in rows[-1].values():
        axis.set_xlabel(label)


def _dodge(count: int, gap: float) -> Sequence[float]:
    """Give where to put so many things beside each other, around 0."""
    gap = min(gap, 0.8 / count)
    return [gap * (i - (count - 1) / 2) for i in range(count)]


def _intervals(axis: Axes, x: Any, cell: DataFrame, look: Look) -> None:
    """Draw means, their intervals, and standard deviations as thinner bars."""
    mean, sd = cell["mean"].to_numpy(), cell["sd"].to_numpy()
    axis.vlines(x, mean - sd, mean + sd, color=look.color, **THIN, zorder=2)
    axis.vlines(x, cell["low"], cell["high"], color=look.color, **THICK, zorder=3)
    axis.plot(
        x, mean, linestyle="none", marker=look.marker, color=look.color, markersize=6, zorder=5, clip_on=False,
        markeredgecolor=axis.get_facecolor(), markeredgewidth=0.6,
    )  # fmt: skip


def _what_bars_mean(cells: DataFrame) -> list[Artist]:
    """Give the entries of a legend for what `_intervals` draws."""
    fewest, most = int(cells["n"].min()), int(cells["n"].max())
    runs = f"{most} runs" if fewest == most else f"{fewest} to {most} runs"
    return [_entry("95 % interval of the mean", **THICK), _entry(f"one standard deviation ({runs})", **THIN)]


def _sample(name: str, look: Look, *, line: bool = True) -> Artist:
    """Give a policy's entry in a legend."""
    return _entry(
        name, color=look.color, marker=look.marker, linestyle=look.line if line else "none", markersize=6, linewidth=1.4
    )


def _entry(label: str, **how: Any) -> Artist:
    """Give an entry in a legend: a line, or a marker without one unless asked for."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": _ink(), "linestyle": "none" if "marker" in how else "-", **how}, label=label)


def _key(figure: Figure, entries: Sequence[Artist]) -> None:
    """Put the legend below all panels, in as few rows as there is width for."""
    figure.align_ylabels()
    for columns in range(len(entries), 0, -1):
        legend = figure.legend(handles=entries, loc="outside lower center", ncols=columns)
        if columns == 1 or legend.get_window_extent().width < figure.bbox.width:
            break
        legend.remove()


def _note(figure: Figure, notes: Mapping[Axes, Sequence[Note]]) -> None:
    """Write beside points, wherever around them the fewest lines and other words are."""
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    figure.draw_without_rendering()  # only a layout says what is near to what
    pixels = figure.dpi / 72
    places = [(right, up) for right, up in product((1, 0, -1), (1, 0, -1)) if right or up]
    for axis, texts in notes.items():
        drawn = [line.get_xydata() for line in axis.get_lines()]
        drawn += [part for bars in axis.collections if isinstance(bars, LineCollection) for part in bars.get_segments()]
        # An interval of a single pool has no ends.
        drawn = [points for points in drawn if np.ndim(points) == 2 and np.isfinite(points).all()]
        lines = [axis.transData.transform(points) for points in drawn]
        # Points of all lines, close to each other.
        ink = np.concatenate([np.linspace(start, end, 60) for line in lines for start, end in pairwise(line)] + lines)
        written: list[tuple[Floats, Floats]] = []
        for text, x, y in texts:
            size, at = np.array([4.8 * len(text), 8]) * pixels, axis.transData.transform((x, y))
            middles = [at + np.array(place) * (size / 2 + 6 * pixels) for place in places]
            hidden = [
                (np.abs(ink - middle) < size / 2).all(axis=1).sum()
                + len(ink) * sum((np.abs(other - middle) < (size + its) / 2 + pixels).all() for other, its in written)
                for middle in middles
            ]
            best = int(np.argmin(hidden))
            written.append((middles[best], size))
            right, up = places[best]
            axis.annotate(
                text, (x, y), xytext=(6 * right, 6 * up), textcoords="offset points", fontsize=8, zorder=7,
                ha=("center", "left", "right")[right], va=("center", "bottom", "top")[up],
                path_effects=[withStroke(linewidth=2.5, foreground=axis.get_facecolor())],
            )  # fmt: skip


def _label(figure: Figure, ends: Mapping[Axes, Sequence[End]], lines: int = 1) -> None:
    """Put names, of so many lines each, beside the ends of curves, moved apart as far as they need and tied to them."""
    from scipy.optimize import isotonic_regression

    figure.draw_without_rendering()  # only a layout says how high the panels are
    for axis, own in ends.items():
        if not own:
            continue
        low, high = axis.get_ylim()
        gap = 10.5 * lines * (high - low) / (axis.get_window_extent().height * 72 / figure.dpi)
        order = sorted(own, key=lambda end: end[3])
        steps = gap * np.arange(len(order))
        # Ascending by `gap` at least, and otherwise as near to the ends as least squares can be.
        heights = isotonic_regression(np.array([end[3] for end in order]) - steps).x + steps
        axis.set_ylim(low, high)
        for (name, color, x, y), height in zip(order, heights, strict=True):
            axis.annotate(
                name, (x, y), xytext=(1.03, height), textcoords=axis.get_yaxis_transform(), va="center", fontsize=8.5,
                linespacing=0.95, annotation_clip=False,
                arrowprops={
                    "arrowstyle": "-", "color": color, "linewidth": 0.9, "shrinkA": 1, "shrinkB": 4, "relpos": (0, 0.5),
                },
            )  # fmt: skip


def _curve(axis: Axes, look: Look, own: DataFrame) -> list[Note]:
    """Draw one policy's points, a line for each cost of moving; give some of the costs, as `_note` takes them."""
    x, y = own["interventions"].to_numpy(), own["actions"].to_numpy()
    indifferent = len({*zip(x, y, strict=True)}) == 1  # costs do not change what the policy does
    axis.hlines(y, own["interventions_low"], own["interventions_high"], color=look.color, **THIN)
    axis.vlines(x, own["actions_low"], own["actions_high"], color=look.color, **THIN)
    # Where both costs grow together no cost of moving has a line of its own.
    together = own["c_move"].is_unique or own["c_move"].nunique() == 1
    for line in [own] if together else [part for _, part in own.groupby("c_move")]:
        axis.plot(
            line["interventions"], line["actions"], color=look.color, linestyle=look.line, linewidth=1.4,
            marker=look.marker, markeredgecolor=axis.get_facecolor(), markeredgewidth=0.6,
            # A policy that hardly ever helps comes to lie upon 'none', which is to show behind it.
            markersize=11 if indifferent else 6, zorder=3 if indifferent else 4,
        )  # fmt: skip
    if indifferent:
        return []
    return [
        (f"{own['c_suggest'].iloc[i]:g}, {own['c_move'].iloc[i]:g}", x[i], y[i])
        for i in (range(len(own)) if len(own) <= MOST_COSTS else (0, len(own) // 2, len(own) - 1))
    ]


def _paper_point(axis: Axes, points: DataFrame, paper: Mapping[str, float]) -> list[Note]:
    """Mark where the paper's savings would lead to from the baselines here; give what to write there."""
    notes: list[Note] = []
    base = {
        policy: points[points["policy"] == policy][["actions", "interventions"]].mean()
        for policy in ("none", "reactive")
    }
    if not (points["policy"] == "reactive").any():  # from nothing no intervention can be saved
        return notes
    x = (1 - paper["interventions against reactive"] / 100) * base["reactive"]["interventions"]
    for policy in ("none", "reactive"):
        if (points["policy"] == policy).any():
            y = (1 - paper[f"actions against {policy}"] / 100) * base[policy]["actions"]
            axis.plot(x, y, marker="*", markersize=10, color=_ink(), zorder=6)
            notes.append((f"against {policy}", float(x), float(y)))
    return notes
