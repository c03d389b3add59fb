"""Figures of what was estimated from people's actions. Needs the extra `plots`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from ...learning.comparison import Comparison
from ...learning.diagnostics import calibrate
from ...learning.person_estimate import PersonEstimate, people_of
from ...people.decision import NOTHING
from .style import BLUE, GREEN, GREY, ORANGE, grid, panels, save, styled, whole_numbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure


People: TypeAlias = Mapping[str, PersonEstimate] | Iterable[PersonEstimate]
"""The result of `assist.fit`, or some of its estimates."""


def draw(fits: list[PersonEstimate], folder: Path) -> list[Path]:
    """Write the figures to a folder; return their files.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    pictures = {
        "calibration": calibration_figure(fits),
        "expertise": expertise_figure(fits),
        "errors": errors_figure(fits),
        "episodes": episodes_figure(fits),
    }
    files = [folder / f"{name}.png" for name in pictures]
    for file, figure in zip(files, pictures.values(), strict=True):
        save(figure, file)
    return files


def draw_comparison(comparison: Comparison, folder: Path) -> Path:
    """Write the figure of a comparison of choice models to a folder; return its file.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    file = folder / "comparison.png"
    save(comparison_figure(comparison), file)
    return file


@styled
def comparison_figure(comparison: Comparison) -> Figure:
    """Plot the held-out prediction error of each choice model, and its difference for each person.

    Parameters
    ----------
    comparison : Comparison
    """
    figure, ((means, people),) = panels(1, 2, height=0.9 + 0.55 * len(comparison.scores), margin=0.0)
    reference, rows = comparison.scores[0], np.arange(len(comparison.scores))[::-1]
    for row, model in zip(rows, comparison.scores, strict=True):
        means.errorbar(model.nats_per_choice, row, xerr=1.96 * model.stderr, fmt="o", color=BLUE, capsize=3)
        less = reference.of_people - model.of_people
        if model.better_for is not None:
            spread = np.linspace(-0.28, 0.28, len(less))[np.argsort(np.argsort(less))]
            people.scatter(less, row + spread, s=9, color=np.where(less > 0, GREEN, ORANGE), linewidths=0)
    means.set_yticks(rows, [model.model for model in comparison.scores])
    means.set(xlabel="nats per choice of held-out people, with 95 % interval", ylim=(-0.6, len(rows) - 0.4))
    people.set_yticks(rows, [""] * len(rows))
    people.set(xlabel=f"less than {reference.model}, one mark per person", ylim=(-0.6, len(rows) - 0.4))
    people.axvline(0.0, color=GREY, linewidth=1)
    for axis in (means, people):
        axis.grid(axis="x")
    return figure


@styled
def calibration_figure(people: People) -> Figure:
    """Plot the observed frequency of choices against their predicted probability.

    Parameters
    ----------
    people : FittedPeople, or iterable of PersonEstimate
    """
    figure, ((axis,),) = panels(height=5.4, margin=0.0, width=6)
    axis.grid()
    c = calibrate(people)
    axis.plot([0, 1], [0, 1], color=GREY, linestyle="--", linewidth=1.2, label="as predicted")
    axis.errorbar(
        c.predicted, c.observed, yerr=np.abs(np.array([c.observed - c.low, c.high - c.observed])),
        fmt="o", color=BLUE, capsize=3, label="observed, with 95 % interval",
    )  # fmt: skip
    for x, y, count in zip(c.predicted, c.observed, c.count, strict=True):
        axis.annotate(f"{count:.0f}", (x, y), xytext=(7, -11), textcoords="offset points", fontsize=8, color="#555555")
    axis.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), xlabel="predicted probability of a choice", ylabel="share chosen")
    axis.set_title("Predicted and observed choices (numbers: applicable actions)")
    axis.legend(loc="upper left")
    return figure


@styled
def expertise_figure(people: People, most: int = 60) -> Figure:
    """Plot beta with its interval for each person, and theta where it is known.

    Parameters
    ----------
    people : FittedPeople, or iterable of PersonEstimate
    most : int
        Largest number of people, each with a line; more cannot be read.
    """
    fits = people_of(people)
    shown = sorted(fits, key=lambda f: (f.estimates["beta"].value, f.beta_interval[0]))
    if len(shown) > most:  # an even selection over the whole range
        shown = [shown[i] for i in np.linspace(0, len(shown) - 1, most).astype(int)]
    columns = 2 if any("theta" in f.estimates for f in shown) else 1
    height = 0.24 * max(len(shown), 4)
    figure, (axes,) = panels(1, columns, height=height, margin=1.3, width=4.7 * columns + 1, sharey=True)
    rows = np.arange(len(shown))
    for axis, name, color in zip(axes, ("beta", "theta"), (BLUE, GREEN), strict=False):
        for row, f in zip(rows, shown, strict=True):
            estimate = f.estimates.get(name)
            if estimate is None:
                continue
            axis.plot(estimate.interval, (row, row), color=color, linewidth=2.2, solid_capstyle="butt", alpha=0.6)
            end = name == "beta" and estimate.open_above
            axis.plot(
                estimate.value, row, marker=">" if end else "o", color=color, markersize=6 if end else 5,
                markerfacecolor="white" if end else color, clip_on=False,
            )  # fmt: skip
        axis.grid(axis="x")
    axes[0].set_xscale("symlog", linthresh=0.1)
    axes[0].xaxis.set_major_formatter("{x:g}")
    axes[0].set_xlim(left=0)
    axes[0].set_xlabel("expertise β, per cost unit (arrow: not bounded above)")
    axes[0].set_yticks(rows, [f.observations.person for f in shown], fontsize=8)
    if columns == 2:
        axes[1].set(xlim=(0, 1), xlabel="initial influence θ")
    number = f"{len(shown)} of {len(fits)} people" if len(shown) < len(fits) else f"{len(fits)} people"
    figure.suptitle(f"Estimates with {100 * fits[0].method.level:g} % intervals, {number}")
    return figure


@styled
def errors_figure(people: People) -> Figure:
    """Plot beta against the share of suboptimal actions.

    Parameters
    ----------
    people : FittedPeople, or iterable of PersonEstimate
    """
    fits = people_of(people)
    figure, ((axis,),) = panels(height=4.6, margin=0.0, width=6.4)
    axis.grid()
    for is_open, marker, label in ((False, "o", "estimate"), (True, "^", "not bounded above")):
        own = [f for f in fits if f.estimates["beta"].open_above == is_open]
        if own:
            x = np.array([100 * f.observations.suboptimal / len(f.observations) for f in own])
            y = np.array([f.estimates["beta"].value for f in own])
            ends = np.array([f.beta_interval for f in own]).T
            axis.errorbar(
                x, y, yerr=np.abs(np.array([y - ends[0], ends[1] - y])), fmt=marker, color=ORANGE if is_open else BLUE,
                markersize=5, linewidth=1, alpha=0.75, label=label, markerfacecolor="white" if is_open else BLUE,
            )  # fmt: skip
    axis.set_yscale("symlog", linthresh=0.1)
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_ylim(bottom=0)
    axis.set(xlabel="suboptimal actions, % of all", ylabel="expertise β, per cost unit")
    axis.set_title("Expertise and mistakes, one mark per person")
    axis.legend()
    return figure


@styled
def episodes_figure(people: People, most: int = 12) -> Figure:
    """Plot the cost-to-go along each person's episodes, and the suggestions.

    Parameters
    ----------
    people : FittedPeople, or iterable of PersonEstimate
    most : int
        Largest number of people, each with a panel.
    """
    shown = fits = people_of(people)
    if len(fits) > most:  # from the least to the most expert person
        order = sorted(fits, key=lambda f: f.estimates["beta"].value)
        shown = [order[i] for i in np.linspace(0, len(order) - 1, most).astype(int)]
    figure, axes = grid(len(shown), 3, height=2.3, width=3.6 * min(3, len(shown)), sharey=True)
    for axis, f in zip(axes, shown, strict=True):
        o = f.observations
        bounds = [*np.flatnonzero(o.begins).tolist(), len(o)]
        for begin, end in pairwise(bounds):
            last = o.ahead[end - 1, o.chosen[end - 1]]
            h = np.append(o.cost_to_go[begin:end], last)
            axis.plot(
                np.arange(end - begin + 1), np.where(np.isfinite(h), h, np.nan), color=BLUE, linewidth=1.2, alpha=0.7
            )
            told = np.flatnonzero(o.suggested[begin:end] != NOTHING)
            for took in (True, False):
                at = told[(o.chosen[begin:end] == o.suggested[begin:end])[told] == took]
                axis.plot(
                    at, h[at], linestyle="none", marker="v", markersize=4.5, color=GREEN,
                    markerfacecolor=GREEN if took else "white",
                )  # fmt: skip
        axis.set_title(f"{o.person}: β = {f.estimates['beta'].value:.2g}, {o.suboptimal} of {len(o)} suboptimal")
        axis.grid(axis="y")
        whole_numbers(axis.xaxis)
    axes[0].set_ylim(bottom=0)  # shared by all axes; set last, since limits stop automatic scaling
    number = f"{len(shown)} of {len(fits)} people" if len(shown) < len(fits) else "all people"
    figure.suptitle(f"Episodes of {number}; triangles: suggestions, filled if followed")
    figure.supxlabel("action", fontsize="medium")
    figure.supylabel("cost-to-go", fontsize="medium")
    return figure
