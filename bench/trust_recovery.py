"""Whether trust rules and influence are recovered from logs of simulated people, whose rule is known.

    python bench/trust_recovery.py coverage [--people N] [--populations N] [--suggestions N] [--record FILE]
    python bench/trust_recovery.py choice   [--people N] [--populations N] [--suggestions N] [--record FILE]
    python bench/trust_recovery.py misjudged [--people N] [--populations N] [--record FILE]

logit(theta_0) has mean 0.7 and standard deviation 1.4 over people; log(beta) has mean 0 and standard deviation 0.5.
Half of the actions have a suggestion, and half of the suggestions are optimal choices, the others random ones. People
know the cost-to-go, and theta is carried from episode to episode. `coverage` counts how many 95 % intervals hold the
true value. `choice` counts how often `compare rules` names the true rule.

`misjudged` simulates people who misjudge costs, and whose theta moves by equation (7) and begins anew in each of four
tasks. The rule is fitted as if they knew the costs: with theta that begins anew, and with theta that is carried.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np
from neighbours import ToAnybody
from simulated_people import People, record_with_trust
from tables import cell, record_option, write_record

from assist.learning import Observations, observed, replayed
from assist.learning.held_out import compare_rules
from assist.learning.trust_fit import fit_influence
from assist.people.ranges import Population
from assist.people.trust_rules import (
    LEAST,
    EquationSeven,
    Reliability,
    TrustRule,
    constant,
    outcome,
    outcome_at_disagreement,
)
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.trace import Trace
from planner import CostToGo, cost_to_go, load, sweep

SETTINGS: dict[str, tuple[str, TrustRule]] = {
    "constant": ("constant", constant()),
    "paper, eta .01": ("paper", EquationSeven(0.01)),
    "paper, eta .05": ("paper", EquationSeven(0.05)),
    "outcome, +.05 -.10": ("outcome", outcome(0.05, 0.1)),
    "outcome, +.10 -.20": ("outcome", outcome(0.1, 0.2)),
    "outcome, +.20 -.40": ("outcome", outcome(0.2, 0.4)),
    "at disagreement, +.03 +.10 -.20": ("outcome-at-disagreement", outcome_at_disagreement()),
    "at disagreement, +.06 +.20 -.40": ("outcome-at-disagreement", outcome_at_disagreement(0.06, 0.2, 0.4)),
    "reliability, 20, .05": ("reliability", Reliability(20.0, 0.05)),
    "reliability, 5, .10": ("reliability", Reliability(5.0, 0.1)),
}
"""Rules of the simulated people.

Steps are in log-odds, of agreement, of a right and of a wrong outcome; of reliability, the weight of the initial theta
in outcomes and the share that is forgotten.
"""

UNKNOWN = {("outcome-at-disagreement", "gain")}
"""Parameters that these logs do not depend on.

