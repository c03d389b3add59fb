"""A service under a path, behind a proxy that may strip the path: pages, requests, connections and clients."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urljoin, urlsplit

import pytest
from conftest import KITTING, invoke, thinned
from serving import served
from starlette.testclient import TestClient
from starlette.types import ASGIApp, Receive, Scope, Send
from streams import opened
from userstudies import PLAN, written

from assist.declare.refusals import Refusal
from assist.live import Joined, Session
from assist.live.live_setting import LiveSetting
from assist.studies.userstudy import StudySession, read
from assist.web.app import make_app
from assist.web.client import Client
from assist.web.server import server_of
from assist.web.service import Service
from assist.web.tokens import VISITOR, AccessTokens, public_address
from assist.web.user_study.routes import router
from assist.web.user_study.service import StudyService
from planner import Table

PUBLIC = "https://host.example/kits/a%20b"
ROOT = "/kits/a b"
STRIPS = pytest.mark.parametrize("strips", thinned([True, False]))
LOADED = re.compile(r'(?:href|src)="([^"]+)"|from "([^"]+)"')


class Proxy:
    """Forwards requests under a path, and no others."""

    def __init__(self, app: ASGIApp, root: str, *, strips: bool) -> None:
        self.app, self.root, self.strips = app, root, strips

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "lifespan":
            assert scope["path"].startswith(f"{self.root}/"), scope["path"]
            if self.strips:
                scope = {**scope, "path": scope["path"].removeprefix(self.root)}
        await self.app(scope, receive, send)


def team(table: Table, folder: Path, base: str) -> Service:
    session = Session(
        {"tiny": table}, folder / "journal.sqlite", setting=LiveSetting(c_suggest=0.02, c_move=0.01, tick=60.0)
    )
    session.report_all([Joined(person=name) for name in ("ann", "bob")])
    return Service(session, AccessTokens.kept(folder / "secret", base))


def study(table: Table, folder: Path, base: str) -> StudyService:
    session = StudySession(
        read(written(folder / "study.toml", PLAN)), {"tiny": table, "practice": table}, folder / "data"
    )
    return StudyService(session, AccessTokens.kept(folder / "data" / "secret", base))


def everything(client: TestClient, page: str, found: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the addresses that a page loads, directly and indirectly."""
    found = {} if found is None else found
    if page not in found:
        found[page] = client.get(page)
        for pair in LOADED.findall(found[page].text):
            named = "".join(pair)
            if not named.startswith("data:"):
                everything(client, urljoin(page, named), found)
    return found


@pytest.mark.parametrize("strips", [True, False], ids=["stripped", "kept"])
def test_all_of_a_session_is_under_the_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    service = team(tiny, tmp_path, PUBLIC)
    access, operator = service.access, {"Authorization": f"Bearer {service.access.operator}"}
    with TestClient(Proxy(make_app(service), ROOT, strips=strips)) as client:
        for page in (access.join_url("ann"), access.operator_url()):
            assert page.startswith(f"{PUBLIC}/")
            loaded = everything(client, page)
            assert len(loaded) >= 4
            assert {answer.status_code for answer in loaded.values()} == {200}
            assert all(address.startswith(f"{PUBLIC}/") for address in loaded)
        page = f"{PUBLIC}/docs"
        loaded = [urljoin(page, "".join(pair)) for pair in LOADED.findall(client.get(page).text)]
        assert {client.get(one).status_code for one in loaded if not one.startswith("data:")} == {200}
        assert "/api/people/{person}/actions" in client.get(f"{PUBLIC}/openapi.json").json()["paths"]
        assert client.get(f"{PUBLIC}/").status_code == 404
        assert client.get(f"{PUBLIC}/api/health").json()["people"] == 2
        assert client.get(f"{PUBLIC}/api/team").status_code == 401  # without a token
        added = client.post(f"{PUBLIC}/api/team/people", headers=operator, json={"person": "cyd"}).json()
        assert added["join"] == access.join_url("cyd")
        assert client.get(added["join"]).status_code == 200
        team_seen = client.get(f"{PUBLIC}/api/team", headers=operator).json()
        assert {person["join"] for person in team_seen["people"]} == {
            access.join_url(name) for name in ("ann", "bob", "cyd")
        }
        path = urlsplit(PUBLIC).path
        with opened(client, f"{path}/api/people/ann/events", operator) as watching:
            assert watching.view()["person"] == "ann"


