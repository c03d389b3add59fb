"""The group of all commands. Each command's module is imported when the command is used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import click

from planner.system.errors import expected

COMMANDS = {
    "bound": "Compute an upper bound on the value of any policy for a team of K people, and the gap of policies to it.",
    "check": "Try your own policy, choice model, rule or term, and say what is wrong with it.",
    "compare": "Compare models of people by how well they predict people to whom they were not fitted.",
    "domains": "List the bundled tasks, whose names every command accepts.",
    "draw": "Draw a state, a plan or an episode as a picture (.svg, .png) or an animation (.gif, .html).",
    "export": "Write the POMDP of assisting one person to a file for other solvers.",
    "fit": "Estimate people's expertise, influence and trust from a LOG of their actions.",
    "infer": "Infer which goal people pursue from a LOG of their actions.",
    "policy": "Solve the POMDP of assisting one person, with a lower and an upper bound on the optimal value.",
    "serve": "Run the live assistant: a web service that receives people's actions and returns suggestions.",
    "settings": "Print all fields of a command's setting with their sentences and defaults, as a file for `--setting`.",
    "simulate": "Simulate a team of people and a robot that assists them, and compare policies.",
    "solve": "Solve PDDL instances: the exact cost-to-go of every state, and an optimal plan.",
    "study": "Run a simulation study over pools of people, teams, policies and conditions, and write its report.",
    "study-prepare": "Preregister a user study, or sign the links of its participants.",
    "study-report": "Report on a user study: means, effects of conditions, questionnaires and dropouts.",
}
"""Summary of each command for `kitassist --help`. The command `study-report` is in the module `study_report`."""

MEANT = {"goals": "infer", "live": "serve", "plan": "solve"}
"""Commands by words that others may have for them, and that are not alike in spelling."""


class Commands(click.Group):
    """A group that imports commands on use. It handles output encoding, signals and one-line errors for all of them."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command. An unknown name is a usage error that suggests a name."""
        if cmd_name not in COMMANDS:
            if cmd_name.startswith("-"):  # an unknown option; click reports it
                return None
            right = expected(MEANT.get(cmd_name, cmd_name), COMMANDS)
            ctx.fail(f"There is no command '{cmd_name}'; {right}")
        name = cmd_name.replace("-", "_")
        command: click.Command = getattr(import_module(f".{name}", __package__), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the summary of each command."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the program."""
        from .terminal.interrupts import interruptible

        with interruptible():
            from .terminal.console import printable_output  # imported late because the import is slow

            with printable_output():
                return super().main(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run one command; report expected errors in one line."""
        from .terminal.console import one_line_errors

        with one_line_errors():
            return super().invoke(ctx)
