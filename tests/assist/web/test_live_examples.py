"""The worked examples of the live assistant without a browser, and their client."""

from __future__ import annotations

import subprocess
import sys

import pytest
from conftest import ROOT
from serving import served

from assist.declare.refusals import Refusal
from assist.web.client import Client

EXAMPLES = ROOT / "docs" / "examples"


@pytest.mark.slow
def test_a_camera_reports_and_a_robot_asks_where_to_go() -> None:
    with served(
        "--humans", 1, "--c-suggest", 0.02, "--set", "travel_time=1", "--c-move", 0.01, "--set", "tick=0.1"
    ) as service:
        robot = subprocess.Popen(
            [sys.executable, EXAMPLES / "robot.py", service.operator], stdout=subprocess.PIPE, text=True
        )
        camera = subprocess.run(
            [sys.executable, EXAMPLES / "vision.py", service.operator, "person-1"],
            capture_output=True, text=True, timeout=600, check=True,
        )  # fmt: skip
        said, _ = robot.communicate(timeout=300)
        log = Client(service.operator).log()
    assert robot.returncode == 0
    seen = camera.stdout.splitlines()
    assert [f"person-1 {row['action']}" for row in log] == [line.partition(",")[0] for line in seen]
    assert seen[-1].endswith("remaining cost 0")
    assert "going to person-1" in said
    assert any(line.startswith("to person-1: (") for line in said.splitlines())


@pytest.mark.slow
def test_the_client_says_what_was_refused_and_tries_again_what_passes() -> None:
    with pytest.raises(ValueError, match="expected a join link"):
        Client("http://127.0.0.1:1/")
    with pytest.raises(OSError, match="refused"):
        Client("http://127.0.0.1:1/operator#abc", patience=0.3).robot()
    with served("--humans", 1, "--c-suggest", 0.02) as service:
        ann = Client(service.links["person-1"])
        watched = ann.watch()
        assert next(watched)["steps"] == 0
        assert ann.observe("person-1", "(fetch box-a)")["steps"] == next(watched)["steps"] == 1
        with pytest.raises(Refusal, match="not applicable here") as refused:
            ann.observe("person-1", "(fetch box-b)")
        assert refused.value.status == 409
        with pytest.raises(Refusal, match="only the operator may do this"):
            ann.team()
        operator = Client(service.operator)
        bob = Client(operator.join("bob")["join"])
        assert bob.begin("bob")["steps"] == 0
        operator.pause()
        assert bob.see()["paused"]
        operator.leave("bob")
        with pytest.raises(Refusal, match="'bob' is not in the team"):
            bob.see()
        assert [row["action"] for row in operator.log()] == ["(fetch box-a)"]
        assert operator.arrived("person-1")["location"] == "person-1"
