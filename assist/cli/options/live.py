"""The options that describe a live team, and the session that is built from them."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from planner import Instance, InstanceError, find_instances
from planner.batch.solve_record import SolveOptions
from planner.system.errors import InputFileError, MissingExtraError, expected

from ...texts.catalogue import FIRST, catalogue
from .common import (
    OUTPUT_FOLDER,
    SECONDS,
    SEED,
    Command,
    Number,
    Option,
    Range,
    range_option,
    refuse_unused,
    with_options,
)
from .config import read_config
from .goals import goal_list_options, question_options, questions_of, several_goals
from .person import model_options, observation_options
from .policies import CHOICES, PolicyName, policies_of
from .population import people_option, population_of, population_options, with_rule_of
from .task import costs_of
from .travel import travel_of, travel_options

if TYPE_CHECKING:
    from planner import CostToGo

    from ...live.events import TeamEvent
    from ...live.session import Session
    from ...people.goals import Goals
    from ...web.server import ServedTeam
    from ...web.service import Bridge

DAYS = Number(min=0, max=36_500, min_open=True)


def live_options(command: Command) -> Command:
    """Add the options of a live session. `plan_of` takes their values."""
    options: tuple[Option[Any], ...] = (
        click.option("--humans", type=click.IntRange(1, 10_000), metavar="K", help="Number of people in the team."),
        click.option(
            "--simulate",
            type=click.IntRange(min=0),
            default=0,
            metavar="N",
            help="Number of simulated people among the K.",
        ),
        click.option(
            "--pace",
            type=SECONDS,
            default=3.0,
            show_default=True,
            help="Mean seconds between actions of simulated people.",
        ),
        click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed of simulated people."),
        click.option(
            "--data",
            type=OUTPUT_FOLDER,
            metavar="DIR",
            help="Folder in which the session is stored. An existing session is resumed.",
        ),
        click.option(
            "--people-store",
            type=click.Path(dir_okay=False, path_type=Path),
            metavar="FILE",
            help="Begin with what earlier sessions have learned about people of the same names, and keep it there.",
        ),
        click.option(
            "--keep-people",
            type=DAYS,
            metavar="DAYS",
            default=30.0,
            show_default=True,
            help="Days after which the store forgets a person.",
        ),
        click.option(
            "--policy", type=PolicyName(), default="attention", show_default=True, help=f"Team policy: {CHOICES}."
        ),
        click.option(
            "--tick",
            type=SECONDS,
            default=2.0,
            show_default=True,
            help="Seconds without an event after which the robot decides again.",
        ),
        goal_list_options,
        observation_options,
        question_options,
        click.option(
            "--language",
            default=FIRST,
            show_default=True,
            metavar="NAME",
            help="Language of people's pages: en, de, or a file such as fr.toml.",
        ),
        *model_options(),
        travel_options,
        population_options(real=True),
        people_option,
        range_option("--sigma", (0.1, 1.0), "Range of the size of simulated people's misconceptions (sigma)."),
    )
    return with_options(command, options)


def plan_of(
    instances: tuple[str, ...], *, humans: int, simulate: int, pace: float, seed: int, data: Path | None, policy: str,
    tick: float, language: str, people_store: Path | None, keep_people: float, domain: str | None,
    distances: Path | None, beta: Range, theta: Range | None, sigma: Range, population_file: Path | None,
    people: str | None, problems: Sequence[str], goal_prior: Sequence[str], miss: float, confusion: float,
    ask: float | None, ask_error: float, **options: Any,
) -> ServedTeam:  # fmt: skip
    """Read the tasks and set up the session. Invalid options raise usage errors."""
    from ...drawing import Artist
    from ...large_tasks.person_problem import WHOLE
    from ...people.goals import first_of
    from ...person.observation_model import ObservationModel
    from ...team.settings import Setting
    from ...web.server import ServedTeam

    if simulate > humans:
        raise click.UsageError(f"--simulate {simulate} is more than --humans {humans}")
    population = population_of(beta, theta, sigma, file=population_file, people=people)
    if not simulate:
        refuse_unused(["sigma", "pace", "seed"], "without --simulate")
    if people_store is None:
        refuse_unused(["keep_people"], "without --people-store")
    (chosen,) = policies_of((policy,)).values()
    try:
        texts = catalogue(language)
        doubtful = bool(miss or confusion) or options["suggestions"] == "all"
        options |= questions_of(ask, ask_error, problems, doubtful=doubtful)
        options["observation"] = ObservationModel(miss, confusion)
        setting = Setting(**with_rule_of(population_file, options))
        if setting.trust != "paper":  # influence on real people is constant unless a rule is given
            refuse_unused(["eta", "utility_scale"], "without --trust paper")
        if setting.fleet.executes:
            raise ValueError("--execute: expected a robot that suggests; one that acts itself can only be simulated")
        distance = None if distances is None else travel_of(setting, humans, distances).distance
        found = _named(find_instances(instances, domain))
        if problems and len(found) > 1:
            raise click.UsageError(
                f"--goals with {len(found)} instances: expected one INSTANCE, which has the first goal"
            )
        goals = several_goals(
            str(next(iter(found.values())).problem),
            problems,
            goal_prior,
            domain=domain,
            asked=None if ask is None else WHOLE,
        )
        tasks: dict[str, CostToGo | Goals] = {
            name: goals or costs_of(one, max_states=SolveOptions.max_states, memory_limit_mb=None)
            for name, one in found.items()
        }
        for task in tasks.values():
            Artist(first_of(task).task)  # reports faults in a `drawing.toml` before a page is served
    except InstanceError:
        raise
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    simulated = [f"simulated-{number}" for number in range(1, simulate + 1)]
    names = [*(f"person-{number}" for number in range(1, humans - simulate + 1)), *simulated]
    in_turn = {name: list(tasks)[number % len(tasks)] for number, name in enumerate(names)}
    chosen_tasks = (click.get_current_context().default_map or {}).get("tasks", {})
    _require_known(chosen_tasks, in_turn, tasks)
    in_turn |= chosen_tasks
    return ServedTeam(
        tasks, data or Path(tempfile.mkdtemp(prefix="kitassist-")), in_turn, policy=chosen, setting=setting,
        population=population, distance=distance, simulated=simulated, pace=pace, seed=seed, tick=tick,
        people_store=people_store, keep_people=keep_people, texts=texts,
    )  # fmt: skip


def changed_settings(config: Path, context: click.Context, session: Session) -> Callable[[], list[TeamEvent]]:
    """Return a function that reads a configuration again, and returns the events by which a session follows it.

    It raises ValueError if the configuration is faulty. Distances that the environment or the command line sets are
    read again from the same file.
    """
    import numpy as np

    from ...live.events import Began, Rearranged

    command, before = context.command, context.params["distances"]
    fixed = context.get_parameter_source("distances") in {ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT}

    def read() -> list[TeamEvent]:
        try:
            settings = read_config(config, command.params, ("tasks",))
            file = before if fixed or "distances" not in settings else Path(settings["distances"])
            tasks = {name: session.person(name)["task"] for name in session.people}
            _require_known(settings.get("tasks", {}), tasks, session.tasks)
        except click.UsageError as error:
            raise ValueError(error.format_message()) from None
        events: list[TeamEvent] = []
        if file is not None:
            try:
                distance = json.loads(file.read_text(encoding="utf-8"))
                if np.asarray(distance, dtype=float).tolist() != session.distance:
                    events.append(Rearranged(distance=distance))
            except (OSError, TypeError, ValueError) as error:
                raise ValueError(f"distances {file}: {error}") from None
        chosen = settings.get("tasks", {}).items()
        return events + [Began(person=name, task=task) for name, task in chosen if tasks[name] != task]

    return read


def _require_known(chosen: Mapping[str, str], people: Collection[str], tasks: Collection[str]) -> None:
    """Check the table `tasks` of a configuration, which names people's tasks."""
    for name, task in chosen.items():
        for what, one, known in (("person", name, people), ("task", task, tasks)):
            if one not in known:
                raise click.UsageError(f"tasks.{name}: there is no {what} {one!r}; {expected(one, list(known))}")


