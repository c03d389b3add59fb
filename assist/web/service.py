"""A session as a service runs it: one thread that writes, and everybody who watches told of what has changed.

Reports from all connections queue up for the writer, which takes all that are there at a time: they share one wait for
the disk. After that, and not before, they are answered, and whoever watches gets what they see now. What is seen is
made once, by the writer; who asks or watches never waits for the disk.

A watcher has room for a few messages that are on their way. One that does not take them is dropped, so that nobody's
memory grows and nobody else waits; it can connect again at any time and is told what there is. Watchers know nothing of
each other: a connection that ends late ends nobody else's.
"""

from __future__ import annotations

import asyncio
import json
import logging
import queue
import threading
from contextlib import suppress
from typing import Any

from ..live.course import AbsentError, Event
from ..live.journal import JournalError
from ..live.live_task import InapplicableError
from ..live.session import Outcome, Outlook, Session
from .tokens import AccessTokens

ROOM = 64
"""Messages on their way to one watcher."""

WAITING = 5000
"""Reports that may wait for the writer."""

TOGETHER = 256
"""Reports that share one wait for the disk."""

TICK = 2.0
"""Seconds without an event after which time has elapsed."""

SLOWEST, FASTEST = 2.0, 0.1
"""Seconds between two messages to the same operator: by how large the team is."""


class BusyError(RuntimeError):
    """More has been reported than can be written; to be tried again."""


class Watcher:
    """Somebody who is told what they see, whenever it changes."""

    def __init__(self) -> None:
        self.messages: asyncio.Queue[bytes | None] = asyncio.Queue(ROOM)
        self.dropped = asyncio.Event()

    def tell(self, message: bytes | None) -> None:
        """Put a message on its way; None: there will be no more."""
        try:
            self.messages.put_nowait(message)
        except asyncio.QueueFull:
            self.dropped.set()


