"""Figures of the identifiability of parameters from recorded actions, and of the online belief and the estimate.

python bench/fit_figures.py [--out FOLDER]
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from simulated_people import People, observed, record

from assist.learning import log_likelihood, maximum_likelihood
from assist.learning.misconception_fit import MarginalLikelihood
from assist.people.belief import Grid as BeliefGrid
from assist.people.choices import Choices
from assist.people.decision import NOTHING
from assist.people.human import HumanModel
from assist.person.pomdp import AssistPOMDP
from assist.plots.people import calibration_figure, expertise_figure
from assist.plots.style import BLUE, ORANGE, save
from planner import Table, load, sweep

DOMAINS = Path(__file__).resolve().parent.parent / "domains"


@click.command()
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build/bench/fit"), show_default=True
)
def main(instance: str, out: Path) -> None:
    """Draw figures of identifiability, and of the online belief and the estimate."""
    table = sweep(load(DOMAINS / f"{instance}.pddl"))
    out.mkdir(parents=True, exist_ok=True)
    draw_identify(table, out / "fit_identify.png")
    draw_online(table, out / "fit_online.png")
    people = People(np.geomspace(0.1, 4.0, 24), np.full(24, 0.6))
    fits = maximum_likelihood(
        observed(table, record(table, people, episodes=3, rng=np.random.default_rng(3), suggest=0.5))
    )
    save(expertise_figure(fits), out / "fit_expertise.png")
    save(calibration_figure(fits), out / "fit_calibration.png")


def panel(figure: Figure, place: int, title: str, x: str, y: str) -> Axes:
    """Return a panel of a figure with two rows of two."""
    axis = figure.add_subplot(2, 2, place)
    axis.set_title(title, fontsize=10, loc="left")
    axis.set(xlabel=x, ylabel=y)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.3)
    return axis


def draw_identify(table: Table, file: Path) -> None:
    """Plot log-likelihoods relative to their maximum; values above -1.92 are in the 95 % interval."""
    figure = Figure(figsize=(9.6, 7.6), layout="constrained")
    drop = -1.92
    noise = np.random.default_rng(1).standard_normal((1, len(table)))
    beta, sigma = np.geomspace(0.3, 8.0, 25), np.linspace(0.0, 3.0, 25)
    for place, episodes in ((1, 3), (2, 30)):
        person = People(np.array([2.0]), np.array([0.6]), noise=noise)
        (o,) = observed(table, record(table, person, episodes=episodes, rng=np.random.default_rng(5)))
        model = MarginalLikelihood(maximum_likelihood([o])[0])
        values = np.array([[model.marginal(b, s)[0] for b in beta] for s in sigma])
        axis = panel(
            figure, place, f"beta against sigma: {episodes} episodes, {len(o)} actions", "expertise β",
            "misconception σ, cost units",
        )  # fmt: skip
        axis.contourf(beta, sigma, values - values.max(), levels=[-30, -12, -3, 0.01], cmap="Blues", alpha=0.6)
        axis.contour(beta, sigma, values - values.max(), levels=[-3], colors="black", linewidths=1.5, linestyles="-")
        axis.plot(2.0, 1.0, marker="*", markersize=13, color=ORANGE, linestyle="none", label="true")
        axis.plot([], [], color="black", linewidth=1.5, label="95 % region")
        axis.set_xscale("log")
        axis.set_xticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
        axis.minorticks_off()
        axis.legend(frameon=True, loc="upper left")

    axis = panel(figure, 3, "theta: information in suggestions", "initial influence θ", "log-likelihood, profile")
    theta = np.linspace(0, 1, 101)
    plan = table.optimal_plan() or []
    taken = [
        {"person": "p", "episode": "1", "step": step, "action": action, "suggestion": action if step % 2 else None}
        for step, action in enumerate(plan)
    ]
    novice = People(np.array([0.5]), np.array([0.7]))
    mixed = record(table, novice, episodes=5, rng=np.random.default_rng(2), suggest=0.5, good=0.3)
    silent = [{**row, "suggestion": None} for row in mixed]
    for label, rows, style in (
        ("no suggestions", silent, ":"),
        ("an expert, good suggestions", taken, "--"),
        ("a novice, good and bad suggestions", mixed, "-"),
    ):
        (o,) = observed(table, rows)
        values = log_likelihood(o, np.geomspace(0.05, 5, 60), theta, np.array([0.2])).max(axis=(0, 2))
        told = o.suggested != NOTHING
        refused = int((o.chosen != o.suggested)[told].sum())
        label += f": {refused} of {told.sum()} refused" if told.any() else ""
        axis.plot(theta, values - values.max(), linestyle=style, label=label)
    axis.axhline(drop, color="#8C8C8C", linewidth=1)
    axis.axvline(0.7, color=ORANGE, linewidth=1)
    axis.set_ylim(-8, 0.3)
    axis.legend(frameon=True, fontsize=8, loc="lower left")

    axis = panel(figure, 4, "beta of people who never err", "expertise β", "log-likelihood")
    beta = np.linspace(0.3, 5, 200)
    for episodes, style in ((1, "-"), (3, "--"), (10, "-.")):
        plan = table.optimal_plan() or []
        rows = [
            {"person": "p", "episode": str(e), "step": s, "action": a, "suggestion": None}
            for e in range(episodes)
            for s, a in enumerate(plan)
        ]
        (o,) = observed(table, rows)
        values = log_likelihood(o, beta, np.array([0.5]), np.array([0.0])).ravel()
        axis.plot(beta, values - values.max(), linestyle=style, label=f"{len(o)} actions without a mistake")
    axis.axhline(drop, color="#8C8C8C", linewidth=1)
    axis.set_ylim(-8, 0.3)
    axis.legend(frameon=True, fontsize=8)
    save(figure, file)


def draw_online(table: Table, file: Path) -> None:
    """Plot the belief about beta after each action, and the estimate from all actions so far."""
    person = People(np.array([0.9]), np.array([0.6]))
    rows = record(table, person, episodes=25, rng=np.random.default_rng(4))
    rows.sort(key=lambda row: (int(row["episode"]), row["step"]))
    (o,) = observed(table, rows)
    grid = BeliefGrid(np.linspace(0.02, 3.0, 150), np.array([0.0, 0.5, 1.0]))
    pomdp = AssistPOMDP.of(HumanModel.exact(Choices.of(table)), grid=grid)
    belief = pomdp.prior[None]
    path = []
    for x, slot in zip(o.state, o.chosen, strict=True):
        belief = pomdp.update(belief, np.array([x]), np.array([0]), np.array([slot]))
        margin = belief[0].sum(axis=1)
        low, high = np.interp([0.025, 0.975], margin.cumsum(), grid.beta)
        path.append((float(margin @ grid.beta), low, high))
    mean, low, high = np.array(path).T
    ends = np.unique(np.append(np.flatnonzero(o.begins)[1:], len(o)))
    offline = [maximum_likelihood(observed(table, rows[:end]))[0].beta for end in ends]
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    axis = figure.subplots()
    n = np.arange(1, len(o) + 1)
    axis.fill_between(n, low, high, color=BLUE, alpha=0.2, linewidth=0, label="online: belief, 95 %")
    axis.plot(n, mean, color=BLUE, label="online: belief, mean")
    value = np.array([e.value for e in offline])
    spans = np.array([e.interval for e in offline]).T
    axis.errorbar(
        ends, value, yerr=np.abs(np.array([value - spans[0], spans[1] - value])), fmt="o", color="#B35900",
        markersize=4, capsize=2, linewidth=1, label="offline: estimate with 95 % interval",
    )  # fmt: skip
    axis.axhline(0.9, color="#8C8C8C", linestyle="--", linewidth=1, label="true")
    axis.set(xlabel="actions seen", ylabel="expertise β", ylim=(0, 3))
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.3)
    axis.legend(frameon=False)
    save(figure, file)
    print(f"after {len(o)} actions: belief {mean[-1]:.3f} ({low[-1]:.3f} to {high[-1]:.3f}), estimate {offline[-1]}")


if __name__ == "__main__":
    main()
