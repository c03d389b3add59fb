"""The command `simulate`: team policies compared on the same people and luck."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from planner.solving import versions

from .console import one_line_errors, print_json, print_table, progress_bar, range_option
from .task import one_instance, table_of

SHOWN = {
    "actions": "human_actions_per_person",
    "interventions": "interventions",
    "moves": "moves",
    "discounted_return": "return",
}


@click.command()
@click.argument("instance", metavar="INSTANCE")
@click.option("--humans", type=click.IntRange(min=1), required=True, metavar="K", help="People in a team.")
@click.option(
    "--policy", "names", type=click.Choice(["none", "reactive", "attention", "attention-never"]), multiple=True,
    default=("attention",),
    show_default=True, help="Team policy; repeat it to compare several on the same people and luck.",
)  # fmt: skip
@click.option("--episodes", type=click.IntRange(min=1), default=100, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--pool",
    "size",
    type=click.IntRange(min=1),
    help="People from whom teams are drawn.  [default: 12, or K if larger]",
)
@click.option("--domain", type=click.Path(), help="Domain file; domain.pddl beside the problem unless given.")
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a record of each episode (JSON Lines)."
)
@click.option(
    "--trace", type=click.Path(dir_okay=False, path_type=Path), help="Write every action of every person (JSON Lines)."
)
@click.option(
    "--figure", type=click.Path(dir_okay=False, path_type=Path),
    help="Draw an episode in which the last policy saved actions (.png, .svg or .pdf).",
)  # fmt: skip
@click.option("--gamma", type=float, default=0.99, show_default=True, help="Discount factor per step.")
@click.option("--c-suggest", type=float, default=1.0, show_default=True, help="Cost of a suggestion.")
@click.option("--c-move", type=float, default=0.5, show_default=True, help="Cost of going to another person.")
@click.option("--eta", type=float, default=0.2, show_default=True, help="Rate of the trust update.")
@click.option(
    "--utility-scale", type=float, default=1.0, show_default=True, help="Cost units that change trust by eta."
)
@click.option(
    "--lapse", type=float, default=1e-3, show_default=True, help="Weight of a uniform choice in the robot's model."
)
@click.option(
    "--knowledge",
    type=click.Choice(["own", "exact"]),
    default="own",
    show_default=True,
    help="What the robot knows of people's perceived costs.",
)
@click.option("--suggestions", type=click.Choice(["optimal", "all"]), default="optimal", show_default=True)
@click.option("--max-steps", type=click.IntRange(min=1), default=500, show_default=True, help="Cut an episode off.")
@range_option("--beta", (0.1, 3.0), "Range of people's expertise.")
@range_option("--theta", (0.5, 0.95), "Range of the robot's influence on them.")
@range_option("--sigma", (0.1, 1.0), "Range of their misconception's size.")
@click.option(
    "--population", "crowd_file", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Draw people from what `fit --population` has written, in place of these three ranges.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
def simulate(
    instance: str,
    humans: int,
    names: tuple[str, ...],
    episodes: int,
    seed: int,
    size: int | None,
    domain: str | None,
    out: Path | None,
    trace: Path | None,
    figure: Path | None,
    beta: tuple[float, float],
    theta: tuple[float, float],
    sigma: tuple[float, float],
    crowd_file: Path | None,
    as_json: bool,
    **setting: Any,
) -> None:
    """Simulate a team of people and a robot that assists them."""
    from planner import storage

    from .. import figures
    from .. import simulate as simulation
    from ..choices import Choices
    from ..human import Mixture, Population
    from ..pool import Pool, Setting

    with one_line_errors():
        found = one_instance(instance, domain)
        if figure:
            figures.require()
            if figure.suffix not in figures.FORMATS:
                raise click.UsageError(f"--figure {figure}: expected a name that ends in {', '.join(figures.FORMATS)}")
        choices = Choices.of(table_of(found))
        try:
            population: Population | Mixture = Population(beta, theta, sigma)
            if crowd_file:
                population = _population(crowd_file)
            chosen = Setting(**setting)
            size = size or max(12, humans)
            with progress_bar("solving people's POMDPs", size if chosen.knowledge == "own" else 1) as advance:
                pool = Pool.sample(
                    choices, size, seed, setting=chosen, population=population, progress=lambda *_: advance(1)
                )
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        if humans > size:
            raise click.UsageError(f"--humans {humans} is more than --pool {size}")
        results: list[simulation.Episodes] = []
        steps: simulation.Trace = []
        run = partial(simulation.simulate, pool, humans=humans, seed=seed)
        for name in dict.fromkeys(names):
            traced: simulation.Trace | None = [] if trace else None
            with progress_bar(f"simulating {name}", episodes) as advance:
                results.append(run(pool.policy(name), episodes=episodes, name=name, trace=traced, progress=advance))
            steps += traced or []
        if figure:
            alone = run(pool.policy("none"), episodes=episodes)
            shown = simulation.illustrative(results[-1], alone)
            pictured: list[simulation.Trace] = [[], []]
            for name, trace_of in zip((names[-1], "none"), pictured, strict=True):
                run(pool.policy(name), episodes=[shown.episode], trace=trace_of)
            figures.save(
                figures.episode_figure(shown, pictured[0], pictured[1] if names[-1] != "none" else None), figure
            )
        if out:
            storage.write_records(out, (episode.record() for result in results for episode in result))
        if trace:
            storage.write_records(trace, steps)
    summaries = [simulation.summarise(result) for result in results]
    if as_json:
        document = {
            "instance": str(found.problem),
            "domain": str(found.domain),
            "humans": humans,
            "pool": size,
            "episodes": episodes,
            "seed": seed,
            "setting": asdict(chosen),
            "population": asdict(population),
            "policies": [_summary_record(summary) for summary in summaries],
            "versions": versions(),
        }
        print_json(document)
    else:
        _show_summaries(summaries)


def _population(file: Path) -> Any:
    """Read a population that `fit` has written."""
    from .. import crowd

    try:
        return crowd.mixture(json.loads(file.read_text(encoding="utf-8")))
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}") from None


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
