"""Removal of what is recorded of a participant from the records of a study: after a withdrawal, and on request.

After a withdrawal the participant's code remains, with the stage that was reached. So the participant cannot take part
again, and the tables say that somebody withdrew. After an erasure a label stands for the participant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..live.events import ERASED, VACANT
from ..live.store import Change
from .participants import Participant


def without(who: Participant, label: str, of_teams: Mapping[int, Change]) -> Change:
    """Return a function that removes what is recorded of a participant from a record and its answer.

    It is called for all records in order. The order of arrival and the assigned condition remain, on which the
    conditions of others depend. After a withdrawal, the id under which the participant arrived remains, too, so that
    the same browser is recognised.

    Parameters
    ----------
    who : Participant
    label : str
        Stands for the participant in the records; the participant's code after a withdrawal.
    of_teams : mapping of int to callable
        The same for the records of the group's team in each period; empty if there is no group.
    """
    time, here, withdrawn = 0.0, False, label == who.code

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
        arrival = None
        if not here:
            here, kept = True, kept | {"event": VACANT, "person": label, "status": who.status}
            kept |= {"simulated": True} if who.simulated else {}
            if withdrawn:
                arrival = {"person": label}
                kept |= {"event": "visited", "reached": who.at, "id": record.get("id", f"visit {label}")}
        elif "condition" in record and not shared:
            kept |= {"person": label, "condition": record["condition"]}
        return kept | shared, arrival

    return removed
