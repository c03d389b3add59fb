"""What people see of their neighbours: bounds, where an outlook pays, and whether a rule is found again from logs.

    python bench/neighbours.py bounds   [--settings N] [--record FILE]
    python bench/neighbours.py policies [--episodes N] [--record FILE] [--figure FILE]
    python bench/neighbours.py recovery [--populations N] [--record FILE]

`bounds` compares the bound of random settings with the best of four policies, simulated in the robot's model.
`policies` simulates policies that know of neighbours, and others, with the same people and random numbers. `recovery`
fits the rate `eta_seen` to logs of simulated people, whose suggestions go to a random person in each step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, more_option, record_option, write_record

from assist.certify import upper_bound
from assist.learning import compare_rules, fit_influence, replayed
from assist.learning.neighbours_in_logs import seen_families, with_neighbours
from assist.people.neighbourhood import NOBODY_SEES
from assist.people.neighbours import Neighbours, SeenOutcome
from assist.people.ranges import Population
from assist.people.trust_rules import constant
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.priority import Priority
from assist.team.simulate import simulate
from assist.team.state import TeamAction, TeamPolicy, TeamState
from assist.team.trace import Trace
from planner import load, sweep


def difference(name: str) -> Callable[[dict[str, Any]], str]:
    """Return a formatter of a difference with its standard error."""
    return lambda row: f"{row[name]:+.3f} ± {row[f'{name}_se']:.3f}"


POLICIES = ("none", "attention", "attention-outlook", "priority")
BOUNDS = {
    "rule": cell("rule"), "settings": cell("settings", ","), "best policy above the bound": cell("above"),
    "nearest, in standard errors": cell("nearest", ".1f"), "gap, median (%)": cell("gap", ".1f"),
    "gap without neighbours (%)": cell("alone", ".1f"),
}  # fmt: skip
COMPARED = {
    "own theta": cell("trust"), "graph": cell("graph"), "rate": cell("rate"), "people": cell("people"),
    "return per person, attention": cell("attention", ".2f"), "suggestions": cell("suggestions", ".1f"),
    "attention-outlook": difference("outlook"), "its suggestions": cell("told", ".1f"),
    "priority": difference("priority"),
    "priority without outlook": difference("blind"),
    "attention, not knowing": difference("ignorant"),
}  # fmt: skip
RECOVERED = {
    "people": cell("people"), "suggestions to each": cell("suggestions", ".0f"), "seen by each": cell("seen", ".0f"),
    "sigma": cell("sigma", "g"), "true eta_seen": cell("true", "g"), "populations": cell("populations"),
    "mean estimate": cell("mean", ".3f"), "standard deviation": cell("sd", ".3f"),
    "95 % intervals that hold it (%)": cell("inside", ".0f"), "that exclude 0 (%)": cell("found", ".0f"),
    "rule rightly chosen (%)": cell("chosen", ".0f"),
}  # fmt: skip


@click.group()
def main() -> None:
    """Measure what neighbours who see each other helped change."""


@main.command()
@click.option("--settings", type=click.IntRange(1), default=200, show_default=True)
@click.option("--instance", default="kitting/tiny", show_default=True)
@record_option
def bounds(settings: int, instance: str, record: Path | None) -> None:
    """Compare bounds with the best simulated policy, in random settings."""
    task, rng, rows = sweep(load(instance)), np.random.default_rng(1), []
    for number in range(settings):
        rule: dict[str, Any] = [
            {"rule": "outcome", "eta_seen": float(rng.choice([0.02, 0.1, 0.3, 1.0]))},
            {"rule": "followed", "rise": float(rng.uniform(0, 0.4)), "fall": float(rng.uniform(0, 0.4))},
            {"rule": "steps", "seen_gain": float(rng.uniform(0, 2)), "seen_loss": float(rng.uniform(0, 2))},
        ][number % 3]
        people, low = int(rng.integers(2, 5)), float(rng.uniform(0.1, 0.6))
        setting = Setting(
            gamma=0.95, c_suggest=float(rng.choice([0.02, 0.1, 0.5])), c_move=float(rng.choice([0.0, 0.1, 0.5])),
            robots=int(rng.integers(1, 3)), trust=str(rng.choice(["paper", "constant", "outcome"])),
            knowledge="own" if rng.random() < 0.3 else "exact",
            neighbours=Neighbours(
                rule=rule, sees=str(rng.choice(["everybody", "next"])), weight=float(rng.uniform(0.3, 1))
            ),
        )  # fmt: skip
        population = Population(theta=(low, min(1.0, low + float(rng.uniform(0.1, 0.4)))))
        pool = Pool.sample(task, people, seed=number, setting=setting, population=population)
        bound = upper_bound(pool, time_limit=2.0, jobs=1)
        found = [bound.certify(policy, episodes=512, seed=number) for policy in POLICIES]
        best = max(found, key=lambda one: one.value)
        alone = upper_bound(pool.under(replace(setting, neighbours=None)), time_limit=0.1, jobs=1).upper_seen
        rows.append({
            "rule": rule["rule"], "errors": (best.value - bound.upper) / best.value_stderr,
            "gap": 100 * (bound.upper - best.value) / abs(best.value),
            "alone": 100 * (alone - best.value) / abs(best.value),
        })  # fmt: skip
        if (number + 1) % 20 == 0:
            click.echo(f"{number + 1} settings, nearest {max(row['errors'] for row in rows):.1f} standard errors")
    table = []
    for name in ("outcome", "followed", "steps", "all"):
        those = [row for row in rows if name in (row["rule"], "all")]
        table.append({
            "rule": name, "settings": len(those), "above": sum(row["errors"] > 3 for row in those),
            "nearest": max(row["errors"] for row in those), "gap": float(np.median([row["gap"] for row in those])),
            "alone": float(np.median([row["alone"] for row in those])),
        })  # fmt: skip
        click.echo("  ".join(show(table[-1]) for show in BOUNDS.values()))
    write_record(record, BOUNDS, table)


@dataclass(frozen=True)
class Blind:
    """A policy that does not consider who sees a suggestion; what it believes of people is right."""

    policy: TeamPolicy
    uses_belief = weighs_costs = True

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the policy's action."""
        known = team.beliefs.of(np.arange(team.x.size))
        known.neighbours = NOBODY_SEES
        return self.policy(replace(team, beliefs=known))


