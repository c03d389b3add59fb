"""Neighbours: who sees whom being helped, and how theta of those who see it moves.

People at their stations see what a robot suggests to a neighbour, whether the neighbour follows, and what comes of it.
A visibility graph (`Neighbours`) has a weight in [0, 1] for each pair of stations. A rule moves theta of those who see
an event, by `update(theta, event)` with a `SeenEvent`: a deterministic map, as trust rules are.

A rule is shipped by the name in its `tag` once its class is in `SEEN_RULES`, as trust rules are: a field with the mark
`Fitted` is estimated from logs. Its name is that of no field of a trust rule, as both are estimated together. A rule of
one's own is any frozen object with `update`, which is tried where it is given (`SeenAlone`). A step has this order:
people act, their theta moves by what was suggested to them, and then by what they saw, in the order of the people that
they saw.
`neighbourhood` applies the maps to people and to beliefs, `sights` to people of a log.

Bounds on team policies need to know how far theta can come. A rule with a method `envelope` tells it: the least and
the largest theta after an event, both of which rise with theta. A bound with another rule is refused.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

from pydantic import BeforeValidator, Field, PlainValidator

from ..declare.declared import MOST, Beside, DeclarationError, Expected, Number, Truth, declared, is_declared
from .given_rules import given_as, possible
from .trust_rules import LARGEST_STEP, LEAST, Event, Feedback, Fitted, TrustRule, by_name
from .user_code import UserCodeError, function_beside

if TYPE_CHECKING:
    from .decision import Bools, Floats, Ints

Range = tuple[float, float]

STEP, LOGIT = Fitted(0.0, 1.0, (0.03, 0.1)), Fitted(0.0, LARGEST_STEP, (0.1, 0.4))


@dataclass(frozen=True)
class SeenEvent:
    """A suggestion to a neighbour, as somebody sees it; arrays that broadcast with theta.

    Attributes
    ----------
    gain : float array
        What came of it: the change of the neighbour's value in this step, in cost units. That is the fall of h*, or of
        the cost-to-go that the neighbour perceives if the robot knows it; the mean over goals, if there are several.
    followed : bool array
        Whether the neighbour did what was suggested.
    weight : float array
        Weight of the pair in the visibility graph, in (0, 1].
    """

    gain: Floats
    followed: Bools
    weight: Floats

    def of(self, rows: Ints) -> SeenEvent:
        """Return some of the events, given by the rows of the arrays."""
        return SeenEvent(self.gain[rows], self.followed[rows], self.weight[rows])


class SeenRule(Protocol):
    """A map of theta and what somebody sees of a neighbour to the theta after it."""

    def update(self, theta: Floats, event: SeenEvent) -> Floats:
        """Return theta after the event; the arrays of both broadcast."""
        ...


@declared
class SeenNothing:
    """Theta stays, whatever is seen of neighbours."""

    tag: ClassVar[Mapping[str, str]] = {"rule": "none"}

    def update(self, theta: Floats, event: SeenEvent) -> Floats:  # noqa: ARG002
        """Return theta as it is."""
        return theta

    def envelope(self, theta: Floats, gain: Range, weight: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Return theta as it is."""
        return theta, theta


@declared
class SeenOutcome:
    """Equation (7) with a neighbour's gain: theta' = clip(theta + weight eta_seen gain / utility_scale, 0, 1)."""

    eta_seen: Annotated[
        Number, Fitted(0.0, 1.0, (0.03, 0.1, 0.3)), Field(ge=0, le=MOST, description="Rate by which theta moves.")
    ] = 0.1
    utility_scale: Annotated[Number, Field(ge=1 / MOST, le=MOST, description="Unit of value, in cost units.")] = 1.0
    tag: ClassVar[Mapping[str, str]] = {"rule": "outcome"}

    def update(self, theta: Floats, event: SeenEvent) -> Floats:
        """Return theta after the event."""
        from .decision import trust

        return trust(theta, 0.0, event.weight * event.gain, self.eta_seen, self.utility_scale)

    def envelope(self, theta: Floats, gain: Range, weight: float) -> tuple[Floats, Floats]:
        """Return the least and the largest theta after an event whose gain is in a range."""
        return _ends(theta, [self.update(theta, _event(end, True, weight)) for end in gain])


