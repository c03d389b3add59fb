"""The price of honesty: the value of one person's assistance with optimal suggestions only, and with all suggestions.

    python bench/honesty.py [--quick] [--instances a,b] [--gammas ...] [--costs ...] [--sigmas ...] [--etas ...]
                            [--gap G] [--time-limit S] [--record FILE [--more]]

A case consists of a kitting instance, the population's range of theta, the rate eta of the trust update, gamma,
c_suggest, and the sigma of the person's misconception, which the robot knows. The table, which `--record` writes for
the documentation, contains the bounds of both values in the initial state. It also contains the price (the loss with
optimal suggestions only), its share of the return, and whether a positive price is proven.

Every policy with optimal suggestions only is also a policy with all suggestions. The lower bound of the former and the
upper bound of the latter are therefore valid for both, and each pair of bounds tightens the other.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import click
import numpy as np
from tables import Columns, cell, more_option, record_option, write_record

from assist.people.choices import Choices
from assist.people.human import Human, HumanModel
from assist.people.misconception import perceived_cost_to_go
from assist.people.ranges import Population
from assist.person.pomdp import AssistPOMDP
from assist.person.robots import Suggestions
from assist.person.solver import solve
from planner import Instance, load, sweep

KITTING = Path(__file__).resolve().parent.parent / "domains" / "kitting"
COLUMNS: Columns = {
    name: cell(name)
    for name in (
        "task", "theta", "eta", "gamma", "c_suggest", "sigma", "optimal", "all", "price", "of the return", "proven",
    )
}  # fmt: skip
THETAS = ((0.05, 0.5), (0.5, 0.95))


@click.command()
@click.option("--quick", is_flag=True, help="Only two cases of each instance.")
@click.option("--instances", default="paper-fixed,paper", show_default=True)
@click.option("--etas", default="0.2,0", show_default=True)
@click.option("--gammas", default="0.99,0.95", show_default=True)
@click.option("--costs", default="0.05,0.2,0.5,1", show_default=True, help="Values of c_suggest.")
@click.option("--sigmas", default="0,0.5,1", show_default=True)
@click.option("--gap", default=5e-4, show_default=True, help="Stop at this relative gap.")
@click.option("--time-limit", default=10.0, show_default=True, help="Seconds for each search.")
@record_option
@more_option
def main(
    quick: bool, instances: str, etas: str, gammas: str, costs: str, sigmas: str, gap: float, time_limit: float,
    record: Path | None, more: bool,
) -> None:  # fmt: skip
    """Print the table."""
    print(*COLUMNS, sep=" | ")
    rows = []
    values = [[float(value) for value in values.split(",")] for values in (etas, gammas, costs, sigmas)]
    if quick:
        values = [[0.2], [0.95], [0.2], [0.5]]
    for name in instances.split(","):
        choices = Choices.of(sweep(load(Instance(KITTING / f"{name}.pddl", KITTING / "domain.pddl"))))
        for theta, eta, gamma, c_suggest, sigma in itertools.product(THETAS, *values):
            h = perceived_cost_to_go(choices, sigma, np.random.default_rng(0))
            model = HumanModel.own(choices, Human(1.0, 0.5, sigma, h), eta=eta)  # only h is used

            def bounds(suggestions: Suggestions, model=model, theta=theta, gamma=gamma, c=c_suggest):
                pomdp = AssistPOMDP.of(
                    model, population=Population(theta=theta), gamma=gamma, c_suggest=c, suggestions=suggestions
                )
                solution = solve(pomdp, gap=gap, time_limit=time_limit)
                return solution.lower, solution.upper

            (some_lower, some_upper), (all_lower, all_upper) = bounds("optimal"), bounds("all")
            some_upper, all_lower = min(some_upper, all_upper), max(all_lower, some_lower)
            least, most = max(all_lower - some_upper, 0.0), all_upper - some_lower
            # The return is negative, so the smallest share refers to the lowest value with optimal suggestions.
            shares = 100 * least / -some_lower, 100 * most / -some_upper
            rows.append(
                {"task": name, "theta": f"{theta[0]:g} to {theta[1]:g}", "eta": f"{eta:g}", "gamma": f"{gamma:g}",
                 "c_suggest": f"{c_suggest:g}", "sigma": f"{sigma:g}",
                 "optimal": f"{some_lower:.3f} to {some_upper:.3f}", "all": f"{all_lower:.3f} to {all_upper:.3f}",
                 "price": f"{least:.3f} to {most:.3f}", "of the return": f"{shares[0]:.2f} to {shares[1]:.2f} %",
                 "proven": "yes" if least else "no"}
            )  # fmt: skip
            print(*rows[-1].values(), sep=" | ", flush=True)
    write_record(record, COLUMNS, rows, more=more)


if __name__ == "__main__":
    main()
