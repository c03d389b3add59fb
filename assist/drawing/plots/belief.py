"""The figure of a robot's belief over the course of an episode."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from ...team.episodes import Episode
from .panels_by_name import named_rows
from .style import BLUE, GREEN, ORANGE, entry, ink, legend_below, robot_entry, styled, whole_numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


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
    figure, rows = named_rows(people, list(hidden), height=1.6, sharey="col")
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
