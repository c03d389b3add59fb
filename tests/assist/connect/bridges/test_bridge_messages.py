"""What bridges read: settings from files, and messages, which are put in order and acknowledged."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from conftest import ROOT, kit
from hypothesis import given
from hypothesis import strategies as st
from serving import TINY
from test_docs import BLOCK

from assist.cli import main
from assist.cli.options.bridges import bridge_of
from assist.connect.bridges.messages import Report, Topic, content_of, filled
from assist.connect.bridges.mqtt import Mqtt
from assist.connect.bridges.mqtt_settings import MqttSettings, Observed
from assist.connect.bridges.opcua_settings import OpcUaSettings, OwnServerSettings
from assist.connect.bridges.ordering import Acknowledgements, InOrder
from assist.connect.bridges.ros2_settings import Ros2Settings
from assist.connect.bridges.transport import Located
from assist.declare.refusals import Refusal
from assist.live.event_base import OfPerson
from assist.live.events import kinds

pytest.importorskip("aiomqtt")
pytest.importorskip("asyncua")

SHOWN = [text for kind, text in BLOCK.findall((ROOT / "docs" / "line.md").read_text()) if kind == "toml"]
"""The settings of the documentation: of MQTT at first and in full, of an OPC UA server, of an own one, and of ROS 2."""
FIRST, MQTT, OPCUA, OWN, ROS2 = range(5)
TEMPLATE, URL = "expected fields as {name}", "expected opc.tcp://host:port/path"
OWN_PLACE = "expected one of its own"

FAULTS = [
    (MQTT, 'topic = "line/{person}/action"', "", "observe.topic: is missing; expected a text"),
    (MQTT, "host =", "hots =", "broker.hots: unknown; did you mean 'host'?"),
    (MQTT, "wait =", "wiat =", "wiat: unknown; did you mean 'wait'?"),
    (MQTT, "[observe]", "[obsreve]", "obsreve: unknown; did you mean 'observe'?"),
    (MQTT, "[observe]", "[[observe]]\nactoin = 'x'", "observe[1].actoin: unknown; did you mean 'action'?"),
    (MQTT, "number =", "nubmer =", "observe.nubmer: unknown; did you mean 'number'?"),
    (MQTT, "line/{person}/action", "line/#", "'line/#'; expected levels"),
    (MQTT, "number =", "pattern = '('\nnumber =", "is no regular expression"),
    (MQTT, "line/{person}/advice", "line", "expected {person} in it"),
    (MQTT, "[advice]", "[status]\ntopic = '{person}'\n[advice]", "expected no field in it"),
    (MQTT, "[advice]", "[robot]\ntopic = 'r'\nfields = ['speed']\n[advice]", "expected some of arrived"),
    (MQTT, "[advice]", "[advice]\nfields = ['sugestion']", "advice.fields: 'sugestion'; did you mean 'suggestion'?"),
    (MQTT, "tls = true", "port = 0", "expected a port, 1 to 65535"),
    (MQTT, SHOWN[MQTT], "observe = []", "observe: []; expected a table or more"),
    (MQTT, "{slot})", "", ":10: observe.action: (place {item}  opens 1 and closes 0"),
    (MQTT, "{item} {slot}", "{item", TEMPLATE),
    (MQTT, "{scan}", "{scan", ":11: observe.id: '{scan'; expected fields as {name}"),
    (OPCUA, "opc.tcp://station:4840", "http://a", URL),
    (OPCUA, "ns=2;s=A.Pick", "A.Pick", "observe[1].node: 'A.Pick'; expected a node id"),
    (OPCUA, "ns=2;s=A.Light", "A.Light", "advice[1].node: 'A.Light'; expected a node id"),
    (OPCUA, "answer =", "pattern = '('\nanswer =", "is no regular expression"),
    (OPCUA, "slot-1)", "slot-1", "observe[1].action: (place {value} slot-1 opens 1 and closes 0"),
    (OWN, "opc.tcp://0.0.0.0:4840", "http://a", f"own_server.url: 'http://a'; {URL}"),
    (OWN, "id =", "person = 'ann'\nid =", "own_server.person: unknown"),
    (OWN, "{item}", "{", TEMPLATE),
    (OWN, "[own_server]", "[server]\nurl = 'opc.tcp://b'\n[own_server]", "server: unknown"),
    (ROS2, "ws://robot:9090", "http://here", "expected ws://host:port"),
    (ROS2, '"/line/action"', '"/line/person-1"', "expected a name of ROS"),
    (ROS2, "line_msgs/action/GoTo", "GoTo", "expected a type of ROS"),
    (ROS2, "[go_to]", "[advice]\ntopic = '/a'\nfields = ['speed']\n[go_to]", "expected some of answered, applicable"),
    (ROS2, "[go_to]", "[advice]\ntopic = '/a'\ntype = 'a/msg/B'\nfields = ['reason']\n[go_to]", "expected some of app"),
    (ROS2, "y = 2.5", "z = 2.5", "'ann' has no y"),
    (ROS2, "[observe]", "[[observe]]\ntopic = '/line/action'\n[[observe]]", f"is also observe[1].topic; {OWN_PLACE}"),
    (ROS2, "[go_to]", "[advice]\ntopic = '/line/action'\n[go_to]", f"is also observe.topic; {OWN_PLACE}"),
    (MQTT, "[observe]", "[[observe]]\ntopic = 'line/ann/action'\n[[observe]]", "is also observe[1].topic"),
    (
        MQTT,
        "[advice]",
        "[answers]\ntopic = 'line/{person}/action'\n[advice]",
        "answers.topic: 'line/{person}/action'",
    ),
    (MQTT, "[advice]", "[answers]\ntopic = 'line/{person}/advice'\n[advice]", "is also advice.topic"),
    (MQTT, "[advice]", "[status]\ntopic = 'line/a/action'\n[advice]", "status.topic: 'line/a/action' is also observe"),
    (OPCUA, "[[observe]]", "[[observe]]\nnode = 'ns=2;s=A.Pick'\nperson = 'a'\n[[observe]]", "is also observe[1]."),
    (OPCUA, "A.Answer", "A.Pick", f"observe[1].answer: 'ns=2;s=A.Pick' is also observe[1].node; {OWN_PLACE}"),
    (OPCUA, "A.Light", "A.Pick", "advice[1].node: 'ns=2;s=A.Pick' is also observe[1].node"),
    (ROS2, "[observe]", "[observe]\ntype = 'a/msg/B'\npattern = 'x'", "applies to texts"),
    (ROS2, "[observe]", "[observe]\naction = '(fetch {box}'", "opens 1 and closes 0 brackets"),
]
"""A part of the settings that are shown, what stands there instead, and what is said of it."""


@pytest.mark.parametrize(("which", "right", "wrong", "said"), FAULTS)
def test_faults_of_the_settings_are_said_with_their_line(
    which: int, right: str, wrong: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KITASSIST_OPCUA_PASSWORD", "secret")
    assert right in SHOWN[which]
    (file := tmp_path / "bridge.toml").write_text(SHOWN[which].replace(right, wrong, 1))
    with pytest.raises(click.UsageError, match=rf"{file}:\d+: ") as refused:
        bridge_of(file)
    assert said in refused.value.message


def test_a_fault_of_the_settings_ends_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("KITASSIST_OPCUA_PASSWORD", raising=False)
    (file := tmp_path / "bridge.toml").write_text(SHOWN[OWN])
    result = CliRunner().invoke(main, ["serve", str(TINY), "--humans", "1", "--bridge", str(file)])
    assert (result.exit_code, result.stdout) == (2, "")
    assert "has no password; expected it in KITASSIST_OPCUA_PASSWORD" in " ".join(result.stderr.split())


def test_the_settings_in_the_documentation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = [tmp_path / f"{name}.toml" for name in ("mqtt", "opcua", "own_server", "ros2")]
    for file, text in zip(files, SHOWN[MQTT:], strict=True):
        file.write_text(text)
    (advice,) = OpcUaSettings.read(files[1]).advice
    assert (advice.node, advice.person) == ("ns=2;s=A.Light", "ann")
    monkeypatch.setenv("KITASSIST_OPCUA_PASSWORD", "secret")
    assert OwnServerSettings.read(files[2]).own_server.url == "opc.tcp://0.0.0.0:4840"
    go_to = Ros2Settings.read(files[3]).go_to
    assert go_to is not None
    assert go_to.goal_for("ann") == {"x": 1.0, "y": 2.5}
    with pytest.raises(Refusal, match=r"go_to.places: 'bob' has no x"):
        go_to.goal_for("bob")
    settings = MqttSettings.read(files[0])
    (source,) = settings.sources
    payload = b'{"item": "4006381333931", "slot": "slot-1", "scan": "s-17", "n": 3}'
    report = source.report(source.fields("line/ann/action", payload), settings.names)
    assert report == Report("ann", "s-17", values={"action": "(place hammer slot-1)"}, number=3)
    assert (settings.broker.host, settings.port, settings.wait) == ("broker.example", 8883, 10.0)
    files[0].write_text(SHOWN[FIRST])
    settings = MqttSettings.read(files[0])
    (source,) = settings.sources
    payload = b'{"action": "(fetch box-a)", "id": "scan-1", "n": 1}'
    assert payload.decode() in (ROOT / "docs" / "line.md").read_text()
    report = source.report(source.fields("line/person-1/action", payload), settings.names)
    assert report == Report("person-1", "scan-1", values={"action": "(fetch box-a)"}, number=1)


def test_goals_that_are_never_sent_are_refused(tmp_path: Path) -> None:
    (file := tmp_path / "ros.toml").write_text(SHOWN[ROS2])
    bridge = bridge_of(file)
    bridge.require_possible([kit("tiny")], travels=True)
    with pytest.raises(click.UsageError, match=rf"{file}:7: go_to: has no effect without travel_time"):
        bridge.require_possible([kit("tiny")], travels=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[observe]]\ntopic = "a"\naction = "(fetsch {item})"', ":3: observe.1..action: .* did you mean 'fetch'"),
        ('[observe]\ntopic = "a"\naction = "place({item}, slot-7)"', ":3: observe.action: .* no action of the tasks"),
        ('[observe]\ntopic = "a"\n[names]\n4711 = "box-c"', ":4: names.4711: 'box-c' is in no action"),
    ],
)
def test_settings_with_actions_that_no_task_has_are_refused(text: str, message: str, tmp_path: Path) -> None:
    (file := tmp_path / "bridge.toml").write_text(text)
    with pytest.raises(click.UsageError, match=message):
        bridge_of(file).require_possible([kit("tiny")], travels=False)


def test_who_is_named_in_settings_and_is_not_in_the_team_is_told(tmp_path: Path) -> None:
    (file := tmp_path / "bridge.toml").write_text(
        '[observe]\ntopic = "a"\nperson = "anne"\naction = "(place {item} slot-1)"\n[names]\n4711 = "box-b"'
    )
    made = bridge_of(file)
    made.require_possible([kit("tiny")], travels=False)
    assert made.strangers(["anne"]) == []
    assert made.strangers(["ann"]) == [f"{file}: observe.person: 'anne' is not in the team yet; did you mean 'ann'?"]


def test_passwords_and_certificates_come_from_the_environment(tmp_path: Path) -> None:
    file = tmp_path / "bridge.toml"
    file.write_text('[observe]\ntopic = "line/{person}"\n[broker]\ntls = true\nusername = "kits"')
    settings = MqttSettings.read(file)
    assert settings.port == 8883
    assert settings.password({"KITASSIST_MQTT_PASSWORD": "secret"}) == "secret"
    assert settings.context({}) is not None
    for name, where in (("none.pem", "No such file"), ("bridge.toml", "")):
        with pytest.raises(OSError, match=f"KITASSIST_MQTT_CA: .*{where}.*{name}"):
            settings.context({"KITASSIST_MQTT_CA": str(tmp_path / name)})


@pytest.mark.parametrize("text", ["", "line/{person}-x", "line/+", "#", "{a}/{a}", "line/{}"])
def test_topics_are_checked(text: str) -> None:
    with pytest.raises(ValueError, match="expected levels"):
        Topic(text)


@given(st.lists(st.text(st.characters(exclude_characters="/+#\0"), min_size=1), min_size=2, max_size=2))
def test_a_topic_has_the_fields_with_which_it_was_filled(values: list[str]) -> None:
    topic = Topic("line/{person}/at/{station}")
    fields = dict(zip(("person", "station"), values, strict=True))
    assert topic.fields(topic.fill(**fields)) == fields
    assert topic.fields("line/a/at") is topic.fields("row/a/at/b") is topic.fields("line//at/b") is None
    assert topic.filter == "line/+/at/+"


def test_templates_take_words_only() -> None:
    assert filled("(put {what} {where})", {"what": "17", "where": "b"}, {"17": "hammer"}) == "(put hammer b)"
    assert filled("{action}", {"action": "(fetch box-a)"}, {}) == "(fetch box-a)"
    for fields in ({"what": "a b", "where": "c"}, {"what": "a) (b", "where": "c"}):
        with pytest.raises(Refusal, match="expected one word"):
            filled("(put {what} {where})", fields, {})
    with pytest.raises(Refusal, match="there is no field 'where'; the message has what"):
        filled("(put {what} {where})", {"what": "a"}, {})


@given(st.binary())
def test_any_payload_is_read_or_refused(payload: bytes) -> None:
    source = Observed(topic="line/{person}", number="{n}")
    with suppress(Refusal):
        source.report(source.fields("line/ann", payload), {})


@pytest.mark.cases
def test_a_report_of_no_kind_of_event_is_refused() -> None:
    """The next reports of the person would have waited for ever."""
    with pytest.raises(Refusal, match=r"^event 'undon'; did you mean 'undone'\?$"):
        Report("ann", "1", "undon").event()


@pytest.mark.cases
@pytest.mark.parametrize(
    ("event", "message", "reported"),
    [
        ("answered", '{"answer": true}', {"answer": True}),
        ("answered", '{"answer": "false"}', {"answer": False}),
        ("answered", '{"answer": null}', {"answer": None}),
        ("answered", '{"answer": "(go)"}', {"answer": "(go)"}),
        ("acted", '{"action": "(go)", "followed": true}', {"action": "(go)", "followed": True}),
        ("acted", '{"action": "(go)", "followed": "false"}', {"action": "(go)", "followed": False}),
        ("acted", '{"missed": 0.1}', {"missed": 0.1}),
        ("acted", '{"missed": 1e-05}', {"missed": 0.00001}),
        ("acted", '{"likelihoods": {"(go)": 0.5, "(stop)": 1}}', {"likelihoods": {"(go)": 0.5, "(stop)": 1.0}}),
        ("began", '{"task": "true"}', {"task": "true"}),
        ("began", '{"task": "7", "more": [1]}', {"task": "7"}),
        ("acted", '{"action": "(go)", "heard": null, "likelihoods": null}', {"action": "(go)"}),
    ],
)
def test_a_message_may_have_every_value_that_an_event_has(event: str, message: str, reported: dict[str, Any]) -> None:
    """Truth values and tables were dropped, so that a question about a goal could not be answered over a bridge."""
    fields = {"person": "ann", "id": "1"} | content_of(message.encode())
    found = Observed(topic="line/{person}", event=event).report(fields, {}).event()
    assert json.loads(found.reported) == json.loads(kinds(OfPerson)[event](person="ann", id="1", **reported).reported)


@given(st.floats(0, 1))
def test_every_probability_of_a_message_is_read(missed: float) -> None:
    source = Observed(topic="line/{person}/action")
    fields = source.fields("line/ann/action", json.dumps({"id": "1", "missed": missed}).encode())
    assert source.report(fields, {}).event().missed == missed


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        ('{"persn": "ann"}', "no person; expected"),
        ("{}", "no person; expected"),
        ('{"person": ["ann"]}', 'person ["ann"]; expected {"person": name}, with null at the base'),
        ('{"person": {"name": "ann"}}', 'person {"name": "ann"}; expected'),
        ('{"person": 3}', "person 3; expected"),
        ("ann", "expected a JSON object"),
        ('{"person": "ann", "id": "r"}', Located(1, "ann", "r")),
        ('{"person": null}', Located(1, None)),
        ('{"person": "ann", "id": null}', Located(1, "ann")),
    ],
)
def test_an_arrival_says_where_the_robot_is(payload: str, words: Any, caplog: pytest.LogCaptureFixture) -> None:
    topics = {name: {"topic": f"robot/{name}"} for name in ("robot", "arrived")}
    settings = MqttSettings(observe={"topic": "line/{person}/action"}, **topics)
    message = Mqtt(settings).message("robot/arrived", payload.encode(), lambda: None)
    if isinstance(words, str):
        assert words in caplog.text
        assert not isinstance(message, Located)
    else:
        assert replace(message, done=words.done) == words


def test_fields_of_payloads() -> None:
    for payload, said in (
        (b"garbage", "'garbage'; expected a JSON object in UTF-8"), (b"[]", "expected a JSON object"),
        (b'{"id": ' + b"9" * 5000 + b"}", "in UTF-8"), (b"\xff", "in UTF-8"),
        (b'{"a": "\\ud800"}', r"""'\{"a": .* expected Unicode text"""),
    ):  # fmt: skip
        with pytest.raises(Refusal, match=said):
            content_of(payload)
    most = sys.getrecursionlimit()
    for depth in range(most - 200, most + 5):  # what can be read can be sent, or is refused
        with suppress(Refusal):
            json.dumps(content_of(b'{"a":' + b"[" * depth + b"]" * depth + b"}"))
    source = Observed(topic="line/{person}", number="{n}", seq="{seq}")
    report = source.report({"person": "ann", "action": "(go)", "id": "1", "n": "2", "seq": "0"}, {})
    assert (report.number, report.values, report.fault) == (2, {"action": "(go)", "seq": 0}, None)
    right = {"person": "ann", "action": "(go)", "id": "1", "n": "2", "seq": "0"}
    for wrong in ({"id": ""}, {"id": "i" * 129}):
        with pytest.raises(Refusal, match="expected"):
            source.report({**right, **wrong}, {})
    for name, value, number in (("n", "0", None), ("n", "x", None), ("seq", "-1", 2)):
        report = source.report({**right, name: value}, {})
        assert (report.id, report.number) == ("1", number)
        with pytest.raises(Refusal, match="expected a whole number"):
            report.event()
    with pytest.raises(
        Refusal, match="there is no field 'n'; the message has person, action, id, seq"
    ):  # which the answer to this id says
        source.report({name: value for name, value in right.items() if name != "n"}, {}).event()
    with pytest.raises(Refusal, match=r"field 'person' is \[\"ann\"\]; expected a text or a number"):
        source.report({**right, "person": ["ann"]}, {})


