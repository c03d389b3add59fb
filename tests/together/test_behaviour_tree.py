"""The documentation's behaviour tree serves people through a running session."""

from __future__ import annotations

import asyncio
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
from beside import Here
from conftest import ROOT
from test_ros2 import DRIVES

from assist.live.simulated_person import SimulatedPerson
from assist.live.store import stored
from assist.people.ranges import advice_takers
from assist.web.server import SimulatedSeats, listen, run

pytest.importorskip("py_trees")


@pytest.mark.slow
def test_a_tree_serves_three_simulated_people_to_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = ["ann", "bob", "eve"]
    here, listening = Here(tmp_path / "session", names, DRIVES), listen("127.0.0.1", 0)
    link = f"http://127.0.0.1:{listening.getsockname()[1]}/operator#{here.service.access.operator}"
    people = {name: SimulatedPerson(advice_takers(), trust=DRIVES.trust_rule(), seed=n) for n, name in enumerate(names)}
    spec = spec_from_file_location("tree", ROOT / "docs" / "examples" / "tree.py")
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(example := module_from_spec(spec))

    async def work() -> None:
        seats = SimulatedSeats(people, pace=0.2).fill(here.service, alone=True)
        await asyncio.gather(asyncio.to_thread(example.main, link), seats)

    asyncio.run(run(here.app, listening, lambda: None, work(), ends=True))
    events = stored(tmp_path / "session" / "journal.sqlite")[1]
    kinds = [record["event"]["kind"] for _, record in events]
    said = capsys.readouterr().out.splitlines()
    assert kinds.count("acted") >= 3 * 4
    ways = sum(line.startswith("going to") for line in said)
    assert ways - 1 <= kinds.count("arrived") <= ways > 0  # all may have finished during the last one
    assert any(line.startswith("to ") for line in said)
