"""The service in operation: one file of options, readiness, JSON logs, and reloading without a restart."""

from __future__ import annotations

import json
import logging
import shutil
import signal
import subprocess
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
from click.testing import CliRunner
from conftest import ROOT, kit
from serving import TINY, served
from test_docs import BLOCK
from test_live_web import Web

from assist import fit, read_log
from assist.cli import main
from assist.cli.options import task
from assist.cli.options.config import read_config
from assist.cli.options.live import changed_settings
from assist.cli.options.settings import ServeSetting
from assist.cli.serve import serve
from assist.declare.declared import names_of
from assist.declare.options import FieldOption, Given, Value, printed
from assist.live import Session
from assist.person.settings import Setting
from assist.web.service import ReadAgain
from planner import Table
from planner.system.errors import InputFileError
from planner.system.jit import announce
from planner.system.progress import compiling_line

FAR = [[0.0, 5.0, 1.0], [5.0, 0.0, 5.0], [1.0, 5.0, 0.0]]
NEAR = [[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]


def test_every_option_can_be_set_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "line.toml"
    without = ("config", "instances", "changes", "setting_file")
    options = [one for one in serve.params if one.name not in without and not isinstance(one, FieldOption)]
    lines = []
    for one in options:
        value = {"humans": "3", "trusted_proxy": '["10.0.0.1"]'}.get(str(one.name))
        if isinstance(one.type, click.Choice):
            value = f'"{one.type.choices[0]}"'
        elif value is None and one.multiple:
            value = '["text"]'
        elif value is None:
            value = "1" if isinstance(one.type, Value) else '"text"'
        lines.append(f"{one.opts[0][2:].replace('-', '_')} = {value}")
    lines += ["[setting]", printed(ServeSetting).replace("[population]", "[setting.population]")]
    file.write_text("\n".join(lines))
    found = read_config(file, serve.params)
    assert set(found) == {one.name for one in options} | {"setting"}
    assert (found["humans"], found["data"]) == (3, str(tmp_path / "text"))
    given = Given(ServeSetting)
    given.file(file, found["setting"], "setting")
    assert given.read() == ServeSetting()
    assert set(found["setting"]) <= set(names_of(ServeSetting))


@pytest.mark.cases
def test_a_field_is_not_shown_with_a_value_that_would_not_hold() -> None:
    """The influence of people in live sessions is that of real people, not the range of simulated ones."""
    shown = printed(ServeSetting)
    people = shown[shown.index("# [population]") :]
    assert "# beta = [0.1, 3.0]\n" in people
    assert "# theta =\n" in people
    assert "it is that of real people: from 0 to 1, above 0.85 for half, below 0.5 for one in nine.\n" in shown
    shares = ServeSetting().population.shares  # of ten ranges of equal width, from 0 to 1
    assert (round(sum(shares[:5]), 2), round(shares[9] + shares[8] / 2, 1)) == (0.11, 0.5)


def test_the_file_in_the_documentation_is_read(tmp_path: Path) -> None:
    (block,) = [text for text in BLOCK.findall((ROOT / "docs/live.md").read_text()) if "log_format" in str(text)]
    (file := tmp_path / "line.toml").write_text(block if isinstance(block, str) else block[-1])
    shutil.copy(TINY, tmp_path / "paper.pddl")
    found = read_config(file, serve.params)
    assert (found["instances"], found["humans"]) == ((str(tmp_path / "paper.pddl"),), 3)
    given = Given(ServeSetting)
    given.file(file, found["setting"], "setting")
    assert (len(given.read().robots), given.read().tick) == (2, 5.0)


def test_paths_in_a_file_are_relative_to_its_folder(tmp_path: Path) -> None:
    (folder := tmp_path / "line").mkdir()
    for name in ("more.pddl", "xx.toml"):
        (folder / name).write_text("")
    file = folder / "line.toml"
    file.write_text("""
instances = ["more.pddl", "*.pddl", "kitting/tiny"]
goals = ["more.pddl", "kitting/tiny"]
policy = "own.py:in_turn"
host = "line"
[setting]
language = "xx.toml"
distances = "far.json"
""")
    assert read_config(file, serve.params) == {
        "instances": (str(folder / "more.pddl"), str(folder / "*.pddl"), "kitting/tiny"),
        "problems": (str(folder / "more.pddl"), "kitting/tiny"),
        "policy": f"{folder / 'own.py'}:in_turn",
        "host": "line",
        "setting": {"language": "xx.toml", "distances": "far.json"},
    }
    given = Given(ServeSetting)
    given.file(file, read_config(file, serve.params)["setting"], "setting")
    assert (given.read().language, given.read().distances) == (str(folder / "xx.toml"), str(folder / "far.json"))
    file.write_text('policy = "attention"\n[setting]\nlanguage = "de"')
    assert read_config(file, serve.params) == {"policy": "attention", "setting": {"language": "de"}}


@pytest.mark.parametrize(
    ("line", "environment", "said"),
    [
        ("humans = 'three'", {}, 'line.toml:2: humans: "three"; expected a whole number from 1 to 10000'),
        ("setting = {c_sugest = 1}", {}, "line.toml:2: setting.c_sugest: unknown; did you mean 'c_suggest'?"),
        ("setting = {population = {noise = 'action'}}", {},
         "line.toml:2: setting.population: noise without theta; expected theta as well"),
        ("setting = {population = {beta = [2, 1]}}", {}, "line.toml:2: setting.population.beta: [2, 1]; expected two"),
        ("c_suggest = 1", {}, "line.toml:2: c_suggest: unknown; expected it in the table `setting`"),
        ("gamma = 0.9", {}, "line.toml:2: gamma: unknown; expected it in the table `setting`, or a file for --setting"),
        ("policy = 'best'", {}, "(from "),
        ("setting = {pace = -1}", {}, "line.toml:2: setting.pace: -1; expected a number above 0"),
        ("tasks = {ann = 'tiny'}", {}, "line.toml:2: tasks.ann: there is no person 'ann'"),
        ("tasks = {person-1 = 'big'}", {}, "line.toml:2: tasks.person-1: there is no task 'big'"),
        ("public_url = 'ftp://x'", {}, "such as https://host.example/kits (from "),
        ("trusted_proxy = ['bogus']", {}, "(from "),
        ("humans = 2\nsimulate = 3", {}, "3 is more than --humans 2 (from "),
        ("setting = {pace = -1}", {"KITASSIST_PACE": ""}, "line.toml:2: setting.pace: -1; expected a number above 0"),
        ("humans = 2", {"KITASSIST_PACE": "slow"}, 'KITASSIST_PACE: "slow"; expected a number above 0'),
        ("humans = 2\nstudy = 'missing.toml'", {}, "missing.toml"),
    ],
)  # fmt: skip
def test_a_faulty_configuration_is_refused_with_its_place(
    tmp_path: Path, line: str, environment: dict[str, str], said: str
) -> None:
    file = tmp_path / "line.toml"
    humans = "" if "humans" in line else "\nhumans = 2"
    file.write_text(f'instances = ["kitting/tiny"]\n{line}{humans}\n')
    found = CliRunner().invoke(main, ["serve", "--config", str(file), "--port", "0"], env=environment)
    assert found.exit_code == 2
    assert said in " ".join(found.stderr.split())


def test_a_configuration_of_a_study_has_no_tasks(tmp_path: Path) -> None:
    study = ROOT / "docs" / "examples" / "kitting-study.toml"
    (file := tmp_path / "line.toml").write_text(f"study = '{study}'\n[tasks]\nann = 'tiny'")
    found = CliRunner().invoke(main, ["serve", "--config", str(file), "--data", str(tmp_path / "data")])
    assert (found.exit_code, "the table tasks cannot be combined with --study" in found.stderr) == (2, True)


@pytest.mark.cases
def test_variables_that_set_nothing_are_told(tmp_path: Path) -> None:
    """One that a host sets may begin so, too, and stops nothing."""
    environment = {
        "KITASSIST_C_SUGEST": "2", "KITASSIST_XYZZYPLUGH": "10.0.0.1", "KITASSIST_C_MOVE": "1",
        "KITASSIST_POPULATION_BETA": "[0, 1]", "KITASSIST_MQTT_PASSWORD": "secret", "KITASSIST_PROGRESS": "0",
        "KITASSIST_DATA": str(tmp_path / "there"),
    }  # fmt: skip
    found = CliRunner().invoke(main, ["serve", "--humans", "1"], env=environment)
    told = [line for line in found.stderr.splitlines() if "sets nothing" in line]
    assert told == [
        "KITASSIST_C_SUGEST in the environment sets nothing; did you mean KITASSIST_C_SUGGEST?",
        "KITASSIST_XYZZYPLUGH in the environment sets nothing",
    ]


@pytest.mark.cases
def test_variables_that_kubernetes_sets_by_itself_are_passed_over() -> None:
    """It sets them in each container beside a service that is called kitassist."""
    environment = {
        "KITASSIST_PORT": "tcp://10.0.0.1:80", "KITASSIST_PORT_80_TCP": "tcp://10.0.0.1:80",
        "KITASSIST_SERVICE_HOST": "10.0.0.1", "KITASSIST_SERVICE_PORT": "80",
    }  # fmt: skip
    found = CliRunner().invoke(main, ["serve", "--humans", "1"], env=environment)
    assert "INSTANCE: missing" in found.stderr
    assert "KITASSIST" not in found.stderr
    found = CliRunner().invoke(main, ["serve", "--humans", "1"], env={"KITASSIST_PORT": "80b"})
    assert "80b; expected a whole number from 0 to 65535 (from KITASSIST_PORT)" in found.stderr


def test_a_service_runs_from_one_file_follows_its_changes_ends_and_goes_on_where_it_was(
    tmp_path: Path, tiny: Table
) -> None:
    shutil.copy(TINY, tmp_path / "own.pddl")
    shutil.copy(TINY.parent / "domain.pddl", tmp_path / "domain.pddl")
    (tmp_path / "far.json").write_text(json.dumps(NEAR))
    file = tmp_path / "line.toml"
    config = """
instances = ["own.pddl", "kitting/tiny"]
humans = 5
log_format = "json"
data = "session"
[setting]
c_suggest = 0.1
distances = "far.json"
[tasks]
person-1 = "tiny"
"""
    file.write_text(config)
    options = ("--config", file, "--humans", 2)  # an option overrides the file
    act, report = "/api/people/person-1/actions", {"action": "(fetch box-a)", "id": "1"}
    with served(*options, instance=None) as service, ExitStack() as held:
        assert list(service.links) == ["person-1", "person-2"]
        assert service.ask("GET", "/api/health?ready=true").json() == {
            "status": "ok", "ready": True, "reasons": [], "people": 2, "events": 2,
        }  # fmt: skip
        assert service.ask("GET", "/api/people/person-1").json()["task"] == "tiny"
        (tmp_path / "far.json").write_text(json.dumps(FAR))
        file.write_text(config.replace('"tiny"', '"own"'))
        service.process.send_signal(signal.SIGHUP)
        until = time.monotonic() + 60
        while service.ask("GET", "/api/people/person-1").json()["task"] != "own":
            assert time.monotonic() < until
            time.sleep(0.05)
        assert service.ask("POST", "/api/reload").json() == {"changes": 0, "restart": [], "new_session": []}
        file.write_text(config.replace("c_suggest = 0.1", "c_suggest = 0.3\ntick = 5.0").replace('"tiny"\n', '"own"\n'))
        assert service.ask("POST", "/api/reload").json() == {
            "changes": 0, "restart": ["setting.tick"], "new_session": ["setting.c_suggest"],
        }  # fmt: skip
        assert service.ask("POST", "/api/reload", "person-1").status_code == 403
        file.write_text(config + "person-9 = 'tiny'")
        refused = service.ask("POST", "/api/reload")
        assert (refused.status_code, "person-9" in refused.json()["detail"]) == (422, True)
        first = service.ask("POST", act, "person-1", json=report)
        assert (first.status_code, first.json()["steps"], first.json()["cost_to_go"]) == (200, 1, 5.0)
        team = service.ask("GET", "/api/team").json()
        streams = []
        for path in ("/api/people/person-1/events", "/api/team/events", "/api/team/changes"):
            request = urllib.request.Request(service.url + path, headers={"Authorization": f"Bearer {service.token()}"})
            streams.append(held.enter_context(urllib.request.urlopen(request, timeout=60)))
            assert streams[-1].readline() == b"event: ping\n"
        links = [service.operator, *service.links.values()]
        code, said = service.end(signal.SIGTERM)
        assert code == 0
        for stream in streams:
            assert stream.read().endswith(b"\n\n")  # complete events, and then an orderly end
    lines = [json.loads(line) for line in said.splitlines()]
    assert {line["logger"] for line in lines} == {
        "assist.cli", "assist.web.server", "assist.web.service", "assist.web.reports",
    }  # fmt: skip
    assert any(line["message"] == "reloaded" and line["changes"] == 2 for line in lines)
    assert [line["message"] for line in lines if line["logger"] == "assist.web.service"] == [
        "a restart is needed for what else has changed: setting.tick",
        "a new session, in another folder, is needed for what else has changed: setting.c_suggest",
    ]
    reports = [(line["event"], line["outcome"]) for line in lines if line["message"] == "report"]
    assert {("rearranged", "recorded"), ("acted", "recorded")} <= set(reports)
    assert not any(secret in said for secret in ("person-1", *(link.partition("#")[2] for link in links)))
    file.write_text(config.replace('"tiny"', '"own"'))
    with served(*options, "--log-format", "text", instance=None) as service:
        again = [service.operator, *service.links.values()]
        assert [link.partition("#")[2] for link in again] == [link.partition("#")[2] for link in links]
        assert service.ask("POST", act, "person-1", json=report).json() == first.json()
        after = service.ask("GET", "/api/team").json()
        assert [person["belief"] for person in after["people"]] == [person["belief"] for person in team["people"]]
        assert after["people"][0]["steps"] == 1
        (tmp_path / "log.jsonl").write_text(service.ask("GET", "/api/log").text)
        code, said = service.end(signal.SIGINT)  # Ctrl-C
    began = [line.split(" in ")[0].split(";")[0] for line in said.splitlines()]
    assert (code, began) == (0, ["preparing the session", "the session is saved"])  # and no task that was cancelled
    assert fit(tiny, read_log(str(tmp_path / "log.jsonl")))["person-1"].actions == 1


@pytest.mark.parametrize("level", [logging.INFO, logging.WARNING])
def test_what_is_compiled_is_a_line_of_the_log_where_the_log_has_objects(
    level: int, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(task, "compiling_line", compiling_line)
    with caplog.at_level(level, "assist"), click.Context(serve):
        task.tell_of_compiling()
        announce("doubled numbers: a second")
    said = "compiling doubled numbers: a second; once after an installation"
    logged = [(record.name, record.getMessage()) for record in caplog.records]
    told = [("assist.cli", said)], ""
    assert (logged, capsys.readouterr().err) == (told if level == logging.INFO else ([], f"{said}\n"))


def test_reading_again_keeps_distances_that_another_file_sets_and_names_those_that_are_gone(tmp_path: Path) -> None:
    for name, content in (("near", NEAR), ("far", FAR)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    config, other = tmp_path / "line.toml", tmp_path / "other.toml"
    config.write_text('[setting]\ndistances = "near.json"')
    session = Session(kit("tiny"), tmp_path / "journal.sqlite", distance=FAR)

    def again(*files: tuple[Path, str]) -> ReadAgain:
        given = Given(ServeSetting)
        for file, table in files:
            given.file(file, {"distances": "far.json"}, table)
        team: Any = SimpleNamespace(setting=given.read(), given=given)
        read = changed_settings(config, click.Context(serve), session, team)
        return read()

    assert again((config, "setting"), (other, "")) == ReadAgain([], [], [])
    assert [one.kind for one in again((config, "setting")).events] == ["rearranged"]
    config.write_text("[setting]")
    assert again((config, "setting"), (other, "")) == ReadAgain([], [], [])
    assert again((config, "setting")) == ReadAgain([], [], ["setting.distances"])
    session.close()


def test_changed_distances_are_restored_and_required(tmp_path: Path) -> None:
    setting = Setting(c_suggest=0.02, c_move=1.0)
    file, table = tmp_path / "journal.sqlite", kit("tiny")
    session = Session(table, file, setting=setting, distance=NEAR)
    for name in ("ann", "bob"):
        session.join(name)
    with pytest.raises(ValueError, match="expected one for each of 2 people"):
        session.rearrange([[0, 1], [1, 0]])
    assert session.distance == NEAR
    first = session.rearrange(FAR)
    assert session.distance == FAR
    session.observe("ann", "(fetch box-a)")
    before, advice = session.beliefs(), session.recommend()
    assert first["seq"] == 3
    session.close()
    again = Session(table, file, setting=setting, distance=FAR)
    assert (again.beliefs(), again.distance, again.recommend()) == (before, FAR, advice)
    again.close()
    with pytest.raises(InputFileError, match="distance"):
        Session(table, file, setting=setting, distance=NEAR)


class _Line:
    counts: dict[str, int] = {}  # noqa: RUF012
    connected = False
    waits = ()

    async def run(self) -> None:
        pass


def test_a_service_says_why_it_is_not_ready(tmp_path: Path) -> None:
    web = Web(kit("tiny"), tmp_path)
    with web.client:
        web.service.bridges["MqttBridge"] = line = _Line()
        seen = web.client.get("/api/health")
        assert (seen.status_code, seen.json()["ready"]) == (200, False)
        assert seen.json()["reasons"] == ["MqttBridge is not connected"]
        assert web.client.get("/api/health", params={"ready": True}).status_code == 503
        line.connected = True
        assert web.client.get("/api/health", params={"ready": True}).status_code == 200
        web.service.session._store._failed = "No space left on device"
        assert "No space left on device" in web.client.get("/api/health").json()["reasons"][0]
        web.act("(fetch box-a)")  # there is room again
        assert web.client.get("/api/health").json()["ready"]
        assert web.ask("POST", "/api/reload", None).status_code == 409


def test_the_unit_of_systemd_is_valid(tmp_path: Path) -> None:
    verify = shutil.which("systemd-analyze")
    if verify is None:
        pytest.skip("no systemd")
    text = (ROOT / "docs/examples/kitassist.service").read_text()
    program = shutil.which("true")
    unit = tmp_path / "kitassist.service"
    lines = [
        line if not line.startswith("Exec") else f"{line.partition('=')[0]}={program}" for line in text.splitlines()
    ]
    unit.write_text("\n".join(lines))
    found = subprocess.run([verify, "verify", "--man=no", str(unit)], capture_output=True, text=True)
    assert not [line for line in found.stderr.splitlines() if "kitassist.service" in line], found.stderr
    assert "kitassist serve --config" in text
