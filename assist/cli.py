"""The command `kitassist`: options in, records and tables out. All work is done elsewhere."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

import planner
from planner import (
    Cache,
    CostToGo,
    Instance,
    InstanceError,
    LimitError,
    Limits,
    OnDemand,
    PDDLError,
    cost_to_go,
    find_instances,
    load,
    sweep,
)
from planner.batch import DONE, ResultsExistError, solve_batch
from planner.errors import MissingExtraError
from planner.fast_downward import FastDownwardError
from planner.solving import Record, SolveOptions, versions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .pomdp import AssistPOMDP, Suggestions

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130

SIMULATED_STATES = 200_000  # each person's POMDP takes about 3 KB a state


def fail(message: str, exit_code: int) -> NoReturn:
    """Say in one line on stderr what is wrong, and end."""
    click.echo(message, err=True)
    sys.exit(exit_code)


@contextmanager
def one_line_errors(interrupted: str = "interrupted") -> Iterator[None]:
    """Turn what is wrong with the input into one line and the exit code of the contract."""
    try:
        yield
    except (InstanceError, ResultsExistError) as error:
        fail(str(error), EXIT_USAGE)
    except (PDDLError, LimitError, FastDownwardError, MissingExtraError) as error:
        fail(str(error), EXIT_FAILED)
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}", EXIT_FAILED)
    except KeyboardInterrupt:
        fail(interrupted, EXIT_INTERRUPTED)


class Rate(ProgressColumn):
    """How many are done per second."""

    def render(self, task: Task) -> Text:
        """Give the mean rate since the start."""
        return Text("" if not task.elapsed else f"{task.completed / task.elapsed:.1f}/s")


@contextmanager
def progress_bar(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar with rate and time left on stderr, where that is a terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda count: bar.advance(task, count)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="kitassist")
def main() -> None:
    """Assistance in task planning: whom to help, when, and with which suggestion."""


@main.command()
@click.argument("instances", metavar="INSTANCE...", nargs=-1, required=True)
@click.option("--domain", type=click.Path(), help="Domain file; domain.pddl beside each problem unless given.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for results.jsonl, tables and plans."
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
@click.option(
    "--time-limit", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds for each instance."
)
@click.option(
    "--memory-limit", type=click.FloatRange(min=0, min_open=True), metavar="MB", help="Memory for each instance."
)
@click.option(
    "--max-states", type=click.IntRange(min=1), default=SolveOptions.max_states, show_default=True,
    help="Solve only the initial state of a larger task.",
)  # fmt: skip
@click.option(
    "--verify", type=click.IntRange(min=1), default=SolveOptions.verify, show_default=True,
    help="States to compare with Fast Downward's A*.",
)  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="Solve on the workers of a Dask cluster (extra `cluster`).")
@click.option("--resume", is_flag=True, help="Keep what --out holds as solved or unsolvable.")
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def solve(
    instances: tuple[str, ...],
    domain: str | None,
    out: Path | None,
    jobs: int,
    time_limit: float | None,
    memory_limit: float | None,
    max_states: int,
    verify: int,
    scheduler: str | None,
    resume: bool,
    as_json: bool,
) -> None:
    """Solve PDDL instances: exact cost-to-go of every state, and an optimal plan.

    INSTANCE is a problem file, a folder (all its problems), or a glob.
    """
    if resume and out is None:
        raise click.UsageError("--resume needs --out")
    with one_line_errors("interrupted; what was finished is kept, --resume continues" if out else "interrupted"):
        found = find_instances(instances, domain)
        options = SolveOptions(time_limit, memory_limit, max_states, verify)
        with progress_bar("solving", len(found)) as advance:
            records = solve_batch(
                found, options, out=out, jobs=jobs, resume=resume, scheduler=scheduler, progress=lambda _: advance(1)
            )
    for record in records:
        if record["error"]:
            place = ":".join(str(record["error"][key]) for key in ("file", "line") if record["error"][key] is not None)
            click.echo(f"{place}: {record['error']['message']}", err=True)
        elif record["note"]:
            click.echo(f"{record['instance']}: {record['note']}", err=True)
    if as_json:
        click.echo(json.dumps(records, indent=2))
    elif len(records) > 1 or not records[0]["error"]:
        _show_solutions(records)
    if any(record["status"] not in DONE for record in records):
        sys.exit(EXIT_FAILED)


def _show_solutions(records: list[Record]) -> None:
    if len(records) == 1 and records[0]["plan"] is not None:
        click.echo("\n".join(records[0]["plan"]))
    table = Table(box=None, pad_edge=False)
    table.add_column("instance", overflow="fold")
    table.add_column("status")
    for name in ("cost", "states", "dead ends", "largest h*", "verified", "seconds"):
        table.add_column(name, justify="right")
    for r in records:
        numbers = (r["cost"], r["states"], r["dead_ends"], r["max_cost_to_go"], r["verified"])
        cells = ("-" if number is None else f"{number:,}" for number in numbers)
        seconds = r["seconds"].get("total")
        table.add_row(r["instance"], r["status"], *cells, "-" if seconds is None else f"{seconds:.2f}")
    Console(width=None if sys.stdout.isatty() else 140).print(table)


Range = tuple[float, float]


def range_option(name: str, default: Range, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """An option with two numbers."""
    return click.option(name, nargs=2, type=float, metavar="LOW HIGH", default=default, show_default=True, help=text)


def one_instance(instance: str, domain: str | None) -> Instance:
    """Find the one problem that INSTANCE stands for."""
    found = find_instances([instance], domain)
    if len(found) != 1:
        raise InstanceError(f"{instance}: stands for {len(found)} problems; expected one")
    return found[0]


def table_of(instance: Instance) -> planner.Table:
    """Read and solve a task that people are to be assisted in, and say in one line why that cannot be."""
    try:
        table = sweep(load(instance), max_states=SIMULATED_STATES)
    except LimitError as error:
        fail(f"{instance}: {error}; people are simulated on tasks of up to {SIMULATED_STATES:,} states", EXIT_FAILED)
    require_goal(instance, table[table.initial])
    return table


def require_goal(instance: Instance, cost: float) -> None:
    """Refuse a task that cannot be solved."""
    if not math.isfinite(cost):
        fail(
            f"{instance}: the goal cannot be reached from the initial state, so there is nobody to assist", EXIT_FAILED
        )


@main.command()
@click.argument("instance", metavar="INSTANCE")
@click.option("--humans", type=click.IntRange(min=1), required=True, metavar="K", help="People in a team.")
@click.option(
    "--policy", "names", type=click.Choice(["none", "reactive", "attention"]), multiple=True, default=("attention",),
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
@click.option("--c-suggest", type=float, default=0.5, show_default=True, help="Cost of a suggestion.")
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

    from . import figures
    from . import simulate as simulation
    from .choices import Choices
    from .human import Mixture, Population

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
            chosen = simulation.Setting(**setting)
            size = size or max(12, humans)
            with progress_bar("solving people's POMDPs", size if chosen.knowledge == "own" else 1) as advance:
                pool = simulation.Pool.sample(
                    choices, size, seed, setting=chosen, population=population, progress=lambda *_: advance(1)
                )
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        if humans > size:
            raise click.UsageError(f"--humans {humans} is more than --pool {size}")
        results: list[list[simulation.Episode]] = []
        steps: simulation.Trace = []
        for name in dict.fromkeys(names):
            policy = pool.policy(name, humans)
            traced: simulation.Trace | None = [] if trace else None
            with progress_bar(f"simulating {name}", episodes) as advance:
                results.append(
                    simulation.simulate(
                        pool,
                        policy,
                        humans=humans,
                        episodes=episodes,
                        seed=seed,
                        name=name,
                        trace=traced,
                        progress=advance,
                    )
                )
            steps += traced or []
        if figure:
            run = partial(simulation.simulate, pool, humans=humans, seed=seed)
            alone = run(pool.policy("none", humans), episodes=episodes)
            shown = simulation.illustrative(results[-1], alone)
            pictured: list[simulation.Trace] = [[], []]
            for name, trace_of in zip((names[-1], "none"), pictured, strict=True):
                run(pool.policy(name, humans), episodes=[shown.episode], trace=trace_of)
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
        click.echo(json.dumps(document, indent=2))
    else:
        _show_summaries(summaries)


def _population(file: Path) -> Any:
    """Read a population that `fit` has written."""
    from . import crowd

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


SHOWN = {
    "actions": "human_actions_per_person",
    "interventions": "interventions",
    "moves": "moves",
    "discounted_return": "return",
}


def _show_summaries(summaries: list[Any]) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("policy")
    for label in SHOWN.values():
        table.add_column(label.replace("_", " "), justify="right")
    table.add_column("cut off", justify="right")
    for summary in summaries:
        cells = [f"{mean:.2f} ± {error:.2f}" for mean, error in (getattr(summary, name) for name in SHOWN)]
        table.add_row(summary.policy, *cells, f"{summary.cut_off}")
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    click.echo(f"mean ± standard error over {summaries[0].episodes} episodes")


def person_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say whose problem it is; `person_problem` takes them all."""
    options = (
        click.option("--domain", type=click.Path(), help="Domain file; domain.pddl beside the problem unless given."),
        click.option("--gamma", type=float, default=0.99, show_default=True, help="Discount factor per step."),
        click.option("--c-suggest", type=float, default=0.5, show_default=True, help="Cost of a suggestion."),
        click.option("--eta", type=float, default=0.2, show_default=True, help="Rate of the trust update."),
        click.option(
            "--utility-scale", type=float, default=1.0, show_default=True, help="Cost units that change trust by eta."
        ),
        click.option(
            "--lapse", type=float, default=1e-3, show_default=True,
            help="Weight of a uniform choice in the robot's model.",
        ),
        click.option("--suggestions", type=click.Choice(["optimal", "all"]), default="optimal", show_default=True),
        click.option("--execute", is_flag=True, help="The robot can also do such an action itself."),
        click.option("--c-execute", type=float, default=1.0, show_default=True, help="What that costs."),
        range_option("--beta", (0.1, 3.0), "Range of the person's expertise."),
        range_option("--theta", (0.5, 0.95), "Range of the robot's influence on them."),
        click.option(
            "--sigma", type=float, default=0.0, show_default=True,
            help="Size of a misconception, drawn once and known to the robot; with 0 it knows the task only.",
        ),
        click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the misconception."),
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class Part:
    """How a task is handled that is too large to keep all of.

    Attributes
    ----------
    max_states : int
        Beyond this many the cost-to-go is asked for on demand.
    region_states : int
        Beyond this many only the states that matter are looked at, and so many of them.
    memory_limit : float or None
        In megabytes.
    time_limit : float or None
        For collecting the states that matter, in seconds.
    """

    max_states: int
    region_states: int
    memory_limit: float | None
    time_limit: float | None


@dataclass(frozen=True)
class Person:
    """One person's problem and where it comes from.

    Attributes
    ----------
    instance : Instance
    known : CostToGo
    pomdp : AssistPOMDP
    states : int array, shape (n,)
        The number of each of the problem's states in `known`.
    """

    instance: Instance
    known: CostToGo
    pomdp: AssistPOMDP
    states: NDArray[np.int64]


def person_problem(
    instance: str,
    *,
    domain: str | None,
    gamma: float,
    c_suggest: float,
    eta: float,
    utility_scale: float,
    lapse: float,
    suggestions: Suggestions,
    execute: bool,
    c_execute: float,
    beta: Range,
    theta: Range,
    sigma: float,
    seed: int,
    part: Part | None = None,
) -> Person:
    """Set up one person's problem from `person_options`; errors are those of a command.

    With `part` a task that is too large is cut down to the states that matter.
    """
    from .choices import Choices
    from .human import HumanModel, Population, perceived_cost, perceived_cost_to_go
    from .pomdp import AssistPOMDP
    from .region import Region

    found = one_instance(instance, domain)
    if not 0 <= sigma < math.inf:
        raise click.UsageError(f"--sigma {sigma:g}: expected 0 or more")
    try:
        population = Population(beta, theta)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    known: CostToGo
    if part is None:
        known = table_of(found)
    else:
        task = load(found)
        known = cost_to_go(task, max_states=part.max_states, memory_limit_mb=part.memory_limit, cache=Cache(task))
        require_goal(found, float(known.lookup([known.initial])[0]))
    options = {"population": population, "gamma": gamma, "c_suggest": c_suggest, "suggestions": suggestions}
    human = {"eta": eta, "lapse": lapse, "utility_scale": utility_scale}
    whole = isinstance(known, planner.Table) and (part is None or len(known) <= part.region_states)
    if part is not None and not whole:
        for name, given in (("--sigma", sigma > 0), ("--execute", execute)):
            if given:
                raise click.UsageError(
                    f"{name}: expected a task of at most {part.region_states:,} states (--region-states)"
                )
    try:
        if isinstance(known, planner.Table) and whole:
            choices = Choices.of(known)
            h = perceived_cost_to_go(choices, sigma, np.random.default_rng(seed)) if sigma else choices.h
            model = HumanModel(choices, perceived_cost(choices, h), **human)
            pomdp = AssistPOMDP.of(model, execute=execute, c_execute=c_execute, **options)  # type: ignore[arg-type]
            return Person(found, known, pomdp, np.arange(len(known)))
        assert part is not None
        with progress_bar("collecting states", part.region_states) as advance:
            region = Region.of(
                known, states=part.region_states, population=population, time_limit=part.time_limit, progress=advance
            )
        return Person(found, known, region.problem(**options, **human), region.states)  # type: ignore[arg-type]
    except ValueError as error:
        raise click.UsageError(str(error)) from None


@main.command()
@click.argument("instance", metavar="INSTANCE")
@click.option(
    "--gap", type=click.FloatRange(min=0), default=1e-3, show_default=True,
    help="Stop when (upper - lower) / |lower| is at most this.",
)  # fmt: skip
@click.option(
    "--time-limit", type=click.FloatRange(min=0, min_open=True), default=60.0, show_default=True, metavar="S",
    help="Seconds for the search.",
)  # fmt: skip
@click.option(
    "--memory-limit", type=click.FloatRange(min=0, min_open=True), default=2000.0, show_default=True, metavar="MB",
    help="Memory for the task's table, and for the search.",
)  # fmt: skip
@click.option(
    "--max-states", type=click.IntRange(min=1), default=SolveOptions.max_states, show_default=True,
    help="Ask for the cost-to-go of a larger task on demand.",
)  # fmt: skip
@click.option(
    "--region-states", type=click.IntRange(min=1), default=20_000, show_default=True,
    help="Of a larger task look at so many states, those that are met most likely.",
)  # fmt: skip
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Save policy and bounds (.npz).")
@person_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
def policy(
    instance: str,
    gap: float,
    time_limit: float,
    memory_limit: float,
    max_states: int,
    region_states: int,
    out: Path | None,
    as_json: bool,
    **person: Any,
) -> None:
    """Solve the problem of assisting one person, with a lower and an upper bound on what can be reached."""
    from .solver import solve as solve_person

    if out is not None and out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: expected a name that ends in .npz")
    part = Part(max_states, region_states, memory_limit, time_limit)
    with one_line_errors():
        problem = person_problem(instance, part=part, **person)
        with bounds_line() as show:
            solution = solve_person(
                problem.pomdp, gap=gap, time_limit=time_limit, memory_limit_mb=memory_limit, progress=show
            )
        if out is not None:
            solution.save(out, values=problem.known.values(problem.states), task_states=problem.states)
    frontier = problem.pomdp.frontier
    record = {
        "instance": str(problem.instance.problem),
        "domain": str(problem.instance.domain),
        "states": len(problem.pomdp.robots),
        "hidden": problem.pomdp.prior.size,
        "lower": solution.lower,
        "upper": solution.upper,
        "gap": solution.gap,
        "value_qmdp": solution.value_qmdp,
        "value_never": solution.value_never,
        "value_always": solution.value_always,
        "seconds": solution.seconds,
        "alpha_vectors": len(solution.policy.robot),
        "stopped": solution.stopped,
        "method": problem.known.method,
        "frontier": 0 if frontier is None else len(frontier.states),
        "versions": versions(),
    }
    if as_json:
        click.echo(json.dumps(record, indent=2))
    else:
        _show_policy(record)


@contextmanager
def bounds_line() -> Iterator[Callable[[float, float, float], None]]:
    """Show time, bounds and gap on stderr while they improve, where that is a terminal."""
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as line:
        task = line.add_task("first bounds")

        def show(seconds: float, lower: float, upper: float) -> None:
            gap = (upper - lower) / abs(lower) if lower else 0.0
            line.update(task, description=f"{seconds:.1f} s  lower {lower:.5f}  upper {upper:.5f}  gap {gap:.2e}")

        yield show


def _show_policy(record: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    what = f"{record['states']:,} states, {record['hidden']} hidden pairs"
    if record["frontier"]:
        what += f"; {record['frontier']:,} of the states are a frontier"
    click.echo(what)
    for name, label in (
        ("value_never", "nothing, ever"), ("value_always", "always a suggestion"), ("lower", "policy, at least"),
        ("upper", "any policy, at most"), ("value_qmdp", "beta and theta seen"),
    ):  # fmt: skip
        table.add_row(label, f"{record[name]:.4f}")
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    ended = {"gap": "", "time": "; the time is up", "memory": "; the memory is full"}
    ended["stalled"] = "; the bounds where the states break off allow no more" if record["frontier"] else "; rounding"
    click.echo(
        f"gap {100 * record['gap']:.3g} %, {record['alpha_vectors']:,} alpha vectors, {record['seconds']:.1f} s"
        + ended[record["stopped"]]
    )


@main.command()
@click.argument("instance", metavar="INSTANCE")
@click.option(
    "--format", "form", type=click.Choice(["pomdpx", "pomdp"]), default="pomdpx", show_default=True,
    help="POMDPX with mixed observability, or the flat format, for small tasks.",
)  # fmt: skip
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="The file to write.")
@person_options
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON document.")
def export(instance: str, form: str, out: Path, as_json: bool, **person: Any) -> None:
    """Write the problem of assisting one person, for other solvers."""
    from . import exchange

    if out.suffix != f".{form}":  # solvers choose the parser by it
        raise click.UsageError(f"--out {out}: expected a name that ends in .{form}")
    with one_line_errors():
        problem = person_problem(instance, **person)
        found, pomdp = problem.instance, problem.pomdp
        try:
            {"pomdpx": exchange.write_pomdpx, "pomdp": exchange.write_pomdp}[form](pomdp, out)
        except ValueError as error:
            fail(f"{found}: {error}", EXIT_FAILED)
        record = {
            "instance": str(found.problem),
            "domain": str(found.domain),
            "format": form,
            "out": str(out),
            "states": len(pomdp.model.choices),
            "hidden": pomdp.prior.size,
            "robot_actions": len(exchange.action_names(pomdp)),
            "bytes": out.stat().st_size,
        }
    if as_json:
        click.echo(json.dumps(record, indent=2))
    else:
        click.echo(
            f"{out}: {record['states']:,} states, {record['hidden']} hidden pairs, "
            f"{record['robot_actions']} robot actions, {record['bytes']:,} bytes"
        )


@main.command()
@click.argument("instance", metavar="INSTANCE")
@click.argument("log", metavar="LOG", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--domain", type=click.Path(), help="Domain file; domain.pddl beside the problem unless given.")
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a record of each person (JSON Lines)."
)
@click.option(
    "--population", "crowd_file", type=click.Path(dir_okay=False, path_type=Path),
    help="Write the distribution of beta and theta over people, for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Of beta's distribution over people; the parametric one that fits best unless given.",
)  # fmt: skip
@click.option("--figures", "folder", type=click.Path(file_okay=False, path_type=Path), help="Draw into this folder.")
@click.option("--misconception", is_flag=True, help="Also estimate sigma, and what people take for the cost-to-go.")
@click.option("--eta", type=float, help="Rate of the trust update where it is known; estimated unless given.")
@click.option(
    "--utility-scale", type=float, default=1.0, show_default=True, help="Cost units that change trust by eta."
)
@click.option("--lapse", type=float, default=1e-3, show_default=True, help="Weight of a uniform choice.")
@click.option("--level", type=float, default=0.95, show_default=True, help="Of the intervals.")
@click.option(
    "--largest-beta", type=float,
    help="Where beta's range ends.  [default: 10, divided by the cost of the smallest possible mistake]",
)  # fmt: skip
@click.option("--drop", multiple=True, metavar="NAME", help="Leave actions of this name out; may be repeated.")
@click.option(
    "--rename", multiple=True, metavar="OLD=NEW", help="What the log calls OLD the task calls NEW; may be repeated."
)
@click.option("--strict", is_flag=True, help="Fit nothing if any line cannot be used, or if any state takes too long.")
@click.option(
    "--max-states", type=click.IntRange(min=1), default=SolveOptions.max_states, show_default=True,
    help="On a larger task evaluate only states that were visited, and their successors.",
)  # fmt: skip
@click.option(
    "--time-limit", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds for each of these states."
)
@click.option(
    "--cache", type=click.Path(file_okay=False, path_type=Path),
    help="Folder where these states are kept.  [default: kitassist in the user's cache folder]",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), help="Processors to use; all unless given.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the check of the model.")
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def fit(
    instance: str,
    log: Path,
    domain: str | None,
    out: Path | None,
    crowd_file: Path | None,
    family: str | None,
    folder: Path | None,
    misconception: bool,
    drop: tuple[str, ...],
    rename: tuple[str, ...],
    strict: bool,
    max_states: int,
    time_limit: float | None,
    cache: Path | None,
    jobs: int | None,
    seed: int,
    as_json: bool,
    **setting: Any,
) -> None:
    """Learn expertise, influence and trust of people from the LOG of their actions.

    LOG has a line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}.
    """
    from planner import storage

    from . import crowd, figures, fit_figures
    from . import fit as fitting
    from . import log as logs
    from .profile import failed, profiles

    jobs = jobs or os.cpu_count() or 1
    wrong = next((pair for pair in rename if not all(part.strip() for part in pair.partition("=")[::2])), None)
    if wrong is not None:
        raise click.UsageError(f"--rename {wrong}: expected OLD=NEW")
    try:
        method = fitting.Method(**setting)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    with one_line_errors("interrupted; states that were evaluated on demand are kept"):
        found = one_instance(instance, domain)
        if folder:
            figures.require()
        task = load(found)
        if task.decided_by_translator:
            fail(
                f"{found}: the goal cannot be reached, or holds from the start; there is nothing to learn from",
                EXIT_FAILED,
            )
        entries, faults = logs.read(log)
        walked = OnDemand(task)
        names = {old.strip(): new.strip() for old, _, new in (pair.partition("=") for pair in rename)}
        recording, more = logs.replay(entries, walked, drop=drop, rename=names)
        faults = sorted(faults + more, key=lambda fault: fault.line)
        for fault in faults:
            whose = "" if fault.person is None else f"person '{fault.person}', "
            whose += "" if fault.episode is None else f"episode '{fault.episode}', which is left out: "
            click.echo(f"{log}:{fault.line}: {whose}{fault.message}", err=True)
        if strict and faults:
            fail(f"{log}: nothing is fitted, because of --strict", EXIT_FAILED)
        if not len(recording):
            if not entries and not faults:
                fail(f"{log}: no recorded actions", EXIT_FAILED)
            fail(f"{log}: no episode can be followed through {found}; is it the log of another instance?", EXIT_FAILED)
        h, goal = _evaluate(walked, recording.wanted(), max_states, time_limit, cache, jobs, strict=strict)
        recording, left_out = recording.evaluated(h)
        if not len(recording):
            fail(f"{found}: the states after every action took more than --time-limit", EXIT_FAILED)
        if not math.isfinite(h[recording.wanted()].min()):
            fail(
                f"{found}: no state that was visited has a way to the goal, so that all actions are alike",
                EXIT_FAILED,
            )
        observations = fitting.observe(recording, h, goal)
        with progress_bar("fitting people", len(observations)) as advance:
            people = profiles(
                observations, method, np.random.default_rng(seed),
                misconceptions=misconception, jobs=jobs, progress=advance,
            )  # fmt: skip
        people_of_faults = {fault.person for fault in faults if fault.person is not None} | {e.person for e in entries}
        left = sorted(people_of_faults - set(recording.people))
        records = [
            profile.record(
                lambda states: [task.facts(values) for values in walked.values(states).tolist()],
                left_out=left_out.get(profile.fit.observations.person, 0),
            )
            for profile in people
        ]
        records += [
            failed(
                person,
                "no action can be used" if left_out.get(person) else "no episode can be used",
                left_out=left_out.get(person, 0),
            )
            for person in left
        ]
        records.sort(key=lambda record: logs.in_order(record["person"]))
        general = None
        if crowd_file or (not as_json and len(people) >= FEWEST_FOR_CROWD):
            with progress_bar("fitting the population", crowd.ETAS) as advance:
                general = crowd.fit_crowd(observations, method, family=family, progress=advance)
        if crowd_file and general:
            sigmas = [p.misconception.sigma for p in people if p.misconception is not None]
            sigma = tuple(np.quantile(sigmas, (0.1, 0.9)).tolist()) if sigmas else (0.0, 0.0)
            with storage.atomic(crowd_file) as path:
                path.write_text(json.dumps(general.record(sigma), indent=1) + "\n", encoding="utf-8")
        if out:
            storage.write_records(out, records)
        if folder:
            fit_figures.draw([profile.fit for profile in people], folder)
    if as_json:
        click.echo(json.dumps(records, indent=2))
    else:
        _show_people(records)
        if general is not None:
            _show_crowd(general)
    if faults or left or left_out:
        sys.exit(EXIT_FAILED)


