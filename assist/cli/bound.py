"""The command `bound`: how far a team policy is from the best, at most."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import click
from rich.table import Table

from planner.solving import versions

from ..team.policies import POLICIES
from .console import one_line_errors, print_json, print_table
from .options import GAP, JOBS, SECONDS, instance_argument, json_option
from .progress import stages
from .team import team_of, team_options


@click.command()
@instance_argument
@click.option(
    "--policy", "names", type=click.Choice(POLICIES), multiple=True, default=("attention",), show_default=True,
    help="Team policy; repeat it to certify several with the same bound.",
)  # fmt: skip
@click.option(
    "--episodes",
    type=click.IntRange(min=2),
    default=20_000,
    show_default=True,
    help="From which its value is estimated.",
)
@click.option(
    "--gap", type=GAP, default=1e-3, show_default=True,
    help="Relative gap to which each person's problem is solved.",
)  # fmt: skip
@click.option(
    "--time-limit", type=SECONDS, default=60.0, show_default=True, metavar="S",
    help="Seconds for each of these.",
)  # fmt: skip
@click.option("--jobs", type=JOBS, help="Problems solved at a time; as many as processors unless given.")
@team_options
@json_option
def bound(
    instance: str,
    names: tuple[str, ...],
    episodes: int,
    gap: float,
    time_limit: float,
    jobs: int | None,
    as_json: bool,
    **team: Any,
) -> None:
    """Bound what any policy gets with a team of K people, and certify a policy's distance from it."""
    from ..certify.bound import upper_bound

    humans, seed = team["humans"], team["seed"]
    with one_line_errors():
        made = team_of(instance, size=humans, **team)
        with stages() as show:
            found = upper_bound(
                made.pool, travel=made.travel, gap=gap, time_limit=time_limit, seed=seed, jobs=jobs, progress=show
            )
            certificates = []
            for done, name in enumerate(dict.fromkeys(names)):
                show("simulating policies", done, len(names))
                policy = made.pool.policy(name, made.travel)
                certificates.append(found.certify(policy, name, episodes=episodes, seed=seed))
    best = max(certificates, key=lambda certificate: certificate.value)
    if as_json:
        print_json(
            {
                "instance": str(made.instance.problem),
                "domain": str(made.instance.domain),
                **asdict(best),
                "policies": [asdict(certificate) for certificate in certificates],
                "upper_seen": found.upper_seen,
                "price": found.price.tolist(),
                "seconds": found.seconds,
                "setting": asdict(made.pool.setting),
                "population": asdict(made.population),
                "seed": seed,
                "versions": versions(),
            }
        )
        return
    table = Table(box=None, pad_edge=False)
    for column in ("policy", "value", "upper bound", "gap at most"):
        table.add_column(column, justify="left" if column == "policy" else "right")
    for c in certificates:
        table.add_row(c.policy, f"{c.value:.3f} ± {c.value_stderr:.3f}", f"{c.upper:.3f}", f"{c.gap_percent:.2f} %")
    print_table(table)
    click.echo(
        f"mean ± standard error over {episodes} episodes; the solver of single people's problems accounts for "
        f"{best.slack_percent:.2f} % of the gap"
    )
