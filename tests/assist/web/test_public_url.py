"""A service under a path, behind a proxy that may strip the path: pages, requests, connections and clients."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urljoin, urlsplit

import pytest
from conftest import KITTING, invoke, thinned
from networks import running
from serving import served
from starlette.testclient import TestClient
from starlette.types import ASGIApp, Receive, Scope, Send
from streams import opened
from test_live_web import Web
from test_userstudy_pages import Web as Study
from userstudies import written

from assist.declare.refusals import Refusal
from assist.web.client import Client
from assist.web.server import address, listen
from assist.web.tokens import VISITOR, AccessTokens, public_address
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


def team(table: Table, folder: Path, base: str) -> Web:
    return Web(table, folder, base=base)


def study(table: Table, folder: Path, base: str) -> Study:
    return Study(table, folder, base=base)


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


def are_under_the_path(client: TestClient, pages: Iterable[str], least: int) -> None:
    for page in pages:
        assert page.startswith(f"{PUBLIC}/")
        loaded = everything(client, page)
        assert len(loaded) >= least
        assert {answer.status_code for answer in loaded.values()} == {200}
        assert all(address.startswith(f"{PUBLIC}/") for address in loaded)


@pytest.mark.parametrize("strips", [True, False], ids=["stripped", "kept"])
def test_all_of_a_session_is_under_the_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    web = team(tiny, tmp_path, PUBLIC)
    access, operator = web.access, web.who(None)
    with TestClient(Proxy(web.app, ROOT, strips=strips)) as client:
        are_under_the_path(client, (access.join_url("ann"), access.operator_url()), 4)
        page = f"{PUBLIC}/docs"
        loaded = [urljoin(page, "".join(pair)) for pair in LOADED.findall(client.get(page).text)]
        assert {client.get(one).status_code for one in loaded if not one.startswith("data:")} == {200}
        assert "/api/people/{person}/actions" in client.get(f"{PUBLIC}/openapi.json").json()["paths"]
        assert client.get(f"{PUBLIC}/").status_code == 404
        assert client.get(f"{PUBLIC}/api/team").status_code == 401  # without a token
        added = client.post(f"{PUBLIC}/api/team/people", headers=operator, json={"person": "cyd"}).json()
        assert added["join"] == access.join_url("cyd")
        assert client.get(added["join"]).status_code == 200
        people = client.get(f"{PUBLIC}/api/team", headers=operator).json()["people"]
        assert [person["join"] for person in people] == [access.join_url(name) for name in ("ann", "bob", "cyd")]
        with opened(client, f"{urlsplit(PUBLIC).path}/api/people/ann/events", operator) as watching:
            assert watching.view()["person"] == "ann"


@STRIPS
def test_all_of_a_user_study_is_under_the_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    web = study(tiny, tmp_path, PUBLIC)
    service = web.service
    with TestClient(Proxy(web.app, ROOT, strips=strips)) as client:
        visitor, operator = ({"Authorization": f"Bearer {token}"} for token in (
            web.access.token(VISITOR), web.access.operator
        ))  # fmt: skip
        seat = client.post(f"{PUBLIC}/api/study/seats", headers=visitor, json={"id": "ann"}).json()
        pages = (service.join_url(), service.operator_url(), f"{PUBLIC}{seat['part']}")
        are_under_the_path(client, pages, 5)
        assert client.get(f"{PUBLIC}/api/study", headers=operator).json()["join"] == service.join_url()
        assert client.get(f"{PUBLIC}/api/study/export", headers=operator).status_code == 200


@contextmanager
def under_a_path(make: Any, table: Table, folder: Path, *, strips: bool) -> Iterator[Any]:
    """A service that listens under a path."""
    listening = listen("127.0.0.1", 0)
    web = make(table, folder, f"{address(listening)}/kits")
    with running(Proxy(web.app, "/kits", strips=strips), listening):
        yield web.service


@STRIPS
def test_a_client_takes_links_with_a_path(strips: bool, tiny: Table, tmp_path: Path) -> None:
    with under_a_path(team, tiny, tmp_path, strips=strips) as service:
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


@pytest.mark.long
@pytest.mark.slow
def test_pages_of_a_study_work_under_a_path(chromium: Any, tiny: Table, tmp_path: Path) -> None:
    """Those of a team do so behind nginx."""
    faults: list[str] = []
    with under_a_path(study, tiny, tmp_path, strips=True) as service:
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
