"""The options that describe a live team, and the session that is built from them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from planner import Instance, find_instances
from planner.batch.results_folder import SolveOptions
from planner.system.errors import InputFileError, expected
from planner.system.files import read_json

from ...declare.catalogue import catalogue
from ...declare.declared import DeclarationError, Whole, names_of
from ...declare.options import Given, Value, setting_options
from ...live.live_setting import LiveSetting
from ...person.settings import Setting
from ..terminal.console import usage_errors
from .common import data_option, domain_option, humans_option, new_folder, together
from .config import ENVIRONMENT, named, read_config
from .goals import check_questions, goals_option, several_goals
from .policies import policies_of, policy_option
from .population import RATES, chosen_setting
from .settings import ServeSetting
from .task import costs_of
from .travel import travel_of

if TYPE_CHECKING:
    from planner import CostToGo

    from ...live.event_base import TeamEvent
    from ...live.session import Session
    from ...people.goals import Goals
    from ...web.server import ServedTeam
    from ...web.service import ReadAgain


class LiveOptions(NamedTuple):
    """The tasks, the people and the policy of a live session, with its setting."""

    instances: tuple[str, ...]
    humans: int | None
    simulate: int
    data: Path | None
    policy: str
    problems: tuple[str, ...]
    domain: str | None
    setting: ServeSetting
    given: Given[ServeSetting]


live_options = together(
    "team", LiveOptions,
    (
        click.argument("instances", metavar="INSTANCE...", nargs=-1),
        humans_option(required=False),
        click.option(
            "--simulate", type=Value(Whole, ge=0), default=0, metavar="N",
            help="Number of simulated people among the K.",
        ),
        data_option(required=False),
        policy_option(several=False),
        goals_option,
        domain_option,
        setting_options(ServeSetting, without=("trust", "population"), environment=ENVIRONMENT),
    ),
)  # fmt: skip


def plan_of(team: LiveOptions) -> ServedTeam:
    """Read the tasks and set up the session. Invalid options raise usage errors."""
    from ...drawing import Artist
    from ...live.uncertain_actions import allows_uncertain
    from ...people.goals import first_of
    from ...web.server import JOURNAL, ServedTeam

    setting, given, problems = team.setting, team.given, team.problems
    humans, simulate, data = team.humans or 0, team.simulate, team.data
    if simulate > humans:
        context = click.get_current_context()
        (option,) = (one for one in context.command.params if one.name == "simulate")
        raise named(click.BadParameter(f"{simulate} is more than --humans {humans}", context, option))
    if not simulate:
        given.refuse(["pace", "seed", "population.sigma"], "without --simulate")
    if setting.people_store is None:
        given.refuse(["keep_people"], "without people_store")
    check_questions(setting, given, problems, doubtful=allows_uncertain(setting))
    given.refuse(["knowledge", "max_steps"], "on a live team")
    (chosen_policy,) = policies_of((team.policy,)).values()
    chosen = chosen_setting(LiveSetting, setting, given, rate=False)
    if chosen.trust != "paper":  # influence on real people is constant unless a rule is given
        given.refuse(RATES, 'without trust = "paper"')
    if chosen.fleet.executes:
        raise click.UsageError("execute: expected a robot that suggests; one that acts itself can only be simulated")
    try:
        catalogue(setting.language)  # reports faults in it before a page is served
    except ValueError as error:
        right = str(error)
        raise click.UsageError(given.told(DeclarationError(("language",), None, right, right))) from None
    with usage_errors(InputFileError):
        file = setting.distances
        distance = None if file is None else travel_of(chosen, humans, file, given, more=True).distance
        found = _named(find_instances(team.instances, team.domain))
        if problems and len(found) > 1:
            raise click.UsageError(
                f"--goals with {len(found)} instances: expected one INSTANCE, which has the first goal"
            )
        goals = several_goals(
            str(next(iter(found.values())).problem),
            problems,
            setting.goal_prior,
            domain=team.domain,
        )
        tasks: dict[str, CostToGo | Goals] = {
            name: goals or costs_of(one, max_states=SolveOptions.max_states, memory_limit_mb=None)
            for name, one in found.items()
        }
        for task in tasks.values():
            Artist(first_of(task).task)  # reports faults in a `drawing.toml` before a page is served
    simulated = [f"simulated-{number}" for number in range(1, simulate + 1)]
    names = [*(f"person-{number}" for number in range(1, humans - simulate + 1)), *simulated]
    in_turn = {name: list(tasks)[number % len(tasks)] for number, name in enumerate(names)}
    context = click.get_current_context()
    chosen_tasks = (context.default_map or {}).get("tasks", {})
    goes_on = data is not None and (data / JOURNAL).exists()  # others may have joined, and all have their tasks
    in_team = {**in_turn, **chosen_tasks} if goes_on else in_turn
    _require_known(context.params.get("config"), chosen_tasks, in_team, tasks)
    people = {name: chosen_tasks.get(name, task) for name, task in in_turn.items()}
    return ServedTeam(
        tasks, data or new_folder(), people, policy=chosen_policy, setting=chosen,
        population=setting.population, distance=distance, simulated=simulated,
    )  # fmt: skip


OF_SESSION = ("instances", "domain", "goals", "humans", "policy")
"""Fields of a configuration beside its table `setting` that a session keeps, as decisions follow from them."""


def changed_settings(
    config: Path, context: click.Context, session: Session, team: LiveOptions
) -> Callable[[], ReadAgain]:
    """Return a function that reads a configuration again, and returns what follows from it for a session.

    It raises ValueError if the configuration is faulty. Distances that the environment or the command line sets, also
    by another file, are read again from where they are.
    """
    import numpy as np

    from ...live.events import Began, Rearranged
    from ...web.service import ReadAgain

    command, at_first, setting = context.command, _fields(config), team.setting
    before = None if setting.distances is None else Path(setting.distances)
    source, _ = team.given.sources.get(("distances",), (config, ""))

    def read() -> ReadAgain:
        try:
            settings = read_config(config, command.params)
            again = Given(ServeSetting)
            again.file(config, settings.get("setting", {}), "setting")
            now = again.read().distances
            file = before if source != config else None if now is None else Path(now)
            chosen, there = settings.get("tasks", {}), session.people
            met = session.see(lambda team: [name for name in chosen if team.desk.has_met(name)])
            _require_known(config, chosen, {*there, *met}, session.tasks)
        except click.UsageError as error:
            raise ValueError(error.format_message()) from None
        events: list[TeamEvent] = []
        if file is not None:
            try:
                distance = read_json(file)
                if np.asarray(distance, dtype=float).tolist() != session.distance:
                    events.append(Rearranged(distance=distance))
            except InputFileError as error:
                raise ValueError(f"distances {error}") from None
            except (TypeError, ValueError) as error:
                raise ValueError(f"distances {file}: {error}") from None
        events += [
            Began(person=name, task=task)
            for name, task in chosen.items()
            if name in there and session.person(name)["task"] != task
        ]
        gone = ["setting.distances"] if file is None and session.distance is not None else []
        present = _fields(config)
        changed = [one for one in {**at_first, **present} if at_first.get(one) != present.get(one)]
        bound = {*OF_SESSION, *(f"setting.{name}" for name in (*names_of(Setting), "population", "goal_prior"))}
        restart, new_session = ([one for one in changed if (one in bound) is of] for of in (False, True))
        return ReadAgain(events, restart, gone + new_session)

    return read


def _fields(config: Path) -> dict[str, Any]:
    """Return the fields of a configuration that reading it again does not change, each by its place."""
    from ...declare import tables as toml

    content = toml.load(config)
    inner = {f"setting.{name}": value for name, value in content.pop("setting", {}).items()}
    return {name: value for name, value in {**content, **inner}.items() if name not in ("tasks", "setting.distances")}


def _require_known(
    config: Path | None, chosen: Mapping[str, str], people: Collection[str], tasks: Collection[str]
) -> None:  # fmt: skip
    """Check the table `tasks` of a configuration, which names people's tasks."""
    from ...declare import tables as toml

    for name, task in chosen.items():
        for what, one, known in (("person", name, people), ("task", task, tasks)):
            if one not in known:
                assert config is not None
                why = f"there is no {what} {one!r}; {expected(one, list(known))}"
                raise click.UsageError(str(toml.fault(config, f"tasks.{name}", why)))


def _named(instances: list[Instance]) -> dict[str, Instance]:
    """Return the instances keyed by file name, prefixed by the folder where several files share a name."""
    stems = [instance.problem.stem for instance in instances]
    return {
        stem if stems.count(stem) == 1 else f"{instance.problem.parent.name}/{stem}": instance
        for stem, instance in zip(stems, instances, strict=True)
    }