FEWEST_FOR_CROWD = 3


def _evaluate(
    walked: OnDemand, wanted: Any, max_states: int, time_limit: float | None, cache: Path | None, jobs: int, *,
    strict: bool,
) -> tuple[Any, Any]:  # fmt: skip
    """Give h* of the wanted states of a task, and which are goal states: from a sweep, or one by one on demand.

    States that took too long have NaN unless `strict`, where they are an error.
    """
    values, limits = walked.values(wanted), Limits(seconds=time_limit)
    answers: Any = cost_to_go(walked.task, values, max_states=max_states, jobs=jobs, limits=limits)
    h, goal = np.full(len(walked), np.nan), np.zeros(len(walked), dtype=bool)
    goal[wanted] = walked.is_goal(wanted)
    if answers.method == "sweep":
        h[wanted] = answers.lookup(answers.numbers(values))
    else:
        click.echo(f"evaluating {len(wanted)} states on demand: {answers.reason}", err=True)
        asked = OnDemand(walked.task, cache=Cache(walked.task, cache), jobs=jobs, limits=limits)
        with progress_bar("evaluating states", len(wanted)) as advance:
            numbers = asked.numbers(values)
            try:
                h[wanted] = asked.lookup(numbers, advance)
            except LimitError as error:
                if strict:
                    raise
                h[wanted] = asked.known(numbers)
                click.echo(f"{error}; actions that depend on them are left out", err=True)
    return h, goal


