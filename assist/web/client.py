"""A client of the live assistant, for programs: a system that observes people, a robot, a warehouse.

What is reported is reported until it is acknowledged, under one id, so that it happens once, whatever the network or a
restart of the service does in between.
"""

from __future__ import annotations

import json
import re
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote, unquote, urlsplit

from planner.system.errors import MissingExtraError

AGAIN = {429, 503, 507}
"""What passes by itself: too much at once, or a disk that is full."""

LINK = re.compile(r"(?P<root>(/[^/]+)*?)/(join/(?P<name>[^/]+)|(study/)?operator)/(?P<token>[^/]+)/?")
"""The path of a link, with that under which the service is, which has none of these names."""

BETWEEN = 0.2
"""Seconds between two attempts."""


class RefusedError(ValueError):
    """The service refuses a request; says why.

    Attributes
    ----------
    status : int
        Of HTTP: 401 and 403 for a link that is not valid there, 404 for a person who is not there, 409 for what cannot
        be done now, 422 for what is not valid.
    """

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class Client:
    """What can be said to a service, and asked of it, with one link.

    All answers are what the service sends, as dictionaries.

    Parameters
    ----------
    link : str
        A join link, or the operator's, as `kitassist serve` prints them; the service may be under a path.
    patience : float
        Seconds for which a service that does not answer is tried again.
    """

    def __init__(self, link: str, *, patience: float = 30.0) -> None:
        parts = urlsplit(link)
        found = LINK.fullmatch(parts.path)
        if found is None or parts.scheme not in ("http", "https") or not parts.netloc:
            raise ValueError(f"{link[:40]!r}: expected the address of a join link or of the operator's")
        self.url = f"{parts.scheme}://{parts.netloc}{found['root']}"
        self.name = None if found["name"] is None else unquote(found["name"])
        self._token = found["token"]
        self.patience = patience

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Ask until there is an answer.

        Raises
        ------
        RefusedError
        OSError
            There was none in time.
        """
        headers = {"Authorization": f"Bearer {self._token}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        given_up = time.monotonic() + self.patience
        while True:
            try:
                request = urllib.request.Request(self.url + path, data, headers, method=method)
                with urllib.request.urlopen(request, timeout=max(1.0, self.patience)) as answer:
                    content = answer.read().decode()
                    return content if path.startswith("/api/log") else json.loads(content)
            except urllib.error.HTTPError as error:
                if error.code not in AGAIN or time.monotonic() > given_up:
                    raise RefusedError(error.code, json.loads(error.read())["detail"]) from None
            except (OSError, ValueError):  # it has gone, perhaps in the middle of an answer
                if time.monotonic() > given_up:
                    raise
            time.sleep(BETWEEN)

    def _path(self, person: str | None) -> str:
        name = person or self.name
        if name is None:
            raise ValueError("expected a person, as the link is the operator's")
        return f"/api/people/{quote(name, safe='')}"

    def see(self, person: str | None = None) -> dict[str, Any]:
        """Give what somebody sees: what they can do, what is suggested to them, and why."""
        seen: dict[str, Any] = self.ask("GET", self._path(person))
        return seen

    def act(
        self, action: str, person: str | None = None, *, followed: bool | None = None, seq: int | None = None
    ) -> dict[str, Any]:
        """Report what somebody did; give what they see then."""
        body = {"action": action, "id": uuid.uuid4().hex, "followed": followed, "seq": seq}
        seen: dict[str, Any] = self.ask("POST", f"{self._path(person)}/actions", body)
        return seen

    def undo(self, person: str | None = None) -> dict[str, Any]:
        """Take somebody's last action back."""
        seen: dict[str, Any] = self.ask("POST", f"{self._path(person)}/undo", {"id": uuid.uuid4().hex})
        return seen

    def begin(self, person: str | None = None, task: str | None = None) -> dict[str, Any]:
        """Let somebody begin the next task, the same again unless named."""
        body = {"id": uuid.uuid4().hex, "task": task}
        seen: dict[str, Any] = self.ask("POST", f"{self._path(person)}/begin", body)
        return seen

    def robot(self) -> dict[str, Any]:
        """Ask where the robot is to go, and what it is to say there."""
        errand: dict[str, Any] = self.ask("GET", "/api/robot")
        return errand

    def arrived(self, person: str | None) -> dict[str, Any]:
        """Report where the robot is, None for its base; give what it is to do there, or where to go next."""
        errand: dict[str, Any] = self.ask("POST", "/api/robot/arrived", {"person": person, "id": uuid.uuid4().hex})
        return errand

    def team(self) -> dict[str, Any]:
        """Give what the operator sees."""
        team: dict[str, Any] = self.ask("GET", "/api/team")
        return team

    def join(self, person: str, task: str | None = None) -> str:
        """Let somebody come; give their link."""
        body = {"person": person, "task": task, "id": uuid.uuid4().hex}
        return str(self.ask("POST", "/api/team/people", body)["join"])

    def leave(self, person: str) -> None:
        """Let somebody go."""
        self.ask("DELETE", f"/api/team/people/{quote(person, safe='')}")

    def pause(self, paused: bool = True) -> None:
        """Let the robot say nothing, or speak again."""
        self.ask("POST", "/api/team/pause", {"paused": paused})

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Give everybody's actions, as `fit` reads them; those in one task, if it is named."""
        which = "" if task is None else f"?task={quote(task, safe='')}"
        return [json.loads(line) for line in self.ask("GET", f"/api/log{which}").splitlines()]

    def watch(self, person: str | None = None) -> Iterator[dict[str, Any]]:
        """Give what somebody sees now and whenever it changes; what the operator does, where the link is theirs.

        Connects again by itself.

        Raises
        ------
        MissingExtraError
            Without the extra `web`.
        OSError
            The service cannot be reached for as long as there is patience, or refuses to be watched.
        """
        try:
            from websockets.exceptions import ConnectionClosed, InvalidHandshake
            from websockets.sync.client import connect
        except ImportError:
            raise MissingExtraError("to watch needs", "websockets", "web") from None
        path = "/api/team" if (person or self.name) is None else self._path(person)
        headers = {"Authorization": f"Bearer {self._token}"}
        heard = time.monotonic()
        while True:
            try:
                with connect(f"ws{self.url[4:]}{path}/events", additional_headers=headers) as socket:
                    for message in socket:
                        heard = time.monotonic()
                        yield json.loads(message)
            except InvalidHandshake as error:
                raise ConnectionRefusedError(f"{self.url}{path}: {error}") from None
            except (OSError, ConnectionClosed):
                if time.monotonic() > heard + self.patience:
                    raise
            time.sleep(BETWEEN)
