"""The command `serve`, which runs the live assistant as a web service."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.system.errors import InputFileError

from ..declare.options import Given
from .options.bridges import bridge_of
from .options.common import INPUT_FILE
from .options.config import config_option, configurable
from .options.help import command
from .options.live import changed_settings, live_options, plan_of
from .options.policies import policy_errors
from .options.settings import LiveSetting
from .terminal.console import note
from .user_study import PORT, conduct, listen, live_server, public_url_option, trusted_proxy_option

if TYPE_CHECKING:
    from ..web.request_limits import Networks
    from ..web.tokens import AccessTokens


@configurable
@command("serve kitting/paper --humans 4 --simulate 3")
@click.argument("instances", metavar="INSTANCE...", nargs=-1)
@config_option()
@click.option(
    "--study", type=INPUT_FILE, metavar="FILE.toml", help="Run this user study instead of a team on given tasks."
)
@click.option(
    "--rehearse", type=click.IntRange(1, 1000), metavar="N", help="Rehearse the study with N simulated participants."
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help=f"Port to listen on; 0 for any free one.  [default: {PORT}, or another if it is taken]",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all networks.")
@click.option("--bridge", type=INPUT_FILE, metavar="FILE.toml", help="Connect the team to MQTT, OPC UA or ROS 2.")
@public_url_option
@trusted_proxy_option
@click.option(
    "--log-format", type=click.Choice(["text", "json"]), default="text", show_default=True,
    help="Format of the log on stderr. As JSON it has a line for each report, without names.",
)  # fmt: skip
@live_options
def serve(
    instances: tuple[str, ...], config: Path | None, study: Path | None, rehearse: int | None, port: int | None,
    host: str, bridge: Path | None, public_url: str | None, trusted_proxy: Networks, log_format: str,
    setting: LiveSetting, given: Given[LiveSetting], data: Path | None, humans: int | None, **team: Any,
) -> None:  # fmt: skip
    """Run the live assistant: a web service that receives people's actions and returns suggestions.

    If several tasks are given, people are assigned to them in turn.
    """
    from ..web.log_lines import write_log

    write_log("json" if log_format == "json" else "text")
    if study is not None:
        conduct(study, data, given, host, port, rehearse or 0, public_url, trusted_proxy)
        return
    if rehearse is not None:
        raise click.UsageError("--rehearse: expected --study FILE.toml as well")
    missing = [name for name, there in (("INSTANCE", instances), ("--humans K", humans)) if not there]
    if missing:
        raise click.UsageError(
            f"{' and '.join(missing)}: missing; expected INSTANCE and --humans K, or --study FILE.toml"
        )
    note("preparing the session; its links follow")
    server = live_server()
    beside = None if bridge is None else bridge_of(bridge, len(setting.robots))
    with policy_errors():
        plan = replace(
            plan_of(instances, setting, given, data=data, humans=humans or 0, **team),
            public_url=public_url,
            trusted_proxies=trusted_proxy,
        )
        if beside is not None:
            beside.require_possible(plan.tasks.values())
        try:
            session = plan.session()
        except InputFileError:
            raise
        except ValueError as error:
            raise click.UsageError(str(error)) from None
    for remark in () if beside is None else beside.strangers(session.people):
        note(remark)
    listening = listen(host, port, public_url)

    def ready(access: AccessTokens, people: tuple[str, ...]) -> None:
        join = {person: access.join_url(person) for person in people if person not in plan.simulated}
        click.echo(json.dumps({"url": access.base, "operator": access.operator_url(), "join": join}))
        again = f"the same command with --data {plan.folder} resumes it"
        note(f"the session is saved in {plan.folder}; Ctrl-C ends the service, {again}")

    changed = None if config is None else changed_settings(config, click.get_current_context(), session, setting, given)
    server.serve(plan, session, listening, ready, beside, changed)