@given(st.data())
def test_numbers_restore_the_order(data: st.DataObject) -> None:
    """However messages are repeated and reordered, each is released first when all before it are."""
    count = data.draw(st.integers(1, 8))
    arrivals = data.draw(st.lists(st.integers(1, count), max_size=20)) + data.draw(st.permutations(range(1, count + 1)))
    order = InOrder[int]()
    released = [item for number in arrivals for item in order.take(number, number)]
    assert list(dict.fromkeys(released)) == list(range(1, count + 1))
    assert not order.held


@given(st.integers(1, 8).flatmap(lambda count: st.permutations(range(count))))
def test_messages_are_acknowledged_in_the_order_of_their_arrival(order: list[int]) -> None:
    sent = list[tuple[int, int]]()
    open_messages = Acknowledgements(lambda identifier, quality: sent.append((identifier, quality)))
    done = [open_messages.expect(10 + number, 1) for number in range(len(order))]
    finished = set[int]()
    for number in order:
        done[number]()
        finished.add(number)
        first_open = min(set(range(len(order))) - finished, default=len(order))
        assert sent == [(10 + one, 1) for one in range(first_open)]


def test_missing_numbers_are_passed_over_and_known() -> None:
    order = InOrder[str](room=2)
    assert [order.take(number, str(number)) for number in (3, 1, 5, 6)] == [[], ["1"], [], []]
    assert order.pass_over() == ["3"]  # 6 found no room, its sender repeats it
    assert (order.late(2), order.late(3), order.next) == (True, False, 4)
    assert order.take(6, "6") == []
    assert order.resume(6) == ["5", "6"]
    assert order.resume(2) == order.pass_over() == []
    assert order.take(10**15, "last") == []  # a number can be enormous
    assert order.pass_over() == ["last"]
    assert order.late(10**14)
