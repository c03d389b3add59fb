"""A running service under load, kills and unusual requests."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import live_load
import pytest
from serving import TINY, Served, served
from userstudies import written


@pytest.mark.long
@pytest.mark.slow
def test_nothing_acknowledged_is_lost_when_the_service_is_killed(tmp_path: Path) -> None:
    """The comparison is that of `live_load.check`."""
    seen = asyncio.run(live_load.run(TINY, 6, seconds=3.0, every=0.1, kills=1, data=tmp_path, seed=1))
    assert seen.latencies
    assert any(seen.acknowledged.values())


def conforms(service: Served, folder: Path, parameters: dict[str, str], *only: str) -> None:
    """Send requests generated from the description, valid and invalid, for existing people in each path's `name`."""
    (folder / "schemathesis.toml").write_text(
        "".join(
            f'[[operations]]\ninclude-name = "{request}"\nparameters = {{ name = "{name}" }}\n'
            for request, name in parameters.items()
        )
    )
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
        conforms(
            service, tmp_path,
            {f"POST /api/people/{{name}}/{what}": "person-1" for what in ("actions", "undo", "begin")},
        )  # fmt: skip


@pytest.mark.slow
def test_the_interface_of_a_user_study_is_what_its_description_says(tmp_path: Path) -> None:
    file = written(tmp_path / "study.toml")
    with served("--study", file, "--data", tmp_path / "data", instance=None) as study:
        described = study.ask("GET", "/openapi.json").json()["paths"]
        seat = study.ask("POST", "/api/study/seats", json={"id": "a visitor"}).json()
        named = [
            f"{method.upper()} {path}" for path, methods in described.items() if "{name}" in path for method in methods
        ]
        # Requests that are answered differently than for a team.
        only = r"^/api/(study.*|team|people/\{name\}(/drawing|/actions)?)$"
        conforms(study, tmp_path, dict.fromkeys(named, seat["person"]), "--include-path-regex", only)
