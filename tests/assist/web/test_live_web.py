"""The live assistant's HTTP interface with its streams: its guarantees and its refusals."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import thinned
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient
from streams import EndedError, Stream, opened

from assist.live.event_base import Event, TeamEvent
from assist.live.events import Acted, Joined, Left, kinds
from assist.live.live_setting import LiveSetting
from assist.live.session import Session
from assist.people.ranges import Population
from assist.studies.userstudy.events import StudyEvent
from assist.web import routes, server
from assist.web.app import make_app
from assist.web.client import request_of
from assist.web.event_routes import body_of, inside_path
from assist.web.measures import Measures
from assist.web.metrics import entropy
from assist.web.request_limits import Allowance, networks
from assist.web.service import Service
from assist.web.tokens import AccessTokens
from planner import Table

ANN = "/api/people/ann"
SEEN = {
    "person", "task", "present", "paused", "applicable", "suggestion", "reason", "cost_to_go", "steps", "finished",
    "explained", "seq",
}  # fmt: skip
WRONG = "(place hammer slot-2 box-a)"


class Web:
    """An application in this process, and its links."""

    def __init__(
        self, table: Table, folder: Path, *, ping: float = 15.0, check: float = 1.0, base: str = "http://testserver",
        robots: int = 1, **more: Any,
    ) -> None:  # fmt: skip
        setting = LiveSetting(c_suggest=0.02, c_move=0.01, trust="paper", robots=robots, tick=60.0)
        session = Session({"tiny": table}, folder / "journal.sqlite", setting=setting, population=Population())
        if not session.people:
            session.report_all([Joined(person=name) for name in ("ann", "bob")])
        self.folder = folder
        self.access = AccessTokens.kept(folder / "secret", base)
        self.service = Service(session, self.access, ping=ping, check=check)
        self.app = make_app(self.service, **more)
        self.client = TestClient(self.app, raise_server_exceptions=False)

    def who(self, person: str | None) -> dict[str, str]:
        token = self.access.operator if person is None else self.access.token(person)
        return {"Authorization": f"Bearer {token}"}

    def ask(self, method: str, path: str, person: str | None = None, **more: Any) -> Any:
        return self.client.request(method, path, headers=self.who(person), **more)

    def act(self, action: str, person: str = "ann", **more: Any) -> Any:
        return self.ask("POST", f"/api/people/{person}/actions", person, json={"action": action, **more})

    def watch(self, person: str | None = "ann") -> Any:
        path = "/api/team" if person is None else f"/api/people/{person}"
        return opened(self.client, f"{path}/events", self.who(person))


@pytest.fixture
def web(tiny: Table, tmp_path: Path) -> Iterator[Web]:
    found = Web(tiny, tmp_path)
    with found.client:
        yield found


def test_explanations(web: Web) -> None:
    web.ask("POST", "/api/team/pause", json={"paused": True})
    for name in ("ann", "bob"):
        assert web.act("(fetch box-a)", name).json()["explained"]
        found = web.ask("GET", f"/api/people/{name}/explanation", name).json()
        assert (found["sentences"], found["step"]) == (["Suggestions are paused."], None)
        refused = web.ask("GET", f"/api/people/{name}/explanation", name, params={"against": WRONG})
        assert refused.status_code == 409
        assert refused.json()["detail"].endswith("; ask without an action why nothing is suggested")
    web.ask("POST", "/api/team/pause", json={"paused": False})
    views = {name: web.ask("GET", f"/api/people/{name}", name).json() for name in ("ann", "bob")}
    (one,), (other,) = ([name for name, seen in views.items() if (seen["suggestion"] is None) == so] for so in (0, 1))
    path, seen = f"/api/people/{one}/explanation", views[one]
    found = web.ask("GET", path, one).json()
    assert set(found) == {"sentences", "step", "now", "nothing", "against", "seq"}
    assert (found["seq"], found["step"]["step"]) == (seen["seq"], "(place hammer slot-1 box-a)")
    assert found["sentences"][0] == "I suggest that you put hammer into slot-1."
    assert [rest["person"] for rest in found["now"]["others"]] == [None]  # people are not told about each other
    assert [rest["person"] for rest in web.ask("GET", path).json()["now"]["others"]] == [other]
    nothing = web.ask("GET", f"/api/people/{other}/explanation", other).json()["nothing"]
    assert (nothing["reason"], nothing["elsewhere"]) == ("cost", True)
    asked = web.ask("GET", path, one, params={"against": WRONG, "language": "de"}).json()
    assert asked["against"]["difference"] == 2.0
    assert asked["against"]["consequence"]["action"] == "(remove hammer slot-2 box-a)"
    assert asked["sentences"][-1].endswith("2 Schritte mehr.")
    for query, status, detail in (
        ({"against": "(fetch box-a)"}, 409, "(fetch box-a) is not applicable here"),
        ({"against": "(fly)"}, 422, "no action of the task"),
        ({"against": "wait"}, 409, "not applicable here; nearest in spelling of the 3 applicable: (place hammer"),
        ({"against": ""}, 422, "against '': expected an action, as (name argument ...)"),
        ({"against": seen["suggestion"]}, 422, "is the step itself"),
        ({"language": "../en"}, 422, "language: expected one of en, de"),
    ):
        wrong = web.ask("GET", path, one, params=query)
        assert wrong.status_code == status
        assert detail in wrong.json()["detail"]
    assert web.ask("GET", path, other).status_code == 403


def test_what_a_person_sees_and_does(web: Web) -> None:
    health = {"status": "ok", "ready": True, "reasons": [], "people": 2, "events": 2}
    assert web.client.get("/api/health").json() == health
    seen = web.ask("GET", ANN, "ann").json()
    assert set(seen) == SEEN
    assert (seen["applicable"], seen["cost_to_go"]) == (["(fetch box-a)", "(fetch box-b)"], 6.0)
    done = web.act("(fetch box-a)", id="1", followed=None)
    assert done.status_code == 200
    assert done.json() == web.ask("GET", ANN, "ann").json()
    assert done.json()["seq"] > seen["seq"]
    advised = web.act(WRONG, id="2").json()
    assert advised["suggestion"] == "(remove hammer slot-2 box-a)"
    assert set(advised["reason"]) == {
        "saving", "moving", "score", "beta", "beta_interval", "theta", "theta_interval",
        "suggestions", "followed", "follow", "follow_interval",
    }  # fmt: skip
    assert web.act("(fetch box-a)", id="1").json() == done.json()
    undone = web.ask("POST", f"{ANN}/undo", "ann").json()
    there = done.json()["reason"] | {"moving": 0.0, "score": done.json()["reason"]["saving"]}  # the robot has come
    assert {**undone, "seq": 0} == {**done.json(), "seq": 0, "reason": there}
    for action in ("(place hammer slot-1 box-a)", "(return box-a)", "(fetch box-b)", "(place wrench slot-2 box-b)"):
        web.act(action)
    assert web.act("(return box-b)").json()["finished"]
    assert web.act("(fetch box-a)").status_code == 409
    assert web.ask("POST", f"{ANN}/begin", "ann").json()["steps"] == 0
    assert web.ask("GET", "/api/me", "ann").json() == {"person": "ann", "operator": False}


def test_what_the_operator_sees_and_does(web: Web) -> None:
    come = web.ask("POST", "/api/team/people", json={"person": "cleo d", "id": "1"}).json()
    assert come["join"].startswith("http://testserver/join/cleo%20d#")
    token = come["join"].partition("#")[2]
    assert web.client.get("/api/people/cleo d", headers={"Authorization": f"Bearer {token}"}).status_code == 200
    assert web.ask("POST", "/api/people/cleo d/leave").json()["present"] is False
    assert web.client.get("/api/people/cleo d", headers={"Authorization": f"Bearer {token}"}).status_code == 404
    for action in ("(fetch box-a)", WRONG):
        web.act(action)
    robot = web.ask("GET", "/api/robots/1").json()
    assert (robot["person"], robot["suggestion"], robot["location"]) == ("ann", "(remove hammer slot-2 box-a)", "ann")
    assert web.ask("POST", "/api/robots/1/arrived", json={"person": "bob"}).json()["location"] == "bob"
    assert web.ask("POST", "/api/robots/1/arrived", json={"person": None}).json()["location"] is None
    team = web.ask("GET", "/api/team").json()
    assert [person["person"] for person in team["people"]] == ["ann", "bob"]
    assert sum(map(sum, team["people"][0]["belief"])) == pytest.approx(1)
    assert [entry["event"] for entry in team["log"]][-4:] == ["acted", "suggested", "arrived", "arrived"]
    assert web.ask("POST", "/api/team/pause", json={"paused": True}).json()["person"] is None
    assert web.ask("GET", ANN, "ann").json()["paused"]
    assert web.act("(return box-a)", "ann").status_code == 200
    assert web.ask("POST", f"{ANN}/undo").status_code == 200
    log = web.ask("GET", "/api/log")
    assert log.headers["content-type"].startswith("application/x-ndjson")
    rows = [json.loads(line) for line in log.text.splitlines()]
    assert [(row["person"], row["episode"], row["step"], row["action"]) for row in rows] == [
        ("ann", "1", 0, "(fetch box-a)"), ("ann", "1", 1, WRONG),
    ]  # fmt: skip


def test_a_departure_is_carried_out_once_however_often_it_is_reported(web: Web) -> None:
    first, again = (web.ask("POST", "/api/people/bob/leave", json={"id": "7"}) for _ in range(2))
    assert (first.status_code, first.json()) == (again.status_code, again.json())
    assert first.json()["present"] is False
    assert web.ask("POST", "/api/people/bob/leave", json={"id": "8"}).status_code == 404
    log = web.ask("GET", "/api/team").json()["log"]
    assert [entry["event"] for entry in log].count("left") == 1


@pytest.mark.parametrize("kind", [one for base in (TeamEvent, StudyEvent) for one in kinds(base).values() if one.path])
def test_every_field_of_an_event_reaches_the_service(kind: type[Event]) -> None:
    assert {*body_of(kind).model_fields, *inside_path(kind)} == {*kind.fields()}
    assert request_of(Left(person="ann b", id="7")) == ("POST", "/api/people/ann%20b/leave", {"id": "7"})


REFUSED: list[tuple[int, str, str, str | None, dict[str, Any]]] = [
    (403, "GET", "/api/people/bob", "ann", {}),
    (403, "POST", "/api/people/bob/actions", "ann", {"json": {"action": "(fetch box-a)"}}),
    (403, "GET", "/api/people/nobody", "ann", {}),
    (404, "GET", "/api/people/nobody", None, {}),
    (403, "GET", "/api/team", "ann", {}),
    (403, "GET", "/api/robots/1", "ann", {}),
    (403, "GET", "/api/log", "ann", {}),
    (403, "GET", "/metrics", "ann", {}),
    (403, "POST", "/api/team/people", "ann", {"json": {"person": "eve"}}),
    (403, "POST", "/api/people/ann/leave", "ann", {}),
    (403, "POST", "/api/team/pause", "ann", {"json": {"paused": True}}),
    (409, "POST", f"{ANN}/actions", "ann", {"json": {"action": "(return box-a)"}}),
    (422, "POST", f"{ANN}/actions", "ann", {"json": {"action": "(fly)"}}),
    (422, "POST", f"{ANN}/actions", "ann", {"json": {"action": ""}}),
    (422, "POST", f"{ANN}/actions", "ann", {"json": {"action": "x" * 2000}}),
    (409, "POST", f"{ANN}/actions", "ann", {"json": {"action": "(fetch box-b)", "followed": True}}),
    (422, "POST", f"{ANN}/actions", "ann", {"content": b'{"action": "\\ud800"}'}),
    (409, "POST", f"{ANN}/undo", "ann", {}),
    (409, "POST", "/api/team/people", None, {"json": {"person": "ann"}}),
    (422, "POST", "/api/team/people", None, {"json": {"person": "../ann"}}),
    (422, "POST", "/api/team/people", None, {"json": {"person": "eve", "task": "none"}}),
    (404, "POST", "/api/robots/1/arrived", None, {"json": {"person": "nobody"}}),
]


def test_what_is_wrong_is_refused_in_one_sentence_and_disturbs_nobody(web: Web) -> None:
    before = web.service.session.beliefs()
    for status, method, path, person, more in REFUSED:
        answer = web.ask(method, path, person, **more)
        assert answer.status_code == status, (method, path, more)
        assert set(answer.json()) == {"detail"}, (method, path, more)
        assert answer.json()["detail"].splitlines() == [answer.json()["detail"]], (method, path, more)
    assert web.service.session.beliefs() == before
    assert web.client.get("/api/health").json()["events"] == 2


def test_without_a_token_there_is_nothing_to_see(web: Web) -> None:
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic YTpi"}):
        for path in (ANN, "/api/people/nobody", "/api/team", "/api/nothing"):
            answer = web.client.get(path, headers=headers)
            assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
    for path in (f"/join/ann/{web.access.token('ann')}", f"/operator/{web.access.operator}"):
        assert web.client.get(path).status_code == 404  # a token in a path would be in the logs of proxies
    for path in (f"{ANN}/events", "/api/team/events", "/api/team/changes"):
        with opened(web.client, path, {"Authorization": "Bearer x"}) as refused:
            assert refused.status == 401
    for path in (f"{ANN}/events", "/api/team/events", "/api/team/changes"):
        with opened(web.client, path, web.who("bob")) as refused:
            assert refused.status == 403


def test_a_cookie_stands_for_the_token_on_pages_of_the_service_only(web: Web) -> None:
    """Pages exchange the token of their link; scripts cannot read the cookie, and other sites cannot use it."""
    ann, operator = ({"Kitassist-Caller": name} for name in ("person%20ann", "operator"))
    assert web.client.post("/api/session").status_code == 401
    for person in ("ann", None):
        answer = web.ask("POST", "/api/session", person)
        assert answer.json() == {"person": person, "operator": person is None}
        cookie = answer.headers["set-cookie"]
        assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    ask = web.client.get
    assert ask(ANN).status_code == 401  # a request has to say whose cookie it uses
    assert ask(ANN, headers=ann).json()["person"] == "ann"
    assert ask("/api/me", headers=operator).json()["operator"]
    for path, headers in ((("/api/team"), ann), ("/api/people/bob", ann)):
        assert ask(path, headers=headers).status_code == 403
    assert ask("/api/people/bob", headers={"Kitassist-Caller": "person%20bob"}).status_code == 401
    own, foreign = {"Origin": "http://testserver"}, {"Origin": "https://evil.example"}
    for more, status in (
        (own, 200), (foreign, 403), ({"Origin": "null"}, 403), ({"Sec-Fetch-Site": "same-origin"}, 200),
        ({"Sec-Fetch-Site": "cross-site"}, 403), ({"Sec-Fetch-Site": "same-site"}, 403),
    ):  # fmt: skip
        answer = web.client.post(f"{ANN}/begin", headers={**ann, **more})
        assert answer.status_code == status, more
        assert answer.status_code == 200 or answer.json() == {"detail": "requests of other sites' pages are refused"}
    with opened(web.client, f"{ANN}/events", ann) as watched:
        assert watched.view()["person"] == "ann"
    with opened(web.client, f"{ANN}/events", {**ann, **foreign}) as watched:
        assert watched.status == 403


def test_what_changes_is_told_to_every_tab_and_a_late_end_ends_no_other(web: Web) -> None:
    with ExitStack() as held:
        first, bob = held.enter_context(web.watch()), held.enter_context(web.watch("bob"))
        kinds = [first.headers[name] for name in ("content-type", "x-accel-buffering")]
        assert kinds == ["text/event-stream; charset=utf-8", "no"]
        assert first.any() == ("ping", {"seconds": 15.0})
        assert first.next() == ("faults", [])
        assert first.view()["steps"] == bob.view()["steps"] == 0
        with web.watch() as reloaded:
            assert reloaded.view()["steps"] == 0
            answer = web.act("(fetch box-a)").json()
            assert first.view() == reloaded.view() == answer
        answer = web.act(WRONG).json()  # the tab before the reload has closed only now
        assert first.view() == answer
        assert web.ask("GET", "/api/team").json()["people"][0]["connected"]
        web.act("(fetch box-a)", "bob")
        assert bob.view()["steps"] == 1
        web.ask("POST", "/api/people/bob/leave")
        with pytest.raises(EndedError):
            bob.view()
        with web.watch("bob") as again:
            assert (again.status, again.detail) == (404, "'bob' is not in the team")
    for _ in range(500):
        if not web.ask("GET", "/api/team").json()["people"][0]["connected"]:
            return
    raise AssertionError("a page that has gone counts as connected")


def test_programs_follow_all_changes_of_the_team_in_one_stream(web: Web) -> None:
    def coming(stream: Stream, *kinds: str) -> list[Any]:
        found = [stream.next() for _ in kinds]
        assert [kind for kind, _ in found] == list(kinds)
        return [content for _, content in found]

    with opened(web.client, "/api/team/changes", web.who(None)) as stream:
        people, ann, bob, robot = coming(stream, "people", "view", "view", "robot")
        assert people == {"people": ["ann", "bob"]}
        assert (ann, bob) == tuple(web.ask("GET", f"/api/people/{name}").json() for name in ("ann", "bob"))
        assert robot == {"robot": 1, "instruction": web.ask("GET", "/api/robots/1").json()}
        answer = web.act("(fetch box-a)").json()
        assert stream.next() == ("view", answer)
        web.act(WRONG)
        while (found := stream.next())[1].get("instruction", {}).get("suggestion") != "(remove hammer slot-2 box-a)":
            pass
        assert (found[0], found[1]["robot"]) == ("robot", 1)
        web.ask("POST", "/api/team/people", json={"person": "cleo"})
        while (found := stream.next())[1].get("person") != "cleo":
            pass
        assert found[0] == "view"
        web.ask("DELETE", "/api/people/cleo/records", params={"reason": "asked"})
        while (found := stream.next())[0] != "left":
            pass
        assert found == ("left", {"person": "cleo"})


def test_a_stream_shows_signs_of_life_and_ends_with_the_service(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, ping=0.01)
    with ExitStack() as held:
        held.enter_context(web.client)
        paths = (f"{ANN}/events", "/api/team/events", "/api/team/changes")
        streams = [held.enter_context(opened(web.client, path, web.who(None))) for path in paths]
        for stream in streams:
            pings = 0
            while pings < 5:
                kind, content = stream.any()
                pings += kind == "ping"
                assert kind != "ping" or content == {"seconds": 0.01}
        assert web.client.portal is not None
        web.client.portal.call(web.service.end_streams)
        for stream in streams:
            assert {kind for kind, _ in stream.rest()} <= {"ping", "view", "team"}
        with web.watch() as late, pytest.raises(EndedError):  # a keep-alive connection may still bring one
            late.view()


def test_the_operator_sees_what_changes_while_the_view_is_computed(tiny: Table, tmp_path: Path) -> None:
    web, read, changed = Web(tiny, tmp_path), threading.Event(), threading.Event()
    entries_of = web.service._entries_of

    def late(people: list[str]) -> dict[str, bytes]:
        found = entries_of(people)
        read.set()
        assert changed.wait(60)
        return found

    async def run() -> list[dict[str, Any]]:
        web.service.start()
        web.service._entries_of = late  # type: ignore[method-assign]
        first = asyncio.create_task(web.service.team())
        await asyncio.to_thread(read.wait, 60)
        await web.service.report(Acted(person="ann", action="(fetch box-a)"))
        web.service.watch("bob")
        changed.set()
        views = [await first, await web.service.team()]
        await web.service.stop()
        return [json.loads(view) for view in views]

    before, after = asyncio.run(run())
    assert [one["person"] for one in before["people"]] == ["ann", "bob"]
    assert [(one["steps"], one["connected"]) for one in after["people"]] == [(1, False), (0, True)]


def test_who_does_not_read_costs_no_memory_and_nobody_waits(tiny: Table, tmp_path: Path) -> None:
    async def run() -> tuple[int, int]:
        web = Web(tiny, tmp_path)
        web.service.start()
        slow, everything = web.service.watch("ann"), web.service.follow()
        for number in range(70):
            action = ("(fetch box-a)", "(return box-a)")[number % 2]
            await web.service.report(Acted(person="ann", action=action))
        view = json.loads((await slow.take())[-1].decode().partition("data: ")[2])
        events = len(await everything.take())
        await web.service.stop()
        return view["steps"], events

    assert asyncio.run(run()) == (70, 4)  # the newest view; who is present, two people and a robot


@pytest.mark.parametrize("path", thinned([f"{ANN}/events", "/api/team/events", "/api/team/changes"], every=3))
def test_a_connection_that_is_not_read_is_given_back_soon(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    """This holds even if a real socket is full and the remaining data can never be sent."""

    async def run() -> None:
        web = Web(tiny, tmp_path)
        listening = server.listen("127.0.0.1", 0, unread=0.2)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        ready = asyncio.Event()
        serving = server.server_of(web.app, ready.set)
        running = asyncio.create_task(serving.serve([listening]))
        await ready.wait()
        stuck = socket.socket()
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.connect(listening.getsockname())
        stuck.sendall(
            f"GET {path} HTTP/1.1\r\nHost: here\r\nAuthorization: {web.who(None)['Authorization']}\r\n\r\n".encode()
        )
        monkeypatch.setattr(Service, "pause_between", 0.0)
        while not (web.service._watchers.get("ann") or web.service._operators or web.service._followers):
            await asyncio.sleep(0.01)
        for number in range(3000):
            action = "(fetch box-a)" if number % 2 == 0 else "(return box-a)"
            await web.service.report(Acted(person="ann", action=action))
            if not serving.server_state.connections:
                break
            await asyncio.sleep(0.002)
        assert not serving.server_state.connections
        for _ in range(1000):  # the stream ends after its connection
            if not (left := [*web.service._watchers, *web.service._operators, *web.service._followers]):
                break
            await asyncio.sleep(0.01)
        assert not left
        stuck.close()
        serving.should_exit = True
        await running

    asyncio.run(run())


def test_too_many_requests_are_refused_to_whom_they_are_from(tiny: Table, tmp_path: Path) -> None:
    now = [0.0]
    web = Web(tiny, tmp_path, allowance=Allowance(rate=1.0, burst=3.0, clock=lambda: now[0]))
    with web.client:
        codes = [web.ask("GET", ANN, "ann").status_code for _ in range(4)]
        assert codes == [200, 200, 200, 429]
        assert web.ask("GET", ANN, "ann").headers["retry-after"] == "1"
        assert web.ask("GET", "/api/people/bob", "bob").status_code == 200
        now[0] += 1.0
        assert web.ask("GET", ANN, "ann").status_code == 200


def test_behind_a_trusted_proxy_everybody_has_a_limit_of_their_own(tiny: Table, tmp_path: Path) -> None:
    """Addresses that clients claim themselves do not count."""
    limit = Allowance(rate=1.0, burst=5.0, clock=lambda: 0.0)
    web = Web(tiny, tmp_path, allowance=limit, trusted_proxies=networks(["10.0.0.0/8", "2001:db8::1"]))
    found = []
    with web.client:
        for proxy, claims in (
            ("10.0.0.9", "192.0.2.1"), ("10.0.0.9", "192.0.2.2"), ("10.0.0.9", "192.0.2.77, 192.0.2.2"),
            ("10.0.0.9", "192.0.2.3, 10.1.1.1"), ("2001:db8::1", "192.0.2.3"), ("192.0.2.9", "192.0.2.4"),
            ("192.0.2.9", "192.0.2.5"), ("10.0.0.9", "nonsense"),
        ):  # fmt: skip
            client = TestClient(web.app, client=(proxy, 1))
            found.append([client.get(ANN, headers={"X-Forwarded-For": claims}).status_code for _ in range(5)])
    assert [codes.count(429) for codes in found] == [0, 0, 5, 0, 5, 0, 5, 0]
    with pytest.raises(ValueError, match=r"proxy: expected an address such as 127\.0\.0\.1"):
        networks(["proxy"])


def test_streams_count_like_requests_and_each_person_has_so_many(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, allowance=Allowance(rate=1.0, burst=4.0, clock=lambda: 0.0))
    web.service._most_connections = 2
    with web.client, ExitStack() as held:
        for _ in range(2):
            assert held.enter_context(web.watch()).view()["person"] == "ann"
        for detail in ("too many pages are open; close some of them", "too many requests; try again later"):
            if detail.startswith("too many requests"):
                web.ask("GET", ANN, "ann")
            refused = held.enter_context(web.watch())
            assert (refused.status, refused.detail) == (429, detail)


@pytest.mark.cases
@pytest.mark.parametrize("path", ["drawing", "explanation"])
def test_who_leaves_while_an_answer_is_made_for_them_is_not_there(
    web: Web, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    async def late(work: Any) -> Any:
        await web.service.report(Left(person="ann"))
        return await asyncio.to_thread(work)

    monkeypatch.setattr(routes, "asyncio", SimpleNamespace(to_thread=late))
    answer = web.ask("GET", f"{ANN}/{path}", "ann")
    assert (answer.status_code, set(answer.json())) == (404, {"detail"})
    assert "ann" in answer.json()["detail"]


def test_the_operator_erases_what_is_recorded_of_a_person(web: Web) -> None:
    ann = web.act("(fetch box-a)").json()
    web.act("(fetch box-b)", "bob", id="bobs")
    assert web.ask("POST", "/api/people/bob/leave").status_code == 200  # whoever has left can be erased, too
    for status, name, person, query in (
        (403, "ann", "ann", {"reason": "mine"}), (404, "eve", None, {"reason": "asked"}), (422, "bob", None, {}),
        (422, "bob", None, {"reason": "x" * 201}), (422, "bob", None, {"reason": "Bob asked"}),
    ):  # fmt: skip
        refused = web.ask("DELETE", f"/api/people/{name}/records", person, params=query)
        assert (refused.status_code, set(refused.json())) == (status, {"detail"})
    with web.watch() as watched:
        assert watched.view() == ann
        found = web.ask("DELETE", "/api/people/bob/records", params={"reason": "asked by e-mail"}).json()
        assert (found["label"], found["reason"], found["events"]) == ("(erased 1)", "asked by e-mail", 3)
        assert b"bob" not in b"".join(file.read_bytes() for file in web.folder.iterdir())
        assert web.ask("GET", ANN, "ann").json() == ann
        assert '"bob"' not in web.ask("GET", "/api/team").text
        assert web.ask("DELETE", "/api/people/ann/records", params={"reason": "asked, too"}).status_code == 200
        with pytest.raises(EndedError):
            watched.view()
    assert web.ask("GET", ANN, "ann").status_code == 404
    assert web.ask("GET", "/api/log").text == ""
    assert web.ask("POST", "/api/team/people", json={"person": "bob"}).status_code == 200
    assert web.ask("GET", "/api/people/bob", "bob").json()["steps"] == 0


@pytest.mark.cases
def test_what_a_request_misspells_is_told(web: Web) -> None:
    """A view that there cannot be yet, a body that is not said to be JSON; pages take what others add to addresses."""
    assert web.client.get("/join/ann?from=mail").status_code == 200  # the address of a page
    assert web.ask("GET", "/api/log?task=tiny").status_code == 200
    seq = web.ask("GET", ANN, "ann").json()["seq"]
    refused = web.act("(fetch box-a)", seq=99)
    assert refused.status_code == 422
    assert refused.json()["detail"] == "seq 99: there is no such view yet; expected 2 or less"
    assert web.act("(fetch box-a)", seq=seq).status_code == 200
    unknown = web.act("(fetsh box-a)").json()["detail"]
    assert "nearest in spelling of all actions: (fetch box-a); of the 3 applicable: " in unknown
    headers = web.who("ann")
    for kind, said in (
        ({}, "the header Content-Type is missing"),
        ({"Content-Type": "text/plain"}, "Content-Type: text/plain"),
    ):
        sent = {"content": b'{"action": "(return box-a)"}', "headers": headers | kind}
        refused = web.client.post(f"{ANN}/actions", **sent)
        assert refused.status_code == 422
        assert refused.json()["detail"] == f"{said}; expected Content-Type: application/json"


@pytest.mark.cases
def test_a_request_that_cannot_be_read_is_told_in_plain_words(web: Web) -> None:
    """A body that is no JSON, no object or has another field, a wrong method, an unknown address or parameter."""
    object_ = "expected an object, such as {}"
    act, undo = f"{ANN}/actions", f"{ANN}/undo"
    for status, method, path, body, said in (
        (422, "POST", act, b'{"action": ', f"request body: no JSON at character 12 (expecting value); {object_}"),
        (422, "POST", act, b'["(fetch box-a)"]', f"request body: a list; {object_}"),
        (422, "GET", "/api/log?tsk=tiny", None, "parameter 'tsk' of the address: unknown; did you mean 'task'?"),
        (422, "GET", "/api/health?redy=true", None,
         "parameter 'redy' of the address: unknown; did you mean 'ready'?"),
        (422, "GET", "/api/team?person=ann", None, "parameter 'person' of the address: unknown; expected none"),
        (422, "GET", f"/api/log?task={'t' * 201}", None,
         f"task '{'t' * 80}': expected the name of a task, of up to 200 characters"),
        (422, "POST", act, b'{"acton": "(fetch box-a)"}', "acton: unknown; did you mean 'action'?"),
        (422, "POST", act, b'{"action": "(go)", "followed": "yes"}', "followed 'yes': expected true or false"),
        (422, "POST", act, b'{"seq": -1}', "seq -1: expected a whole number of 0 or more"),
        (422, "POST", undo, b'{"of": "answerd"}', "of 'answerd': did you mean 'answered'?"),
        (422, "POST", undo, b"[]", f"request body: a list; {object_}"),
        (422, "POST", undo, b"1.5", f"request body: a number; {object_}"),
        (422, "POST", "/api/team/people", b"null", f"request body: is missing; {object_}"),
        (400, "POST", act, b'{"action": "\xff"}', f"request body: is not in UTF-8; {object_}"),
        (400, "POST", act, b"[" * 60_000, f"request body: is nested too deeply; {object_}"),
        (400, "POST", act, b'{"seq": %s}' % (b"9" * 5000), f"request body: has a number of too many digits; {object_}"),
        (405, "PUT", act, b"{}", "PUT: expected POST at this address"),
        (405, "PUT", "/api/people/ann/records", b"", "PUT: expected DELETE at this address"),
        (404, "POST", f"{ANN}/action", b"{}",
         f"{ANN}/action: there is no such address; did you mean /api/people/{{person}}/actions?"),
        (404, "GET", "/api/xyz", None, "/api/xyz: there is no such address; see /docs for those that there are"),
        (404, "GET", "/xyz", None, "there is no such page"),
        (422, "GET", "/api/robots/x", None, "robot 'x': expected a whole number"),
        (422, "POST", "/api/robots/x/arrived", b'{"person": "ann"}', "robot 'x': expected a whole number"),
        (422, "GET", "/api/health?ready=perhaps", None, "ready 'perhaps': expected true or false"),
        (422, "GET", f"{ANN}/drawing?width=3", None, "width '3': expected a whole number from 240 to 2000"),
        (422, "DELETE", "/api/people/ann/records", None,
         "parameter 'reason' of the address: is missing; expected a reason of 1 to 200 characters"),
    ):  # fmt: skip
        headers = web.who(None) | {"Content-Type": "application/json"}
        answer = web.client.request(method, path, content=body, headers=headers)
        assert (answer.status_code, answer.json()) == (status, {"detail": said})
    assert web.ask("PUT", act, "ann").headers["allow"] == "POST"
    assert web.ask("DELETE", ANN, "ann").headers["allow"] == "GET"


@pytest.mark.cases
def test_a_bridge_that_fails_to_say_why_it_waits_stops_no_checks(
    tiny: Table, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Broken:
        name, counts, connected = "line", dict[str, int](), True

        @property
        def waits(self) -> list[str]:
            raise OSError("no such queue")

    class Worse:
        name, counts, waits = "line", dict[str, int](), ["never said"]

        @property
        def connected(self) -> bool:
            raise OSError("no such line")

    web = Web(tiny, tmp_path, check=0.01)
    with web.client, web.watch(None) as team:
        assert team.view()["problems"] == []
        web.service.bridges["line"] = Worse()  # type: ignore[assignment]
        while "it is not known what keeps the service from its work" not in caplog.text:
            time.sleep(0.01)
        web.service.bridges["line"] = Broken()  # type: ignore[assignment]
        assert team.view()["problems"] == ["line: it is not known what it waits for: no such queue"]
        del web.service.bridges["line"]
        assert team.view()["problems"] == []


# Metrics, read with Prometheus's own parser.


def values(text: str) -> dict[tuple[str, ...], float]:
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_metrics_are_what_happened(web: Web) -> None:
    web.service.bridges["mqtt"] = SimpleNamespace(counts={"recorded": 3}, connected=True, waits=())  # type: ignore[assignment]
    first = web.ask("GET", "/api/people/ann", "ann").json()
    assert first["suggestion"] is not None
    web.act(first["suggestion"], id="1")
    web.act(first["suggestion"], id="1")
    web.act("(fetch box-z)")
    seen = web.ask("GET", "/api/people/ann", "ann").json()
    other = next(action for action in seen["applicable"] if action != seen["suggestion"])
    declined = seen["suggestion"] is not None
    web.act(other)
    answer = web.ask("GET", "/metrics?name[]=kitassist_people", None)  # as some scrapers ask
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    found = values(answer.text)
    events = web.ask("GET", "/api/team", None).json()["seq"]
    beliefs = web.service.session.beliefs()
    assert found["kitassist_events_total",] == events
    assert found["kitassist_people",] == 2
    assert found["kitassist_reports_total", "acted", "recorded"] == 3
    assert found["kitassist_reports_total", "acted", "refused"] == 1
    assert found["kitassist_suggestions_answered_total", "yes"] == 1
    assert found["kitassist_suggestions_answered_total", "no"] == int(declined)
    assert found["kitassist_report_seconds_bucket", "+Inf"] == found["kitassist_report_seconds_count",] == 4
    assert found["kitassist_belief_entropy_nats", "largest"] == max(map(entropy, beliefs.values()))
    assert found["kitassist_bridge_total", "mqtt", "recorded"] == 3
    assert found["kitassist_bridge_connected", "mqtt"] == found["kitassist_ready",] == 1
    assert "ann" not in answer.text


def test_an_action_on_an_older_view_answers_no_suggestion(web: Web) -> None:
    """The counts are those of the actions that have a suggestion in the log."""
    answered = [0]
    for late in (1, 0, 1, 0):
        seen = web.ask("GET", "/api/people/ann", "ann").json()
        assert seen["suggestion"] is not None
        other = next(action for action in seen["applicable"] if action != seen["suggestion"])
        assert web.act(other, seq=seen["seq"] - late).status_code == 200
        found = values(web.ask("GET", "/metrics", None).text)
        answered.append(int(found["kitassist_suggestions_answered_total", "no"]))
        assert found["kitassist_suggestions_answered_total", "yes"] == 0
        assert answered[-1] == sum(row["suggestion"] is not None for row in web.service.session.log())
    assert answered == [0, 0, 1, 1, 2]


def test_entropy_and_buckets() -> None:
    assert entropy(np.full(8, 1 / 8).tobytes()) == pytest.approx(math.log(8))
    assert entropy(np.array([1.0, 0.0]).tobytes()) == 0
    measures = Measures()
    for seconds in (0.002, 0.003, 60.0):
        measures.add("acted", "recorded", seconds)
    found = values(generate_latest(measures.registry).decode())
    assert [found["kitassist_report_seconds_bucket", limit] for limit in ("0.002", "5.0", "+Inf")] == [1, 2, 3]
