"""The figure of an episode that was watched: what the robot expected of each person, and where it went."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from .style import (
    BLUE,
    GREEN,
    GREY,
    entry,
    is_followed,
    legend_below,
    panels,
    robot_bands,
    robot_entry,
    styled,
    whole_numbers,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def watched_figure(watched: Any) -> Figure:
    """Return the figure of a `WatchedEpisode`: a row for each person, with the expected gain and the cost-to-go.

    Bands show where the robot was. It goes where the gain is largest and above 0, if it follows Algorithm 1. Where a
    step has no gain, no suggestion would be worth its cost; one that a policy made all the same stands on the line of
    0.

    Parameters
    ----------
    watched : WatchedEpisode
        What `assist.studies.reports.watch` returns.
    """
    people, steps = watched.episode.people, len(watched.gain)
    figure, axes = panels(len(people), 2, height=1.5, margin=1.2, sharex=True, sharey="col")
    at = np.arange(steps)
    for place, (gains, costs) in enumerate(axes):
        rows = [row for row in watched.trace if row["place"] == place]
        told = [row["step"] for row in rows if row["suggestion"]]
        followed = [row["step"] for row in rows if is_followed(row)]
        robot_bands((gains, costs), rows, place)
        gains.axhline(0.0, color=GREY, linewidth=1.0)
        gains.plot(at, watched.gain[:, place], color=BLUE, marker=".", linewidth=1.6)
        height = np.nan_to_num(watched.gain[:, place], nan=0.0)
        gains.plot(told, height[told], linestyle="none", marker="v", color=GREEN, markerfacecolor="white")
        gains.plot(followed, height[followed], linestyle="none", marker="v", color=GREEN)
        for trace, color, line in ((watched.alone, GREY, "--"), (watched.trace, BLUE, "-")):
            own = [row for row in trace if row["place"] == place]
            shown = [row for row in own if row["step"] <= 2 * steps]
            ends = [(row["step"], row["cost_to_go"]) for row in shown]
            if len(shown) == len(own):
                ends += [(row["step"] + 1, row["cost_to_go_after"]) for row in own[-1:]]
            else:
                costs.text(
                    1.0, 1.0, f"alone until step {own[-1]['step'] + 1}", transform=costs.transAxes, color=color,
                    fontsize=8, va="top", ha="right",
                )  # fmt: skip
            heights = [np.nan if height is None else height for _, height in ends]
            costs.plot([step for step, _ in ends], heights, color=color, linestyle=line, drawstyle="steps-post")
        gains.set_title(people[place], loc="left", fontweight="bold")
        whole_numbers(gains.xaxis, costs.xaxis)
        for axis in (gains, costs):
            axis.grid(axis="y")
    axes[len(people) // 2][0].set_ylabel("gain expected by Algorithm 1 (cost units)")
    axes[len(people) // 2][1].set_ylabel("cost-to-go")
    for axis in axes[-1]:
        axis.set_xlabel("step")
    about = f"Episode {watched.episode.episode} under the policy '{watched.episode.policy}'"
    figure.suptitle(textwrap.fill(about, 100))
    legend_below(figure, [
        entry("gain, or cost-to-go with the robot", color=BLUE, linewidth=1.6),
        entry("alone", color=GREY, linestyle="--"),
        robot_entry(),
        entry("suggestion, followed", color=GREEN, marker="v"),
        entry("suggestion, not followed", color=GREEN, marker="v", markerfacecolor="white"),
    ])  # fmt: skip
    return figure