@main.command()
@click.option("--episodes", type=click.IntRange(2), default=1000, show_default=True)
@click.option("--instance", default="kitting/tiny", show_default=True)
@click.option("--people", "sizes", type=int, multiple=True, default=(2, 4, 8), show_default=True)
@click.option("--rate", "rates", type=float, multiple=True, default=(0.02, 0.1, 0.3), show_default=True)
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Draw the differences here.")
@record_option
def policies(
    episodes: int, instance: str, sizes: tuple[int, ...], rates: tuple[float, ...], figure: Path | None,
    record: Path | None,
) -> None:  # fmt: skip
    """Compare policies with an outlook on neighbours with others, over graphs, rates and team sizes."""
    task, rows = sweep(load(instance)), []
    for trust in ("constant", "paper"):
        for graph in ("everybody", "next"):
            for rate in rates:
                seen = Neighbours(rule={"rule": "outcome", "eta_seen": rate}, sees=graph)
                setting = Setting(c_suggest=0.5, c_move=0.1, knowledge="exact", trust=trust, neighbours=seen)
                pool = Pool.sample(task, 24, seed=1, setting=setting)
                for people in sizes:
                    rows.append(
                        {"trust": trust, "graph": graph, "rate": rate, "people": people}
                        | _differences(pool, people, episodes)
                    )
                    click.echo("  ".join(show(rows[-1]) for show in COMPARED.values()))
    if figure is not None:
        _drawn(rows, figure)
    write_record(record, COMPARED, rows)


def _differences(pool: Pool, people: int, episodes: int) -> dict[str, Any]:
    """Return what policies gain over attention, in return per person, with standard errors."""
    blind = Blind(Priority.of(pool.policies, pool.setting.travel(people)))
    seen = replace(pool.setting.neighbours, known=False)  # type: ignore[type-var]
    ignorant = pool.under(replace(pool.setting, neighbours=seen))
    found = {
        name: simulate(one, policy, humans=people, episodes=episodes, seed=0)
        for name, one, policy in (
            ("attention", pool, "attention"), ("outlook", pool, "attention-outlook"), ("priority", pool, "priority"),
            ("blind", pool, blind), ("ignorant", ignorant, "attention"),
        )
    }  # fmt: skip
    base = found["attention"]
    row = {"attention": float(base.discounted_return.mean()) / people, "suggestions": float(base.interventions.mean())}
    row["told"] = float(found["outlook"].interventions.mean())
    for name, one in found.items():
        if name != "attention":
            more = (one.discounted_return - base.discounted_return) / people
            row |= {name: float(more.mean()), f"{name}_se": float(more.std(ddof=1) / np.sqrt(len(more)))}
    return row


