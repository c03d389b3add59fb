"""The bridge of a live team: its settings, read from a file, and its transport."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.system.errors import InputFileError, MissingExtraError, in_words

if TYPE_CHECKING:
    from planner import CostToGo

    from ...connect.bridges.messages import BridgeSettings
    from ...connect.bridges.transport import Transport
    from ...people.goals import Goals
    from ...web.service import Bridge

TRANSPORTS = {
    "rosbridge": ("ROS 2", "ros2", "ros2", "Ros2"),
    "own_server": ("OPC UA", "opcua", "opcua_server", "OwnServer"),
    "server": ("OPC UA", "opcua", "opcua", "OpcUa"),
    "broker": ("MQTT", "mqtt", "mqtt", "Mqtt"),
}
"""The protocol, the extra, the module in `assist.connect.bridges` and the transport of each table that a bridge's
settings may have. Without one of these, it is MQTT."""


@dataclass(frozen=True)
class Beside:
    """A bridge that is to work beside the service: its settings, and its transport."""

    file: Path
    settings: BridgeSettings
    transport: Transport

    def __call__(self, link: str, **options: Any) -> Bridge:
        """Return the bridge, given the operator's link and options as in `assist.connect.bridges.Bridge`."""
        from ...connect.bridges.kernel import Bridge

        return Bridge(self.transport, link, **options)

    def require_possible(self, tasks: Iterable[CostToGo | Goals], *, travels: bool) -> None:
        """Refuse settings with actions that no task has, and those of ways that take no time."""
        from ...declare import tables as toml
        from ...people.goals import each_of

        names = {action for task in tasks for each in each_of(task) for action in each.task.actions}
        try:
            with toml.told(self.file):
                self.settings.require_possible({tuple(name[1:-1].lower().split()) for name in names}, travels=travels)
        except InputFileError as error:
            raise click.UsageError(str(error)) from None

    def strangers(self, people: Collection[str]) -> list[str]:
        """Return a remark for each place of the settings that names somebody who is not among these people."""
        return [f"{self.file}: {remark}" for remark in self.settings.strangers(people)]


def bridge_of(file: Path, robots: int = 1) -> Beside:
    """Read the settings of a bridge of so many robots; only the packages of its own protocol are needed.

    Raises
    ------
    MissingExtraError
        The packages of the bridge's extra are not installed.
    click.UsageError
        The settings are faulty, or a file of the TLS settings cannot be read.
    """
    from ...declare import tables as toml

    try:
        tables = toml.load(file)
        protocol, extra, module, name = TRANSPORTS[next((one for one in TRANSPORTS if one in tables), "broker")]
        try:
            import_module("assist.connect.bridges.kernel")  # which needs a client of HTTP
            kind = getattr(import_module(f"assist.connect.bridges.{module}"), name)
        except ImportError as error:
            raise MissingExtraError(f"the {protocol} bridge needs", str(error.name), extra) from None
        settings = kind.reads.read(file, robots)
        return Beside(file, settings, kind(settings, robots))
    except InputFileError as error:
        raise click.UsageError(str(error)) from None
    except OSError as error:
        raise click.UsageError(in_words(error)) from None
