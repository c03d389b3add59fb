"""A running service under load, kills and unusual requests, and the worked examples of its programs."""

from __future__ import annotations

import asyncio
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import live_load
import pytest
from conftest import ROOT
from serving import TINY, Served, served
from userstudies import written

from assist.web.client import Client

EXAMPLES = ROOT / "docs" / "examples"


@pytest.mark.long
@pytest.mark.slow
def test_nothing_acknowledged_is_lost_when_the_service_is_killed(tmp_path: Path) -> None:
    """The comparison is that of `live_load.check`."""
    seen = asyncio.run(live_load.run(TINY, 6, seconds=3.0, every=0.1, kills=1, data=tmp_path, seed=1))
    assert seen.latencies
    assert any(seen.acknowledged.values())


def conforms(service: Served, folder: Path, person: str, *only: str, without: str = "nobody") -> None:
    """Send requests generated from the description, valid and invalid, with this person where a path has one.

    Requests whose path matches `without` are about people who do not exist.
    """
    described = service.ask("GET", "/openapi.json").json()["paths"]
    named = [
        f'[[operations]]\ninclude-name = "{method.upper()} {path}"\nparameters = {{ person = "{person}" }}\n'
        for path, methods in described.items()
        if "{person}" in path and not re.search(without, path)
        for method in methods
    ]
    assert len(named) > 5
    (folder / "schemathesis.toml").write_text("".join(named))
    # Which people, tasks and actions there are is not in the description: not all that it allows is accepted.
    command = [
        str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(folder / "schemathesis.toml"),
        "run", f"{service.url}/openapi.json", "--checks", "all", "--exclude-checks", "positive_data_acceptance",
        "--max-examples", "3", "--request-timeout", "120", "--max-response-time", "120",
        "--phases", "examples,coverage,fuzzing",
        "--exclude-path-regex", "/(events|changes)$",  # streams, which do not end
        "--no-color", "--seed", "1", "--header", f"Authorization: Bearer {service.token()}", *only,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, cwd=folder)
    assert done.returncode == 0, done.stdout
    assert service.ask("GET", "/api/health").json()["status"] == "ok"


@pytest.mark.slow
def test_the_interface_is_what_its_description_says(tmp_path: Path) -> None:
    with served("--humans", 2, "--c-suggest", 0.02) as service:
        conforms(service, tmp_path, "person-1", without="(leave|records)$")


@pytest.mark.slow
def test_the_interface_of_a_user_study_is_what_its_description_says(tmp_path: Path) -> None:
    file = written(tmp_path / "study.toml")
    with served("--study", file, "--data", tmp_path / "data", instance=None) as study:
        seat = study.ask("POST", "/api/study/seats", json={"id": "a visitor"}).json()
        # Requests that are answered differently than for a team.
        only = r"^/api/(study.*|team|people/\{person\}(/drawing|/actions)?)$"
        conforms(study, tmp_path, seat["person"], "--include-path-regex", only)


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
