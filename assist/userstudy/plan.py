"""The plan of a user study: tasks, conditions, texts, questionnaires, and the stages of the procedure.

`docs/userstudy.md` describes the file format. Every error names the line and the place in the file.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from planner import Instance, InstanceError, find_instances
from planner.pddl import bundled
from planner.system.errors import InputFileError
from planner.system.errors import expected as meant
from planner.system.typed_toml import (
    AnyTable,
    Number,
    Pair,
    Seed,
    Text,
    Texts,
    Truth,
    Whole,
    convert,
    fault,
    given,
    load,
    located,
    partial_of,
)

from ..people.human import Population
from ..people.mixture import Mixture, advice_takers
from ..people.user_code import parse
from ..team.policies import POLICIES
from ..team.settings import Setting
from ..texts.catalogue import FIRST, Catalogue, catalogue
from .assignment import balanced_orders
from .questionnaire_file import QuestionnaireTable, questionnaires_of
from .questionnaires import BEFORE, END, Item, Questionnaire

BETWEEN, WITHIN = "between", "within"
"""Kinds of design: a participant has one condition, or all of them in a counterbalanced order."""

OUTCOMES = ("completion", "actions", "suboptimal_actions", "seconds", "suggestions", "followed")
"""Outcomes of tasks."""

Minutes = Annotated[float, Meta(gt=0, le=10_000, description="a number of minutes above 0")]
# More simulated people would keep the robot away from the participant.
Mates = Annotated[int, Meta(ge=0, le=20, description="a whole number from 0 to 20")]
Members = Annotated[int, Meta(ge=2, le=20, description="a whole number from 2 to 20")]
Day = Annotated[date, Meta(description="a date such as 2027-03-31")]


class ConditionTable(Struct, forbid_unknown_fields=True):
    """A table of `conditions`."""

    name: Text
    policy: Text
    setting: AnyTable = {}
    reasons: Truth | None = None


class GroupTable(Struct, forbid_unknown_fields=True, frozen=True):
    """The table `group`."""

    size: Members
    wait: Minutes = 5.0
    then: Text = "end"


class PopulationTable(Struct, forbid_unknown_fields=True, frozen=True):
    """The table `population`."""

    beta: Pair | None = None
    theta: Pair | None = None
    sigma: Pair | None = None


class FileTable(Struct, forbid_unknown_fields=True):
    """The whole file."""

    tasks: Texts
    conditions: list[ConditionTable]
    consent: Text
    instructions: Text
    language: Text = FIRST
    title: Text | None = None
    thanks: Text | None = None
    practice: Text | None = None
    design: Text = BETWEEN
    reference: Text | None = None
    participants: Whole | None = None
    simulated: Mates | None = None
    again: Truth = True
    reasons: Truth = False
    replace: Truth = False
    away: Minutes = 10.0
    minutes: Minutes | None = None
    tick: Number = 2.0
    code: Text | None = None
    withdraw_until: Day | None = None
    exclude_failed_checks: Whole | None = None
    confirmatory: Texts | None = None
    seed: Seed = 0
    setting: AnyTable = {}
    population: PopulationTable = PopulationTable()
    group: GroupTable | None = None
    questionnaires: list[QuestionnaireTable] = []


SettingTable = partial_of(
    Setting, trust=str | AnyTable, believed_trust=str | AnyTable, observation=AnyTable, c_ask=float
)


@dataclass(frozen=True)
class Condition:
    """A condition, varied between participants or within each.

    Attributes
    ----------
    name : str
    policy : str
        Name of a team policy, or FILE.py:FUNCTION.
    setting : Setting
        The study's setting, with what differs in this condition.
    reasons : bool
        Whether participants see the reasons of suggestions.
    """

    name: str
    policy: str
    setting: Setting
    reasons: bool


@dataclass(frozen=True)
class Grouping:
    """How participants form groups that share one robot.

    Attributes
    ----------
    size : int
        Number of participants of a group.
    wait : float
        Minutes after which a participant no longer waits for the others.
    then : str
        What happens then: "start" with those who are waiting, or without them ("alone"), or "end" the participant's
        study.
    """

    size: int
    wait: float
    then: str


@dataclass(frozen=True)
class Stage:
    """A stage of the procedure.

    Attributes
    ----------
    name : str
        Name in results: "consent", "instructions", "practice", "waiting", "task ...", "questionnaire ...",
        "thanks".
    kind : str
        The first word of the name.
    what : str
        The task or questionnaire; empty for other stages.
    period : int
        For tasks and questionnaires, 1 in the participant's first condition; 0 for other stages.
    """

    name: str
    kind: str
    what: str = ""
    period: int = 0


@dataclass(frozen=True)
class UserStudy:
    """The plan of a user study.

    Attributes
    ----------
    file : Path
    digest : str
        Digest of the file's content.
    title : str
    seed : int
        Seed of the assignment and of the simulated people.
    tasks : tuple of (str, Instance)
        Tasks by name, in the order in which all participants do them.
    practice : Instance or None
    conditions : tuple of Condition
    design : str
        "between" or "within" participants.
    reference : str
        The condition with which the others are compared.
    participants : int or None
        Number of places; None: unlimited.
    simulated : int
        Number of simulated people in each participant's team.
    again : bool
        Whether simulated people begin again when they have finished, so that the robot stays in demand.
    replace : bool
        Whether participants who leave after their task began are replaced.
    away : float
        Minutes without a connection after which a participant counts as dropped out.
    minutes : float or None
        Time limit of a task in minutes, after which participants may proceed.
    tick : float
        Seconds without an action after which the robot decides again.
    code : str or None
        Completion code of all participants; None: a code of their own.
    withdraw_until : date or None
        Last day (UTC) on which data can be withdrawn after the end; None: no limit.
    exclude_failed_checks : int or None
        Number of failed attention checks from which on participants are excluded from the report; None: never.
    confirmatory : tuple of str
        Outcomes whose comparisons are tests of the study's hypotheses, as one family; all others are exploratory.
    setting : Setting
    population : Population or Mixture
        The robot's prior over people, from which simulated people are drawn too.
    texts : dict of str
        Consent, instructions and thanks, in Markdown.
    questionnaires : tuple of Questionnaire
    catalogue : Catalogue
        Texts of participants' pages, in the study's language.
    group : Grouping or None
        How participants form groups that share a robot; None if each has a team of their own.
    """

    file: Path
    digest: str
    title: str
    seed: int
    tasks: tuple[tuple[str, Instance], ...]
    practice: Instance | None
    conditions: tuple[Condition, ...]
    design: str
    reference: str
    participants: int | None
    simulated: int
    again: bool
    replace: bool
    away: float
    minutes: float | None
    tick: float
    code: str | None
    withdraw_until: date | None
    exclude_failed_checks: int | None
    confirmatory: tuple[str, ...]
    setting: Setting
    population: Population | Mixture
    texts: dict[str, str]
    questionnaires: tuple[Questionnaire, ...]
    catalogue: Catalogue
    group: Grouping | None = None

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Stages of the procedure, in order."""
        practice = [] if self.practice is None else [Stage("practice", "practice", "practice")]
        # Between participants, the end of the study is the end of the only condition.
        once = [BEFORE, END] if self.is_within else [BEFORE]
        parts = [("task", name) for name, _ in self.tasks]
        parts += [("questionnaire", one.name) for one in self.questionnaires if one.when not in (BEFORE, END)]
        parts += [("questionnaire", one.name) for one in self.questionnaires if one.when == END and END not in once]

        def singles(when: str) -> list[Stage]:
            names = [one.name for one in self.questionnaires if one.when == when and when in once]
            return [Stage(f"questionnaire {name}", "questionnaire", name) for name in names]

        return (
            Stage("consent", "consent"), Stage("instructions", "instructions"), *singles(BEFORE), *practice,
            *([] if self.group is None else [Stage("waiting", "waiting")]),
            *(
                Stage(f"{kind} {what}" + f" {period}" * self.is_within, kind, what, period)
                for period in range(1, self.periods + 1)
                for kind, what in parts
            ),
            *singles(END), Stage("thanks", "thanks"),
        )  # fmt: skip

    def condition_at(self, stage: Stage, assigned: str | None) -> str | None:
        """Return the condition of a participant at a stage; None outside of conditions.

        Parameters
        ----------
        stage : Stage
        assigned : str or None
            The participant's condition or order of conditions (`orders`).
        """
        return self.orders[assigned][stage.period - 1] if stage.period and assigned is not None else None

    def items_at(self, number: int, assigned: str | None, participant: int) -> tuple[Item, ...]:
        """Return the questions that a participant sees at a stage, in their order; none at other stages.

        Parameters
        ----------
        number : int
            Number of the stage, from 0.
        assigned : str or None
            The participant's condition or order of conditions (`orders`).
        participant : int
            Number of the participant in the order of arrival, from 0.
        """
        stage = self.stages[number]
        if stage.kind != "questionnaire":
            return ()
        seed = [self.seed, 3, participant, number]  # 1 and 2 are the seeds of a rehearsal
        return self.questionnaire(stage.what).shown(self.condition_at(stage, assigned), seed)

    def is_shown(self, number: int, assigned: str | None) -> bool:
        """Whether participants with this condition or order come to a stage; they skip empty questionnaires."""
        return self.stages[number].kind != "questionnaire" or bool(self.items_at(number, assigned, 0))

    def next_stage(self, number: int, assigned: str | None) -> int:
        """Return the number of the stage that follows; the number of stages after the last one."""
        number += 1
        while number < len(self.stages) and not self.is_shown(number, assigned):
            number += 1
        return number

    def condition(self, name: str) -> Condition:
        """Return the condition of this name."""
        return next(one for one in self.conditions if one.name == name)

    def is_by_condition(self, questionnaire: Questionnaire) -> bool:
        """Whether the answers belong to one condition."""
        return questionnaire.when != BEFORE and not (questionnaire.when == END and self.is_within)

    @property
    def is_within(self) -> bool:
        """Whether each participant has all conditions."""
        return self.design == WITHIN

    @property
    def periods(self) -> int:
        """Number of conditions of each participant."""
        return len(self.conditions) if self.is_within else 1

    @cached_property
    def orders(self) -> dict[str, tuple[str, ...]]:
        """Orders of conditions to which participants are assigned, by name; between participants, single ones."""
        names = [condition.name for condition in self.conditions]
        orders = balanced_orders(names) if self.is_within else [(name,) for name in names]
        return {" > ".join(order): order for order in orders}

    def questionnaire(self, name: str) -> Questionnaire:
        """Return the questionnaire of this name."""
        return next(one for one in self.questionnaires if one.name == name)


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
    if table.design not in (BETWEEN, WITHIN):
        raise fault(file, "design", f"'{table.design}'; {meant(table.design, (BETWEEN, WITHIN))}")
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
    if not 0 < table.tick <= 86_400:
        raise fault(file, "tick", f"{table.tick:g}; expected a number of seconds above 0")
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
        questionnaires, words, group,
    )  # fmt: skip


