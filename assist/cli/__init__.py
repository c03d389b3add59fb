"""The command `kitassist`: options in, records and tables out. All work is done elsewhere.

In the order in which they build on each other:

interrupts     signals that end a command
options        types and options that several commands share
console        JSON, tables and errors out
progress       how far a command is
task           the task that people are assisted in, or were recorded in
person         one person's problem, and the options that describe it
team           a team, and the options that describe it
solve          the command `solve`
simulate       the command `simulate`
study          the command `study`
policy         the command `policy`
bound          the command `bound`
export         the command `export`
fit            the command `fit`
"""

from __future__ import annotations

from typing import Any

import click

from . import bound, export, fit, policy, simulate, solve, study
from .console import one_line_errors, print_in_any_encoding
from .interrupts import interruptible


class Commands(click.Group):
    """What holds for every command: encodings, signals, and errors in one line."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command line."""
        print_in_any_encoding()
        with interruptible():
            return super().main(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run one command."""
        with one_line_errors():
            return super().invoke(ctx)


@click.group(
    cls=Commands,
    commands=[
        solve.solve,
        simulate.simulate,
        study.study,
        policy.policy,
        bound.bound,
        export.export,
        fit.fit,
    ],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="kitassist")
def main() -> None:
    """Assistance in task planning: whom to help, when, and with which suggestion."""
