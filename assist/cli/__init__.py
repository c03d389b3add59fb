"""The command `kitassist`: options in, records and tables out. All work is done elsewhere.

In the order in which they build on each other:

console        numbers in; JSON, tables, progress and errors out
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

import click

from . import bound, export, fit, policy, simulate, solve, study


@click.group(
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