@STRIPS
def test_all_of_a_user_study_is_under_the_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    service = study(tiny, tmp_path, PUBLIC)
    with TestClient(Proxy(make_app(service, more=[router]), ROOT, strips=strips)) as client:
        visitor = {"Authorization": f"Bearer {service.access.token(VISITOR)}"}
        seat = client.post(f"{PUBLIC}/api/study/seats", headers=visitor, json={"id": "ann"}).json()
        for page in (service.join_url(), service.operator_url(), f"{PUBLIC}{seat['part']}"):
            assert page.startswith(f"{PUBLIC}/")
            loaded = everything(client, page)
            assert len(loaded) >= 5
            assert {answer.status_code for answer in loaded.values()} == {200}
            assert all(address.startswith(f"{PUBLIC}/") for address in loaded)
        operator = {"Authorization": f"Bearer {service.access.operator}"}
        assert client.get(f"{PUBLIC}/api/study", headers=operator).json()["join"] == service.join_url()
        assert client.get(f"{PUBLIC}/api/study/export", headers=operator).status_code == 200


@contextmanager
def running(make: Callable[[str], tuple[Any, ASGIApp]], *, strips: bool) -> Iterator[Any]:
    """A service that listens under a path."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        service, app = make(f"http://127.0.0.1:{listening.getsockname()[1]}/kits")
        begun = threading.Event()
        server = server_of(Proxy(app, "/kits", strips=strips), begun.set)
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
        thread.start()
        assert begun.wait(60)
        try:
            yield service
        finally:
            server.should_exit = True
            thread.join(60)


@STRIPS
def test_a_client_takes_links_with_a_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    def make(base: str) -> tuple[Service, ASGIApp]:
        service = team(tiny, tmp_path, base)
        return service, make_app(service)

    with running(make, strips=strips) as service:
        operator, ann = Client(service.access.operator_url()), Client(service.access.join_url("ann"))
        assert ann.observe("ann", "(fetch box-a)")["steps"] == 1
        watched = ann.watch()
        assert next(watched)["steps"] == 1
        watched.close()  # type: ignore[attr-defined]
        assert Client(operator.join("operator")["join"]).see()["person"] == "operator"
        assert [person["person"] for person in operator.team()["people"]] == ["ann", "bob", "operator"]
        assert [row["action"] for row in operator.log()] == ["(fetch box-a)"]
        with pytest.raises(Refusal, match="another person"):
            ann.see("bob")
        with pytest.raises(Refusal, match="not applicable here") as refused:
            ann.observe("ann", "(fetch box-b)")
        assert refused.value.status == 409
        operator.leave("ann")
        with pytest.raises(Refusal, match="'ann' is not in the team"):
            ann.see()
    with pytest.raises(OSError, match="refused"):
        Client(service.access.operator_url(), patience=0.3).robot()


def test_a_link_of_a_client_may_have_any_path() -> None:
    for root in ("", "/kits", "/a/b%20c", "/joins/operators"):
        for path, name in (
            ("join/ann%20b#T", "ann b"), ("operator#T", None), ("study/operator#T", None),
            ("study#T", None), ("part/P-2#T", "P-2"),
        ):  # fmt: skip
            client = Client(f"https://host.example:8443{root}/{path}")
            assert (client.url, client.name) == (f"https://host.example:8443{root}", name)
    for link in (
        "https://host.example/kits",
        "/kits/join/ann/T",
        "ftp://host.example/join/ann/T",
        "https://h/join/T",
        "https://h/join/ann/T",
    ):
        with pytest.raises(ValueError, match="expected a join link"):
            Client(link)


def test_the_address_is_read() -> None:
    for given, expected in (
        ("https://host.example", "https://host.example"), ("HTTPS://host.example/", "https://host.example"),
        ("http://10.0.0.7:8080/kits/", "http://10.0.0.7:8080/kits"), ("https://[::1]:8443/a/b", "https://[::1]:8443/a/b"),
        (PUBLIC, PUBLIC), ("https://host.example/my-study", "https://host.example/my-study"),
    ):  # fmt: skip
        assert public_address(given) == expected
    for path, expected in ((ROOT, "/"), (f"{ROOT}/", "/"), (f"{ROOT}/api/me", "/api/me"), ("/api/me", "/api/me")):
        assert AccessTokens(b"", PUBLIC).within(path) == expected
    assert AccessTokens(b"", PUBLIC).within(f"{ROOT}more") == f"{ROOT}more"
    assert AccessTokens(b"", "https://host.example").within("/api/me") == "/api/me"
    for wrong in (
        "", "kits", "host.example/kits", "//host.example", "ftp://host.example", "https://", "https:///kits",
        "https://host.example:99999", "https://host.example:port", "https://[::1", "https://host.example/?a=b",
        "https://host.example/#a", "https://me:secret@host.example", "https://host.example/a b", "https://h/a\nb",
        "https://host.example/a//b", "https://host.example/../a", "https://host.example/%2e%2e/a", "https://h/a%2Fb",
        "https://höst.example/",
    ):  # fmt: skip
        with pytest.raises(ValueError, match="expected the address of the service, such as"):
            public_address(wrong)
    for own in ("https://host.example/study", "https://host.example/lab/%73tudy", "https://host.example/api/x"):
        with pytest.raises(ValueError, match=r"expected a path without '.*', a name of the service's own pages"):
            public_address(own)


@pytest.mark.parametrize("option", [("--humans", "2", KITTING / "tiny.pddl"), ("--study", "study.toml")])
def test_a_wrong_address_is_one_line(option: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(Path("study.toml"))
    result = invoke("serve", *option, "--data", "data", "--public-url", "host.example/kits")
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == (
        "Error: Invalid value for '--public-url': host.example/kits: expected the address of the service, "
        "such as https://host.example/kits"
    )
    assert not Path("data").exists()


@pytest.mark.slow
def test_the_command_prints_public_links_and_listens_where_it_is_told() -> None:
    with served("--humans", 2, "--public-url", f"{PUBLIC}/") as service:
        assert service.url == PUBLIC
        links = [service.operator, *service.links.values()]
        assert all(link.startswith(f"{PUBLIC}/") for link in links)
        code, said = service.end()
        assert code == 0
        listening = re.search(rf"listening at http://127\.0\.0\.1:\d+ for a proxy that serves {PUBLIC}\n", said)
        assert listening


def page_at(chromium: Any, link: str, faults: list[str]) -> Any:
    page = chromium.new_page()
    page.set_default_timeout(60_000)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("response", lambda answer: faults.append(answer.url) if answer.status >= 400 else None)
    page.on("request", lambda asked: faults.append(asked.url) if "/kits/" not in asked.url else None)
    page.goto(link)
    return page


@pytest.mark.parametrize(
    "strips", [pytest.param(strips, marks=[pytest.mark.long, pytest.mark.slow]) for strips in (True, False)]
)
def test_pages_work_under_a_path(strips: bool, chromium: Any, tiny: Table, tmp_path: Path) -> None:
    def live(base: str) -> tuple[Service, ASGIApp]:
        service = team(tiny, tmp_path, base)
        return service, make_app(service)

    def conducted(base: str) -> tuple[StudyService, ASGIApp]:
        service = study(tiny, tmp_path, base)
        return service, make_app(service, more=[router])

    faults: list[str] = []
    with running(live, strips=strips) as service:
        worker = page_at(chromium, service.access.join_url("ann"), faults)
        worker.click("#actions button")
        worker.wait_for_function("() => document.getElementById('steps').textContent === '1'")
        worker.wait_for_function("() => document.getElementById('connection').textContent === 'Connected'")
        operators = page_at(chromium, service.access.operator_url(), faults)
        operators.wait_for_selector("#people li")
        operators.fill("#name", "cyd")
        operators.click("#add button")
        operators.wait_for_function("() => document.querySelectorAll('#people li').length === 3")
        for page in (worker, operators):
            page.close()
    with running(conducted, strips=strips) as service:
        part = page_at(chromium, service.join_url(), faults)
        part.wait_for_url("**/kits/part/**")
        for _ in range(2):  # consent, instructions; practice has a page of its own
            part.click("#form button.main")
            part.wait_for_timeout(300)
        part.wait_for_url("**/kits/join/**")
        part.click("#leave a")
        part.wait_for_url("**/kits/part/**leave")
        part.click("#stay")
        part.wait_for_url("**/kits/join/**")
        conducting = page_at(chromium, service.operator_url(), faults)
        conducting.wait_for_selector("#people tr")
        assert conducting.input_value("#join") == service.join_url()
        for page in (part, conducting):
            page.close()
    assert faults == []
