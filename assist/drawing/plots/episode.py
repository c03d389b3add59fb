"""The figure of one episode: each person's progress to the goal, and the robot's actions. Needs the extra `plots`."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ...team.episodes import Episode
from ...team.trace import Link, Trace
from .style import (
    BLUE,
    GREEN,
    GREY,
    VERMILLION,
    entry,
    is_followed,
    panels,
    robot_bands,
    robot_entry,
    styled,
    whole_numbers,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def episode_figure(episode: Episode, trace: Trace, alone: Trace | None = None, links: Sequence[Link] = ()) -> Figure:
    """Plot one episode: each person's cost-to-go over time, the suggestions, and where the robot was.

    Parameters
    ----------
    episode : Episode
        The episode's people and totals.
    trace : list of dict
        The episode's actions, as `simulate` traces them.
    alone : list of dict, optional
        The actions of the same episode without a robot, plotted for comparison.
    links : sequence of Link
        Lines between stations: from each suggestion to those who saw it.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    places = sorted({row["place"] for row in trace})
    steps = max(row["step"] for row in trace) + 1
    alone_steps = max((row["step"] for row in alone or []), default=0) + 1
    shown = max(steps, min(alone_steps, 2 * steps))  # a person in a trap would squeeze the rest
    highest = max(row["cost_to_go"] or 0 for row in [*trace, *(r for r in alone or [] if r["step"] < shown)])
    executed = sum(episode.executed)
    title = textwrap.fill(
        f"Episode {episode.episode} under the policy '{episode.policy}': {sum(episode.actions)} human actions, "
        f"suggestions: {episode.interventions - executed}, "
        + (f"executed by the robot: {executed}, " if executed else "")
        + f"moves: {episode.moves}",
        100,
    )
    above = 0.55 + 0.2 * (title.count("\n") + 1)  # inches
    height = above + 1.15 + 1.9 * len(places)  # inches; 1.9 for each panel
    figure, stations = panels(len(places), height=1.9, margin=above + 1.15, layout=None, sharex=True)
    axes = stations[:, 0]
    figure.subplots_adjust(left=0.08, right=0.78, top=1 - above / height, bottom=1.15 / height, hspace=0.35)
    figure.suptitle(title, fontsize=11, y=1 - 0.2 / height, va="top")
    for place, axis in zip(places, axes, strict=True):
        own, without = ([row for row in rows or [] if row["place"] == place] for rows in (trace, alone))
        _panel(axis, place, own, [row for row in without if row["step"] < shown])
        axis.set_title(_short(episode.people[place]), loc="left", fontsize=10, fontweight="bold")
        _about(axis, episode, place, own, without)
        axis.set_ylim(0, highest * 1.12)
        axis.set_xlim(0, shown * 1.02)
        whole_numbers(axis.yaxis, nbins=4)
        whole_numbers(axis.xaxis)
        axis.grid(axis="y")
    _links(figure, dict(zip(places, axes, strict=True)), trace, links)
    axes[len(axes) // 2].set_ylabel("cost-to-go")
    axes[-1].set_xlabel("step (in each, every person acts once)")
    figure.legend(handles=_entries(bool(alone), bool(links)), loc="lower center", ncols=3)
    return figure


def _panel(axis: Axes, place: int, rows: Trace, alone: Trace) -> None:
    """Plot one person's cost-to-go with the robot and without it, the suggestions, and when the robot was there."""
    robot_bands([axis], rows, place, start=0.0)
    _line(axis, alone, GREY, "--", 1.3)
    _line(axis, rows, BLUE, "-", 2.0)
    for followed in (True, False):
        told = [row for row in rows if row["suggestion"] and is_followed(row) == followed]
        axis.plot(
            [row["step"] + 0.5 for row in told],
            [row["cost_to_go"] or 0 for row in told],
            linestyle="none", marker="v", markersize=8, zorder=5, clip_on=False,
            color=GREEN, markerfacecolor=GREEN if followed else "white",
        )  # fmt: skip
    if rows[-1]["cost_to_go_after"] == 0:
        axis.plot([rows[-1]["step"] + 1], [0], marker="o", markersize=7, color=BLUE, zorder=6, clip_on=False)


def _links(figure: Figure, axes: dict[int, Axes], trace: Trace, links: Sequence[Link]) -> None:
    """Draw lines between stations; the weight of each is its opacity."""
    from matplotlib.patches import ConnectionPatch

    height = {(row["place"], row["step"]): row["cost_to_go"] or 0 for row in trace}
    for one in links:
        here, there = ((one.step + 0.5, height[place, one.step]) for place in (one.place, one.to))
        line = ConnectionPatch(
            here, there, "data", "data", axesA=axes[one.place], axesB=axes[one.to], color=VERMILLION, linewidth=0.9,
            alpha=0.15 + 0.55 * one.weight,
        )  # fmt: skip
        line.set_gid("link")
        figure.add_artist(line)


def _about(axis: Axes, episode: Episode, place: int, rows: Trace, alone: Trace) -> None:
    """Write the person's goal, if it is one of several, parameters and number of actions next to a panel."""
    beta, theta, sigma = (values[place] for values in (episode.beta, episode.theta, episode.sigma))
    goal = rows[0].get("goal")
    lines = [
        *([] if goal is None else [(f"goal {_short(goal, 25)}", "#555555")]),
        (f"expertise β = {beta:.2f}", "#555555"),
        (f"initial influence θ = {theta:.2f}", "#555555"),
        (f"misconception σ = {sigma:.2f}", "#555555"),
        (f"{_ending(rows)} action{'s' * (_actions(rows) != 1)}", BLUE),
    ]
    if alone:
        lines.append((f"alone {_ending(alone)}", GREY))
    for number, (text, color) in enumerate(lines):
        # Right of the panel, as fractions of its width and height.
        axis.text(1.02, 1 - 0.19 * number, text, transform=axis.transAxes, va="top", fontsize=9, color=color)


def _ending(rows: Trace) -> str:
    return f"{'finished' if rows[-1]['cost_to_go_after'] == 0 else 'not finished'} after {_actions(rows)}"


def _actions(rows: Trace) -> int:
    """Return the number of a person's own actions; a robot may reach the goal before the person acts."""
    return sum(row["action"] is not None for row in rows)


def _short(name: str, most: int = 80) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}…"


def _entries(alone: bool, links: bool) -> list[Artist]:
    """Return the entries of the legend."""
    told: dict[str, Any] = {"marker": "v", "markersize": 8, "color": GREEN}
    return [
        entry("with the robot", color=BLUE, linewidth=2),
        *([entry("the same people, alone", color=GREY, linewidth=1.3, linestyle="--")] if alone else []),
        robot_entry(),
        entry("suggestion, followed", **told),
        entry("suggestion, not followed", markerfacecolor="white", **told),
        *([entry("seen by a neighbour", color=VERMILLION, linewidth=0.9)] if links else []),
    ]


def _line(axis: Axes, rows: Trace, color: str, style: str, width: float) -> None:
    """Plot a person's cost-to-go at every step, including the end of the last action."""
    if rows:
        x = [row["step"] for row in rows] + [rows[-1]["step"] + 1]
        y = [row["cost_to_go"] for row in rows] + [rows[-1]["cost_to_go_after"]]
        heights = [float("nan") if value is None else value for value in y]
        axis.plot(x, heights, color=color, linestyle=style, linewidth=width, zorder=4)
