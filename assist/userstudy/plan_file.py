"""The file of a user study, from which its plan is read.

`docs/userstudy.md` describes the format. Every error names the line and the place in the file.
"""

from __future__ import annotations

import hashlib
from dataclasses import field
from datetime import date
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, Strict

from planner import Instance, InstanceError, find_instances
from planner.pddl.instance_finder import bundled_files
from planner.system.errors import expected as meant

from ..declare.declared import AnyTable, Count, Expected, Number, Seed, Text, Texts, Truth, Whole, declared
from ..declare.tables import convert, fault, load, located, replaced
from ..people.ranges import Population
from ..people.real_people import advice_takers
from ..people.user_code import parse
from ..person.settings import Setting
from ..team.policy_names import POLICIES
from ..texts.catalogue import FIRST, Catalogue, catalogue
from .plan import OUTCOMES, WITHIN, Condition, Grouping, UserStudy
from .questionnaire_file import QuestionnaireTable, questionnaires_of
from .questionnaires import BEFORE, END, Questionnaire

Minutes = Annotated[Number, Field(gt=0, le=10_000), Expected("a number of minutes above 0")]
Seconds = Annotated[Number, Field(gt=0, le=86_400), Expected("a number of seconds above 0")]
# More simulated people would keep the robot away from the participant.
Mates = Annotated[Whole, Field(ge=0, le=20), Expected("a whole number from 0 to 20")]
Members = Annotated[Whole, Field(ge=2, le=20), Expected("a whole number from 2 to 20")]
Day = Annotated[date, Strict(), Expected("a date such as 2027-03-31")]


@declared
class ConditionTable:
    """A table of `conditions`."""

    name: Annotated[Text, Field(description="Name of the condition.")]
    policy: Annotated[Text, Field(description="A shipped team policy, or FILE.py:FUNCTION.")]
    setting: Annotated[AnyTable, Field(description="Fields of the setting that differ from the study's.")] = field(
        default_factory=dict
    )
    reasons: Annotated[
        Truth | None,
        Field(description="Whether participants see the reasons of suggestions, if it differs from the study."),
    ] = None


@declared
class GroupTable:
    """The table `group`: several participants share a robot."""

    size: Annotated[Members, Field(description="Participants of a group.")]
    wait: Annotated[Minutes, Field(description="Minutes after which a participant no longer waits for the others.")] = (
        5.0
    )
    then: Annotated[
        Literal["end", "alone", "start"],
        Field(description="What happens then: the study ends, or begins alone, or with those who are there."),
    ] = "end"


