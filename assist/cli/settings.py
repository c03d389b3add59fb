"""The command `settings`, which prints all fields of a command's setting."""

from __future__ import annotations

import click

from ..declare.options import printed
from .options.help import command
from .options.settings import DrawSetting, EstimateSetting, GoalSetting, PersonSetting, ServeSetting, TeamSetting

OF_COMMANDS = {
    "simulate": TeamSetting, "bound": TeamSetting, "serve": ServeSetting, "policy": PersonSetting,
    "export": PersonSetting, "fit": EstimateSetting, "compare": EstimateSetting, "infer": GoalSetting,
    "draw": DrawSetting,
}  # fmt: skip
"""The setting of each command that has one."""


@command("settings serve")
@click.argument("name", metavar="COMMAND", type=click.Choice(list(OF_COMMANDS)), default="simulate")
def settings(name: str) -> None:
    """Print all fields of a command's setting with their sentences and defaults, as a file for `--setting`.

    COMMAND is simulate unless given. A field is set by `--set NAME=VALUE`, such as `--set gamma=0.95` or
    `--set population.beta="[0.1, 0.5]"`, or in a file, of which every line may be left out.
    """
    click.echo(printed(OF_COMMANDS[name]))
