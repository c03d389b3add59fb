"""The command `bound`: an upper bound on the value of every team policy, and the gap of given policies to it."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from planner.batch.results_folder import versions
from planner.system.progress import stages

from ..declare.declared import Whole
from ..declare.options import Value
from .options.common import gap_option, jobs_option, json_option, time_limit_option
from .options.goals import check_questions
from .options.help import command
from .options.policies import policies_of, policy_errors
from .options.team import TeamOptions, team_of, team_options
from .terminal.console import end_after_showing, kept_if_interrupted, print_json, print_table

if TYPE_CHECKING:
    from ..certify.certificate import Certificate


@command("bound kitting/paper --humans 4 --policy priority")
@click.option(
    "--value-episodes", type=Value(Whole, ge=2, le=1e8), default=20_000, show_default=True,
    help="Simulated episodes that estimate each policy's value.",
)  # fmt: skip
@gap_option
@time_limit_option
@click.option(
    "--samples", type=Value(Whole, ge=0), default=0, show_default=True,
    help="Number of sample paths for a tighter bound (95 % confidence; at least 30).",
)  # fmt: skip
@jobs_option
@team_options
@json_option
def bound(
    team: TeamOptions, value_episodes: int, gap: float, time_limit: float, samples: int, jobs: int | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Compute an upper bound on the value of any policy for a team of K people, and the gap of policies to it."""
    from ..certify.comparison import Comparison
    from ..certify.computation import InterruptedBound
    from ..certify.information_relaxation.confidence import CONFIDENCE
    from ..declare.declared import plain
    from .output.person_bounds import show_samples

    start = time.perf_counter()
    setting, seed = team.setting, team.seed
    check_questions(setting, team.given, team.problems)
    team.given.refuse(("goal_knowledge", "max_steps", "observation", "c_ask", "ask_error", "reasons"), "on a bound")
    if samples and team.problems:
        raise click.UsageError("--samples with --goals: expected people whose goal is known")
    with policy_errors():
        policies = policies_of(team.policy)
        goals = team.goals()
        made = team_of(team, team.humans, goals)
        try:
            with stages(within=time_limit) as show:
                ready = {name: made.prepared(one) for name, one in policies.items()}
                compared = Comparison.of(
                    made.pool, ready, progress=show,
                    time_limit=max(1e-3, start + time_limit - time.perf_counter()), episodes=value_episodes,
                    seed=seed, travel=made.travel, gap=gap, paths=samples, jobs=jobs,
                    memory_limit_mb=setting.memory_limit, first=_show_first,
                )  # fmt: skip
                with kept_if_interrupted(lambda: True):
                    compared.simulate(show)
        except InterruptedBound as interrupted:
            end_after_showing(interrupted)
            _show_alone(interrupted.upper, interrupted.bounded, interrupted.people, as_json=as_json)
            return
    found, certificates = compared.bound, compared.certificates()
    if not certificates:
        _show_alone(found.upper, len(found.team), len(found.team), as_json=as_json)
        return
    best = max(certificates, key=lambda certificate: certificate.value)
    sampled = samples and made.pool.setting.fleet.scarce_for(len(found.team))
    if as_json:
        if sampled and found.sampled is None:
            show_samples(found, err=True)
        print_json({
            "instance": str(made.instance.problem), "domain": str(made.instance.domain), **asdict(best),
            **({"goals": dict(goals.prior)} if goals else {}),
            "policies": [asdict(certificate) for certificate in certificates], "upper_seen": found.upper_seen,
            "upper_proven": found.proven, "sampled": found.sampled and asdict(found.sampled),
            "confidence": CONFIDENCE if found.sampled and found.sampled.enough else 1.0,
            "price": found.price.tolist(), "seconds": found.seconds, "setting": plain(made.pool.setting),
            "population": plain(made.population), "seed": seed, "versions": versions(),
        })  # fmt: skip
        return
    print_table(("policy", "value", "upper bound", "gap at most"), map(_cells, certificates))
    if math.isinf(found.slack):
        rest = "with neighbours, it is not known how much an exact solution would lower the gap"
    else:
        rest = "solving each person's problem exactly would lower the gap by at most "
        rest += f"{best.slack_percent:.2f} percentage points"
    fewer = "" if best.episodes >= value_episodes else f" of {value_episodes}, as the time was up,"
    click.echo(
        f"mean ± standard error over {best.episodes} episodes{fewer} with people drawn from the robot's prior, so that "
        f"values differ from those of `simulate`; gaps in percent of the value; {rest}"
    )
    for c in certificates:
        if c.above:
            click.echo(
                f"{c.policy}: the mean is more than three standard errors above the bound, which no policy's value "
                "exceeds; more --value-episodes"
            )
    if sampled:
        show_samples(found)


def _cells(found: Certificate) -> list[str]:
    """Return the row of a policy."""
    return [found.policy, f"{found.value:.3f} ± {found.value_stderr:.3f}", f"{found.upper:.3f}", found.gap]


def _show_first(certificates: list[Certificate]) -> None:
    """Print certificates with a looser bound on stderr, as the others may take minutes."""
    for c in certificates:
        click.echo(
            f"a first answer, {c.policy}: value {c.value:.3f} ± {c.value_stderr:.3f}, upper bound {c.upper:.3f} with "
            f"free attention and what is hidden known: gap at most {c.gap}; a tighter bound follows",
            err=True,
        )  # fmt: skip


def _show_alone(upper: float, bounded: int, people: int, *, as_json: bool) -> None:
    """Print the bound of a command that was interrupted before any policy was simulated."""
    if as_json:
        print_json({"upper": upper, "people_bounded": bounded, "people": people, "policies": []})
        return
    free = "" if bounded == people else ", with free attention for the others, whose problems have not been bounded"
    click.echo(f"upper bound {upper:.3f}, from the problems of {bounded} of {people} people{free}")
