"""The command `simulate`, which compares team policies on the same people and random numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from planner.batch.results_folder import versions
from planner.system.files import write_records
from planner.system.limits import processors
from planner.system.progress import stages

from ..declare.declared import Count
from ..declare.options import Given, Value
from .options.common import OUTPUT_FILE, baseline_option, jobs_option, json_option, out_option, separate_files, together
from .options.goals import check_questions
from .options.help import command
from .options.policies import baseline_among, policies_of, policy_errors
from .options.team import TeamOptions, team_of, team_options
from .terminal.console import kept_if_interrupted, print_json, print_table

if TYPE_CHECKING:
    from ..studies.reports.compared_policies import ComparedPolicy, PolicyComparison


class Written(NamedTuple):
    """What is written, and where."""

    out: Path | None
    trace: Path | None
    figure: Path | None

    def require(self, given: Given[Any]) -> None:
        """Refuse files that are not apart from each other and the inputs, and reasons without a trace."""
        from ..drawing.plots import style

        separate_files({"--out": self.out, "--trace": self.trace, "--figure": self.figure}, given.files())
        if self.trace is None:
            given.refuse(["reasons"], "without --trace")
        if self.figure:
            style.require()
            if self.figure.suffix not in style.FORMATS:
                formats = ", ".join(style.FORMATS)
                raise click.UsageError(f"--figure {self.figure}: expected a name that ends in {formats}")


written_options = together(
    "files", Written,
    (
        out_option("one record per episode (JSON Lines)"),
        click.option("--trace", type=OUTPUT_FILE, help="Write every action of every person (JSON Lines)."),
        click.option(
            "--figure", type=OUTPUT_FILE,
            help="Plot an episode that the last policy shortened (.png, .svg); Python's compare() plots all policies.",
        ),
    ),
)  # fmt: skip


@command("simulate kitting/paper --humans 4 --policy none --policy attention")
@click.option("--episodes", type=Value(Count), default=100, show_default=True, help="Number of episodes.")
@click.option(
    "--pool", "size", type=Value(Count),
    help="Number of people from whom teams are drawn.  [default: 12, or K if larger]",
)  # fmt: skip
@baseline_option
@written_options
@jobs_option
@team_options
@json_option
def simulate(
    team: TeamOptions, files: Written, episodes: int, size: int | None, baseline: str | None, jobs: int | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Simulate a team of people and a robot that assists them, and compare policies."""
    from ..declare.declared import plain
    from ..drawing.plots import style
    from ..drawing.plots.episode import episode_figure
    from ..live.trace_reasons import TraceReasons
    from ..studies.reports.compared_policies import comparison_of
    from ..team.episodes import Episodes
    from ..team.illustration import Illustration
    from ..team.policies import UserPolicy
    from ..team.simulate import simulate as run

    setting, humans, seed = team.setting, team.humans, team.seed
    check_questions(setting, team.given, team.problems)
    size = size or max(12, humans)
    if setting.observation is not None:
        unclear = "with observation: expected actions that are all seen as they are"
        if setting.c_ask is not None:
            raise click.UsageError(f"c_ask {unclear}")
        if "rollout" in team.policy:
            raise click.UsageError(f"--policy rollout {unclear}, or another policy, such as priority")
        if team.problems and setting.goal_knowledge == "likeliest":
            raise click.UsageError("goal_knowledge likeliest with observation: expected inferred or known")
    files.require(team.given)
    with policy_errors():
        policies, results = policies_of(team.policy), list[Episodes]()
        base = baseline_among(policies, baseline)
        goals = team.goals()
        made = team_of(team, size, goals)
        options: dict[str, Any] = {
            "humans": humans, "seed": seed, "travel": made.travel, "goals": setting.goal_knowledge,
        }  # fmt: skip
        steps: list[Any] = []
        kept: dict[str, Any] = {"trace": steps if files.trace else None, "memory_limit_mb": setting.memory_limit}
        kept["reasons"] = TraceReasons(made.pool.policies, made.known) if setting.reasons else None
        ready = {name: made.prepared(one) for name, one in policies.items()}
        with kept_if_interrupted(lambda: results):
            for name, one in ready.items():
                written = len(steps)
                try:
                    with stages() as show:
                        kept |= {"episodes": episodes, "name": name, "progress": show}
                        # The user's own policy need not be ready for threads.
                        kept["jobs"] = 1 if isinstance(one, UserPolicy) else jobs or processors()
                        results.append(run(made.pool, one, **kept, **options))
                except KeyboardInterrupt:
                    del steps[written:]  # of a policy that is not shown
                    raise
            if files.figure:
                shown = Illustration.of(made.pool, one, results[-1], **options)
                alone = None if name == "none" else shown.alone
                style.save(episode_figure(shown.episode, shown.trace, alone, shown.links), files.figure)
    if files.out:
        write_records(files.out, (episode.record() for result in results for episode in result))
    if files.trace:
        write_records(files.trace, steps)
    base = base if base in [result.policy for result in results] else results[0].policy  # which an interrupt left out
    compared, drawn = comparison_of(results, baseline=base), len(set(results[0].people.ravel().tolist()))
    if as_json:
        print_json({
            "instance": str(made.instance.problem), "domain": str(made.instance.domain), "humans": humans,
            "pool": size, "drawn": drawn, "episodes": episodes, "seed": seed,
            "setting": plain(made.pool.setting), "population": plain(made.population),
            **({"goals": dict(goals.prior), "goal_knowledge": setting.goal_knowledge} if goals else {}),
            "baseline": base, "policies": [one.summary.record() | _difference(one) for one in compared],
            "versions": versions(),
        })  # fmt: skip
    else:
        _show(compared, drawn, size)


def _show(found: PolicyComparison, drawn: int, pool: int) -> None:
    """Print what policies led to, and how they differ; and how many people of the pool were in a team."""
    print_table(*found.means())
    click.echo(found.note() if drawn == pool else f"{found.note()}; {drawn} of {pool} people drawn")
    for line in found.notes():
        click.echo(f"{line} (--c-suggest)")
    for row in found:
        if row.summary.questions is not None:
            click.echo(f"{row.policy}: {row.summary.questions:.2f} questions per episode")
    if len(found) > 1 and found[0].summary.episodes > 1:
        click.echo()
        print_table(*found.differences())


def _difference(one: ComparedPolicy) -> dict[str, Any]:
    """Return a policy's differences to the baseline as plain data, named as its means."""
    from ..team.episodes import SHOWN

    found = one.differences
    return {"differences": found and {SHOWN[name]: estimate.record() for name, estimate in found.items()}}
