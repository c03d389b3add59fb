"""Why nothing is suggested: each cause with what it says and when it holds.

The first cause that holds is told. Its sentence is the text `nothing.KEY`, or `nothing.KEY_of_yours` to a person, if
there is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Place = int | None


@dataclass(frozen=True)
class Cause:
    """A cause.

    Attributes
    ----------
    key : str
        Of its text, and in the explanation's data.
    said : str
        What it says, for the description of the data.
    when : callable
        Whether it holds at a `DecisionPoint`, for the person at a place, or for the whole team (None). That none of
        those before it holds need not be checked.
    more : callable
        Returns further fields of the `WhyNothing`, for the same arguments.
    """

    key: str
    said: str
    when: Callable[[Any, Place], bool]
    more: Callable[[Any, Place], dict[str, Any]] = lambda point, place: {}  # noqa: ARG005


CAUSES = (
    Cause("paused", "suggestions are paused", lambda point, _: point.paused),
    Cause("finished", "the person has reached the goal", lambda point, k: k is not None and point.certainly_ended(k)),
    Cause("probably-finished", "they probably have", lambda point, k: k is not None and point.ended[k]),
    Cause("nobody", "no one is at work", lambda point, k: k is None and not point.working.any()),
    Cause("never", "the policy of the team makes no suggestions", lambda point, _: point.rule == "none"),
    Cause(
        "asked", "a question is open", lambda point, k: point.asked(k) is not None,
        lambda point, k: {"question": point.asked(k)},
    ),
    Cause("waiting", "everybody at work has a suggestion", lambda point, k: k is None and not point.waiting.any()),
    Cause("dead-end", "the goal cannot be reached from here", lambda point, k: point.lost(k)),
    Cause(
        "mistake-elsewhere", 'the policy "reactive" helps after mistakes, and the robot is with another person',
        lambda point, k: point.rule == "reactive" and k is not None and bool(point.beliefs.erred[k]),
    ),
    Cause("no-mistake", "it helps after mistakes, and there was none", lambda point, _: point.rule == "reactive"),
    Cause("no-step", "there is no step to suggest", lambda point, k: point.best(k) is None),
    Cause(
        "cost", "the suggestion is expected to save less than it costs, or the policy considers more than that",
        lambda point, k: True,  # noqa: ARG005
        lambda point, k: {"prospect": point.best(k), "exact": point.rule == "attention"},
    ),
)  # fmt: skip
