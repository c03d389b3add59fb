"""Sessions for tests: people, events, and all that can be seen of a session."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from assist.live.event_base import TeamEvent
from assist.live.events import Acted, Answered, Arrived, Elapsed, Paused, Undone, kinds
from assist.live.session import Session
from assist.live.team import Team
from assist.people.ranges import Population
from assist.person.settings import Setting

# People to whom the robot says something after one mistake, too, that they made against its advice.
EASY = Population()
SETTING = Setting(c_suggest=0.02, c_move=0.01, trust="paper")
WRONG = "(place hammer slot-2 box-a)"

KINDS = [*["acted"] * 5, "undone", "left", "joined", "began", "arrived", "elapsed", "paused", "resumed"]
DOUBTS = [*["acted"] * 3, "doubted", "alike", "missed", *["answered"] * 2, "retracted"]
"""Kinds that need an observation model, or people who are asked."""
HAPPENS, DOUBTFUL = (
    st.lists(st.tuples(st.sampled_from(kinds), st.integers(0, 2), st.integers(0, 9)), max_size=most)
    for kinds, most in ((KINDS, 25), (KINDS + DOUBTS, 12))
)


def happen(session: Session, events: list[tuple[str, int, int]], tag: str = "") -> None:
    """Apply events to a, b and c, as far as they are possible."""
    for number, (kind, who, luck) in enumerate(events):
        name = "abc"[who]
        once: dict[str, Any] = {"id": f"{tag}{session.now()}-{number}"}
        if kind in ("paused", "resumed"):
            event: TeamEvent = Paused(paused=kind == "paused", **once)
        elif kind == "elapsed":
            event = Elapsed(**once)
        elif kind == "arrived":
            event = Arrived(person=name, robot=1 + luck % len(session.outlook().robots), **once)
        elif kind in ("undone", "left", "joined", "began"):
            event = kinds(TeamEvent)[kind](person=name, **once)
        elif kind == "retracted":
            event = Undone(person=name, of="answered", **once)
        else:
            options = session.person(name)["applicable"] if name in session.people else []
            action = options[luck % len(options)] if options else "(return box-a)"
            if kind == "answered":
                event = Answered(person=name, answer=(True, False, None, action)[luck % 4], **once)
            else:
                seen: dict[str, Any] = {
                    "acted": {"action": action, "seq": luck if luck < 4 else None}, "missed": {"missed": luck / 9},
                    "alike": {"likelihoods": dict.fromkeys(options, 1.0)},
                    "doubted": {"likelihoods": {action: luck / 9, "(wait)": 0.1}},
                }  # fmt: skip
                event = Acted(person=name, **seen[kind], **once)
        session.report_all([event])


def all_of(session: Session) -> str:
    """Return all views of a session, its beliefs, and the saved team, with the places of robots under way."""
    seen = [session.entry(name) for name in session.people], session.log(), session.recommend(), session.outlook()
    team = session.history
    assert isinstance(team, Team)
    places = team.desk._places
    return repr(seen) + repr(session.beliefs()) + repr((team.desk.robots, places.under_way, team.desk.step))
