"""A user study as a service: connections, participants who leave, time limits, and the robots' decisions."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import urlencode

from ...declare.refusals import AbsentError, InapplicableError, Refusal
from ...live.event_base import Event
from ...live.views import RobotView
from ...studies.userstudy.codes import identifier, spelled
from ...studies.userstudy.cohort import Cohort
from ...studies.userstudy.events import Elapsed, Returned, StudyEvent, Visited, Withdrew
from ...studies.userstudy.roll import DONE, HERE, Participant
from ...studies.userstudy.session import StudySession
from ...studies.userstudy.views import ParticipantView
from ..request_limits import Allowance
from ..service import Erasure, Service
from ..tokens import PARTICIPANT, VISITOR, AccessTokens, secret_in
from ..watchers import Watcher
from .schemas import Assigned, Enrolled, Overview

CODES_KEY = "codes.key"
"""File of the key that leads from ids of browsers and of other systems to codes, which nothing else connects."""


SIGNED = "signed"
"""Empty file in the folder of a study for which signed links were made; it then admits nobody without one."""


def participant_url(access: AccessTokens, participant: str, folder: Path) -> str:
    """Return the join link of a participant whom another system identifies, signed, for any device.

    From then on, the study in the folder admits new participants by signed links only.
    """
    (folder / SIGNED).touch()
    named = identifier(participant)
    query = {"participant": named, "signature": access.signature(PARTICIPANT + named)}
    return f"{access.base}/study?{urlencode(query)}#{access.token(VISITOR)}"


class StudyService(Service):
    """A user study with its writer and its watchers.

    Parameters
    ----------
    session : StudySession
    access : AccessTokens
    ticks : bool
        Whether robots decide again while participants are idle.
    rehearsal : bool
        Whether simulated participants are admitted.
    check : float
        As in `Service`; also the seconds between two looks for idle and absent participants.
    connections : int
        Largest number of open connections for one participant's view.
    ping : float
        As in `Service`.
    """

    events: ClassVar[type[Event]] = StudyEvent
    shown: ClassVar[Mapping[str, type[Any]]] = {"person": ParticipantView, "robot": RobotView}

    def __init__(
        self, session: StudySession, access: AccessTokens, *, ticks: bool = True, rehearsal: bool = False,
        check: float = 1.0, connections: int = 64, ping: float = 15.0,
    ) -> None:  # fmt: skip
        super().__init__(
            session, access, connections=connections, texts=session.study.catalogue, ping=ping, check=check
        )  # fmt: skip
        self.study, self.folder, self.ticks, self.rehearsal = session.study, session.folder, ticks, rehearsal
        self.guesses = Allowance(rate=1 / 30, burst=20)  # withdrawal codes that each network address may try
        self.arrivals = Allowance(rate=0.1, burst=300)  # new participants of each address, such as a waiting room
        self.often = Allowance(rate=1.0, burst=1000)  # what each participant does, all of which is saved
        self._came_from: dict[str, str] = {}  # network addresses of participants, since the service began
        self._arriving = asyncio.Lock()
        self._heard: dict[str, float] = {}  # when a participant who is not connected was last heard of
        access.token(VISITOR)
        self._codes_key = secret_in(self.folder / CODES_KEY)

    # Arrivals and departures.

    def join_url(self) -> str:
        """Return the address at which participants join."""
        return f"{self.access.base}/study#{self.access.token(VISITOR)}"

    def withdrawal_url(self) -> str:
        """Return the address at which participants enter their withdrawal code."""
        return f"{self.access.base}/study?withdraw#{self.access.token(VISITOR)}"

    def operator_url(self) -> str:
        """Return the address of the experimenter's page."""
        return f"{self.access.base}/study/operator#{self.access.operator}"

    def withdrawal_code(self, code: str) -> str:
        """Return the code by which a participant's data can be withdrawn, also without the participant's page."""
        digest = _digest(self.access.operator.encode(), f"withdrawal {code}")
        return f"{code}-{spelled(int.from_bytes(digest, 'big'), 8)}"

    async def withdraw(self, withdrawal: str) -> None:
        """Withdraw the data of the participant whose withdrawal code this is. A repeated request has no effect.

        Raises
        ------
        AbsentError
            There is no such code.
        InapplicableError
            The study's date for withdrawals is over.
        """
        code = withdrawal.strip().upper().rpartition("-")[0]
        real = self.withdrawal_code(code)
        if not hmac.compare_digest(real.encode(), withdrawal.strip().upper().encode()) or code not in self.views:
            raise AbsentError("code")
        if json.loads(self.views[code])["study"]["kind"] not in ("withdrew", "declined"):
            await self.report(Withdrew(person=code))

    def code_of(self, visit: str) -> str:
        """Return the participant code for an id as a visitor gives it; errors as in `visit`."""
        return self.code(_in_one_form(visit))

    def code(self, visit: str) -> str:
        """Return the participant code for a browser's id. The code is always the same and does not reveal the id."""
        return f"P-{spelled(int.from_bytes(_digest(self._codes_key, visit)[:8], 'big'), 6)}"

    def participant_url(self, participant: str) -> str:
        """Return the join link of a participant whom another system identifies, signed, for any device."""
        return participant_url(self.access, participant, self.folder)

    def is_under_way(self, code: str | None) -> bool:
        """Whether this is the code of a participant who takes part at present."""
        ended = ("thanks", "unmatched", "withdrew", "declined", "gone", "full")
        return code is not None and code in self.views and json.loads(self.views[code])["study"]["kind"] not in ended

    async def visit(
        self, visit: str, *, key: str | None = None, signature: str | None = None, simulated: bool = False,
        before: str | None = None, address: str = "",
    ) -> dict[str, Any]:  # fmt: skip
        """Admit a participant, or readmit one; neither the id nor the key is stored.

        Parameters
        ----------
        visit : str
            An id that the browser has drawn, which is secret; or `PARTICIPANT` and the id of another system,
            which others may know. Ids that differ in blanks around them or in invisible signs are the same.
        key : str, optional
            A key that the browser has drawn. It is required for the id of another system without a signature; the
            participant is then readmitted from this browser only.
        signature : str, optional
            The signature of the id. The participant is then readmitted from any device.
        simulated : bool
        before : str, optional
            Code of the participant as whom the same browser has joined. While this participant takes part, there is no
            further place for the browser, unless another one has a signed link.
        address : str
            Network address of the browser, of which a study may admit only so many before their first task. It is
            kept in memory only.

        Raises
        ------
        Refusal
            The signature is wrong, or there is neither a signature nor a key, or the study has signed links and this
            is none.
        Refusal
            There is nothing behind `PARTICIPANT`.
        InapplicableError
            The participant has joined on another device, or another one in this browser has not finished, or too many
            of this address have places that they do not use.
        """
        visit = _in_one_form(visit)
        code, once = self.code(visit), visit
        if signature is not None:
            if not self.access.is_signed(visit, signature):
                raise Refusal("signature")
            if code in self.views:
                found: dict[str, Any] = json.loads(self.views[code])
                return found
        elif before not in (None, code) and self.is_under_way(before):
            if visit.startswith(PARTICIPANT):
                raise InapplicableError("begun_here")
            return dict(json.loads(self.views[before or ""]))
        elif code not in self.views and not simulated and (self.folder / SIGNED).exists():
            raise Refusal("own_links")
        elif visit.startswith(PARTICIPANT):
            if key is None:
                raise Refusal("unsigned")
            once = f"{visit} {key}"
        self._came_from[code] = "" if simulated or signature is not None else address
        event = Visited(person=code, id=_digest(self._codes_key, once)[8:].hex(), simulated=simulated)
        try:
            return await self.report(event)
        except InapplicableError as error:
            if error.key in ("full", "network"):
                raise
            raise InapplicableError("elsewhere") from None

    async def report(self, event: Event | Erasure) -> dict[str, Any]:
        """Record an event, as `Service.report` does; refuse arrivals of an address that holds too many places.

        Raises
        ------
        InapplicableError
            Too many participants of the address have not begun a task.
        Refusal
            The participant has done more for a long time than anybody does by hand. Whoever wants to withdraw can.
        """
        if not isinstance(event, StudyEvent):
            return await super().report(event)
        if isinstance(event, Returned):
            self.heard(event.person)  # also if somebody else asks for it
        if event.by_hand and not self.rehearsal and self.often.wait(event.person):
            raise Refusal("many")
        if self.study.per_address is None or not event.takes_place:
            return await super().report(event)
        async with self._arriving:  # one after the other, so that no two take the last place
            await asyncio.to_thread(self.session.see, partial(self._require_room, event.person))
            return await super().report(event)

    def _require_room(self, code: str, cohort: Cohort) -> None:
        """Refuse a participant who takes a place, if others of the address hold too many before their first task."""
        address, here = self._came_from.get(code, ""), cohort.participants.get(code)
        if not address or (here is not None and (here.status == HERE or here.condition is not None)):
            return
        idle = (
            one.status == HERE and one.condition is None and self._came_from.get(other) == address
            for other, one in cohort.participants.items()
        )  # fmt: skip
        if sum(idle) >= (self.study.per_address or 0):
            raise InapplicableError("network")

    def heard(self, person: str | None) -> None:
        """Note a request or a connection. A participant counts as present, also where no connection can be kept."""
        super().heard(person)
        if person is not None:
            self._heard[person] = self._loop.time()

    def leave(self, person: str, watcher: Watcher) -> None:
        """Remove one watcher of a participant's view."""
        self._heard[person] = self._loop.time()
        super().leave(person, watcher)

    def connected(self, person: str) -> bool:
        """Whether a page of the participant is connected."""
        return person in self._watchers

    def due(self) -> tuple[list[Event], float]:
        """Return departures, expired time limits and ticks that are due, and when to look again."""
        return self.session.see(self._due), self._every

    def _due(self, cohort: Cohort) -> list[Event]:
        now = self._loop.time()
        away = {
            code: None if self.connected(code) else now - self._heard.setdefault(code, now)
            for code, who in cohort.participants.items()
            if who.status == HERE
        }
        found = cohort.caused(self.session.now(), away)
        return [event for event in found if self.ticks or not isinstance(event, Elapsed)]

    # The experimenter's view.

    async def overview(self) -> Overview:
        """Return each participant's stage, condition and status."""
        return await asyncio.to_thread(self.session.see, self._overview)

    def _overview(self, cohort: Cohort) -> Overview:
        study, people = self.study, tuple(self._enrolled(cohort, who) for who in cohort.participants.values())
        counts, policies = cohort.by_condition(), {one.name: one.policy for one in study.conditions}
        conditions = tuple(
            Assigned(
                name=name, policy=" > ".join(policies[one] for one in order), counting=counts[name],
                begun=sum(who.condition == name for who in people),
                done=sum(who.condition == name and who.status == DONE for who in people),
            )
            for name, order in study.orders.items()
        )  # fmt: skip
        return Overview(
            title=study.title, design=study.design, join=self.join_url(), places=study.participants, taken=cohort.taken,
            stages=tuple(stage.name for stage in cohort.stages), conditions=conditions, participants=people,
            events=cohort.count, fault=cohort.fault, problems=tuple(self.problems()),
        )  # fmt: skip

    def _enrolled(self, cohort: Cohort, who: Participant) -> Enrolled:
        tasks = [] if who.erased or who.removed else who.at_tasks()
        return Enrolled(
            code=who.code, status=who.status, stage=cohort.stage(who).name, number=who.at + 1, condition=who.condition,
            connected=self.connected(who.code), simulated=who.simulated, erased=who.erased, excluded=who.excluded,
            seconds=round(self.session.now() - who.entered) if who.status == HERE else None,
            steps=tasks[-1].seen(who.code).steps if tasks else None, group=who.group,
        )  # fmt: skip


def _in_one_form(visit: str) -> str:
    """Return an id with that of another system, if there is one, in the form that all its copies have."""
    if not visit.startswith(PARTICIPANT):
        return visit
    named = identifier(visit.removeprefix(PARTICIPANT))
    if not named:
        raise Refusal("no_id")
    return PARTICIPANT + named


def _digest(key: bytes, text: str) -> bytes:
    return hmac.new(key, text.encode(errors="replace"), hashlib.sha256).digest()