def _show_people(records: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("person")
    for name in ("beta", "theta", "eta", "actions", "suboptimal", "log-likelihood", "check p"):
        table.add_column(name, justify="right")
    if any("misconception" in r for r in records):
        table.add_column("sigma", justify="right")
    for r in records:
        if r["error"]:
            table.add_row(r["person"], *["-"] * 7)
            continue
        cells = [_show_estimate(r[name], r[f"{name}_interval"], r[f"{name}_open"]) for name in ("beta", "theta", "eta")]
        p = r["check"]["p"]
        cells += [f"{r['actions']}", f"{r['suboptimal_actions']}", f"{r['log_likelihood']:.2f}"]
        cells.append("-" if p is None else f"{p:.3f}")
        m = r.get("misconception")
        if m is not None:
            cells.append(_show_estimate(m["sigma"], m["sigma_interval"], m["sigma_open"]))
        table.add_row(r["person"], *cells)
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    for r in records:
        for note in [*r["notes"], *([r["error"]] if r["error"] else [])]:
            click.echo(f"{r['person']}: {note}")


def _show_estimate(value: float | None, interval: list[float] | None, is_open: list[str] | None) -> str:
    if value is None or interval is None:
        return "-"
    return f"{value:.2f} ({interval[0]:.2f} to {interval[1]:.2f}{'+' if 'above' in (is_open or []) else ''})"


def _show_crowd(general: Any) -> None:
    for name in ("beta", "theta"):
        margin = getattr(general, name)
        if margin is not None:
            click.echo(
                f"population of {general.people}: {name} is {margin.family}, "
                f"mean {margin.mean:.2f}, standard deviation {margin.spread:.2f}"
            )
    if general.eta is not None:
        click.echo(f"population of {general.people}: eta {general.eta:.2f}")