def _group(file: Path, table: FileTable) -> Grouping | None:
    """Return how participants form groups; None if each has a team of their own."""
    if table.group is None:
        return None
    size, then = table.group.size, table.group.then
    if then not in ("start", "alone", "end"):
        raise fault(file, "group.then", f"'{then}'; expected 'end', 'alone', or 'start' with those who are there")
    if table.design != BETWEEN:
        raise fault(file, "design", f"'{table.design}'; expected '{BETWEEN}' in a study with groups")
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


def _conditions(file: Path, tables: list[ConditionTable], carried_out: bool) -> list[str]:
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
    known = [] if problem.exists() else bundled.files(name)
    try:
        found = find_instances(known or [problem])
    except InstanceError as error:
        raise fault(file, place, str(error)) from None
    if len(found) != 1 or (not known and found[0].problem.name != problem.name):
        raise fault(file, place, f"'{name}' matches {len(found)} problems; expected the file of one")
    return found[0]


def _setting(file: Path, content: dict[str, Any], place: str = "setting") -> Setting:
    try:
        setting = replace(Setting(), **given(convert(content, SettingTable, file, place))).for_real_people()
    except ValueError as error:
        if isinstance(error, InputFileError):
            raise
        raise fault(file, place, str(error)) from None
    if setting.travel_time:
        message = f"{setting.travel_time:g}; expected 0, since the robot of a user study does not move"
        raise fault(file, f"{place}.travel_time", message)
    if setting.observation is not None:
        raise fault(file, f"{place}.observation", "given; expected none, as participants' actions are all seen")
    if setting.c_ask is not None:
        raise fault(file, f"{place}.c_ask", "given; expected none, as participants' pages show no questions")
    if setting.execute:
        raise fault(file, f"{place}.execute", "true; expected a robot that suggests")
    if setting.robots > 1:
        raise fault(file, "setting.robots", f"{setting.robots}; expected 1")
    return setting


def _population(file: Path, table: PopulationTable) -> Population | Mixture:
    ranges = {name: getattr(table, name) for name in ("beta", "theta", "sigma")}
    try:
        given = {name: value for name, value in ranges.items() if value is not None}
        return Population(**given) if "theta" in given else advice_takers(**given)
    except ValueError as error:
        raise fault(file, "population", str(error)) from None
