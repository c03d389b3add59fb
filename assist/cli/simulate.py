"""The command `simulate`: team policies compared on the same people and luck."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from planner.solving import versions

from ..team.policies import POLICIES
from .console import one_line_errors, print_json, print_table
from .options import OUTPUT_FILE, instance_argument, json_option
from .progress import progress_bar
from .team import team_of, team_options

SHOWN = {
    "actions": "human_actions_per_person",
    "interventions": "interventions",
    "moves": "moves",
    "discounted_return": "return",
}


@click.command()
@instance_argument
@click.option(
    "--policy", "names", type=click.Choice(POLICIES), multiple=True, default=("attention",), show_default=True,
    help="Team policy; repeat it to compare several on the same people and luck.",
)  # fmt: skip
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True)
@click.option(
    "--pool", "size", type=click.IntRange(min=1),
    help="People from whom teams are drawn.  [default: 12, or K if larger]",
)  # fmt: skip
@click.option("--out", type=OUTPUT_FILE, help="Write a record of each episode (JSON Lines).")
@click.option("--trace", type=OUTPUT_FILE, help="Write every action of every person (JSON Lines).")
@click.option(
    "--figure", type=OUTPUT_FILE,
    help="Draw an episode in which the last policy saved actions (.png, .svg or .pdf).",
)  # fmt: skip
@click.option("--max-steps", type=click.IntRange(min=1), default=500, show_default=True, help="Cut an episode off.")
@team_options
@json_option
def simulate(
    instance: str,
    names: tuple[str, ...],
    episodes: int,
    size: int | None,
    out: Path | None,
    trace: Path | None,
    figure: Path | None,
    as_json: bool,
    **team: Any,
) -> None:
    """Simulate a team of people and a robot that assists them."""
    from planner import storage

    from ..plots import style
    from ..plots.episode import episode_figure
    from ..simulation.episodes import Episodes, Trace, illustrative, summarise
    from ..simulation.simulate import simulate as run_episodes

    humans, seed = team["humans"], team["seed"]
    with one_line_errors():
        if figure:
            style.require()
            if figure.suffix not in style.FORMATS:
                raise click.UsageError(f"--figure {figure}: expected a name that ends in {', '.join(style.FORMATS)}")
        size = size or max(12, humans)
        made = team_of(instance, size=size, **team)
        pool = made.pool
        results: list[Episodes] = []
        steps: Trace = []
        run = partial(run_episodes, pool, humans=humans, seed=seed, travel=made.travel)
        for name in dict.fromkeys(names):
            traced: Trace | None = [] if trace else None
            with progress_bar(f"simulating {name}", episodes) as advance:
                results.append(
                    run(pool.policy(name, made.travel), episodes=episodes, name=name, trace=traced, progress=advance)
                )
            steps += traced or []
        if figure:
            alone = run(pool.policy("none"), episodes=episodes)
            shown = illustrative(results[-1], alone)
            pictured: list[Trace] = [[], []]
            for name, trace_of in zip((names[-1], "none"), pictured, strict=True):
                run(pool.policy(name, made.travel), episodes=[shown.episode], trace=trace_of)
            style.save(episode_figure(shown, pictured[0], pictured[1] if names[-1] != "none" else None), figure)
        if out:
            storage.write_records(out, (episode.record() for result in results for episode in result))
        if trace:
            storage.write_records(trace, steps)
    summaries = [summarise(result) for result in results]
    if as_json:
        document = {
            "instance": str(made.instance.problem),
            "domain": str(made.instance.domain),
            "humans": humans,
            "pool": size,
            "episodes": episodes,
            "seed": seed,
            "setting": asdict(pool.setting),
            "population": asdict(made.population),
            "policies": [_summary_record(summary) for summary in summaries],
            "versions": versions(),
        }
        print_json(document)
    else:
        _show_summaries(summaries)


def _summary_record(summary: Any) -> dict[str, Any]:
    record: dict[str, Any] = {"policy": summary.policy, "episodes": summary.episodes}
    for name, label in SHOWN.items():
        mean, error = getattr(summary, name)
        record[label] = {"mean": mean, "stderr": None if error != error else error}
    return {**record, "cut_off": summary.cut_off}


def _show_summaries(summaries: list[Any]) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("policy")
    for label in SHOWN.values():
        table.add_column(label.replace("_", " "), justify="right")
    table.add_column("cut off", justify="right")
    for summary in summaries:
        cells = [f"{mean:.2f} ± {error:.2f}" for mean, error in (getattr(summary, name) for name in SHOWN)]
        table.add_row(summary.policy, *cells, f"{summary.cut_off}")
    print_table(table)
    click.echo(f"mean ± standard error over {summaries[0].episodes} episodes")
