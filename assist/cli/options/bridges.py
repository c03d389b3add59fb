"""The bridge of a live team: its settings, read from a file, and its transport."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.system.errors import InputFileError, MissingExtraError

if TYPE_CHECKING:
    from planner import CostToGo

    from ...connect.bridges.messages import BridgeSettings
    from ...connect.bridges.transport import Transport
    from ...people.goals import Goals
    from ...web.service import Bridge

TRANSPORTS = {
    "rosbridge": ("ROS 2", "ros2"), "own_server": ("OPC UA", "opcua"), "server": ("OPC UA", "opcua"),
    "broker": ("MQTT", "mqtt"),
}  # fmt: skip
"""The protocol and the extra of each table that a bridge's settings may have. Without one of these, it is MQTT."""


@dataclass(frozen=True)
class Beside:
    """A bridge that is to work beside the service: its settings, and what makes its transport."""

    file: Path
    settings: BridgeSettings
    transport: Callable[[], Transport]

    def __call__(self, link: str, **options: Any) -> Bridge:
        """Return the bridge, given the operator's link and options as in `assist.connect.bridges.Bridge`."""
        from ...connect.bridges.kernel import Bridge

        return Bridge(self.transport(), link, **options)

    def require_possible(self, tasks: Iterable[CostToGo | Goals]) -> None:
        """Refuse settings with actions that no task has."""
        from ...declare import tables as toml
        from ...people.goals import each_of

        names = {action for task in tasks for each in each_of(task) for action in each.task.actions}
        try:
            with toml.located(self.file), toml.told(self.file):
                self.settings.require_possible({tuple(name[1:-1].lower().split()) for name in names})
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
        table = next((name for name in TRANSPORTS if name in tables), "broker")
        protocol, extra = TRANSPORTS[table]
        try:
            from ...connect.bridges import kernel  # noqa: F401  which needs a client of HTTP

            return Beside(file, *_transport(table, file, robots))
        except MissingExtraError:
            raise
        except ImportError as error:
            raise MissingExtraError(f"the {protocol} bridge needs", str(error.name), extra) from None
    except (InputFileError, OSError) as error:
        raise click.UsageError(str(error)) from None


def _transport(table: str, file: Path, robots: int) -> tuple[BridgeSettings, Callable[[], Transport]]:
    """Read the settings of a bridge; return them, and a function that makes its transport."""
    if table == "rosbridge":
        from ...connect.bridges.ros2 import Ros2
        from ...connect.bridges.ros2_settings import Ros2Settings

        ros = Ros2Settings.read(file, robots)
        return ros, partial(Ros2, ros, robots)
    if table == "own_server":
        from ...connect.bridges import opcua, opcua_server
        from ...connect.bridges.opcua_settings import OwnServerSettings

        opcua.library()
        own = OwnServerSettings.read(file)
        return own, partial(opcua_server.OwnServer, own, robots)
    if table == "server":
        from ...connect.bridges import opcua
        from ...connect.bridges.opcua_settings import OpcUaSettings

        opcua.library()
        other = OpcUaSettings.read(file)
        return other, partial(opcua.OpcUa, other)
    from ...connect.bridges import mqtt
    from ...connect.bridges.mqtt_settings import MqttSettings

    mqtt.library()
    settings = MqttSettings.read(file, robots)
    settings.context()
    return settings, partial(mqtt.Mqtt, settings, robots)
