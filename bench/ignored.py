"""What a robot believes of a person who ignores its suggestions, and how often it still makes suggestions.

    python bench/ignored.py [--people N] [--suggestions N] [--figure FILE] [--record FILE]

`Assistant` assists one person after the other at `kitting/paper`, task after task, with suggestions at 0.05. People
take an action other than the suggested one, follow every second suggestion, or follow all. Where nothing is suggested,
they take a random action. The believed theta is the mean of the belief after each answer. The rate is the share of
decisions that are suggestions, by the number of answers before; a person is observed for at most 300 decisions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, record_option, write_record

from assist.live import Assistant
from assist.people import Population
from assist.person import Setting
from planner import cost_to_go, load

ANSWERS: dict[str, Callable[[int], bool]] = {
    "ignores all": lambda _: False,
    "follows every second": lambda number: number % 2 == 1,
    "follows all": lambda _: True,
}
MODELS: dict[str, dict[str, Any]] = {
    "default": {"setting": Setting(c_suggest=0.05)},
    "paper": {"setting": Setting(c_suggest=0.05, trust="paper"), "population": Population()},
}
LONGEST = 300  # decisions about one person: a robot that has given up suggests nothing for long
SHOWN = {
    "robot's model": cell("model"),
    "the person": cell("answers"),
    "theta after 4": cell("theta_4", ".2f"),
    "after 12": cell("theta_12", ".2f"),
    "suggestions per decision after one answer": cell("rate_first", ".2f", "rate_first_se"),
    "after four or more": cell("rate_later", ".2f", "rate_later_se"),
}


def one(table: Any, model: str, follows: Callable[[int], bool], suggestions: int, seed: int) -> tuple[Any, Any, Any]:
    """Return, by the number of answers before, the believed theta after the next one, suggestions and decisions."""
    desk, rng = Assistant(table, ["ann"], **MODELS[model]), np.random.default_rng(seed)
    theta, made, decisions = np.full(suggestions, np.nan), np.zeros(suggestions), np.zeros(suggestions)
    answered = 0
    for _ in range(LONGEST):
        if desk.finished:
            desk.begin("ann")
        told, applicable = desk.recommend().suggestion, desk.person("ann").applicable
        decisions[answered] += 1
        others = [action for action in applicable if action != told]
        followed = told is not None and (follows(answered) or not others)
        desk.observe("ann", told if followed else others[int(rng.integers(len(others)))])
        if told is not None:
            chances = desk.person("ann").belief.sum(axis=0)
            theta[answered] = chances @ np.linspace(0, 1, len(chances))
            made[answered] = 1
            answered += 1
            if answered == suggestions:
                break
    return theta, made, decisions


def rate(made: np.ndarray, decisions: np.ndarray) -> tuple[float, float]:
    """Return suggestions per decision over all people, and its standard error (ratio estimator)."""
    made, decisions = made.sum(axis=1), decisions.sum(axis=1)
    mean, people = made.sum() / decisions.sum(), len(made)
    return mean, np.sqrt(((made - mean * decisions) ** 2).sum() * people / (people - 1)) / decisions.sum()


@click.command()
@click.option("--people", default=40, show_default=True, help="People of each kind.")
@click.option("--suggestions", default=12, show_default=True, type=click.IntRange(5), help="Suggestions to each.")
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Write the figure here.")
@record_option
def main(people: int, suggestions: int, figure: Path | None, record: Path | None) -> None:
    """Simulate people who ignore suggestions."""
    table, rows, found = cost_to_go(load("kitting/paper")), [], {}
    for model in MODELS:
        for answers, follows in ANSWERS.items():
            each = [one(table, model, follows, suggestions, seed) for seed in range(people)]
            theta, made, decisions = (np.array(part) for part in zip(*each, strict=True))
            found[model, answers] = theta, made.sum(axis=0) / np.maximum(decisions.sum(axis=0), 1)
            first, later = rate(made[:, 1:2], decisions[:, 1:2]), rate(made[:, 4:], decisions[:, 4:])
            rows.append(
                {
                    "model": model, "answers": answers, "theta_4": np.nanmean(theta[:, 3]),
                    "theta_12": np.nanmean(theta[:, -1]), "rate_first": first[0], "rate_first_se": first[1],
                    "rate_later": later[0], "rate_later_se": later[1],
                }
            )  # fmt: skip
            click.echo({name: show(rows[-1]) for name, show in SHOWN.items()})
    write_record(record, SHOWN, rows)
    if figure is not None:
        draw(found, figure)


def draw(found: dict[tuple[str, str], tuple[Any, Any]], file: Path) -> None:
    """Plot the believed theta, and the rate of suggestions, against the number of answers."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(8, 4.2), layout="constrained")
    left, right = drawing.subplots(1, 2)
    for (model, answers), (theta, rates) in found.items():
        look = {
            "color": {"ignores all": "#b3402a", "follows every second": "#7a6a00", "follows all": "#1f6f8b"}[answers],
            "linestyle": "-" if model == "default" else ":",
            "label": f"{answers}, {'constant theta' if model == 'default' else 'equation (7)'}",
        }
        number = np.arange(1, theta.shape[1] + 1)
        left.plot(number, np.nanmean(theta, axis=0), **look)
        if answers == "ignores all":  # how often a robot speaks to others depends on where they are in their task
            right.plot(number[1:] - 1, rates[1:], **look)
    left.set(xlabel="suggestions answered", ylabel="believed theta (mean)", ylim=(0, 1.02))
    right.set(xlabel="suggestions ignored", ylabel="suggestions per decision", ylim=(0, 1.02))
    for axis in (left, right):
        axis.grid(visible=True, color="0.88", linewidth=0.8)
        axis.spines[["top", "right"]].set_visible(False)
    drawing.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    drawing.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
