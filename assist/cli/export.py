"""The command `export`, which writes one person's POMDP in a format of other solvers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from planner import Table

from .options.common import OUTPUT_FILE, instance_argument
from .options.help import command
from .options.person import person_options, person_problem
from .options.task import table_of
from .terminal.console import ExitCode, fail, one_line_errors, print_json


@command("export kitting/tiny --out tiny.pomdpx")
@instance_argument
@click.option(
    "--format", "form", type=click.Choice(["pomdpx", "pomdp"]), default="pomdpx", show_default=True,
    help="POMDPX with mixed observability, or the flat POMDP format for small tasks.",
)  # fmt: skip
@click.option("--out", type=OUTPUT_FILE, required=True, help="Output file.")
@person_options
@click.option("--json", "as_json", is_flag=True, help="Print what was written as one JSON document.")
def export(instance: str, form: str, out: Path, as_json: bool, **person: Any) -> None:
    """Write the POMDP of assisting one person to a file for other solvers."""
    from ..interop.observed import action_names
    from ..interop.pomdp import write_pomdp
    from ..interop.pomdpx import write_pomdpx

    if out.suffix != f".{form}":  # solvers choose the parser by the suffix
        raise click.UsageError(f"--out {out}: expected a name that ends in .{form}")
    with one_line_errors():
        found, problem = person_problem(instance, table_of, states=None, **person)
        pomdp = problem.pomdp
        try:
            table = problem.known if isinstance(problem.known, Table) else None
            {"pomdpx": write_pomdpx, "pomdp": write_pomdp}[form](pomdp, out, table)
        except ValueError as error:
            fail(f"{found}: {error}", ExitCode.FAILED)
        record = {
            "instance": str(found.problem),
            "domain": str(found.domain),
            "format": form,
            "out": str(out),
            "states": len(pomdp.model.choices),
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
