"""The command `serve`: the live assistant for people at work, over HTTP."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from planner.errors import DamagedFileError, MissingExtraError, ResultsExistError

from .live import live_options, plan_of
from .policies import policy_errors

if TYPE_CHECKING:
    from ..live.access import Access

PORT = 8000


@click.command()
@click.argument("instances", metavar="INSTANCE...", nargs=-1, required=True)
@click.option("--port", type=click.IntRange(0, 65535), help=f"0 for any.  [default: {PORT}, or another if it is taken]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Where to listen; 0.0.0.0 for all networks.")
@live_options
def serve(instances: tuple[str, ...], port: int | None, host: str, **team: Any) -> None:
    """Run the assistant live: what people do comes in over HTTP, whom to help and how goes out.

    Several tasks are given to people in turn.
    """
    try:
        from ..live import server
    except ImportError as error:
        raise MissingExtraError("the live assistant needs", str(error.name), "web") from None
    with policy_errors():
        plan = plan_of(instances, **team)
        try:
            session = plan.session()
        except (ResultsExistError, DamagedFileError):
            raise
        except ValueError as error:
            raise click.UsageError(str(error)) from None
    listening = server.listen(host, PORT if port is None else port, otherwise=0 if port is None else None)

    def ready(access: Access, people: tuple[str, ...]) -> None:
        join = {person: access.join_url(person) for person in people if person not in plan.simulated}
        click.echo(json.dumps({"url": access.base, "operator": access.operator_url(), "join": join}))
        click.echo(
            f"the session is kept in {plan.folder}; Ctrl-C ends the service, --data {plan.folder} goes on", err=True
        )

    server.serve(plan, session, listening, ready)
