"""A user study as a service runs it: who is connected or gone, whose robot decides once more, whose time is up."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from typing import Any

from ...live.course import Event
from ...userstudy.cohort import HERE, LETTERS, Cohort, StudyEvent
from ...userstudy.session import StudySession
from ..service import Service, Watcher
from ..tokens import AccessTokens

VISITOR = "?"
"""Whose token the join link has: nobody's name, since names have letters."""

NEVER = 1e7
"""Seconds between two ticks of the whole session, which has none: each team has its own."""

LOOK = 1.0
"""Seconds between two looks at who is idle or gone."""


class StudyService(Service):
    """A study with its writer and those who watch.

    Parameters
    ----------
    session : StudySession
    access : AccessTokens
    ticks : bool
        Whether robots decide once more while participants are idle.
    """

    def __init__(self, session: StudySession, access: AccessTokens, *, ticks: bool = True) -> None:
        super().__init__(session, access, tick=NEVER)
        self.study, self.folder, self.ticks = session.study, session.folder, ticks
        self._held: StudySession = session
        self._away: dict[str, float] = {}
        access.token(VISITOR)

    def start(self) -> None:
        """Begin, in the event loop that runs."""
        super().start()
        self._looking = self._loop.create_task(self._look())

    async def stop(self) -> None:
        """End."""
        self._looking.cancel()
        await super().stop()

    # Who comes and goes.

    def join_url(self) -> str:
        """Give the address at which everybody gets a place."""
        return f"{self.access.base}/study/{self.access.token(VISITOR)}"

    def operator_url(self) -> str:
        """Give the address of the page of whoever conducts the study."""
        return f"{self.access.base}/study/operator/{self.access.operator}"

    def code(self, visit: str) -> str:
        """Give the code of who comes with an id of their browser's: always the same, and nothing follows from it."""
        number, signs = int.from_bytes(self._digest(visit)[:8], "big"), ""
        for _ in range(6):
            number, place = divmod(number, len(LETTERS))
            signs += LETTERS[place]
        return f"P-{signs}"

    async def visit(self, visit: str, *, simulated: bool) -> dict[str, Any]:
        """Let somebody come, or come back; the id, which may say who they are, is kept nowhere."""
        once = self._digest(visit)[8:].hex()
        return await self.report(StudyEvent("visited", self.code(visit), id=once, simulated=simulated))

    def _digest(self, visit: str) -> bytes:
        return hmac.new(self.access.operator.encode(), visit.encode(errors="replace"), hashlib.sha256).digest()

    def watch(self, person: str) -> Watcher:
        """Begin to tell what somebody sees; who had gone is back."""
        self._away.pop(person, None)
        return super().watch(person)

    def leave(self, person: str, watcher: Watcher) -> None:
        """End it."""
        super().leave(person, watcher)
        if person not in self._watchers:
            self._away[person] = self._loop.time()

    def connected(self, person: str) -> bool:
        """Whether a page of somebody's is."""
        return person in self._watchers

    async def _look(self) -> None:
        """Report, now and then, what time brings."""
        while True:
            await asyncio.sleep(LOOK)
            for event in await asyncio.to_thread(self._held.see, self._due):
                await self.pass_on(event)

    def _due(self, cohort: Cohort) -> list[Event]:
        now, session_now, study = self._loop.time(), self.session.now(), self.study
        found: list[Event] = []
        for code, person in list(cohort.participants.items()):
            if person.status != HERE:
                continue
            stage = cohort.stages[person.at]
            away = 0.0 if self.connected(code) else now - self._away.setdefault(code, now)
            if away > 60 * study.away:
                found.append(Event("left", code))
            elif stage.kind == "task":
                late = study.minutes is not None and session_now - person.entered > 60 * study.minutes
                if late and not person.expired:
                    found.append(Event("expired", code))
                elif self.ticks and session_now - person.acted > study.tick and self.connected(code):
                    found.append(Event("elapsed", code))
        return found

    # What the operator sees.

    async def overview(self) -> dict[str, Any]:
        """Give who is where, in which condition, and who has left."""
        found: dict[str, Any] = await asyncio.to_thread(self._held.see, self._overview)
        return found

    def _overview(self, cohort: Cohort) -> dict[str, Any]:
        now, study = self.session.now(), self.study
        people = []
        for code, person in cohort.participants.items():
            tasks = person.at_tasks()
            people.append({
                "code": code, "status": person.status, "stage": cohort.stages[person.at].name,
                "number": person.at + 1, "condition": person.condition, "connected": self.connected(code),
                "seconds": round(now - person.entered) if person.status == HERE else None,
                "steps": tasks[-1].seen()["steps"] if tasks else None, "simulated": person.simulated,
            })  # fmt: skip
        counts, policies = cohort.counts(), {one.name: one.policy for one in study.conditions}
        return {
            "title": study.title, "join": self.join_url(), "places": study.participants, "taken": cohort.taken,
            "stages": [stage.name for stage in cohort.stages], "participants": people, "events": cohort.count,
            "fault": cohort.fault, "design": study.design,
            "conditions": [
                {
                    "name": name, "policy": " > ".join(policies[one] for one in order), "counting": counts[name],
                    "begun": sum(who["condition"] == name for who in people),
                    "done": sum(who["condition"] == name and who["status"] == "done" for who in people),
                }
                for name, order in study.orders.items()
            ],
        }  # fmt: skip