class Service:
    """A session with its writer and its watchers; but for the writer, all of it runs in one event loop.

    Parameters
    ----------
    session : Session
    access : AccessTokens
    tick : float
        Seconds without an event after which time is taken to have elapsed.
    """

    def __init__(self, session: Session, access: AccessTokens, *, tick: float = TICK) -> None:
        self.session, self.access, self.tick = session, access, tick
        session.changed = self._seen
        self.views = {person: _json(self.session.person(person)) for person in self.session.people}
        for person in self.views:
            access.token(person)
        self.outlook = self.session.outlook()
        self.visited = asyncio.Event()
        self.simulated: frozenset[str] = frozenset()
        self._entries: dict[str, bytes] = {}
        self._watchers: dict[str, set[Watcher]] = {}
        self._operators: set[asyncio.Event] = set()
        self._reports: queue.Queue[tuple[Event, asyncio.Future[Outcome]] | None] = queue.Queue(WAITING)
        self._changes: dict[str, bytes | None] = {}
        self._writer: threading.Thread | None = None
        self._last = 0.0

    # The writer.

    def start(self) -> None:
        """Begin to write, in the event loop that runs."""
        self._loop = asyncio.get_running_loop()
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()
        self._ticking = self._loop.create_task(self._tick())

    async def stop(self) -> None:
        """Answer what has been reported, end all connections' messages, and let go of the session."""
        self._ticking.cancel()
        for watchers in self._watchers.values():
            for watcher in watchers:
                watcher.tell(None)
        if self._writer is not None:
            await asyncio.to_thread(self._reports.put, None)
            await asyncio.to_thread(self._writer.join)
        self.session.close()

    def _write(self) -> None:
        ended = False
        while not ended:
            taken = [self._reports.get()]
            with suppress(queue.Empty):
                while len(taken) < TOGETHER:
                    taken.append(self._reports.get_nowait())
            ended = None in taken
            reports = [report for report in taken if report is not None]
            if reports:
                self._changes = {}
                try:
                    outcomes = self.session.report([event for event, _ in reports])
                except Exception as error:  # noqa: BLE001 whatever it is, those who wait are told
                    outcomes = [error] * len(reports)
                futures = [future for _, future in reports]
                seen = dict(self._changes), self.session.outlook()
                self._loop.call_soon_threadsafe(self._deliver, futures, outcomes, *seen)

    def _seen(self, touched: set[str]) -> None:
        """Make what those see for whom something has changed; called by the writer, after it is on the disk."""
        for person in touched:
            try:
                self._changes[person] = _json(self.session.person(person))
            except AbsentError:
                self._changes[person] = None

    def _deliver(
        self,
        futures: list[asyncio.Future[Outcome]],
        outcomes: list[Outcome],
        changes: dict[str, bytes | None],
        outlook: Outlook,
    ) -> None:
        if outlook.events != self.outlook.events:
            self._last = self._loop.time()
        if outlook.fault not in (None, self.outlook.fault):
            logging.getLogger(__name__).warning("the policy: %s", outlook.fault)
        self.outlook = outlook
        for person, view in changes.items():
            self._entries.pop(person, None)
            if view is None:
                self.views.pop(person, None)
            else:
                self.views[person] = view
                self.access.token(person)
            for watcher in self._watchers.get(person, ()):
                watcher.tell(view)
        for operator in self._operators:
            operator.set()
        for future, outcome in zip(futures, outcomes, strict=True):
            if future.done():  # whoever reported it has gone
                continue
            if isinstance(outcome, Exception):
                future.set_exception(outcome)
            else:
                future.set_result(outcome)

    async def report(self, event: Event) -> dict[str, Any]:
        """Let something happen; give what whoever it is about sees then.

        Raises
        ------
        BusyError
            Too much waits to be written.
        Exception
            As `Session.report` gives them.
        """
        future: asyncio.Future[Any] = self._loop.create_future()
        try:
            self._reports.put_nowait((event, future))
        except queue.Full:
            raise BusyError(f"{WAITING} reports wait to be written; to be tried again") from None
        answer: dict[str, Any] = await future
        return answer

    async def pass_on(self, event: Event) -> None:
        """Let something happen that time brings, and that nobody waits for: what is in its way now may not be later."""
        try:
            await self.report(event)
        except (InapplicableError, BusyError, JournalError):
            pass  # something has changed meanwhile, too much waits, or the disk is full, which is said to those who act
        except Exception:
            logging.getLogger(__name__).exception("%s: time cannot bring this", event.kind)

    async def _tick(self) -> None:
        """Report that time has elapsed whenever nothing has happened for a while."""
        self._last = self._loop.time()
        while True:
            await asyncio.sleep(max(0.01, self._last + self.tick - self._loop.time()))
            if self._loop.time() >= self._last + self.tick:
                self._last = self._loop.time()
                await self.pass_on(Event("elapsed"))

    # Those who watch.

    def watch(self, person: str) -> Watcher:
        """Begin to tell what somebody sees."""
        watcher = Watcher()
        watcher.tell(self.views[person])
        self._watchers.setdefault(person, set()).add(watcher)
        self._connected(person)
        return watcher

    def leave(self, person: str, watcher: Watcher) -> None:
        """End it; nobody else's."""
        watchers = self._watchers.get(person, set())
        watchers.discard(watcher)
        if not watchers:
            self._watchers.pop(person, None)
        self._connected(person)

    def _connected(self, person: str) -> None:
        self._entries.pop(person, None)
        for operator in self._operators:
            operator.set()

    def operator(self) -> asyncio.Event:
        """Begin to say when something has changed, of whatever kind."""
        changed = asyncio.Event()
        changed.set()
        self._operators.add(changed)
        return changed

    def operator_leaves(self, changed: asyncio.Event) -> None:
        """End that."""
        self._operators.discard(changed)

    @property
    def pause_between(self) -> float:
        """Seconds between two messages to the same operator, the more the more people there are."""
        return min(SLOWEST, max(FASTEST, len(self.views) / 400))

    async def team(self) -> bytes:
        """Give what the operator sees: everybody, the robot, the last events, as JSON."""
        missing = [person for person in self.views if person not in self._entries]
        if missing:
            self._entries.update(await asyncio.to_thread(self._entries_of, missing))
        now = self.outlook
        rest = {"seq": now.events, "paused": now.paused, "robot": now.robot, "log": now.recent}
        rest |= {"time": round(self.session.now(), 3), "fault": now.fault, "tasks": list(self.session.tasks)}
        people = b",".join(self._entries[person] for person in self.views if person in self._entries)
        return _json(rest)[:-1] + b',"people":[' + people + b"]}"

    def _entries_of(self, people: list[str]) -> dict[str, bytes]:
        found = {}
        for person in people:
            with suppress(AbsentError):
                entry = self.session.entry(person)
                more = {
                    "connected": person in self._watchers,
                    "simulated": person in self.simulated,
                    "join": self.access.join_url(person),
                }
                found[person] = _json(entry | more)
        return found


def _json(document: Any) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode()
