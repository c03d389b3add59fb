"""The commands, each loaded when it is used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import click

from planner.system.errors import expected

COMMANDS = {
    "bound": "Bound what any policy gets with a team of K people, and certify a policy's distance from it.",
    "domains": "List the tasks that come with the package; every command takes their names.",
    "draw": "Draw a state, a plan or an episode: .svg and .png are pictures or strips, .gif and .html animations.",
    "export": "Write the problem of assisting one person, for other solvers.",
    "fit": "Learn expertise, influence and trust of people from the LOG of their actions.",
    "policy": "Solve the problem of assisting one person, with a lower and an upper bound on what can be reached.",
    "serve": "Run the assistant live: what people do comes in over HTTP, whom to help and how goes out.",
    "simulate": "Simulate a team of people and a robot that assists them.",
    "solve": "Solve PDDL instances: exact cost-to-go of every state, and an optimal plan.",
    "study": "Run a whole study: pools of people, teams, policies, conditions; then write its report.",
    "study-report": "Report on a user study: means, differences and effects of conditions, questionnaires, dropouts.",
}
"""The commands, each in a file of that name with _ for -, and what the overview says of them without loading any."""


class Commands(click.Group):
    """Commands that are loaded when they are used; encodings, signals, and errors in one line for all of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Give their names."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load one; an unknown name is a usage error that offers the nearest, or all."""
        if cmd_name not in COMMANDS:
            if cmd_name.startswith("-"):  # an option, which click refuses
                return None
            ctx.fail(f"There is no command '{cmd_name}'; {expected(cmd_name, COMMANDS)}")
        name = cmd_name.replace("-", "_")
        command: click.Command = getattr(import_module(f".{name}", __package__), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write what each is for."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command line."""
        from .terminal.interrupts import interruptible

        with interruptible():
            from .terminal.console import print_in_any_encoding  # takes its time

            print_in_any_encoding()
            return super().main(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run one command."""
        from .terminal.console import one_line_errors

        with one_line_errors():
            return super().invoke(ctx)
