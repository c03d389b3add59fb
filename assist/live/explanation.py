"""Explanations of advice: why this step, why this person now, or why nothing, as data and as sentences.

The data are exact differences of h*, probabilities under the robot's belief, and expected savings of the person's
policy. The sentences say no more than the data. A probability is what the robot expects, never what it has observed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from typing import Annotated

from pydantic import Field

from ..declare.catalogue import FIRST, Catalogue, catalogue
from ..declare.declared import AnyNumber, AnyText, Seldom, Truth, View, declared
from .causes import CAUSES
from .contrast import Contrast


@declared
class WhyStep(View):
    """Why a step is suggested."""

    step: Annotated[AnyText, Field(description="In PDDL notation.")]
    alone: Annotated[
        AnyNumber, Field(description="How likely the person is to choose it without a suggestion, under the belief.")
    ]
    likely: Annotated[
        Contrast | None,
        Field(
            description=(
                "The step against the action that the person is most likely to choose among those that are worse;"
                " if none is worse, among all others. None if there is no other."
            )
        ),
    ]
    goal: Annotated[
        AnyText | None,
        Seldom(),
        Field(description="The goal to which the comparisons refer, if the person pursues one of several."),
    ] = None
    goal_probability: Annotated[AnyNumber, Seldom(), Field(description="How probable this goal is.")] = 1.0


@declared
class Prospect(View):
    """What a suggestion to a person is expected to bring."""

    person: Annotated[AnyText | None, Field(description="None where it is not said who it is.")]
    action: Annotated[AnyText | None, Field(description="The best suggestion; None where it is not said.")]
    worth: Annotated[
        AnyNumber,
        Field(
            description=(
                "By how much it lowers the person's expected discounted cost, in cost units, before its own cost."
            )
        ),
    ]
    cost: Annotated[AnyNumber, Field(description="Cost of the suggestion, in cost units.")]
    moving: Annotated[AnyNumber, Field(description="Cost of the robot's way to the person, in cost units.")]
    beside: Annotated[
        AnyNumber,
        Field(description="By how much it should lower the cost of others, in cost units, if the policy considers it."),
    ] = 0.0

    @property
    def score(self) -> float:
        """The score of Algorithm 1: the expected saving minus the costs of the suggestion and of the way."""
        return self.worth + self.beside - self.cost - self.moving

    @property
    def threshold(self) -> float:
        """The cost of this suggestion at which its score would be 0, if later ones kept their cost."""
        return self.worth + self.beside - self.moving


@declared
class Remark(View):
    """What happened to a person in their present task, besides what they did themselves."""

    what: Annotated[AnyText, Field(description="What it was: the name of its sentence.")]
    other: Annotated[AnyText | None, Field(description="Of whom it was; None where it is not said who it is.")] = None


@declared
class WhyPerson(View):
    """Why a person is helped now."""

    prospect: Annotated[Prospect, Field(description="What a suggestion to them is expected to bring.")]
    here: Annotated[Truth, Field(description="Whether the robot was with the person before.")]
    arrived: Annotated[Truth, Field(description="Whether it is there.")]
    others: Annotated[
        tuple[Prospect, ...], Field(description="The other people who could be helped, the largest score first.")
    ]
    rule: Annotated[AnyText, Field(description="Name of the team's policy.")]
    remark: Annotated[Remark | None, Seldom(), Field(description="What happened to the person last.")] = None


@declared
class WhyQuestion(View):
    """Why a question is asked before anything is suggested."""

    person: Annotated[AnyText, Field(description="Who is asked.")]
    goal: Annotated[AnyText | None, Field(description="The goal that is asked about; None for the last action.")]
    worth: Annotated[
        AnyNumber, Field(description="Expected worth of the answer minus the cost of the question, in cost units.")
    ]


@declared
class WhyNothing(View):
    """Why nothing is suggested, and what would have to change."""

    reason: Annotated[
        AnyText,
        Field(
            description=" ".join(f'"{one.key}": {one.said}.' for one in CAUSES),
            json_schema_extra={"enum": [one.key for one in CAUSES]},
        ),
    ]
    rule: Annotated[AnyText, Field(description="Name of the team's policy.")]
    prospect: Annotated[Prospect | None, Field(description='The best suggestion, if the reason is "cost".')] = None
    exact: Annotated[
        Truth,
        Field(
            description="Whether the policy makes this suggestion exactly if its cost is below `prospect.threshold`."
        ),
    ] = False
    elsewhere: Annotated[Truth, Field(description="Whether the robot's attention is with another person.")] = False
    about: Annotated[AnyText | None, Field(description="Who is asked about; None for the whole team.")] = None
    question: Annotated[
        WhyQuestion | None, Seldom(), Field(description='The open question, if the reason is "asked".')
    ] = None


@declared
class Explanation(View):
    """Why the robot suggests what it does, or nothing."""

    step: Annotated[WhyStep | None, Field(description="Why this step; None without a suggestion.")] = None
    now: Annotated[WhyPerson | None, Field(description="Why this person, now; None if nobody is attended to.")] = None
    nothing: Annotated[WhyNothing | None, Field(description="Why nothing is suggested.")] = None
    against: Annotated[Contrast | None, Field(description="The step against an action that was asked about.")] = None
    words: Annotated[
        Mapping[str, str], Field(exclude=True, description="Actions in the domain's own words, as far as it has them.")
    ] = field(default_factory=dict, repr=False)
    state_probability: Annotated[
        AnyNumber,
        Seldom(),
        Field(
            description=(
                "How probable the task state is for which steps are compared, the most probable one. Expected "
                "savings are averages over all states."
            )
        ),
    ] = 1.0

    def sentences(self, language: str = FIRST) -> list[str]:
        """Return the explanation as sentences.

        Parameters
        ----------
        language : str
            As in `catalogue`.

        Raises
        ------
        ValueError
            There is no such language.
        """
        return list(self._sentences(catalogue(language)))

    def text(self, language: str = FIRST) -> str:
        """Return the explanation as one text; arguments as in `sentences`."""
        return " ".join(self.sentences(language))

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions that the sentences mention, in PDDL notation."""
        found = [] if self.step is None else [self.step.step]
        for one in (self.against, None if self.step is None else self.step.likely):
            if one is not None:
                found.append(one.alternative)
                if one.consequence is not None and one.consequence.action is not None:
                    found.append(one.consequence.action)
        if self.nothing is not None and self.nothing.prospect is not None and self.nothing.prospect.action is not None:
            found.append(self.nothing.prospect.action)
        return tuple(dict.fromkeys(found))

    def in_words(self, words: Mapping[str, str]) -> Explanation:
        """Return the same explanation with actions in the given words."""
        return replace(self, words=words)

    def in_state(self, probability: float) -> Explanation:
        """Return the same explanation for a task state that has this probability."""
        return replace(self, state_probability=probability)

    def without_names(self) -> Explanation:
        """Return the same explanation without the names of other people."""
        if self.now is None:
            return self
        others = tuple(replace(other, person=None, action=None) for other in self.now.others)
        remark = None if self.now.remark is None else replace(self.now.remark, other=None)
        return replace(self, now=replace(self.now, others=others, remark=remark))

    def _sentences(self, say: Catalogue) -> Iterator[str]:
        if self.step is not None:
            yield say("step.suggestion", step=self._action(say, self.step.step))
            if self.state_probability < 1:
                yield say("step.state", probability=say.percent(self.state_probability))
            if self.step.goal is not None:
                yield say("step.goal", goal=self.step.goal, probability=say.percent(self.step.goal_probability))
            if self.against is None:
                yield from self._step(say, self.step)
                likely = self.step.likely
                if (
                    likely is not None
                    and likely.difference <= 0
                    and self.now is not None
                    and self.now.prospect.worth > 0
                ):
                    yield say("step.later")
        if self.against is not None:
            yield self._contrast(say, self.against)
        elif self.now is not None:
            yield from _person(say, self.now, self.step is not None)
        if self.nothing is not None:
            yield from self._nothing(say, self.nothing)

    def _action(self, say: Catalogue, action: str) -> str:
        return say.action(action, self.words.get(action))

    def _step(self, say: Catalogue, why: WhyStep) -> Iterator[str]:
        if why.likely is None:
            yield say("step.only")
            return
        yield self._contrast(say, why.likely)
        if why.likely.probability is not None:
            chances = {"alone": say.percent(why.alone), "probability": say.percent(why.likely.probability)}
            yield say("step.alone", **chances)

    def _contrast(self, say: Catalogue, one: Contrast) -> str:
        table = f"contrast.{one.unit}"
        values = {"alternative": self._action(say, one.alternative), "step": self._action(say, one.step)}
        if one.difference == 0:
            return say(f"{table}.equal" if one.consequence is None else "contrast.cost.longer", **values)
        size = abs(one.difference)
        n = "" if math.isinf(size) else say.number(size) if size % 1 else f"{size:.0f}"
        if one.difference < 0:
            return say(f"{table}.better{'_one' * (size == 1)}", n=n, **values)
        values["more"] = say.texts[f"{table}.more{'_one' * (size == 1)}"].format(n=n)
        if one.consequence is None:
            return say(f"{table}.plain", n=n, **values)
        if one.consequence.action is not None:
            values["action"] = self._action(say, one.consequence.action)
        kind = one.consequence.kind.replace("-", "_") + "_again" * one.consequence.again
        return say(f"{table}.{kind}", n=n, **values)

    def _nothing(self, say: Catalogue, why: WhyNothing) -> Iterator[str]:
        if why.question is not None:
            yield from _asks(say, why.question, why.about)
        elif why.prospect is None:
            key = f"nothing.{why.reason.replace('-', '_')}"
            yours = f"{key}_of_yours"
            yield say(yours if why.about is not None and yours in say.texts else key)
        else:
            yield from self._too_little(say, why, why.prospect)

    def _too_little(self, say: Catalogue, why: WhyNothing, best: Prospect) -> Iterator[str]:
        if why.elsewhere:
            yield say("nothing.elsewhere")
        if best.action is not None and best.person is not None:
            action = self._action(say, best.action)
            if why.about is None:
                yield say("nothing.best", action=action, person=best.person)
            else:
                yield say("nothing.best_for_you", action=action)
        yield _brings(say, "nothing", best, here=False)
        if why.elsewhere:
            return
        if not why.exact:
            yield say("nothing.rule", rule=why.rule)
        elif best.score > 0:
            yield say("nothing.pays")
        elif best.threshold > best.cost / 1000:  # anyone would call a smaller cost none
            yield say("nothing.threshold", threshold=say.below(best.threshold))
        elif best.threshold > 0:
            yield say("nothing.at_no_cost")
        else:
            yield say("nothing.for_the_way" if 0 < best.worth <= best.moving else "nothing.not_for_free")