def _drawn(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw what an outlook gains, over team sizes, for each rate and graph."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True, layout="constrained")
    colors = dict(zip(sorted({row["rate"] for row in rows}), ("#56B4E9", "#0072B2", "#332288"), strict=False))
    for axis, trust in zip(axes, ("constant", "paper"), strict=True):
        for (rate, color), graph in ((one, graph) for one in colors.items() for graph in ("everybody", "next")):
            those = [row for row in rows if (row["trust"], row["rate"], row["graph"]) == (trust, rate, graph)]
            axis.errorbar(
                [row["people"] for row in those], [row["outlook"] for row in those],
                [1.96 * row["outlook_se"] for row in those], color=color, capsize=2,
                marker="o" if graph == "everybody" else "^", linestyle="-" if graph == "everybody" else "--",
                label=f"rate {rate:g}, {graph}",
            )  # fmt: skip
        axis.axhline(0, color="#8C8C8C", linewidth=0.8)
        axis.set_xlabel("people")
        axis.set_title("own theta stays" if trust == "constant" else "own theta moves by equation (7)", fontsize=10)
    axes[0].set_ylabel("gain of attention-outlook over attention\n(return per person, cost units)", fontsize=9)
    axes[1].legend(fontsize=8, frameon=False)
    figure.savefig(file)


class ToAnybody:
    """Suggests an optimal action to a random person in each step."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return a suggestion."""
        actions = np.ones(team.x.shape, dtype=np.int64)
        for group, rows in team.by_policy():
            actions.reshape(-1)[rows] = team.policies[group].pomdp.robot_actions[team.x.reshape(-1)[rows]]
        person = np.where(team.active, self.rng.random(team.x.shape), -1.0).argmax(axis=1)
        return team.act(person[:, None], self.rng.integers(1, actions.clip(2)))


@main.command()
@click.option("--populations", type=click.IntRange(1), default=10, show_default=True)
@click.option("--instance", default="kitting/paper", show_default=True)
@click.option("--people", "sizes", type=int, multiple=True, default=(10, 30, 100), show_default=True)
@click.option("--tasks", "counts", type=int, multiple=True, default=(2, 8), show_default=True, help="Of each person.")
@click.option("--rate", "rates", type=float, multiple=True, default=(0.1,), show_default=True)
@click.option("--sigma", type=float, default=0.0, show_default=True, help="By how much people misjudge costs.")
@record_option
@more_option
def recovery(
    populations: int, instance: str, sizes: tuple[int, ...], counts: tuple[int, ...], rates: tuple[float, ...],
    sigma: float, record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Fit the rate to logs of simulated teams of three who all see each other."""
    task, rows = sweep(load(instance)), []
    for rate in rates:
        for people in sizes:
            for tasks in counts:
                rows.append({"true": rate, "sigma": sigma, "people": people, "populations": populations}
                            | _recovered(task, rate, sigma, people, tasks, populations))  # fmt: skip
                click.echo("  ".join(show(rows[-1]) for show in RECOVERED.values()))
    write_record(record, RECOVERED, rows, more=more)


def _recovered(
    task: Any, rate: float, sigma: float, people: int, tasks: int, populations: int
) -> dict[str, Any]:  # fmt: skip
    """Return how well a rate is found again from the logs of some populations."""
    neighbours = Neighbours(rule=SeenOutcome(rate), sees="everybody")
    setting = Setting(
        c_suggest=0.0, c_move=0.0, knowledge="exact", trust="constant", max_steps=60, neighbours=neighbours
    )
    population = Population(beta=(0.3, 2.0), theta=(0.3, 0.9), sigma=(sigma, sigma))
    families = seen_families(constant())
    estimates, inside, found, chosen, told, saw = ([] for _ in range(6))
    for number in range(populations):
        pool, trace = Pool.sample(task, people, seed=number, setting=setting, population=population), Trace()
        order = np.random.default_rng(number).permuted(np.tile(np.arange(people), (tasks, 1)), axis=1)
        teams = order[:, : people // 3 * 3].reshape(-1, 3)
        _ = simulate(pool, ToAnybody(number), humans=teams, episodes=len(teams), seed=number, trace=trace)
        log = with_neighbours(replayed(task, trace), neighbours)
        fit = fit_influence(log, families["outcome"], carry=False)
        low, high = fit.intervals["eta_seen"]
        estimates.append(fit.parameters["eta_seen"])
        inside.append(low <= rate <= high)
        found.append(low > 0)
        told.append(np.mean([(o.suggested >= 0).sum() for o in log]))
        saw.append(np.mean([len(o.seen.gain) for o in log]))
        some = {name: families[name] for name in ("none", "outcome", "followed")}
        chosen.append(compare_rules(log, rules=some, folds=2, carry=False).best.model == "outcome")
    return {
        "suggestions": float(np.mean(told)), "seen": float(np.mean(saw)), "mean": float(np.mean(estimates)),
        "sd": float(np.std(estimates, ddof=1)) if populations > 1 else 0.0, "inside": 100 * float(np.mean(inside)),
        "found": 100 * float(np.mean(found)), "chosen": 100 * float(np.mean(chosen)),
    }  # fmt: skip


if __name__ == "__main__":
    main()