With unit costs, nobody who knows the costs sees at a disagreement that a suggestion was right.
"""

COVERAGE = {
    "rule": cell("rule"), "populations": cell("populations", ","), "people": cell("people", ","),
    "theta at first (% inside)": cell("theta_first", ".1f"), "theta at last": cell("theta", ".1f"),
    "beta": cell("beta", ".1f"), "parameters": cell("parameters", ".1f"), "intervals": cell("intervals", ","),
    "parameters, mean estimate": cell("estimates"),
}  # fmt: skip
CHOICE = {
    "rule": cell("rule"), "populations": cell("populations", ","), "minus constant": cell("difference", "+.4f"),
    "rightly chosen (%)": cell("right", ".0f"), "chosen": cell("chosen"),
}  # fmt: skip


MISJUDGED = {
    "sigma": cell("sigma", "g"), "populations": cell("populations"), "people": cell("people"),
    "mean theta at first": cell("true", ".2f"), "estimate": cell("theta", ".2f", "theta_sd"),
    "true eta": cell("eta", "g"), "estimate of eta": cell("rate", ".2f", "rate_sd"),
    "estimate, carried": cell("carried", ".2f"), "eta, carried": cell("carried_rate", ".2f"),
    "log likelihood, anew minus carried": cell("gain", ".1f"),
}  # fmt: skip


def drawn(
    answers: CostToGo, rule: TrustRule, people: int, suggestions: int, rng: np.random.Generator
) -> tuple[People, np.ndarray, list[Observations]]:
    """Return people, their theta after the last suggestion, and the observations of what they did."""
    theta = 1 / (1 + np.exp(-rng.normal(0.7, 1.4, people)))
    them = People(np.exp(rng.normal(0.0, 0.5, people)), np.clip(theta, LEAST, 1 - LEAST))
    last = np.empty(people)
    rows = record_with_trust(answers, them, rule, suggestions=suggestions, rng=rng, last=last)
    return them, last, observed(answers, rows)


def sizes(people: int, populations: int) -> Any:
    """Return a decorator that adds the options of both commands."""

    def add(command: Any) -> Any:
        for option in (
            click.option("--people", type=click.IntRange(2), default=people, show_default=True),
            click.option("--populations", type=click.IntRange(1), default=populations, show_default=True),
            click.option(
                "--suggestions", type=click.IntRange(1), default=60, show_default=True, help="To each person."
            ),
            click.option("--instance", default="kitting/paper", show_default=True),
            click.option("--setting", "settings", type=click.Choice(list(SETTINGS)), multiple=True, default=SETTINGS),
            record_option,
        ):
            command = option(command)
        return command

    return add


@click.group()
def main() -> None:
    """Recover trust rules and influence from logs of simulated people."""


@main.command()
@sizes(25, 20)
def coverage(
    people: int, populations: int, suggestions: int, instance: str, settings: tuple[str, ...], record: Path | None
) -> None:
    """Count how many 95 % intervals hold the true value."""
    answers, rows = cost_to_go(load(instance)), []
    for name in settings:
        kind, rule = SETTINGS[name]
        rng = np.random.default_rng(sum(name.encode()))
        inside: dict[str, list[bool]] = {"theta_first": [], "theta": [], "beta": [], "parameters": []}
        estimates: list[list[float]] = []
        for _ in range(populations):
            them, last, observations = drawn(answers, rule, people, suggestions, rng)
            found = fit_influence(observations, kind)
            for k, one in enumerate(found.people):
                for of, true, (low, high) in (
                    ("theta_first", them.theta[k], one.theta_first_interval),
                    ("theta", last[k], one.theta_interval),
                    ("beta", them.beta[k], one.beta_interval),
                ):  # fmt: skip
                    inside[of].append(bool(low - 1e-9 <= true <= high + 1e-9))
            known = [parameter for parameter in found.intervals if (kind, parameter) not in UNKNOWN]
            for parameter in known:
                low, high = found.intervals[parameter]
                inside["parameters"].append(bool(low <= getattr(rule, parameter) <= high))
            estimates.append([found.parameters[parameter] for parameter in known])
        means = ", ".join(f"{p} {v:.3f}" for p, v in zip(known, np.mean(estimates, axis=0).tolist(), strict=True))
        rows.append(
            {"rule": name, "populations": populations, "people": people * populations, "estimates": means or "-"}
            | {"intervals": len(inside["parameters"])}
            | {of: 100 * float(np.mean(those)) if those else float("nan") for of, those in inside.items()}
        )  # fmt: skip
        click.echo("  ".join(show(rows[-1]) for show in COVERAGE.values()))
    write_record(record, COVERAGE, rows)


@main.command()
@sizes(100, 5)
@click.option("--folds", type=click.IntRange(2), default=2, show_default=True)
def choice(
    people: int, populations: int, suggestions: int, instance: str, settings: tuple[str, ...], record: Path | None,
    folds: int,
) -> None:  # fmt: skip
    """Count how often the comparison of rules names the true one."""
    answers, rows = cost_to_go(load(instance)), []
    for name in settings:
        kind, rule = SETTINGS[name]
        rng = np.random.default_rng(sum(name.encode()))
        chosen, differences = [], []
        for _ in range(populations):
            compared = compare_rules(drawn(answers, rule, people, suggestions, rng)[2], folds=folds)
            chosen.append(compared.best.model)
            differences += [row.difference or 0.0 for row in compared.scores if row.model == kind]
        counts = {one: chosen.count(one) for one in sorted(set(chosen))}
        rows.append({
            "rule": name, "populations": populations, "difference": float(np.mean(differences)),
            "right": 100 * float(np.mean([one == kind for one in chosen])),
            "chosen": ", ".join(f"{one} {count}" for one, count in counts.items()),
        })  # fmt: skip
        click.echo("  ".join(show(rows[-1]) for show in CHOICE.values()))
    write_record(record, CHOICE, rows)


@main.command()
@click.option("--people", type=click.IntRange(3), default=30, show_default=True)
@click.option("--populations", type=click.IntRange(2), default=4, show_default=True)
@click.option("--instance", default="kitting/paper", show_default=True)
@record_option
def misjudged(people: int, populations: int, instance: str, record: Path | None) -> None:
    """Fit equation (7) to people who misjudge costs."""
    task, eta, rows = sweep(load(instance)), 0.2, []
    setting = Setting(c_suggest=0.0, c_move=0.0, knowledge="exact", trust="paper", eta=eta, max_steps=60)
    for sigma in (0.0, 0.5, 1.0):
        each = []
        for number in range(populations):
            population = Population(beta=(0.3, 2.0), theta=(0.3, 0.9), sigma=(sigma, sigma))
            pool, trace = Pool.sample(task, people, seed=number, setting=setting, population=population), Trace()
            order = np.random.default_rng(number).permuted(np.tile(np.arange(people), (4, 1)), axis=1)
            teams = order[:, : people // 3 * 3].reshape(-1, 3)
            _ = simulate(pool, ToAnybody(number), humans=teams, episodes=len(teams), seed=number, trace=trace)
            log = replayed(task, trace)
            anew, carried = (fit_influence(log, "paper", carry=carry) for carry in (False, True))
            each.append([
                np.mean([person.theta for person in pool.people]), np.mean([one.theta_first for one in anew.people]),
                anew.parameters["eta"], np.mean([one.theta_first for one in carried.people]),
                carried.parameters["eta"], anew.log_likelihood - carried.log_likelihood,
            ])  # fmt: skip
        mean, sd = np.mean(each, axis=0).tolist(), np.std(each, axis=0, ddof=1).tolist()
        names = ("true", "theta", "rate", "carried", "carried_rate", "gain")
        rows.append(
            {"sigma": sigma, "populations": populations, "people": people, "eta": eta, "theta_sd": sd[1]}
            | {"rate_sd": sd[2]} | dict(zip(names, mean, strict=True))
        )  # fmt: skip
        click.echo("  ".join(show(rows[-1]) for show in MISJUDGED.values()))
    write_record(record, MISJUDGED, rows)


if __name__ == "__main__":
    main()