@declared
class SeenFollowed:
    """Theta rises by a step times the weight when a neighbour follows a suggestion, and falls by one when not."""

    rise: Annotated[Number, STEP, Field(ge=0, le=1, description="Rise of theta when the neighbour follows.")] = 0.05
    fall: Annotated[
        Number, STEP, Field(ge=0, le=1, description="Fall of theta when the neighbour does not follow.")
    ] = 0.05
    tag: ClassVar[Mapping[str, str]] = {"rule": "followed"}

    def update(self, theta: Floats, event: SeenEvent) -> Floats:
        """Return theta after the event."""
        import numpy as np

        return np.clip(theta + event.weight * np.where(event.followed, self.rise, -self.fall), 0.0, 1.0)

    def envelope(self, theta: Floats, gain: Range, weight: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Return theta after a neighbour has not followed, and after one has."""
        return _ends(theta, [self.update(theta, _event(0.0, followed, weight)) for followed in (False, True)])


@declared
class SeenSteps:
    """Logit(theta) moves by a step times the weight when a neighbour follows a suggestion; else theta stays."""

    seen_gain: Annotated[
        Number,
        LOGIT,
        Field(ge=0, le=MOST, description="Step up if the neighbour came closer to the goal, in log-odds."),
    ] = 0.1
    seen_loss: Annotated[
        Number,
        LOGIT,
        Field(ge=0, le=MOST, description="Step down if the neighbour did not come closer, in log-odds."),
    ] = 0.2
    tag: ClassVar[Mapping[str, str]] = {"rule": "steps"}

    def update(self, theta: Floats, event: SeenEvent) -> Floats:
        """Return theta after the event, between `LEAST` and 1 - `LEAST` where it moves."""
        import numpy as np

        step = event.weight * np.where(event.followed, np.where(event.gain > 0, self.seen_gain, -self.seen_loss), 0.0)
        start = np.clip(np.asarray(theta, dtype=float), LEAST, 1 - LEAST)
        return np.where(step == 0, theta, np.clip(1 / (1 + np.exp(-step) * (1 - start) / start), LEAST, 1 - LEAST))

    def envelope(self, theta: Floats, gain: Range, weight: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """Return theta after a step down and after one up."""
        return _ends(theta, [self.update(theta, _event(sign, True, weight)) for sign in (-1.0, 1.0)])


def _ends(theta: Floats, moved: list[Floats]) -> tuple[Floats, Floats]:
    """Return the least and the largest of values of theta that may have moved, or not."""
    import numpy as np

    return np.min([theta, *moved], axis=0), np.max([theta, *moved], axis=0)


def _event(gain: float, followed: bool, weight: float) -> SeenEvent:
    import numpy as np

    return SeenEvent(np.array(gain), np.array(followed), np.array(weight))


@dataclass(frozen=True)
class WithSeen:
    """A trust rule of people who also see their neighbours helped, in estimates from logs and in live sessions.

    Attributes
    ----------
    own : TrustRule
        How theta moves by suggestions to oneself.
    seen : SeenRule
    """

    own: TrustRule
    seen: SeenRule

    @property
    def uses_answer(self) -> bool:
        """As in the person's own rule."""
        return self.own.uses_answer

    @property
    def feedback(self) -> Feedback:
        """As in the person's own rule."""
        return self.own.feedback

    def update(self, theta: Floats, event: Event, *count: Any) -> Floats:
        """Return theta after a suggestion to oneself."""
        return self.own.update(theta, event, *count)

    def __getattr__(self, name: str) -> Any:
        """Return what else the person's own rule has, such as `counts` and `sees_silence`."""
        if name.startswith("__") or name in ("own", "seen"):  # of a copy that has no rules yet
            raise AttributeError(name)
        return getattr(self.own, name)


SEEN_RULES: dict[str, Any] = by_name(SeenNothing, SeenOutcome, SeenFollowed, SeenSteps)
"""The classes of the shipped rules, by name."""


@dataclass(frozen=True)
class SeenAlone:
    """A rule of what is seen, as the trust rule of somebody who takes each suggestion for one to a neighbour.

    So a rule of one's own is tried and identified as trust rules are. Suggestions whose outcome is not shown are to a
    neighbour who is seen with half of the weight.

    Attributes
    ----------
    seen : SeenRule
    """

    seen: SeenRule
    uses_answer: ClassVar[bool] = True
    feedback: ClassVar[Feedback] = "never"

    @property
    def __name__(self) -> str:
        """The name in messages: that of the rule."""
        return str(getattr(self.seen, "__name__", type(self.seen).__name__))

    @property
    def file(self) -> Any:
        """The file of the rule; an AttributeError if it is in none."""
        return self.seen.file  # type: ignore[attr-defined]

    def update(self, theta: Floats, event: Event) -> Floats:
        """Return theta after the event.

        Raises
        ------
        UserCodeError
            The rule's envelope does not contain it.
        """
        import numpy as np

        weight = np.where(event.shown, 1.0, 0.5)
        moved = self.seen.update(theta, SeenEvent(event.gain, event.followed, weight))
        if (within := getattr(self.seen, "envelope", None)) is not None:
            gain = float(np.min(event.gain)), float(np.max(event.gain))
            least, most = within(theta, gain, float(np.max(weight)))
            if (moved < least - 1e-12).any() or (moved > most + 1e-12).any():
                raise UserCodeError("moves theta out of its `envelope`; expected the least and the largest theta there")
        return moved


def seen_rule(given: Any) -> SeenRule:
    """Return a rule of what is seen: that of a name, a table or FILE.py:RULE, or the user's own object.

    Raises
    ------
    UserCodeError
        It is a rule of the user's own that fails, or leads to what is impossible.
    ValueError
        There is no such rule, or it has no such field.
    """
    found = given_as(
        given, SEEN_RULES,
        lambda rule: possible(rule if isinstance(rule, type) else SeenAlone(rule)), "a method update(theta, event)",
    )  # fmt: skip
    made: SeenRule = SEEN_RULES[found]() if isinstance(found, str) else found
    return made


def _rows(value: Any) -> Any:
    """Return a list or array of rows as tuples."""
    listed = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(listed, list | tuple):
        return listed
    return tuple(tuple(row) if isinstance(row, list) else row for row in listed)


Weight = Annotated[Number, Field(ge=0, le=1)]
Rows = Annotated[tuple[tuple[Number, ...], ...], BeforeValidator(_rows)]


@declared
class Neighbours:
    """Who sees whom being helped, and how theta of those who see it moves.

    Stations are people's places in the team, numbered from 1.
    """

    rule: Annotated[
        SeenRule,
        PlainValidator(seen_rule),
        Beside(function_beside),
        Expected('the name of a rule, your own FILE.py:RULE, or a table such as {rule = "outcome", eta_seen = 0.1}'),
        Field(
            description=f"How theta moves by what is seen of a neighbour: one of the names {', '.join(SEEN_RULES)}, a "
            "table, or your own FILE.py:RULE."
        ),
    ] = SeenNothing()
    sees: Annotated[
        Literal["everybody", "next"],
        Field(description="Whether all see each other, or those who are next to each other in a row."),
    ] = "everybody"
    weight: Annotated[Weight, Field(description="Weight with which those see each other whom `sees` names.")] = 1.0
    pairs: Annotated[
        Rows | None,
        Expected("a list of [station, station] or [station, station, weight]"),
        Field(description="The pairs of stations that see each other, in place of `sees`, each perhaps with a weight."),
    ] = None
    matrix: Annotated[
        Rows | None,
        Expected("rows of as many numbers from 0 to 1, 0 on the diagonal"),
        Field(description="Weight with which each station (a row) sees each other one, in place of `sees`."),
    ] = None
    known: Annotated[
        Truth, Field(description="Whether the robots know of it; if not, they believe that theta stays.")
    ] = True

    def __post_init__(self) -> None:
        if self.pairs is not None and self.matrix is not None:
            raise DeclarationError.among("pairs and matrix: expected one of them", "pairs", "matrix")
        for pair in self.pairs or ():
            a, b, w = (*pair, 1.0)[:3] if len(pair) in (2, 3) else (0.0, 0.0, 0.0)
            if a != int(a) or b != int(b) or min(a, b) < 1 or a == b or not 0 <= w <= 1:
                right = f"pairs: {list(pair)}; expected two stations, numbered from 1, and perhaps a weight from 0 to 1"
                raise DeclarationError.among(right, "pairs")
        for k, row in enumerate(self.matrix or ()):
            if len(row) != len(self.matrix or ()) or row[k] != 0 or not all(0 <= w <= 1 for w in row):
                right = (
                    f"matrix: row {k + 1} is {list(row)}; expected as many numbers from 0 to 1 as there are rows, and "
                    "0 on the diagonal"
                )
                raise DeclarationError.among(right, "matrix")

    @property
    def stations(self) -> int:
        """The largest number of stations."""
        return sys.maxsize if self.matrix is None else len(self.matrix)

    def require_stations(self, places: int) -> None:
        """Raise an error if a pair names a station that is none of the places of a team.

        Raises
        ------
        ValueError
            It says which.
        """
        named = max((int(max(pair[:2])) for pair in self.pairs or ()), default=0)
        if named > places:
            raise ValueError(
                f"neighbours.pairs: station {named} in a team of {places}; expected stations up to {places}"
            )

    def weights(self, places: int) -> Floats:
        """Return the weight with which each station sees each other one, shape (K, K); 0 for those that do not.

        Stations beyond the places are left out.

        Raises
        ------
        ValueError
            The graph has fewer stations than places.
        """
        import numpy as np

        if self.matrix is not None:
            if len(self.matrix) < places:
                raise ValueError(f"neighbours.matrix: {len(self.matrix)} stations for {places} people; expected more")
            return np.array(self.matrix, dtype=float)[:places, :places]
        found = np.zeros((places, places))
        if self.pairs is not None:
            for pair in self.pairs:
                a, b = int(pair[0]) - 1, int(pair[1]) - 1
                if max(a, b) < places:
                    found[a, b] = found[b, a] = pair[2] if len(pair) > 2 else 1.0
            return found
        apart = np.abs(np.subtract.outer(np.arange(places), np.arange(places)))
        found[(apart == 1) if self.sees == "next" else (apart > 0)] = self.weight
        return found


Watched = Annotated[
    Neighbours | None,
    Field(description="Who sees whom being helped, and how theta of those who see it moves; nobody unless given."),
]
"""The field of a setting."""


def parts_of(rule: TrustRule) -> tuple[TrustRule, SeenRule]:
    """Return how theta moves by suggestions to oneself, and by what is seen of neighbours, under a rule."""
    return (rule.own, rule.seen) if isinstance(rule, WithSeen) else (rule, SeenNothing())


def seen_rule_of(given: Neighbours | None) -> SeenRule:
    """Return the rule by which theta moves by what is seen."""
    return SeenNothing() if given is None else given.rule


def own_seen_rule(given: Neighbours | None) -> dict[str, TrustRule]:
    """Return the rule by which theta moves by what is seen, by its field, if it is the user's own."""
    rule = seen_rule_of(given)
    return {} if is_declared(type(rule)) else {"neighbours.rule": SeenAlone(rule)}


def moves_theta(given: Neighbours | None) -> bool:
    """Return whether theta moves by what is seen at all."""
    return not isinstance(seen_rule_of(given), SeenNothing)
