"""The command `simulate`, which compares team policies on the same people and random numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from planner.batch.solve_record import versions
from planner.system import files
from planner.system.machine import processors
from planner.system.progress import stages

from .options.common import JOBS, OUTPUT_FILE, instance_argument, json_option, refuse_unused, separate_files
from .options.goals import goal_knowledge_option, goal_list_options, question_options, questions_of, several_goals
from .options.help import command
from .options.person import observation_options
from .options.policies import policies_of, policy_errors, policy_option
from .options.team import team_of, team_options
from .terminal.console import kept_if_interrupted, print_json


@command("simulate kitting/paper --humans 4 --policy none --policy attention")
@instance_argument
@policy_option("Repeat it to compare several.")
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True, help="Number of episodes.")
@click.option(
    "--pool", "size", type=click.IntRange(min=1),
    help="Number of people from whom teams are drawn.  [default: 12, or K if larger]",
)  # fmt: skip
@click.option("--out", type=OUTPUT_FILE, help="Write one record per episode (JSON Lines).")
@click.option("--trace", type=OUTPUT_FILE, help="Write every action of every person (JSON Lines).")
@click.option("--reasons", is_flag=True, help="Explain each suggestion in the trace.")
@click.option("--figure", type=OUTPUT_FILE, help="Plot an episode that the last policy shortened (.png, .svg).")
@click.option(
    "--max-steps",
    type=click.IntRange(min=1),
    default=500,
    show_default=True,
    help="Steps after which an episode is cut off.",
)
@click.option("--jobs", type=JOBS, help="Number of threads. One for each processor unless given.")
@observation_options
@team_options
@goal_list_options
@goal_knowledge_option
@question_options
@json_option
def simulate(
    instance: str, names: tuple[str, ...], episodes: int, size: int | None, out: Path | None, trace: Path | None,
    reasons: bool, figure: Path | None, jobs: int | None, as_json: bool, problems: tuple[str, ...],
    goal_prior: tuple[str, ...], goal_knowledge: str, miss: float, confusion: float, ask: float | None,
    ask_error: float, **team: Any,
) -> None:  # fmt: skip
    """Simulate a team of people and a robot that assists them, and compare policies."""
    from ..declare.declared import plain
    from ..live.trace_reasons import TraceReasons
    from ..person.observation_model import ObservationModel
    from ..plots import style
    from ..plots.episode import episode_figure
    from ..reports.policy_comparison import comparison_of
    from ..simulation.episode import plain_summary
    from ..simulation.episodes import Episodes
    from ..simulation.illustration import Illustration
    from ..simulation.pool import MAX_ENUMERATED
    from ..simulation.simulate import simulate as run
    from ..team.policies import UserPolicy
    from .output.episode_summaries import show_comparison

    if not problems:
        refuse_unused(["goal_knowledge"], "without --goals")
    size = size or max(12, team["humans"])
    team |= questions_of(ask, ask_error, problems)
    team["observation"] = ObservationModel(miss, confusion)
    for option, value in {"--miss": miss, "--confusion": confusion}.items():
        if value and ask is not None:
            raise click.UsageError(f"--ask with {option}: a simulated robot asks only where it sees all actions")
        if value and "rollout" in names:
            raise click.UsageError(
                f"--policy rollout with {option}: it simulates from states that the robot knows; expected another "
                "policy, such as priority"
            )
        if value and problems and goal_knowledge == "likeliest":
            raise click.UsageError(f"--goal-knowledge likeliest with {option}: expected inferred or known")
    separate_files({"--out": out, "--trace": trace, "--figure": figure}, {"--population": team["population_file"]})
    if reasons and trace is None:
        raise click.UsageError("--reasons: expected --trace, too")
    if figure:
        style.require()
        if figure.suffix not in style.FORMATS:
            raise click.UsageError(f"--figure {figure}: expected a name that ends in {', '.join(style.FORMATS)}")
    with policy_errors():
        policies, results = policies_of(names), list[Episodes]()
        goals = several_goals(
            instance, problems, goal_prior, domain=team["domain"], max_states=team["max_states"],
            asked=None if ask is None else MAX_ENUMERATED,
        )  # fmt: skip
        made = team_of(instance, size=size, goals=goals, **team)
        options = {"humans": team["humans"], "seed": team["seed"], "travel": made.travel, "goals": goal_knowledge}
        steps: list[Any] = []
        kept: dict[str, Any] = {"trace": steps if trace else None, "memory_limit_mb": team["memory_limit"]}
        kept["reasons"] = TraceReasons(made.pool.policies, made.known) if reasons else None
        ready = {name: made.prepared(policy) for name, policy in policies.items()}
        with kept_if_interrupted(lambda: results):
            for name, policy in ready.items():
                written = len(steps)
                try:
                    with stages() as show:
                        kept |= {"episodes": episodes, "name": name, "progress": show}
                        # The user's own policy need not be ready for threads.
                        kept["jobs"] = 1 if isinstance(policy, UserPolicy) else jobs or processors()
                        results.append(run(made.pool, policy, **kept, **options))
                except KeyboardInterrupt:
                    del steps[written:]  # of a policy that is not shown
                    raise
            if figure:
                shown = Illustration.of(made.pool, policy, results[-1], **options)
                alone = None if name == "none" else shown.alone
                style.save(episode_figure(shown.episode, shown.trace, alone), figure)
    if out:
        files.write_records(out, (episode.record() for result in results for episode in result))
    if trace:
        files.write_records(trace, steps)
    summaries, drawn = [result.summary() for result in results], len(set(results[0].people.ravel().tolist()))
    if as_json:
        print_json({
            "instance": str(made.instance.problem), "domain": str(made.instance.domain), "humans": team["humans"],
            "pool": size, "drawn": drawn, "episodes": episodes, "seed": team["seed"],
            "setting": plain(made.pool.setting), "population": plain(made.population),
            **({"goals": dict(goals.prior), "goal_knowledge": goal_knowledge} if goals else {}),
            "policies": [plain_summary(summary) for summary in summaries], "versions": versions(),
        })  # fmt: skip
    else:
        show_comparison(comparison_of(results), drawn, size)
