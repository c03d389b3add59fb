"""The file of a user study, from which its plan is read.

`docs/userstudy.md` describes the format. Every error names the line and the place in the file.
"""

from __future__ import annotations

import hashlib
from dataclasses import field, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from planner import Instance
from planner.pddl.instances import bundled_files
from planner.system.errors import expected as meant

from ...declare.catalogue import FIRST, Catalogue, catalogue
from ...declare.declared import AnyTable, Expected, Text, Texts, Truth, Whole, declared, names_of, shown
from ...declare.tables import convert, fault, load, replaced
from ...people.ranges import OF_ADVICE_TAKERS, Population, advice_takers
from ...person.settings import Setting, require_effect
from ..plan_tables import among, different, own_policy, population, tasks
from .outcomes import OUTCOMES
from .plan import WITHIN, Condition, UserStudy, UserStudyPlan
from .questionnaire_file import questionnaires_of
from .questionnaires import BEFORE, END, Questionnaire

# More simulated people would keep the robot away from the participant.
Mates = Annotated[Whole, Field(ge=0, le=20), Expected("a whole number from 0 to 20")]


@declared(kw_only=True)
class FileTable(UserStudyPlan):
    """The whole file."""

    tasks: Annotated[Texts, Field(description="Problems, as files or names of shipped tasks, in order.")]
    conditions: Annotated[
        tuple[AnyTable, ...],
        Field(description="Conditions with name and policy, and with setting and reasons where they differ."),
    ]
    consent: Annotated[Text, Field(description="Text in Markdown to which participants consent.")]
    instructions: Annotated[Text, Field(description="Text in Markdown before the first task.")]
    language: Annotated[
        Text,
        Field(description="Language: en, de, or a file such as fr.toml with the texts of assist/declare/en.toml."),
    ] = FIRST
    title: Annotated[Text | None, Field(description="Title of the study; the name of the file unless given.")] = None
    thanks: Annotated[Text | None, Field(description="Text in Markdown after the last task.")] = None
    practice: Annotated[Text | None, Field(description="A problem for practice, without suggestions.")] = None
    reference: Annotated[
        Text | None, Field(description="The condition with which the others are compared; the first unless given.")
    ] = None
    simulated: Annotated[
        Mates | None,
        Field(
            description="Simulated people who share the robot with each participant; 2, or 0 in groups, unless given."
        ),
    ] = None
    reasons: Annotated[Truth, Field(description="Whether participants see the reasons of suggestions.")] = False
    setting: Annotated[AnyTable, Field(description="Fields of the setting, such as costs.")] = field(
        default_factory=dict
    )
    population: Annotated[
        AnyTable,
        Field(
            description="The people whom the robot expects; their influence is as wide as real people's unless given."
        ),
    ] = field(default_factory=dict)
    questionnaires: Annotated[
        tuple[AnyTable, ...], Field(description="Questionnaires before, after and at the end.")
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
    return _study(file, convert(load(file), FileTable, file), carried_out)


def first_difference(before: str, after: str) -> dict[str, Any]:
    """Return the first `line` in which two texts differ, and what it is in each (`before`, `after`)."""
    lines = zip_longest(before.splitlines(), after.splitlines(), fillvalue="")
    found = ((number, one, other) for number, (one, other) in enumerate(lines, start=1) if one != other)
    number, one, other = next(found, (1, "", ""))
    return {"line": number, "before": one.strip()[:80], "after": other.strip()[:80]}


def _study(file: Path, table: FileTable, carried_out: bool) -> UserStudy:
    setting = _setting(file, table.setting)
    conditions = _conditions(file, table, carried_out)
    names = [one.name for one in conditions]
    found = partial(_instance, file, carried_out=carried_out)
    if table.design == WITHIN and len(names) < 2:
        raise fault(file, "design", f"'{WITHIN}' with one condition; expected two or more")
    reference = table.reference or names[0]
    among(file, "reference", [reference], names)
    instances = [found(f"tasks[{number}]", task) for number, task in enumerate(table.tasks, start=1)]
    stems = [task.problem.stem for task in instances]
    for number, stem in enumerate(stems):
        if stem in stems[:number]:
            both = f"{table.tasks[stems.index(stem)]} and {table.tasks[number]}"
            raise fault(file, "tasks", f"{both} have the same file name; expected different names, such as of copies")
    words = _words(file, table.language, carried_out)
    questionnaires = questionnaires_of(file, table.questionnaires, names, words, within=table.design == WITHIN)
    _check_group(file, table)
    _check_confirmatory(file, table.confirmatory, questionnaires)
    study = UserStudy(
        **{name: getattr(table, name) for name in names_of(UserStudyPlan)},
        file=file, digest=hashlib.sha256(file.read_bytes()).hexdigest()[:32], title=table.title or file.stem,
        tasks=tuple(zip(stems, instances, strict=True)),
        practice=None if table.practice is None else found("practice", table.practice),
        conditions=conditions, reference=reference,
        simulated=table.simulated if table.simulated is not None else 2 if table.group is None else 0,
        setting=setting, population=_population(file, table.population, carried_out),
        questionnaires=questionnaires, catalogue=words,
        texts={"consent": table.consent, "instructions": table.instructions,
               "thanks": table.thanks or words("study.thanks_text")},
    )  # fmt: skip
    if not carried_out:
        _check_comparisons(file, study)
    return study


def _check_group(file: Path, table: FileTable) -> None:
    """Check that all places are in groups, which have no simulated people."""
    if table.group is None:
        return
    size, places = table.group.size, table.participants
    if table.simulated:
        raise fault(file, "simulated", f"{table.simulated}; expected 0 in a study with groups")
    if places is not None and places % size:
        raise fault(file, "participants", f"{places}; expected a multiple of {size}, the size of a group")


def _words(file: Path, language: str, carried_out: bool) -> Catalogue:
    own = language.endswith(".toml")
    path = str(file.parent / language) if own else language
    if own and carried_out and not Path(path).exists():
        return catalogue()
    try:
        return catalogue(path)
    except ValueError as error:
        raise fault(file, "language", str(error).removeprefix("language ")) from None


def _check_confirmatory(file: Path, names: tuple[str, ...], questionnaires: tuple[Questionnaire, ...]) -> None:
    """Check that these are different outcomes of the study."""
    scales = [one.name for one in questionnaires if one.scale and one.when not in (BEFORE, END)]
    known = (*OUTCOMES, *scales)
    for number, name in enumerate(names, start=1):
        if name not in known or names.index(name) < number - 1:
            right = meant(name, known) if name not in known else "expected different names"
            raise fault(file, f"confirmatory[{number}]", f"'{name}'; {right}")


def _check_comparisons(file: Path, study: UserStudy) -> None:
    """Check that each confirmatory outcome can be compared with the reference in at least one condition."""
    for number, name in enumerate(study.confirmatory, start=1):
        found = study.conditions_with(name)
        if len(study.conditions) > 1 and not study.compared_in(name):
            what = "has values" if name in OUTCOMES else "is asked"
            where = f"condition {found[0]} only" if len(found) == 1 else f"the conditions {', '.join(found)}"
            where = where if found else "no condition"
            needed = f"expected an outcome of the reference '{study.reference}' and of another condition"
            raise fault(
                file, f"confirmatory[{number}]", f"'{name}' {what} in {where}, so it cannot be compared; {needed}"
            )


def _conditions(file: Path, table: FileTable, carried_out: bool) -> tuple[Condition, ...]:
    """Return the conditions, each with the study's setting and reasons where it has none of its own."""
    found = []
    for number, own in enumerate(table.conditions, start=1):
        place = f"conditions[{number}]"
        whole = {"reasons": table.reasons} | own
        one = convert({name: value for name, value in whole.items() if name != "setting"}, Condition, file, place)
        content = own.get("setting", {})
        if not isinstance(content, dict):
            raise fault(file, f"{place}.setting", f"{shown(content)}; expected a table")
        where = f"{place}.setting" if content else "setting"
        found.append(replace(one, setting=_setting(file, table.setting | content, where)))
    different(file, "conditions", [one.name for one in found])
    if found and not carried_out:
        try:
            require_effect(one.setting for one in found)
        except ValueError as error:
            raise fault(file, "setting", str(error)) from None
    for number, one in enumerate(found, start=1):
        own_policy(file, f"conditions[{number}].policy", one.policy, must_exist=not carried_out)
    return tuple(found)


def _instance(file: Path, place: str, name: str, *, carried_out: bool) -> Instance:
    problem = file.parent / name
    if carried_out:
        return Instance(problem, problem.with_name("domain.pddl"))
    found = tasks(file, place, name)
    if len(found) != 1 or (found[0].problem.name != problem.name and not bundled_files(name)):
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
    if setting.ask_error:
        raise fault(file, f"{place}.ask_error", f"{setting.ask_error:g}; expected 0, as nothing is asked")
    if setting.execute:
        raise fault(file, f"{place}.execute", "true; expected a robot that suggests")
    if len(setting.robots) > 1:
        raise fault(file, "setting.robots", f"{len(setting.robots)}; expected 1")
    return setting


def _population(file: Path, content: dict[str, Any], carried_out: bool) -> Population:
    """Return the prior over participants, whose influence is that of real people unless it is given."""
    if "file" in content:
        ranges = "the ranges in it, such as beta = [0.3, 2.5] and theta = [0.2, 0.9]"
        raise fault(file, "population.file", f"given; expected {ranges}, as the study's folder has no other file")
    if carried_out:  # reports tell ranges, and the file of a choice model may be missing
        content = {name: value for name, value in content.items() if name != "chooses"}
    found = population(file, "population", content)
    if {"theta", "parts", "advice_takers"} & set(content):
        return found
    if others := set(content) - {*OF_ADVICE_TAKERS}:
        raise fault(file, "population", f"{' and '.join(sorted(others))} without theta; expected theta as well")
    return advice_takers(found.beta, found.sigma, chooses=found.chooses)
