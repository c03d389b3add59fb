"""Figures of a user study: measures by condition, differences from a reference, scales and dropouts. Needs `plots`.

The functions take rows of the study's summary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...declare.catalogue import Catalogue, catalogue
from .style import BLUE, GREY, PolicyLook, grid, ink, legend_below, looks, panels, sample, styled, whole_numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]

POINTS = 10
"""Length of a scale up to which each point has a mark."""


@styled
def outcomes_figure(
    measures: Rows, points: Mapping[str, Mapping[str, Sequence[float]]], texts: Catalogue | None = None
) -> Figure:
    """Plot each measure by condition: a point for each participant, next to the mean with its 95 % interval.

    Parameters
    ----------
    measures : sequence of dict
        Keys `measure`, `label`, `ends` (the least and the largest possible value, or None), and `cells` with
        `condition`, `n`, `mean`, `low`, `high`.
    points : mapping of mapping of sequence of float
        The participants' values, by measure and condition.
    texts : Catalogue, optional
        Texts of the report's language; English unless given, here and in the other figures.
    """
    shown = looks(cell["condition"] for cell in measures[0]["cells"])
    figure, axes = grid(len(measures), 3, height=2.5, margin=0.3)
    for axis, measure in zip(axes, measures, strict=True):
        for place, cell in enumerate(measure["cells"]):
            look = shown[cell["condition"]]
            values = np.sort(points[measure["measure"]][cell["condition"]])
            spread = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(len(values))
            order = np.argsort(np.arange(len(values)) * 0.618 % 1)  # separates neighbours, in the same way in every run
            axis.plot(place - 0.12 + spread[order], values, ".", color=look.color, alpha=0.55, markersize=5)
            _interval(axis, place + 0.22, cell, look, vertical=True)
        axis.set_xticks(
            range(len(measure["cells"])), [f"{cell['condition']}\nn = {cell['n']}" for cell in measure["cells"]]
        )
        axis.set_xlim(-0.6, len(measure["cells"]) - 0.4)
        axis.set_title(measure["label"])
        _in_language(axis.yaxis, texts)
        if None in measure["ends"]:
            axis.set_ylim(bottom=min(0, axis.get_ylim()[0]))
        else:
            axis.set_ylim(*_scale(axis.yaxis, *measure["ends"]))
        axis.grid(axis="y")
    return figure


@styled
def differences_figure(measures: Rows, reference: str, texts: Catalogue | None = None) -> Figure:
    """Plot the differences of conditions from the reference, with 95 % intervals.

    Parameters
    ----------
    measures : sequence of dict
        Keys `label`, and `differences` with `condition`, `mean`, `low`, `high`, `hedges_g`.
    reference : str
    texts : Catalogue, optional
    """
    texts = texts or catalogue()
    names = [one["condition"] for one in max(measures, key=lambda one: len(one["differences"]))["differences"]]
    shown = looks(names)
    figure, axes = grid(len(measures), 3, height=0.8 + 0.3 * len(names), margin=0.3)
    for axis, measure in zip(axes, measures, strict=True):
        for one in measure["differences"]:
            place = -names.index(one["condition"])
            _interval(axis, place, one, shown[one["condition"]], vertical=False)
            if one["hedges_g"] is not None:
                text, at = f"g = {texts.decimal(one['hedges_g'], 2)}", (one["mean"], place)
                axis.annotate(text, at, (0, 6), textcoords="offset points", ha="center", fontsize=7.5)
        axis.axvline(0, color=ink(), linewidth=0.9, alpha=0.6)
        axis.set_yticks([-number for number in range(len(names))], names)
        axis.set_ylim(0.4 - len(names), 0.75)
        axis.set_title(measure["label"])
        axis.grid(axis="x")
        _in_language(axis.xaxis, texts)
    figure.supxlabel(texts.phrase("report.figures.difference", reference=reference), fontsize=9)
    return figure


@styled
def scales_figure(questionnaire: Mapping[str, Any], texts: Mapping[str, str], ends: tuple[float, float]) -> Figure:
    """Plot the items of a questionnaire by condition, as means with 95 % intervals.

    Parameters
    ----------
    questionnaire : dict
        Key `items`, with `item`, `condition`, `mean`, `low`, `high`.
    texts : mapping of str to str
        Label of each item.
    ends : tuple of float
        Lower and upper end of the scale.
    """
    items = list(dict.fromkeys(row["item"] for row in questionnaire["items"]))
    shown = looks(row["condition"] for row in questionnaire["items"])
    figure, ((axis,),) = panels(height=0.9 + 0.55 * len(items), margin=0.0)
    apart = np.linspace(0.27, -0.27, len(shown)) if len(shown) > 1 else np.zeros(1)
    for (name, look), shift in zip(shown.items(), apart, strict=True):
        for row in questionnaire["items"]:
            if row["condition"] == name and row["mean"] is not None:
                _interval(axis, shift - items.index(row["item"]), row, look, vertical=False)
    axis.set_yticks([-number for number in range(len(items))], [texts[item] for item in items])
    lowest, highest = ends
    axis.set_xlim(*_scale(axis.xaxis, lowest, highest))
    axis.set_ylim(-len(items) + 0.5, 0.5)
    axis.grid(axis="x")
    legend_below(figure, [sample(name, look, line=False) for name, look in shown.items()])
    return figure


@styled
def flow_figure(flow: Rows, texts: Catalogue | None = None) -> Figure:
    """Plot how many participants reached each stage of the procedure, how many left there, and how many withdrew.

    Parameters
    ----------
    flow : sequence of dict
        Keys `stage`, `reached`, `left`, `there`, `withdrew`.
    texts : Catalogue, optional
    """
    texts = texts or catalogue()
    figure, ((axis,),) = panels(height=0.7 + 0.36 * len(flow), margin=0.0)
    for place, row in enumerate(flow):
        stay = row["reached"] - row["left"]
        axis.barh(-place, stay, color=BLUE, height=0.6)
        axis.barh(-place, row["left"], left=stay, color=GREY, height=0.6, alpha=0.6)
        said = [str(row["reached"])]
        for key, word in (("left", "left"), ("there", "present"), ("withdrew", "withdrew")):
            said += [texts.phrase(f"report.figures.{word}", n=row[key])] if row[key] else []
        axis.annotate(", ".join(said), (row["reached"], -place), (5, 0), textcoords="offset points", va="center")
    axis.set_yticks([-place for place in range(len(flow))], [row["stage"] for row in flow])
    axis.set_xlim(0, 1.18 * max(1, flow[0]["reached"]))
    whole_numbers(axis.xaxis)
    axis.set_xlabel(texts.phrase("report.figures.reached"))
    return figure


def _scale(axis: Axis, lowest: float, highest: float) -> tuple[float, float]:
    """Mark both ends of a scale, and each point of a short one; return the limits of the axis, somewhat beyond them."""
    steps = highest - lowest
    axis.set_ticks(np.linspace(lowest, highest, int(steps) + 1 if steps <= POINTS else 5))
    return lowest - 0.04 * steps, highest + 0.04 * steps


def _in_language(axis: Axis, texts: Catalogue | None) -> None:
    """Write the numbers of an axis with the decimal sign of a language."""
    from matplotlib.ticker import ScalarFormatter

    sign = (texts or catalogue()).texts["decimal"]

    class Formatter(ScalarFormatter):
        def __call__(self, value: float, place: int | None = None) -> str:
            return str(super().__call__(value, place)).replace(".", sign)

    axis.set_major_formatter(Formatter())


def _interval(axis: Axes, place: float, row: Mapping[str, Any], look: PolicyLook, *, vertical: bool) -> None:
    if row["mean"] is None:
        return
    if row["low"] is not None:
        ends = [place, place], [row["low"], row["high"]]
        axis.plot(*(ends if vertical else ends[::-1]), color=look.color, linewidth=2, alpha=0.85)
    at = (place, row["mean"]) if vertical else (row["mean"], place)
    axis.plot(*at, marker=look.marker, color=look.color, markersize=6, linestyle="none")
