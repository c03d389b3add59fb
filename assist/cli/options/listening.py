"""The options of where the service listens, and of a proxy in front of it."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import click

from planner.system.errors import MissingExtraError

from ...declare.declared import Whole
from ...declare.options import Value
from ..terminal.console import note
from .common import together
from .config import of_kubernetes

if TYPE_CHECKING:
    import socket

    from ...web.request_limits import Networks

PORT = 8000  # usual port of local web servers that need no privileges


def live_server() -> ModuleType:
    """Return the module of the live assistant's server.

    Raises
    ------
    MissingExtraError
        The packages of the extra `web` are not installed.
    """
    try:
        from ...web import server
    except ImportError as error:
        raise MissingExtraError("the live assistant needs", str(error.name), "web") from None
    return server


def _public_address(context: click.Context, option: click.Parameter, given: str | None) -> str | None:
    from ...web.tokens import public_address

    try:
        return None if given is None else public_address(given)
    except ValueError as error:
        raise click.BadParameter(str(error), context, option) from None


public_url_option = click.option(
    "--public-url", callback=_public_address, metavar="URL",
    help="Address of the service behind a proxy, such as https://host.example/kits.",
)  # fmt: skip


def _networks(context: click.Context, option: click.Parameter, given: tuple[str, ...]) -> Networks:
    if not given:
        return ()
    from ...web.request_limits import networks

    try:
        return networks(given)
    except ValueError as error:
        raise click.BadParameter(str(error), context, option) from None


trusted_proxy_option = click.option(
    "--trusted-proxy", callback=_networks, multiple=True, metavar="ADDRESS",
    help="Address or network of a proxy whose X-Forwarded-For names the client. Can be repeated.",
)  # fmt: skip


class PortOption(click.Option):
    """The option `--port`; a variable of its name that Kubernetes sets by itself is no port."""

    def resolve_envvar_value(self, ctx: click.Context) -> str | None:
        """Return the value of the variable."""
        return None if of_kubernetes(str(self.envvar)) else super().resolve_envvar_value(ctx)


class Listening(NamedTuple):
    """Where the service listens, and how it is reached."""

    port: int | None
    host: str
    public_url: str | None
    trusted_proxy: Networks

    def listen(self) -> socket.socket:
        """Return a listening socket. If no port is given, use `PORT`, or any free port if `PORT` is taken."""
        server, port = live_server(), PORT if self.port is None else self.port
        found: socket.socket = server.listen(self.host, port, otherwise=0 if self.port is None else None)
        if self.public_url is not None:
            note(f"listening at {server.address(found)} for a proxy that serves {self.public_url}")
        return found


listening_options = together(
    "at", Listening,
    (
        click.option(
            "--port", cls=PortOption, type=Value(Whole, ge=0, le=65_535),
            help=f"Port to listen on; 0 for any free one.  [default: {PORT}, or another if it is taken]",
        ),
        click.option(
            "--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all networks."
        ),
        public_url_option, trusted_proxy_option,
    ),
)  # fmt: skip
