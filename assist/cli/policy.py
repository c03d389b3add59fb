"""The command `policy`: one person's problem, solved between two bounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.table import Table

from planner.solving import SolveOptions, versions

from .console import one_line_errors, print_json, print_table
from .options import GAP, MEGABYTES, OUTPUT_FILE, SECONDS, instance_argument, json_option
from .person import Part, person_options, person_problem
from .progress import status_line


@click.command()
@instance_argument
@click.option(
    "--gap", type=GAP, default=1e-3, show_default=True,
    help="Stop when (upper - lower) / |lower| is at most this.",
)  # fmt: skip
@click.option(
    "--time-limit", type=SECONDS, default=60.0, show_default=True, metavar="S",
    help="Seconds for the search.",
)  # fmt: skip
@click.option(
    "--memory-limit", type=MEGABYTES, default=2000.0, show_default=True, metavar="MB",
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
@click.option("--out", type=OUTPUT_FILE, help="Save policy and bounds (.npz).")
@person_options
@json_option
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
    from ..person.solver import is_compiled
    from ..person.solver import solve as solve_person

    if out is not None and out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: expected a name that ends in .npz")
    part = Part(max_states, region_states, memory_limit, time_limit)
    with one_line_errors():
        problem = person_problem(instance, part=part, **person)
        first = "first bounds" if is_compiled() else "compiling, once after an installation, and first bounds"
        with status_line(first) as show:
            solution = solve_person(
                problem.pomdp,
                gap=gap,
                time_limit=time_limit,
                memory_limit_mb=memory_limit,
                progress=lambda *found: show(_bounds(*found)),
            )
        if out is not None:
            solution.save(out, values=problem.known.values(problem.states), task_states=problem.states)
    frontier = problem.pomdp.frontier
    record = {
        "instance": str(problem.instance.problem),
        "domain": str(problem.instance.domain),
        "states": len(problem.pomdp.robot_actions),
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
        print_json(record)
    else:
        _show_policy(record)


def _bounds(seconds: float, lower: float, upper: float) -> str:
    gap = (upper - lower) / abs(lower) if lower else 0.0
    return f"{seconds:.1f} s  lower {lower:.5f}  upper {upper:.5f}  gap {gap:.2e}"


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
    print_table(table)
    ended = {"gap": "", "time": "; the time is up", "memory": "; the memory is full"}
    ended["stalled"] = "; the bounds where the states break off allow no more" if record["frontier"] else "; rounding"
    click.echo(
        f"gap {100 * record['gap']:.3g} %, {record['alpha_vectors']:,} alpha vectors, {record['seconds']:.1f} s"
        + ended[record["stopped"]]
    )
