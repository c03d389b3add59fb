"""The command `serve`: the live assistant for people at work, over HTTP."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from planner.errors import MissingExtraError
from planner.solving import SolveOptions

from ..team.policies import POLICIES
from .options import NUMBER, OUTPUT_FOLDER, SECONDS, SEED, instance_argument, with_options
from .person import model_options
from .population import population_of, population_options
from .task import costs_of, one_instance

if TYPE_CHECKING:
    from ..live.access import Access

PORT = 8000


@click.command()
@instance_argument
@click.option("--humans", type=click.IntRange(1, 10_000), required=True, metavar="K", help="People in the team.")
@click.option("--port", type=click.IntRange(0, 65535), help=f"0 for any.  [default: {PORT}, or another if it is taken]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Where to listen; 0.0.0.0 for all networks.")
@click.option("--simulate", type=click.IntRange(min=0), default=0, metavar="N", help="Simulated people among the K.")
@click.option("--pace", type=SECONDS, default=3.0, show_default=True, help="Seconds in which those act once.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="From which those are drawn.")
@click.option("--data", type=OUTPUT_FOLDER, metavar="DIR", help="Where the session is kept, and goes on from.")
@click.option("--policy", type=click.Choice(list(POLICIES)), default="attention", show_default=True)
@click.option("--tick", type=SECONDS, default=2.0, show_default=True, help="Idle seconds after which to decide again.")
@click.option("--c-move", type=NUMBER, default=0.5, show_default=True, help="Cost of going to somebody else.")
@click.option(
    "--travel-time", type=NUMBER, default=0.0, show_default=True, help="Above 0 the robot says when it is there."
)
@lambda command: with_options(command, [*model_options(), population_options()])
def serve(
    instance: str, humans: int, port: int | None, host: str, simulate: int, pace: float, seed: int, data: Path | None,
    policy: str, tick: float, domain: str | None, beta: Any, theta: Any, population_file: Path | None, **options: Any,
) -> None:  # fmt: skip
    """Run the assistant live: what people do comes in over HTTP, whom to help and how goes out."""
    from ..drawing import Artist
    from ..team.settings import Setting

    try:
        from ..live import server
    except ImportError as error:
        raise MissingExtraError("the live assistant needs", str(error.name), "web") from None
    if simulate > humans:
        raise click.UsageError(f"--simulate {simulate} is more than --humans {humans}")
    found, population = one_instance(instance, domain), population_of(beta, theta, file=population_file)
    task = costs_of(found, max_states=SolveOptions.max_states, memory_limit_mb=None)
    folder = data or Path(tempfile.mkdtemp(prefix="kitassist-"))
    names = [f"person-{number}" for number in range(1, humans - simulate + 1)]
    simulated = [f"simulated-{number}" for number in range(1, simulate + 1)]
    try:
        Artist(task.task)  # says what is wrong with a `drawing.toml` before anybody sees a page
        plan = server.Plan(
            {found.problem.stem: task}, folder, [*names, *simulated], policy=policy, setting=Setting(**options),
            population=population, simulated=simulated, pace=pace, seed=seed, tick=tick,
        )  # fmt: skip
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    listening = server.listen(host, PORT if port is None else port, otherwise=0 if port is None else None)

    def ready(access: Access, people: tuple[str, ...]) -> None:
        join = {person: access.join_url(person) for person in people if person not in simulated}
        click.echo(json.dumps({"url": access.base, "operator": access.operator_url(), "join": join}))
        click.echo(f"the session is kept in {folder}; Ctrl-C ends the service, --data {folder} goes on", err=True)

    server.serve(plan, listening, ready)
