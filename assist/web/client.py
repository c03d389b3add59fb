"""A Python client of the live assistant, for robots and for systems that observe people.

A report is sent again under the same id until the service acknowledges it. It is therefore recorded exactly once, even
if the network fails or the service restarts.
"""

from __future__ import annotations

import http.client
import json
import re
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qsl, quote, unquote, urlencode, urlsplit

from ..declare.refusals import Refusal
from ..live.event_base import Event, TeamEvent
from ..live.reports import Reports
from .tokens import PARTICIPANT

AGAIN = {408, 425, 429, 502, 503, 504, 507}
"""Status codes of temporary failures: too many requests, an overloaded service, a full disk, or a proxy that does not
reach the service.
"""

LINK = re.compile(r"(?P<root>(/[^/]+)*?)/((join|part)/(?P<name>[^/]+)|(study/)?operator|study)/?")
"""Pattern of a link's path, before the token. The path of the service (`root`) contains none of these names."""


class Client(Reports):
    """Connection to a service with the rights of one link.

    It has the verbs of `Reports`, which return the view of the person, or of the robot; `join` also returns the link of
    the person's page (`join`). All answers are the service's JSON objects, as dictionaries.

    Parameters
    ----------
    link : str
        A join link or the operator's link, as `kitassist serve` prints them, or the link of a participant's page. The
        join link of a study has the rights of visitors (`docs/http.md`). The service may be under a path.
    patience : float
        Seconds for which requests to a service that does not answer are repeated.
    pause : float
        Seconds between two attempts. Fewer add load to a service that restarts, more add delay.
    silence : float
        Seconds without a sign of life after which a stream counts as lost. The service sends one every 15 s.

    Attributes
    ----------
    name : str or None
        The person of a join link, or the participant.
    visit : dict of str
        Of a signed link of a study: the `id` and the `signature` with which a seat is asked for. Else empty.
    """

    def __init__(self, link: str, *, patience: float = 30.0, pause: float = 0.2, silence: float = 40.0) -> None:
        parts = urlsplit(link)
        found = LINK.fullmatch(parts.path)
        token = parts.fragment
        if found is None or not token or parts.scheme not in ("http", "https") or not parts.netloc:
            raise ValueError(f"{link[:40]!r}: expected a join link or the operator's link")
        self.url = f"{parts.scheme}://{parts.netloc}{found['root']}"
        self.name = None if found["name"] is None else unquote(found["name"])
        self._token, query = token, dict(parse_qsl(parts.query))
        signed = "participant" in query and "signature" in query
        self.visit = {"id": PARTICIPANT + query["participant"], "signature": query["signature"]} if signed else {}
        self.patience, self._pause, self._silence = patience, pause, silence

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request, repeatedly until it is answered, and return the answer.

        Raises
        ------
        Refusal
            The service refused the request.
        OSError
            No answer arrived within `patience`.
        """
        headers = {"Authorization": f"Bearer {self._token}", "Content-Type": "application/json"}
        data = None if body is None else json.dumps(body).encode()
        asked = time.monotonic()
        while True:
            try:
                request = urllib.request.Request(self.url + path, data, headers, method=method)
                with urllib.request.urlopen(request, timeout=max(1.0, self.patience)) as answer:
                    content = answer.read().decode()
                    return content if path.startswith("/api/log") else json.loads(content)
            except urllib.error.HTTPError as error:
                if error.code not in AGAIN or time.monotonic() > asked + self.patience:
                    raise Refusal.answered(error.code, _detail(error)) from None
            except (
                OSError,
                ValueError,
                http.client.HTTPException,
            ):  # the connection broke, perhaps within an answer
                if time.monotonic() > asked + self.patience:
                    raise
            time.sleep(self._pause)

    def _path(self, person: str | None) -> str:
        name = person or self.name
        if name is None:
            raise ValueError("expected the name of a person, since the link is not that of one")
        return f"/api/people/{quote(name, safe='')}"

    def see(self, person: str | None = None) -> dict[str, Any]:
        """Return a person's view: the applicable actions, the suggestion and its reasons."""
        seen: dict[str, Any] = self.ask("GET", self._path(person))
        return seen

    def report(self, event: TeamEvent) -> dict[str, Any]:
        """Report an event; return the view of the person, or of the robot.

        Raises
        ------
        ValueError
            Events of this kind are not reported over HTTP.
        """
        if event.id is None:
            event = event.model_copy(update={"id": uuid.uuid4().hex})
        answer: dict[str, Any] = self.ask(*request_of(event))
        return answer

    def explain(self, person: str | None = None, *, against: str | None = None, language: str = "en") -> dict[str, Any]:
        """Return why a person has this suggestion now, or none.

        Parameters
        ----------
        person : str, optional
            Needed with the operator's link only.
        against : str, optional
            An action with which the suggested step is compared.
        language : str
            "en" or "de".
        """
        asked = {"language": language} | ({} if against is None else {"against": against})
        found: dict[str, Any] = self.ask("GET", f"{self._path(person)}/explanation?{urlencode(asked)}")
        return found

    def robot(self, number: int = 1) -> dict[str, Any]:
        """Return where a robot, by its number from 1, should go and what it should suggest there."""
        errand: dict[str, Any] = self.ask("GET", robot_path(number))
        return errand

    def team(self) -> dict[str, Any]:
        """Return the operator's view of the team."""
        team: dict[str, Any] = self.ask("GET", "/api/team")
        return team

    def log(self, task: str | None = None) -> list[dict[str, Any]]:
        """Return all recorded actions, in the format of `fit`; with `task`, only those in this task."""
        which = "" if task is None else f"?task={quote(task, safe='')}"
        return [json.loads(line) for line in self.ask("GET", f"/api/log{which}").splitlines()]

    def watch(self, person: str | None = None) -> Iterator[dict[str, Any]]:
        """Yield a person's view now and after every change; with the operator's link, the operator's view.

        A lost connection is restored. Changes that follow each other closely are one.

        Raises
        ------
        Refusal
            The service refuses the request; with status 404, the person has left.
        OSError
            The service cannot be reached within `patience`.
        """
        path = "/api/team" if (person or self.name) is None else self._path(person)
        for kind, view in self._events(f"{path}/events"):
            if kind in ("view", "team"):
                yield view

    def changes(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield what changes in the team, with the operator's link: the kind of each event, and its content.

        First, and after each lost connection, come the names of all who are present (`people`), the view of each
        (`view`) and the instruction of each robot (`robot`); then each of these that has changed, and who has left
        (`left`). Errors are those of `watch`.
        """
        yield from self._events("/api/team/changes")

    def _events(self, path: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the events of a stream, which is opened again whenever it ends or nothing is heard of it."""
        headers = {"Authorization": f"Bearer {self._token}"}
        heard = time.monotonic()
        while True:
            try:
                request = urllib.request.Request(self.url + path, headers=headers)
                with urllib.request.urlopen(request, timeout=self._silence) as answer:
                    reader = EventReader()
                    for line in answer:
                        heard = time.monotonic()
                        if (found := reader.take(line.decode())) is not None:
                            yield found
            except urllib.error.HTTPError as error:
                if error.code not in AGAIN or time.monotonic() > heard + self.patience:
                    raise Refusal.answered(error.code, _detail(error)) from None
            except (OSError, http.client.HTTPException):
                if time.monotonic() > heard + self.patience:
                    raise
            time.sleep(self._pause)


class EventReader:
    """Puts the lines of a stream together to events."""

    def __init__(self) -> None:
        self._kind = ""

    def take(self, line: str) -> tuple[str, dict[str, Any]] | None:
        """Return the event that a line completes, as its kind and content; None for a sign of life and other lines."""
        name, _, value = line.strip().partition(": ")
        if name == "event":
            self._kind = value
        return (self._kind, json.loads(value)) if name == "data" and self._kind != "ping" else None


def request_of(event: Event) -> tuple[str, str, dict[str, Any]]:
    """Return the method, the path and the body of the request that reports an event.

    Raises
    ------
    ValueError
        Events of this kind are not reported over HTTP.
    """
    if event.path is None:
        raise ValueError(f"{event.kind}: expected an event that is reported over HTTP")
    every = json.loads(event.model_dump_json(include={*event.fields()}))
    inside = {name: str(every.pop(name)) for name in re.findall(r"\{(\w+)\}", event.path)}
    path = event.path.format(**{name: quote(value, safe="") for name, value in inside.items()})
    differs = event.model_dump(exclude_defaults=True).keys() | event.never_left_out
    said = {name: value for name, value in every.items() if name in differs}
    return "POST", path, said


def robot_path(number: int) -> str:
    """Return the path of a robot's instruction, by its number from 1."""
    return f"/api/robots/{number}"


def _detail(error: urllib.error.HTTPError) -> str:
    """Return the service's reason; a proxy's answer has none, so that its status line is returned."""
    try:
        return str(json.loads(error.read())["detail"])
    except (OSError, ValueError, KeyError, TypeError):
        return f"{error.code} {error.reason}"