def _asks(say: Catalogue, why: WhyQuestion, about: str | None) -> Iterator[str]:
    """Yield sentences on an open question, to the person who is asked, or else about them."""
    if about is None:
        yield say("nothing.asked", person=why.person)
    elif why.goal is None:
        yield say("nothing.asked_action")
    else:
        yield say("nothing.asked_goal", goal=why.goal)
    yield say("nothing.asked_worth", worth=say.about(why.worth))


def _brings(say: Catalogue, table: str, one: Prospect, *, here: bool) -> str:
    """Return a sentence on what a suggestion is expected to save, and on the costs of the suggestion and the way."""
    worth = say.about(one.worth) if one.worth > 0 else say.texts["nought"]
    way = "_way" if one.moving > 0 else "_here" if here else ""
    return say(f"{table}.saving{way}", worth=worth, cost=say.number(one.cost), moving=say.number(one.moving))


def _person(say: Catalogue, why: WhyPerson, suggests: bool) -> Iterator[str]:
    mine = why.prospect
    if not suggests:
        yield say("person.present" if why.arrived else "person.coming")
    if why.rule == "reactive":
        yield say("person.mistake")
        return
    if why.remark is not None:
        other = say.texts["somebody"] if why.remark.other is None else why.remark.other
        yield say(f"person.{why.remark.what}", other=other)
    if suggests or not why.arrived:
        yield _brings(say, "person", mine, here=why.here)
    if mine.beside:
        yield say("person.beside" if mine.beside > 0 else "person.beside_harm", worth=say.about(abs(mine.beside)))
    left = say.about(mine.score) if mine.score > 0 else say.texts["nought"]
    best = why.others[0].score if why.others else 0.0
    if not why.others:
        yield say("person.nobody_else", left=left)
    elif best <= 0:
        yield say("person.others_nothing", left=left)
    else:
        key = "person.others_less" if best <= mine.score else "person.others_more"
        key = "person.others_alike" if math.isclose(best, mine.score, abs_tol=1e-9) else key
        yield say(key, left=left, other=say.about(best), rule=why.rule)
