"""The command `kitassist`: options in, records and tables out. All work is done elsewhere.

The commands in `command_group.COMMANDS` have files of their names. Beside them:

command_group  the commands, each loaded when it is used
user_study     what `serve` listens at, and a user study that it conducts
options        options that several commands share, and what is set up from them
output         what commands print
terminal       signals, errors in one line, and JSON and tables out
"""

from __future__ import annotations

import click

from .command_group import Commands


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="kitassist")
def main() -> None:
    """Assistance in task planning: whom to help, when, and with which suggestion."""