def bridge_of(file: Path, robots: int = 1) -> Callable[[str], Bridge]:
    """Read the settings of a bridge of so many robots; return a function that makes it, given the operator's link.

    The settings of an OPC UA bridge have a table `server` or `own_server`, those of a ROS 2 bridge a table `rosbridge`.
    Others are of an MQTT bridge.

    Raises
    ------
    MissingExtraError
        The packages of the bridge's extra are not installed.
    click.UsageError
        The settings are faulty, or a file of the TLS settings cannot be read.
    """
    try:
        from ...bridges import mqtt, opcua, opcua_server
        from ...bridges.mqtt_settings import MqttSettings
        from ...bridges.opcua_settings import OpcUaSettings, OwnServerSettings
        from ...bridges.ros2 import Ros2Bridge
        from ...bridges.ros2_settings import Ros2Settings
        from ...declare import tables as toml
    except ImportError as error:  # of the library for typed tables
        raise MissingExtraError("a bridge needs", str(error.name), "mqtt") from None
    try:
        tables = toml.load(file)
        if "rosbridge" in tables:
            return partial(Ros2Bridge, Ros2Settings.read(file, robots))
        if "own_server" in tables:
            opcua.library()
            return partial(opcua_server.OpcUaServer, OwnServerSettings.read(file, robots))
        if "server" in tables:
            opcua.library()
            return partial(opcua.OpcUaBridge, OpcUaSettings.read(file))
        mqtt.library()
        settings = MqttSettings.read(file, robots)
        settings.context()
        return partial(mqtt.MqttBridge, settings)
    except (InputFileError, OSError) as error:
        raise click.UsageError(str(error)) from None


def _named(instances: list[Instance]) -> dict[str, Instance]:
    """Return the instances keyed by file name, prefixed by the folder where several files share a name."""
    stems = [instance.problem.stem for instance in instances]
    return {
        stem if stems.count(stem) == 1 else f"{instance.problem.parent.name}/{stem}": instance
        for stem, instance in zip(stems, instances, strict=True)
    }
