"""Help texts of the commands: an example, followed by the options in groups."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from typing import Any

import click
from rich_click import RichCommand, RichHelpConfiguration
from rich_click.rich_panel import RichOptionPanel

from ...declare.options import FieldOption
from .config import named

GROUPS = {
    "Task": (
        "--domain", "--max-states", "--state", "--plan", "--protocol", "--format", "--goals", "--as",
    ),
    "Log": ("--log", "--columns", "--drop", "--rename", "--strict", "--advice", "--rows"),
    "People": ("--humans", "--pool", "--population", "--simulate"),
    "Estimates": ("--misconception", "--terms", "--influence", "--rule", "--folds", "--family"),
    "Robot": ("--policy",),
    "Setting": ("--setting", "--set"),
    "Service": (
        "--config", "--study", "--rehearse", "--links", "--check", "--port", "--host", "--public-url",
        "--trusted-proxy", "--bridge", "--data", "--log-format",
    ),
    "Run": (
        "--episodes", "--value-episodes", "--episode", "--repeats", "--baseline", "--difference", "--samples", "--gap",
        "--time-limit", "--memory-limit", "--verify", "--most-values", "--jobs", "--scheduler", "--resume", "--seed",
    ),
    "Output": (
        "--out", "--write-population", "--size-limit", "--leaves", "--trace", "--figure", "--figures",
        "--width", "--json", "--help",
    ),
}  # fmt: skip
"""Options of all commands by topic, in the order of the help; other declared fields are the robot's."""

LOOK = RichHelpConfiguration(
    theme="nu",
    enable_theme_env_var=False,
    max_width=100,
    options_table_column_types=["opt_all_metavar", "help"],
    options_table_help_sections=["help", "default", "required"],
)


class Command(RichCommand):
    """A command whose errors name the option that was meant, or the source of a faulty value."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            said = f"No such option '{error.option_name}'{_hint(error.option_name, ctx)}"
            raise click.NoSuchOption(error.option_name, said, ctx=ctx) from None
        except click.BadParameter as error:
            raise named(error) from None
        except click.UsageError as error:
            last = [each.name for each in self.params if isinstance(each, click.Argument)][-1:]
            if last != ["instance"] or not error.message.startswith("Got unexpected extra argument"):
                raise
            why = "one INSTANCE at a time; several in one `kitassist study`, or each by itself"
            raise click.UsageError(f"{error.message}: expected {why}", ctx) from None


def _hint(name: str, context: click.Context) -> str:
    """Return which commands have an option that this one has not, or the option of this command that was meant."""
    have, group = list[str](), None if context.parent is None else context.parent.command
    if isinstance(group, click.Group):
        have = [one for one in group.list_commands(context) if name in _options(group.get_command(context, one))]
    elsewhere = f"; {' and '.join(have)} {'has' if len(have) == 1 else 'have'} it" if have else ""
    near = difflib.get_close_matches(name, _options(context.command), n=1, cutoff=0.75)
    if near:
        return f"{elsewhere}. Did you mean '{near[0]}'?"
    return elsewhere or f". {context.command_path} --help lists the options"


def _options(command: click.Command | None) -> list[str]:
    """Return the long names of a command's options, or of those of the commands in a group."""
    inner = command.commands.values() if isinstance(command, click.Group) else [command]
    params = [option for one in inner if one is not None for option in one.params]
    return [name for option in params for name in option.opts if name.startswith("--")]


def command(example: str, name: str | None = None) -> Callable[[Callable[..., Any]], click.Command]:
    """Return a decorator that turns a function into a command.

    The command's help shows an example and groups the options.

    Parameters
    ----------
    example : str
        A call of the command, without the program's name.
    name : str, optional
        Name of the command; the function's name unless given.
    """

    def decorated(function: Callable[..., Any]) -> click.Command:
        placed = {option for group in GROUPS.values() for option in group}
        fields = [option for option in getattr(function, "__click_params__", ()) if isinstance(option, FieldOption)]
        of_robot = [option.opts[0] for option in reversed(fields) if option.opts[0] not in placed]
        groups = GROUPS | {"Robot": (*GROUPS["Robot"], *of_robot)}
        first, _, rest = (function.__doc__ or "").partition("\n\n")
        made = click.command(
            name,
            cls=Command,
            help="\n\n".join(filter(None, (first, f"\b\nExample: kitassist {example}", rest))),
            panels=[RichOptionPanel(title, options=list(options)) for title, options in groups.items()],
            context_settings={"rich_help_config": LOOK},
        )(function)
        for option in made.params:
            if isinstance(option, click.Option) and isinstance(option.type, click.Choice):
                names = option.type.choices
                if option.metavar is None and len("|".join(names)) > 24:  # a longer placeholder would be cut
                    option.metavar = option.opts[0].removeprefix("--").upper()
                    option.help = f"{option.help} One of {', '.join(names)}."
        return made

    return decorated
