"""The command `simulate`, which compares team policies on the same people and random numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from planner.batch.results_folder import versions
from planner.system import files
from planner.system.limits import processors
from planner.system.progress import stages

from ..declare.options import Given
from .options.common import OUTPUT_FILE, instance_argument, jobs_option, json_option, out_option, separate_files
from .options.goals import check_questions, goals_option, several_goals
from .options.help import command
from .options.policies import policies_of, policy_errors, policy_option
from .options.settings import TeamSetting
from .options.team import team_of, team_options
from .terminal.console import kept_if_interrupted, print_json


@command("simulate kitting/paper --humans 4 --policy none --policy attention")
@instance_argument
@policy_option(several=True)
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True, help="Number of episodes.")
@click.option(
    "--pool", "size", type=click.IntRange(min=1),
    help="Number of people from whom teams are drawn.  [default: 12, or K if larger]",
)  # fmt: skip
@out_option("one record per episode (JSON Lines)")
@click.option("--trace", type=OUTPUT_FILE, help="Write every action of every person (JSON Lines).")
@click.option("--reasons", is_flag=True, help="Explain each suggestion in the trace.")
@click.option("--figure", type=OUTPUT_FILE, help="Plot an episode that the last policy shortened (.png, .svg).")
@jobs_option
@team_options
@goals_option
@json_option
def simulate(
    instance: str, policy: tuple[str, ...], episodes: int, size: int | None, out: Path | None, trace: Path | None,
    reasons: bool, figure: Path | None, jobs: int | None, as_json: bool, problems: tuple[str, ...], humans: int,
    seed: int, domain: str | None, setting: TeamSetting, given: Given[TeamSetting],
) -> None:  # fmt: skip
    """Simulate a team of people and a robot that assists them, and compare policies."""
    from ..declare.declared import plain
    from ..live.trace_reasons import TraceReasons
    from ..plots import style
    from ..plots.episode import episode_figure
    from ..reports.policy_comparison import comparison_of
    from ..simulation.episode import plain_summary
    from ..simulation.episodes import Episodes
    from ..simulation.illustration import Illustration
    from ..simulation.simulate import simulate as run
    from ..team.policies import UserPolicy
    from .output.episode_summaries import show_comparison

    check_questions(setting, given, problems)
    size = size or max(12, humans)
    if setting.observation is not None:
        unclear = "with observation: expected actions that are all seen as they are"
        if setting.c_ask is not None:
            raise click.UsageError(f"c_ask {unclear}")
        if "rollout" in policy:
            raise click.UsageError(f"--policy rollout {unclear}, or another policy, such as priority")
        if problems and setting.goal_knowledge == "likeliest":
            raise click.UsageError("goal_knowledge likeliest with observation: expected inferred or known")
    separate_files({"--out": out, "--trace": trace, "--figure": figure}, given.files())
    if reasons and trace is None:
        raise click.UsageError("--reasons: expected --trace, too")
    if figure:
        style.require()
        if figure.suffix not in style.FORMATS:
            raise click.UsageError(f"--figure {figure}: expected a name that ends in {', '.join(style.FORMATS)}")
    with policy_errors():
        policies, results = policies_of(policy), list[Episodes]()
        goals = several_goals(
            instance, problems, setting.goal_prior, domain=domain, max_states=setting.max_states
        )  # fmt: skip
        made = team_of(instance, setting, given, humans=humans, size=size, seed=seed, domain=domain, goals=goals)
        options: dict[str, Any] = {
            "humans": humans, "seed": seed, "travel": made.travel, "goals": setting.goal_knowledge,
        }  # fmt: skip
        steps: list[Any] = []
        kept: dict[str, Any] = {"trace": steps if trace else None, "memory_limit_mb": setting.memory_limit}
        kept["reasons"] = TraceReasons(made.pool.policies, made.known) if reasons else None
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
            if figure:
                shown = Illustration.of(made.pool, one, results[-1], **options)
                alone = None if name == "none" else shown.alone
                style.save(episode_figure(shown.episode, shown.trace, alone), figure)
    if out:
        files.write_records(out, (episode.record() for result in results for episode in result))
    if trace:
        files.write_records(trace, steps)
    summaries, drawn = [result.summary() for result in results], len(set(results[0].people.ravel().tolist()))
    if as_json:
        print_json({
            "instance": str(made.instance.problem), "domain": str(made.instance.domain), "humans": humans,
            "pool": size, "drawn": drawn, "episodes": episodes, "seed": seed,
            "setting": plain(made.pool.setting), "population": plain(made.population),
            **({"goals": dict(goals.prior), "goal_knowledge": setting.goal_knowledge} if goals else {}),
            "policies": [plain_summary(summary) for summary in summaries], "versions": versions(),
        })  # fmt: skip
    else:
        show_comparison(comparison_of(results), drawn, size)