@declared
class FileTable:
    """The whole file."""

    tasks: Annotated[Texts, Field(description="Problems, as files or names of shipped tasks, in order.")]
    conditions: Annotated[
        tuple[ConditionTable, ...],
        Field(description="Conditions with name and policy, and with setting and reasons where they differ."),
    ]
    consent: Annotated[Text, Field(description="Text in Markdown to which participants consent.")]
    instructions: Annotated[Text, Field(description="Text in Markdown before the first task.")]
    language: Annotated[
        Text,
        Field(description="Language: en, de, or a file such as fr.toml with the texts of assist/texts/en.toml."),
    ] = FIRST
    title: Annotated[Text | None, Field(description="Title of the study; the name of the file unless given.")] = None
    thanks: Annotated[Text | None, Field(description="Text in Markdown after the last task.")] = None
    practice: Annotated[Text | None, Field(description="A problem for practice, without suggestions.")] = None
    design: Annotated[
        Literal["between", "within"],
        Field(description="Whether a participant has one condition, or all of them in a balanced order."),
    ] = "between"
    reference: Annotated[
        Text | None, Field(description="The condition with which the others are compared; the first unless given.")
    ] = None
    participants: Annotated[Count | None, Field(description="Number of places; unlimited unless given.")] = None
    simulated: Annotated[
        Mates | None,
        Field(
            description="Simulated people who share the robot with each participant; 2, or 0 in groups, unless given."
        ),
    ] = None
    again: Annotated[Truth, Field(description="Whether simulated people start again when they have finished.")] = True
    reasons: Annotated[Truth, Field(description="Whether participants see the reasons of suggestions.")] = False
    cost_to_go: Annotated[
        Truth, Field(description="Whether participants' views have the cost-to-go, which says how far they are.")
    ] = False
    per_address: Annotated[
        Count | None,
        Field(
            description="Participants of one address (IPv6: a /64 network) who may hold a place before the first task."
        ),
    ] = None
    replace: Annotated[
        Truth, Field(description="Whether participants who leave after their task began are replaced.")
    ] = False
    away: Annotated[
        Minutes, Field(description="Minutes without contact after which a participant counts as dropped out.")
    ] = 10.0
    minutes: Annotated[
        Minutes | None, Field(description="Minutes after which a task may be left unfinished; never unless given.")
    ] = None
    tick: Annotated[Seconds, Field(description="Seconds without an action after which the robot decides again.")] = 2.0
    code: Annotated[
        Text | None, Field(description="Completion code of all; each participant has their own unless given.")
    ] = None
    withdraw_until: Annotated[
        Day | None,
        Field(
            description="Last day, by the service's clock, for withdrawing data after the end; no limit unless given."
        ),
    ] = None
    exclude_failed_checks: Annotated[
        Count | None, Field(description="Failed attention checks that exclude from the report; never unless given.")
    ] = None
    confirmatory: Annotated[
        Texts | None, Field(description="Outcomes that test your hypotheses; all others are exploratory.")
    ] = None
    seed: Annotated[Seed, Field(description="Seed of all randomness.")] = 0
    setting: Annotated[AnyTable, Field(description="Fields of the setting, such as costs.")] = field(
        default_factory=dict
    )
    population: Annotated[
        AnyTable,
        Field(
            description="The people whom the robot expects; their influence is as wide as real people's unless given."
        ),
    ] = field(default_factory=dict)
    group: Annotated[
        GroupTable | None,
        Field(description="How participants form groups that share a robot; each has a team unless given."),
    ] = None
    questionnaires: Annotated[
        tuple[QuestionnaireTable, ...], Field(description="Questionnaires before, after and at the end.")
    ] = ()


def read(file: str | Path, *, carried_out: bool = False) -> UserStudy:
    """Read the file of a user study. Paths in the file are relative to its folder.

    Parameters
    ----------
    file : path
    carried_out : bool
        Whether this is the copy in a study's folder. The files that it names may then be missing.

    Raises
    ------
    InputFileError
        The file is invalid; the message names the line, the place and the expected value.
    """
    file = Path(file)
    with located(file):
        return _study(file, convert(load(file), FileTable, file), carried_out)


def _study(file: Path, table: FileTable, carried_out: bool) -> UserStudy:
    names = _conditions(file, table.conditions, carried_out)
    found = partial(_instance, file, carried_out=carried_out)
    if table.design == WITHIN and len(names) < 2:
        raise fault(file, "design", f"'{WITHIN}' with one condition; expected two or more")
    reference = table.reference or names[0]
    if reference not in names:
        raise fault(file, "reference", f"'{reference}'; {meant(reference, names)}")
    tasks = [found(f"tasks[{number}]", task) for number, task in enumerate(table.tasks, start=1)]
    stems = [task.problem.stem for task in tasks]
    if len(set(stems)) < len(stems):
        raise fault(file, "tasks", "two tasks have the same file name; expected different names")
    words = _words(file, table.language, carried_out)
    questionnaires = questionnaires_of(file, table.questionnaires, names, words, within=table.design == WITHIN)
    setting = _setting(file, table.setting)
    conditions = tuple(
        Condition(
            own.name, own.policy,
            _setting(file, table.setting | own.setting, f"conditions[{number}].setting") if own.setting else setting,
            table.reasons if own.reasons is None else own.reasons,
        )
        for number, own in enumerate(table.conditions, start=1)
    )  # fmt: skip
    group = _group(file, table)
    simulated = table.simulated if table.simulated is not None else 2 if group is None else 0
    return UserStudy(
        file, hashlib.sha256(file.read_bytes()).hexdigest()[:32], table.title or file.stem, table.seed,
        tuple(zip(stems, tasks, strict=True)),
        None if table.practice is None else found("practice", table.practice),
        conditions, table.design, reference, table.participants,
        simulated, table.again, table.replace, table.away, table.minutes, table.tick, table.code,
        table.withdraw_until, table.exclude_failed_checks, _confirmatory(file, table, questionnaires),
        setting, _population(file, table.population),
        {"consent": table.consent, "instructions": table.instructions,
         "thanks": table.thanks or words("study.thanks_text")},
        questionnaires, words, group, table.cost_to_go, table.per_address,
    )  # fmt: skip


