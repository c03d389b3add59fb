"""A service outlasts a disk that fails for a moment, keeps the order of reports, and answers whoever waits."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import generate_latest

from assist.declare import AbsentError, Refusal
from assist.live import Acted, Event, Joined, JournalError, Left, Session
from assist.live.live_setting import LiveSetting
from assist.web import service as services
from assist.web.service import Erasure, Service
from assist.web.tokens import AccessTokens
from planner import Table

pytestmark = pytest.mark.cases

FETCH = Acted(person="ann", action="(fetch box-a)")
SOON = 60  # seconds after which an answer is taken as missing


@pytest.fixture
def session(tiny: Table, tmp_path: Path) -> Iterator[Session]:
    setting = LiveSetting(c_suggest=0.02, c_move=0.01, tick=60.0)
    found = Session({"tiny": tiny}, tmp_path / "journal.sqlite", setting=setting)
    found.report_all([Joined(person=name) for name in ("ann", "bob")])
    yield found
    found.close()


class Once:
    """A method that fails the first time."""

    def __init__(self, owner: Any, name: str, error: BaseException) -> None:
        self.owner, self.name, self.error = owner, name, error
        self.method = getattr(owner, name)
        setattr(owner, name, self)

    def __call__(self, *_: Any, **__: Any) -> Any:
        setattr(self.owner, self.name, self.method)
        raise self.error


def unreadable() -> JournalError:
    return JournalError(5, "disk I/O error; nothing was recorded", "journal.sqlite")


def run(session: Session, work: Callable[[Service], Any], *, check: float = 0.01) -> Any:
    """Return what a coroutine of a started service returns."""

    async def whole() -> Any:
        service = Service(session, AccessTokens(b"k" * 32, "http://testserver"), check=check)
        service.start()
        try:
            return await asyncio.wait_for(work(service), SOON)
        finally:
            await asyncio.wait_for(service.stop(), SOON)

    return asyncio.run(whole())


def test_after_a_batch_that_could_be_neither_saved_nor_read_again_reports_are_answered(session: Session) -> None:
    async def work(service: Service) -> tuple[Any, int, list[str]]:
        Once(session._store, "add", unreadable())
        Once(session, "_resume", unreadable())
        with pytest.raises(JournalError):
            await service.report(FETCH)
        assert (service.outlook.seq, service.views["ann"]) == (2, view)
        return (await service.report(FETCH))["steps"], service.outlook.seq, service.unready()

    view = Service(session, AccessTokens(b"k" * 32, "http://testserver")).views["ann"]
    assert run(session, work) == (1, 3, [])


def test_whatever_ends_the_writer_who_waits_is_answered_and_the_service_is_not_ready(session: Session) -> None:
    async def work(service: Service) -> list[str]:
        Once(session._store, "add", SystemExit())
        found = await asyncio.gather(*(service.report(FETCH) for _ in range(3)), return_exceptions=True)
        found += await asyncio.gather(service.report(FETCH), return_exceptions=True)
        assert [(type(one), getattr(one, "status", None)) for one in found] == [(Refusal, 503)] * 4
        return service.unready()

    assert run(session, work) == ["the service does not accept reports"]


def test_a_report_to_a_service_that_has_stopped_is_refused(session: Session) -> None:
    async def work(service: Service) -> Service:
        return service

    async def late() -> None:
        await asyncio.wait_for(service.report(FETCH), SOON)

    service = run(session, work)
    with pytest.raises(Refusal, match="accepts no reports"):
        asyncio.run(late())


def test_the_clock_goes_on_after_a_look_that_failed_and_says_so_until_then(session: Session) -> None:
    async def work(service: Service) -> list[str]:
        failing = Once(session, "due", unreadable())
        looked = asyncio.Event()
        loop, due = asyncio.get_running_loop(), failing.method

        def late() -> Any:  # the look after the one that failed
            looks.append(service.problems())
            loop.call_soon_threadsafe(looked.set)
            return due()

        failing.method = late
        await looked.wait()
        assert "what time causes is not known: [Errno 5] disk I/O error" in looks[0][0]
        while service.problems():
            await asyncio.sleep(0.01)
        return service.unready()

    looks = list[list[str]]()
    assert run(session, work) == []


def test_reports_and_erasures_happen_in_the_order_of_their_arrival(session: Session) -> None:
    session.report_all([FETCH, Left(person="ann")])

    async def work(service: Service) -> tuple[Any, ...]:
        with session.lock:  # so that all wait for one batch
            first = asyncio.ensure_future(service.report(Acted(person="bob", action="(fetch box-a)")))
            await asyncio.sleep(0)
            while service._reports.qsize():
                await asyncio.sleep(0.01)
            orders: list[Event | Erasure] = [Erasure("ann", "asked"), Joined(person="ann"), Erasure("eve", "asked")]
            waiting = [asyncio.ensure_future(service.report(one)) for one in orders]
            await asyncio.sleep(0)
        await first
        return tuple(await asyncio.gather(*waiting, return_exceptions=True))

    stone, joined, nobody = run(session, work)
    assert (stone["events"], joined["present"], joined["steps"]) == (3, True, 0)
    assert isinstance(nobody, AbsentError)


def test_a_report_for_which_there_is_no_room_counts_as_refused(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(services, "WAITING", 1)

    async def work(service: Service) -> str:
        with session.lock:
            waiting = [asyncio.ensure_future(service.report(FETCH))]
            await asyncio.sleep(0)
            while service._reports.qsize():
                await asyncio.sleep(0.01)
            waiting.append(asyncio.ensure_future(service.report(Left(person="ann"))))
            await asyncio.sleep(0)
            with pytest.raises(Refusal, match="1 reports are waiting to be saved"):
                await service.report(Left(person="bob"))
        await asyncio.gather(*waiting)
        return generate_latest(service.measures.registry).decode()

    counts = run(session, work)
    assert 'kitassist_reports_total{kind="left",outcome="refused"} 1.0' in counts
    assert 'outcome="failed"' not in counts
