"""The command `serve`, which runs the live assistant as a web service."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner.system.errors import InputFileError

from ..declare.declared import Count
from ..declare.options import Value
from .options.bridges import bridge_of
from .options.common import INPUT_FILE
from .options.config import config_option, configurable, variables_that_set_nothing
from .options.help import command
from .options.listening import Listening, listening_options, live_server
from .options.live import LiveOptions, changed_settings, live_options, plan_of
from .options.policies import policy_errors
from .options.settings import ServeSetting
from .terminal.console import note, usage_errors
from .user_study import conduct

if TYPE_CHECKING:
    from ..web.tokens import AccessTokens


@configurable
@command("serve kitting/paper --humans 4 --simulate 3")
@config_option()
@click.option(
    "--study", type=INPUT_FILE, metavar="FILE.toml", help="Run this user study instead of a team on given tasks."
)
@click.option(
    "--rehearse", type=Value(Count, le=1000), metavar="N", help="Rehearse the study with N simulated participants."
)
@click.option("--bridge", type=INPUT_FILE, metavar="FILE.toml", help="Connect the team to MQTT, OPC UA or ROS 2.")
@listening_options
@click.option(
    "--log-format", type=click.Choice(["text", "json"]), default="text", show_default=True,
    help="Format of the log on stderr. As JSON it has a line for each report, without names.",
)  # fmt: skip
@live_options
def serve(
    config: Path | None, study: Path | None, rehearse: int | None, bridge: Path | None, at: Listening,
    log_format: str, team: LiveOptions,
) -> None:  # fmt: skip
    """Run the live assistant: a web service that receives people's actions and returns suggestions.

    If several tasks are given, people are assigned to them in turn.
    """
    from ..web.log_lines import write_log

    write_log("json" if log_format == "json" else "text")
    for sentence in variables_that_set_nothing(click.get_current_context().command, ServeSetting):
        note(sentence)
    if study is not None:
        conduct(study, team.data, team.given, at, rehearse or 0)
        return
    if rehearse is not None:
        raise click.UsageError("--rehearse: expected --study FILE.toml as well")
    missing = [name for name, there in (("INSTANCE", team.instances), ("--humans K", team.humans)) if not there]
    if missing:
        raise click.UsageError(
            f"{' and '.join(missing)}: missing; expected INSTANCE and --humans K, or --study FILE.toml"
        )
    note("preparing the session; its links follow")
    server = live_server()
    beside = None if bridge is None else bridge_of(bridge, len(team.setting.robots))
    with policy_errors():
        plan = replace(plan_of(team), public_url=at.public_url, trusted_proxies=at.trusted_proxy)
        if beside is not None:
            beside.require_possible(plan.tasks.values(), travels=bool(plan.setting.fleet.each("travel_time").any()))
        with usage_errors(InputFileError):
            session = plan.session()
    for remark in () if beside is None else beside.strangers(session.people):
        note(remark)
    listening = at.listen()

    def ready(access: AccessTokens, people: tuple[str, ...]) -> None:
        join = {person: access.join_url(person) for person in people if person not in plan.simulated}
        click.echo(json.dumps({"url": access.base, "operator": access.operator_url(), "join": join}))
        again = f"the same command with --data {plan.folder} resumes it"
        note(f"the session is saved in {plan.folder}; Ctrl-C ends the service, {again}")

    changed = None if config is None else changed_settings(config, click.get_current_context(), session, team)
    server.serve(plan, session, listening, ready, beside, changed)
