"""The worked examples of the live assistant without a browser, and their client."""

from __future__ import annotations

import runpy
import subprocess
import sys
from types import SimpleNamespace

import pytest
from conftest import ROOT
from serving import served

from assist.web.client import Client

EXAMPLES = ROOT / "docs" / "examples"


def test_a_camera_stops_in_a_dead_end() -> None:
    view = {"finished": False, "suggestion": None, "applicable": [], "cost_to_go": None}
    camera = runpy.run_path(str(EXAMPLES / "vision.py"))["camera"]
    assert list(camera(SimpleNamespace(see=lambda _: view), "ann")) == []


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
