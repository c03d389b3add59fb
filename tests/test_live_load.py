"""A service that runs, under load, kills, and requests that nobody would think of."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import live_load
import pytest
from serving import TINY, served


@pytest.mark.long
def test_nothing_acknowledged_is_lost_when_the_service_is_killed(tmp_path: Path) -> None:
    """What is compared, and with what, stands in `live_load.check`."""
    seen = asyncio.run(live_load.run(TINY, 6, seconds=8.0, every=0.1, kills=2, data=tmp_path, seed=1))
    assert seen.latencies
    assert any(seen.acknowledged.values())


@pytest.mark.long
def test_the_interface_is_what_its_description_says(tmp_path: Path) -> None:
    """Requests made from the description, valid and not, against a service that runs."""
    people = "".join(
        f'[[operations]]\ninclude-name = "POST /api/people/{{name}}/{what}"\nparameters = {{ name = "person-1" }}\n'
        for what in ("actions", "undo", "begin")
    )
    (tmp_path / "schemathesis.toml").write_text(people)
    with served("--humans", 2, "--c-suggest", 0.02) as service:
        # Which people, tasks and actions there are is not in the description: not all that it allows is accepted.
        command = [
            str(Path(sys.executable).with_name("schemathesis")), "--config-file", str(tmp_path / "schemathesis.toml"),
            "run", f"{service.url}/openapi.json", "--checks", "all", "--exclude-checks", "positive_data_acceptance",
            "--max-examples", "5", "--phases", "examples,coverage,fuzzing", "--no-color", "--seed", "1",
            "--header", f"Authorization: Bearer {service.token()}",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=tmp_path)
        assert done.returncode == 0, done.stdout
        assert service.ask("GET", "/api/health").json()["status"] == "ok"
