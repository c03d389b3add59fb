"""The latest events of a session, as the operator's page lists them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..people.action_names import in_pddl
from .advice import Advice
from .events import ERASED, VACANT


def entries(record: Mapping[str, Any], advices: Sequence[Advice]) -> Iterator[dict[str, Any]]:
    """Yield an event, unless people do not notice it, and each question and suggestion that followed it."""
    entry = {"n": record["n"], "time": record["time"], "event": record["event"], "person": record.get("person")}
    unsaid = {"action": None, "followed": None, "suggestion": None}
    if record["event"] not in ("elapsed", VACANT, ERASED):
        action = record.get("action")
        if "likelihoods" in record:
            action = in_pddl(max(record["likelihoods"], key=record["likelihoods"].get))
        answer = {"answer": record["answer"]} if "answer" in record else {}
        yield entry | unsaid | {"action": action, "followed": record.get("followed")} | answer
    for advice in advices:
        if advice.question is not None:
            asked = {"event": "asked", "person": advice.question.person, "goal": advice.question.goal}
            yield entry | unsaid | asked
        if advice.person is not None and advice.suggestion is not None:
            suggested = {"event": "suggested", "person": advice.person, "suggestion": advice.suggestion}
            yield entry | unsaid | suggested
