"""Removal of what is recorded of a participant from the records of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..live.events import ERASED, VACANT
from ..live.store import Change
from .participants import Participant


def without(who: Participant, label: str, of_teams: Mapping[int, Change]) -> Change:
    """Return a function that removes what is recorded of a participant from a record and its answer.

    It is called for all records in order. The order of arrival and the assigned condition remain, on which the
    conditions of others depend.

    Parameters
    ----------
    who : Participant
    label : str
        Stands for the participant in the records.
    of_teams : mapping of int to callable
        The same for the records of the group's team in each period; empty if there is no group.
    """
    time, here = 0.0, False

    def removed(record: dict[str, Any], answer: Any) -> tuple[dict[str, Any], Any]:
        nonlocal time, here
        shared: dict[str, Any] = {}
        if of_teams and record.get("group") == who.group:
            of_team = of_teams[record.get("period", 1)]
            shared = {name: record[name] for name in ("group", "period", "members", "condition") if name in record}
            shared["team"] = [of_team(sub, None)[0] for sub in record["team"]]
            if "members" in record:
                shared["members"] = [label if code == who.code else code for code in record["members"]]
            record = record | shared
        if record.get("person") != who.code:
            time = record["time"]
            return record, answer
        kept: dict[str, Any] = {"n": record["n"], "time": time, "event": ERASED}
        if not here:
            here, kept = True, kept | {"event": VACANT, "person": label, "status": who.status}
            kept |= {"simulated": True} if who.simulated else {}
        elif "condition" in record and not shared:
            kept |= {"person": label, "condition": record["condition"]}
        return kept | shared, None

    return removed