def _group(file: Path, table: FileTable) -> Grouping | None:
    """Return how participants form groups; None if each has a team of their own."""
    if table.group is None:
        return None
    size, then = table.group.size, table.group.then
    if table.simulated:
        raise fault(file, "simulated", f"{table.simulated}; expected 0 in a study with groups")
    if table.participants is not None and table.participants % size:
        raise fault(file, "participants", f"{table.participants}; expected a multiple of {size}, the size of a group")
    return Grouping(size, table.group.wait, then)


def _words(file: Path, language: str, carried_out: bool) -> Catalogue:
    own = language.endswith(".toml")
    path = str(file.parent / language) if own else language
    if own and carried_out and not Path(path).exists():
        return catalogue()
    try:
        return catalogue(path)
    except ValueError as error:
        raise fault(file, "language", str(error).removeprefix("language ")) from None


def _confirmatory(file: Path, table: FileTable, questionnaires: tuple[Questionnaire, ...]) -> tuple[str, ...]:
    scales = [one.name for one in questionnaires if one.scale and one.when not in (BEFORE, END)]
    known, names = (*OUTCOMES, *scales), table.confirmatory or ()
    for number, name in enumerate(names, start=1):
        if name not in known or names.index(name) < number - 1:
            right = meant(name, known) if name not in known else "expected different names"
            raise fault(file, f"confirmatory[{number}]", f"'{name}'; {right}")
    return tuple(names)


def _conditions(file: Path, tables: tuple[ConditionTable, ...], carried_out: bool) -> list[str]:
    if not tables:
        raise fault(file, "conditions", "[]; expected one table or more")
    names: list[str] = []
    for number, own in enumerate(tables, start=1):
        place = f"conditions[{number}]"
        if own.name in names:
            raise fault(file, f"{place}.name", f"there are two conditions '{own.name}'; expected different names")
        names.append(own.name)
        found = parse(own.policy, file.parent)
        if found is None and own.policy not in POLICIES:
            raise fault(
                file, f"{place}.policy", f"'{own.policy}'; {meant(own.policy, POLICIES, ', or FILE.py:FUNCTION')}"
            )
        if found is not None and not carried_out and not found[0].is_file():
            raise fault(file, f"{place}.policy", f"{found[0]}: no such file")
    return names


def _instance(file: Path, place: str, name: str, *, carried_out: bool) -> Instance:
    problem = file.parent / name
    if carried_out:
        return Instance(problem, problem.with_name("domain.pddl"))
    known = [] if problem.exists() else bundled_files(name)
    try:
        found = find_instances(known or [problem])
    except InstanceError as error:
        raise fault(file, place, str(error)) from None
    if len(found) != 1 or (not known and found[0].problem.name != problem.name):
        raise fault(file, place, f"'{name}' matches {len(found)} problems; expected the file of one")
    return found[0]


def _setting(file: Path, content: dict[str, Any], place: str = "setting") -> Setting:
    setting = replaced(Setting(), content, file, place).for_real_people()
    if setting.travel_time:
        message = f"{setting.travel_time:g}; expected 0, since the robot of a user study does not move"
        raise fault(file, f"{place}.travel_time", message)
    if setting.observation is not None:
        raise fault(file, f"{place}.observation", "given; expected none, as participants' actions are all seen")
    if setting.c_ask is not None:
        raise fault(file, f"{place}.c_ask", "given; expected none, as participants' pages show no questions")
    if setting.execute:
        raise fault(file, f"{place}.execute", "true; expected a robot that suggests")
    if len(setting.robots) > 1:
        raise fault(file, "setting.robots", f"{len(setting.robots)}; expected 1")
    return setting


def _population(file: Path, content: dict[str, Any]) -> Population:
    """Return the prior over participants, whose influence is that of real people unless it is given."""
    found = convert(content, Population, file, "population")
    return found if "theta" in content else advice_takers(found.beta, found.sigma)
