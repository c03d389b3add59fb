"""The plan of a user study: tasks, conditions, texts, questionnaires, and the stages of the procedure."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, Strict

from planner import Instance

from ...declare.catalogue import Catalogue
from ...declare.declared import Count, Expected, Number, Seconds, Seed, Text, Truth, Whole, declared
from ...people.ranges import Population
from ...person.settings import Setting
from .assignment import balanced_orders
from .forms import Item
from .outcomes import COUNTED
from .questionnaires import BEFORE, END, Questionnaire

BETWEEN, WITHIN = "between", "within"
"""Kinds of design: a participant has one condition, or all of them in a counterbalanced order."""

WAITING = "waiting"
"""Kind of the stage at which participants wait for their group."""

Minutes = Annotated[Number, Field(gt=0, le=10_000), Expected("a number of minutes above 0")]
Members = Annotated[Whole, Field(ge=2, le=20), Expected("a whole number from 2 to 20")]
Day = Annotated[date, Strict(), Expected("a date such as 2027-03-31")]


@declared
class Condition:
    """A table of `conditions`, which vary between participants or within each."""

    name: Annotated[Text, Field(description="Name of the condition.")]
    policy: Annotated[Text, Field(description="A shipped team policy, or FILE.py:FUNCTION.")]
    setting: Annotated[Setting, Field(description="The study's setting, with what differs in this condition.")] = (
        Setting()
    )
    reasons: Annotated[Truth, Field(description="Whether participants see the reasons of suggestions.")] = False


@declared
class Grouping:
    """The table `group`: several participants share a robot."""

    size: Annotated[Members, Field(description="Participants of a group.")]
    wait: Annotated[Minutes, Field(description="Minutes after which a participant no longer waits for the others.")] = (
        5.0
    )
    then: Annotated[
        Literal["end", "alone", "start"],
        Field(description="What happens then: the study ends, or begins alone, or with those who are there."),
    ] = "end"


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
        For tasks, questionnaires, and waiting for the group, 1 in the participant's first condition; 0 for others.
    """

    name: str
    kind: str
    what: str = ""
    period: int = 0


@declared(kw_only=True)
class UserStudyPlan:
    """What a user study's file sets, and the study has as it is."""

    design: Annotated[
        Literal["between", "within"],
        Field(description="Whether a participant has one condition, or all of them in a balanced order."),
    ] = "between"
    participants: Annotated[Count | None, Field(description="Number of places; unlimited unless given.")] = None
    again: Annotated[Truth, Field(description="Whether simulated people start again when they have finished.")] = True
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
    tick: Annotated[
        Seconds, Field(le=86_400, description="Seconds without an action after which the robot decides again.")
    ] = 2.0
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
        tuple[Text, ...], Field(description="Outcomes that test your hypotheses; all others are exploratory.")
    ] = ()
    seed: Annotated[Seed, Field(description="Seed of what is drawn; when participants come and act is not.")] = 0
    group: Annotated[
        Grouping | None,
        Field(description="How participants form groups that share a robot; each has a team unless given."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class UserStudy(UserStudyPlan):
    """The plan of a user study.

    Attributes
    ----------
    file : Path
    digest : str
        Digest of the file's content.
    title : str
    tasks : tuple of (str, Instance)
        Tasks by name, in the order in which all participants do them.
    practice : Instance or None
    conditions : tuple of Condition
    reference : str
        The condition with which the others are compared.
    simulated : int
        Number of simulated people in each participant's team.
    setting : Setting
    population : Population
        The robot's prior over people, from which simulated people are drawn too.
    texts : dict of str
        Consent, instructions and thanks, in Markdown.
    questionnaires : tuple of Questionnaire
    catalogue : Catalogue
        Texts of participants' pages, in the study's language.
    """

    file: Path
    digest: str
    title: str
    tasks: tuple[tuple[str, Instance], ...]
    practice: Instance | None
    conditions: tuple[Condition, ...]
    reference: str
    simulated: int
    setting: Setting
    population: Population
    texts: dict[str, str]
    questionnaires: tuple[Questionnaire, ...]
    catalogue: Catalogue

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Stages of the procedure, in order."""
        practice = [] if self.practice is None else [Stage("practice", "practice", "practice")]
        # Between participants, the end of the study is the end of the only condition.
        once = [BEFORE, END] if self.is_within else [BEFORE]
        parts = [] if self.group is None else [(WAITING, "")]
        parts += [("task", name) for name, _ in self.tasks]
        parts += [("questionnaire", one.name) for one in self.questionnaires if one.when not in (BEFORE, END)]
        parts += [("questionnaire", one.name) for one in self.questionnaires if one.when == END and END not in once]

        def singles(when: str) -> list[Stage]:
            names = [one.name for one in self.questionnaires if one.when == when and when in once]
            return [Stage(f"questionnaire {name}", "questionnaire", name) for name in names]

        return (
            Stage("consent", "consent"), Stage("instructions", "instructions"), *singles(BEFORE), *practice,
            *(
                Stage(" ".join(filter(None, [kind, what, str(period) * self.is_within])), kind, what, period)
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

    def begins_at(self, period: int) -> int:
        """Return the number of the first task's stage in a participant's condition, which is 1 for the first."""
        return self.stages.index(next(one for one in self.stages if (one.kind, one.period) == ("task", period)))

    def condition(self, name: str) -> Condition:
        """Return the condition of this name."""
        return next(one for one in self.conditions if one.name == name)

    def is_by_condition(self, questionnaire: Questionnaire) -> bool:
        """Whether the answers belong to one condition."""
        return questionnaire.when != BEFORE and not (questionnaire.when == END and self.is_within)

    def conditions_with(self, outcome: str) -> tuple[str, ...]:
        """Return the conditions in which an outcome or a questionnaire can have values.

        A share of suggestions has none under the policy `none`, and a questionnaire none where it is not shown.
        """
        if any(one.name == outcome and one.share_of is not None for one in COUNTED):
            return tuple(one.name for one in self.conditions if one.policy != "none")
        asked = next((one.conditions for one in self.questionnaires if one.name == outcome), ())
        return tuple(one.name for one in self.conditions if not asked or one.name in asked)

    def compared_in(self, outcome: str) -> tuple[str, ...]:
        """Return the conditions in which an outcome can be compared with the reference."""
        found = self.conditions_with(outcome)
        return tuple(name for name in found if name != self.reference) if self.reference in found else ()

    @property
    def comparisons(self) -> int:
        """Number of comparisons of the confirmatory outcomes, the family over which p-values are adjusted."""
        return sum(len(self.compared_in(name)) for name in self.confirmatory)

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

    def patience(self, kind: str) -> float:
        """Return the minutes without a page after which a participant at a stage of this kind counts as dropped out.

        Who waits for a group has to be there when it begins, and who has not consented keeps a place from others; half
        a minute, or a whole one, suffices for a reload.
        """
        if kind == WAITING:
            return min(self.away, 0.5)
        return min(self.away, 1.0) if kind == "consent" and self.participants is not None else self.away

    def questionnaire(self, name: str) -> Questionnaire:
        """Return the questionnaire of this name."""
        return next(one for one in self.questionnaires if one.name == name)
