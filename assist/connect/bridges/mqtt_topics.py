"""MQTT: what messages on topics report, and on which topics what is told, by the settings of a bridge."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from ...declare.refusals import Refusal
from ...live.robot_places import robot_numbers
from .messages import LONGEST_ID, content_of, filled, unusable
from .mqtt_settings import ADVICE, ROBOT, MqttSettings
from .transport import Answer, Kept, Located, Message, Output, Resumed, Transport

LOG = logging.getLogger(__name__)

MISSING = object()
WILD = re.compile(r"[/+#\0]")  # characters that a level of a topic cannot have


class Topics(Transport):
    """A transport whose messages have topics and payloads.

    Parameters
    ----------
    settings : MqttSettings
    robots : int
    """

    name, reads = "MQTT", MqttSettings
    settings: MqttSettings

    def __init__(self, settings: MqttSettings, robots: int = 1) -> None:
        super().__init__()
        self.settings, self.wait, self._count = settings, settings.wait, robots
        self.robots = 0 if settings.robot is None else robots

    def topics(self) -> list[str]:
        """Return what is subscribed to."""
        settings = self.settings
        topics = [source.topic.filter for source in settings.sources]
        return topics + ([settings.arrived.topic.filter] if settings.arrived is not None else [])

    def kept(self) -> list[str]:
        """Return on which topics a broker may have kept something of before."""
        outputs = (self.settings.answers, self.settings.advice)
        return [one.topic.filter for one in outputs if one is not None]

    def message(self, topic: str, payload: bytes, done: Any) -> Message:
        """Return what a message reports."""
        arrived = self.settings.arrived
        if arrived is not None and (fields := arrived.topic.fields(topic)) is not None:
            return self._located(fields.get("robot", "1"), payload, done)
        source = next((one for one in self.settings.sources if one.topic.fields(topic) is not None), None)
        if source is None:  # a subscription of an earlier configuration
            return Message(done=done)
        return self.reported(source, lambda: source.fields(topic, payload), source.topic.fields(topic), done=done)

    def before(self, topic: str, payload: bytes) -> Iterator[Message]:
        """Yield what follows from a message that the broker has kept; the one last answer may be of this session."""
        answers, advice = self.settings.answers, self.settings.advice
        if answers is not None and (own := answers.topic.fields(topic)) is not None:
            with suppress(TypeError, ValueError):
                fields = content_of(payload)
                if fields.get("session") == self.session and "next" in fields:
                    yield Resumed(own["person"], int(fields["next"]))
                    return
            yield Kept(own["person"])
        if advice is not None and (own := advice.topic.fields(topic)) is not None:
            yield Kept(own["person"])

    def _located(self, robot: str, payload: bytes, done: Any) -> Message:
        try:
            if robot not in map(str, range(1, self._count + 1)):
                raise unusable(f"robot {robot[:40]!r}; expected {robot_numbers(self._count)}")
            content = content_of(payload)
            person = content.get("person", MISSING)
            if not isinstance(person, str | None):
                given = "no person" if person is MISSING else f"person {json.dumps(person)[:40]}"
                raise unusable(f'{given}; expected {{"person": name}}, with null at the base')
            identifier = None if content.get("id") is None else filled("{id}", content, {})
        except Refusal as error:
            LOG.warning("MQTT: arrival of a robot: %s", error)
            return Message(done=done)
        return Located(int(robot), person, identifier, done=done)

    # What goes where.

    def advice(self, person: str, view: Mapping[str, Any] | None) -> Iterable[Output]:
        """Yield a person's advice; when they have left, the broker is to keep nothing of them."""
        output = self.settings.advice
        if output is not None:
            payload = b"" if view is None else _json(view, output.fields or ADVICE)
            yield Output(output.topic.fill(person=person), (payload, True), keep=True)

    def answer(self, answer: Answer) -> Iterable[Output]:
        """Yield the answer to a report; that to a numbered one is retained, with the number that comes next."""
        topic, person = self.settings.answers, answer.person
        if topic is not None and person and len(person) <= LONGEST_ID and not WILD.search(person):
            session = {} if answer.next is None else {"session": self.session}
            payload = json.dumps(answer.as_dict() | session).encode()
            yield Output(topic.topic.fill(person=person), (payload, answer.number is not None))

    def forget(self, person: str) -> Iterable[Output]:
        """Yield what removes the last answer to a person who has left."""
        if self.settings.answers is not None:
            yield Output(self.settings.answers.topic.fill(person=person), (b"", True))

    def instruction(self, robot: int, errand: Mapping[str, Any]) -> Iterable[Output]:
        """Yield a robot's instruction."""
        output = self.settings.robot
        if output is not None:
            yield Output(output.topic.fill(robot=str(robot)), (_json(errand, output.fields or ROBOT), True), keep=True)


def _json(view: Mapping[str, Any], fields: Iterable[str]) -> bytes:
    return json.dumps({name: view.get(name) for name in fields}).encode()
