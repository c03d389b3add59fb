"""The command-line program `kitassist`: it parses options, calls the library and prints records and tables.

Each command in `command_group.COMMANDS` has a file of the same name. The other modules are:

command_group  the list of commands, which are imported on use
user_study     the server socket of `serve`, and user studies that `serve` conducts
options        options that several commands share, and objects that are built from them
output         what commands print
terminal       signals, one-line error messages, and output as JSON or tables
"""

from __future__ import annotations

import atexit
import gc

import click

from .command_group import Commands

# The compiler has very many objects that last. Otherwise they are scanned many times while it is imported, and all of
# them once more at the end, which takes 0.3 s of the processor.
gc.set_threshold(100_000)
atexit.register(gc.freeze)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="kitassist")
def main() -> None:
    """Assistance in task planning: whom to help, when, and with which suggestion."""
