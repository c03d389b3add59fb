"""Pictures of what happened. Needs the extra `plots`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

from planner.errors import MissingExtraError
from planner.storage import atomic

from ..simulation.episodes import Episode, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which people with any colour vision tell apart.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#E69F00", "#009E73", "#8C8C8C"
SKY, VERMILLION, PURPLE = "#56B4E9", "#D55E00", "#CC79A7"

FORMATS = (".png", ".svg", ".pdf")


def require() -> None:
    """Check that pictures can be drawn.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise MissingExtraError("pictures need matplotlib: pip install 'kitassist[plots]'")


def episode_figure(episode: Episode, trace: Trace, alone: Trace | None = None) -> Figure:
    """Draw one episode: each person's cost-to-go over time, the suggestions, and where the robot was.

    Parameters
    ----------
    episode : Episode
        Who was in the team.
    trace : list of dict
        The episode's actions, as `simulate` traces them.
    alone : list of dict, optional
        Those of the same episode without a robot, drawn for comparison.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    require()
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    places = sorted({row["place"] for row in trace})
    steps = max(row["step"] for row in trace) + 1
    alone_steps = max((row["step"] for row in alone or []), default=0) + 1
    shown = max(steps, min(alone_steps, 2 * steps))  # a person in a trap would squeeze all else
    height = 1.9 + 1.9 * len(places)
    figure = Figure(figsize=(9, height))
    axes = figure.subplots(len(places), 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(left=0.08, right=0.98, top=1 - 0.75 / height, bottom=1.15 / height, hspace=0.35)
    figure.suptitle(
        f"Episode {episode.episode} under the policy '{episode.policy}': {sum(episode.actions)} human actions, "
        f"suggestions: {episode.interventions}, moves: {episode.moves}",
        fontsize=11, y=1 - 0.2 / height, va="top",
    )  # fmt: skip
    highest = max(row["cost_to_go"] or 0 for row in [*trace, *(r for r in alone or [] if r["step"] < shown)])
    for place, axis in zip(places, axes, strict=True):
        rows = [row for row in trace if row["place"] == place]
        for step in {row["step"] for row in trace if row["robot_place"] == place}:
            axis.axvspan(step, step + 1, color=ORANGE, alpha=0.22, linewidth=0)
        if alone:
            own = [row for row in alone if row["place"] == place]
            _line(axis, [row for row in own if row["step"] < shown], GREY, "--", 1.3)
            if len(own) != len(rows):
                at = own[min(len(own), shown) - 1]
                axis.annotate(
                    f"alone: {len(own)}", (at["step"] + 1, at["cost_to_go_after"] or 0), xytext=(8, 5),
                    textcoords="offset points", fontsize=9, color=GREY,
                )  # fmt: skip
        _line(axis, rows, BLUE, "-", 2.0)
        for followed in (True, False):
            told = [row for row in rows if row["suggestion"] and (row["suggestion"] == row["action"]) == followed]
            axis.plot(
                [row["step"] + 0.5 for row in told],
                [row["cost_to_go"] or 0 for row in told],
                linestyle="none", marker="v", markersize=8, zorder=5, clip_on=False,
                color=GREEN, markerfacecolor=GREEN if followed else "white",
            )  # fmt: skip
        last = rows[-1]
        if last["cost_to_go_after"] == 0:
            axis.plot([last["step"] + 1], [0], marker="o", markersize=7, color=BLUE, zorder=6, clip_on=False)
            axis.annotate(
                f"done after {last['step'] + 1} actions", (last["step"] + 1, 0), xytext=(8, 5),
                textcoords="offset points", fontsize=9, color=BLUE,
            )  # fmt: skip
        axis.set_title(episode.people[place], loc="left", fontsize=10, fontweight="bold")
        beta, theta, sigma = (values[place] for values in (episode.beta, episode.theta, episode.sigma))
        who = f"expertise β = {beta:.2f}, influence θ = {theta:.2f} at first, misconception σ = {sigma:.2f}"
        axis.set_title(who, loc="right", fontsize=9, color="#555555")
        axis.set_ylim(0, highest * 1.12)
        axis.set_xlim(0, shown * 1.17)
        axis.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="y", alpha=0.3)
    axes[len(axes) // 2].set_ylabel("cost still to go, at best")
    axes[-1].set_xlabel("step (in each, every person acts once)")
    entries = [
        Line2D([], [], color=BLUE, linewidth=2, label="with the robot"),
        Line2D([], [], color=GREY, linewidth=1.3, linestyle="--", label="the same people, alone"),
        Patch(color=ORANGE, alpha=0.22, label="the robot is here"),
        Line2D([], [], linestyle="none", marker="v", markersize=8, color=GREEN, label="suggestion, taken"),
        Line2D(
            [],
            [],
            linestyle="none",
            marker="v",
            markersize=8,
            color=GREEN,
            markerfacecolor="white",
            label="suggestion, not taken",
        ),
    ]
    figure.legend(
        handles=entries if alone else [entries[0], *entries[2:]], loc="lower center", ncols=3, frameon=False, fontsize=9
    )
    return figure


def _line(axis: Axes, rows: Trace, color: str, style: str, width: float) -> None:
    """Draw a person's cost-to-go at every step, the end of their last action included."""
    if rows:
        x = [row["step"] for row in rows] + [rows[-1]["step"] + 1]
        y = [row["cost_to_go"] for row in rows] + [rows[-1]["cost_to_go_after"]]
        axis.plot(
            x,
            [float("nan") if value is None else value for value in y],
            color=color,
            linestyle=style,
            linewidth=width,
            zorder=4,
        )


def save(figure: Figure, file: Path) -> None:
    """Save a figure in the format that the file's name asks for, at once or not at all."""
    with atomic(file) as path:
        figure.savefig(path, dpi=150)
