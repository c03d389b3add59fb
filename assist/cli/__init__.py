"""The command `kitassist`: options in, records and tables out. All work is done elsewhere.

The commands in `commands.COMMANDS` have files of their names. The others, in the order in which they build on each
other:

interrupts     signals that end a command
options        types and options that several commands share
console        JSON, tables and errors out
bars           how far something is, on a terminal
progress       how far a command is, on a terminal or elsewhere
task           the task that people are assisted in, or were recorded in
population     from whom people are drawn
person         one person's problem, and the options that describe it
travel         the way between people's places
team           a team, and the options that describe it
policies       team policies by name, or of one's own
live           a live team, and the options that describe it
summaries      episodes as a table
solutions      records of `solve` as a table
solving        how far the instances of `solve` are
bounds         one person's problem between two bounds, as a table
conducting     what `serve` listens at, and a user study that it conducts
log            the options that say how a log is read, and people estimated
commands       the commands, each loaded when it is used
"""

from __future__ import annotations

import click

from .commands import Commands


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="kitassist")
def main() -> None:
    """Assistance in task planning: whom to help, when, and with which suggestion."""
