"""The command `export`, which writes one person's POMDP in a format of other solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

import planner

from ..declare.options import Value
from .options.common import Megabytes, json_option, out_option
from .options.help import command
from .options.person import PersonOptions, person_options, person_problem
from .options.task import costs_of, table_of
from .terminal.console import ExitCode, fail, print_json

FORMATS = ("pomdpx", "pomdp")


@command("export kitting/tiny --out tiny.pomdpx")
@click.option(
    "--format", "form", type=click.Choice(FORMATS),
    help="POMDPX with mixed observability, or the flat POMDP format for small tasks.  [default: by the name of --out]",
)  # fmt: skip
@out_option("a file .pomdpx or .pomdp", required=True)
@click.option(
    "--size-limit", type=Value(Megabytes), default=500.0, show_default=True, metavar="MB",
    help="A larger file is not written.",
)  # fmt: skip
@click.option(
    "--leaves",
    type=click.Choice(("lower", "upper")),
    default="lower",
    show_default=True,
    help="With --set region_states: whether the file's optimal value is a lower or an upper bound for the whole task.",
)
@person_options
@json_option
def export(
    person: PersonOptions, form: str | None, out: Path, size_limit: float, leaves: Literal["lower", "upper"],
    as_json: bool,
) -> None:  # fmt: skip
    """Write the POMDP of assisting one person to a file for other solvers."""
    from ..connect import pomdp as flat
    from ..connect import pomdpx as mixed
    from ..connect.observed import Observed, action_names, bytes_needed

    named = out.suffix.removeprefix(".")
    if named not in ((form,) if form else FORMATS):  # solvers choose the parser by the suffix
        raise click.UsageError(f"--out {out}: expected a name that ends in .{form or ' or .'.join(FORMATS)}")
    given, setting = person.given, person.setting
    given.refuse(("goal_prior", "max_states", "memory_limit"), "on an export")

    def known_of(found: planner.Instance) -> planner.CostToGo:
        if setting.region_states is None:
            return table_of(found)
        return costs_of(found, max_states=setting.max_states, memory_limit_mb=setting.memory_limit)

    found, problem = person_problem(person, known_of, states=setting.region_states)
    pomdp = problem.pomdp
    if pomdp.followed_low is not None:
        whose = "--trust" if "trust" in given else f"--population {given.values['population']}"
        raise click.UsageError(
            f"{whose}: a file has no trust that depends on whether advice is followed; expected --trust paper or "
            "constant"
        )
    try:
        whole = pomdp.frontier is None
        table = problem.known if whole and isinstance(problem.known, planner.Table) else None
        observed = Observed.of(pomdp, table, leaves)
        if named == "pomdp":
            flat.require_size(observed)
        needed = bytes_needed(observed, {"pomdpx": mixed, "pomdp": flat}[named].lines_of) / 1e6
        if needed > size_limit:
            fail(
                f"--out {out}: it would take about {needed:,.3g} MB, more than --size-limit {size_limit:,.3g}",
                ExitCode.FAILED,
            )
        if needed > 10:
            click.echo(f"{out}: about {needed:,.0f} MB", err=True)
        {"pomdpx": mixed.write_pomdpx, "pomdp": flat.write_pomdp}[named](pomdp, out, table, leaves=leaves)
    except ValueError as error:
        fail(f"{found}: {error}", ExitCode.FAILED)
    record = {
        "instance": str(found.problem),
        "domain": str(found.domain),
        "format": named,
        "out": str(out),
        "states": len(pomdp.model.choices),
        "frontier": 0 if pomdp.frontier is None else len(pomdp.frontier.states),
        "hidden": pomdp.prior.size,
        "robot_actions": len(action_names(pomdp)),
        "bytes": out.stat().st_size,
    }
    if as_json:
        print_json(record)
    else:
        click.echo(
            f"{out}: {record['states']:,} states, {record['hidden']} hidden pairs, "
            f"{record['robot_actions']} robot actions, {record['bytes']:,} bytes"
        )
