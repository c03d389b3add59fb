"""A behaviour tree that serves people through a running session, and what its leaves do when something fails."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from test_mqtt import Here
from test_ros2 import DRIVES

from assist.live.simulated_person import SimulatedPerson
from assist.live.store import stored
from assist.people.mixture import advice_takers
from assist.web.client import RefusedError
from assist.web.server import SimulatedSeats, listen, run

py_trees = pytest.importorskip("py_trees")
from assist.bridges.behaviour_tree import assistance  # noqa: E402  which needs py_trees

INVALID, FAILURE, RUNNING, SUCCESS = (py_trees.common.Status[n] for n in ("INVALID", "FAILURE", "RUNNING", "SUCCESS"))
STAY = {"person": None, "suggestion": None, "reason": None, "arrived": True}
GO = {"person": "ann", "suggestion": None, "reason": None, "arrived": False}
SAY = {"person": "ann", "suggestion": "(fetch box-a)", "reason": {"suggestions": 0}, "arrived": True}


@pytest.fixture(autouse=True)
def _empty_blackboard() -> Iterator[None]:
    yield
    py_trees.blackboard.Blackboard.clear()


def test_a_tree_serves_three_simulated_people_to_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tree is the one of the documentation's example."""
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
    kinds = [record["event"] for _, record in events]
    said = capsys.readouterr().out.splitlines()
    assert kinds.count("acted") >= 3 * 4
    assert kinds.count("arrived") == sum(line.startswith("going to") for line in said) > 0
    assert any(line.startswith("to ") for line in said)


class Played:
    """A robot, and a service that gives it one errand after the other."""

    patience = 1.0

    def __init__(self, *errands: dict[str, Any] | Exception) -> None:
        self.errands, self.done, self.at = list(errands), list[str](), iter(())

    def robot(self, number: int = 1) -> dict[str, Any]:
        self.asked = number
        errand = self.errands.pop(0)
        if isinstance(errand, Exception):
            raise errand
        return errand

    def arrived(self, person: str, number: int = 1) -> dict[str, Any]:
        self.done.append(f"arrived at {person}")
        return self.robot(number)

    def go(self, person: str) -> None:
        self.done.append(f"go to {person}")

    def there(self) -> bool | None:
        return next(self.at, True)

    def stop(self) -> None:
        self.done.append("stop")

    def say(self, person: str, suggestion: str) -> None:
        self.done.append(f"say {suggestion} to {person}")


def outcome(tree: Any) -> Any:
    """Tick a tree until it is not running any more; return its status."""
    given_up = time.monotonic() + 10
    tree.tick_once()
    while tree.status is RUNNING and time.monotonic() < given_up:
        time.sleep(0.005)
        tree.tick_once()
    return tree.status


def played(*errands: dict[str, Any] | Exception, number: int = 1) -> tuple[Any, Played]:
    played = Played(*errands)
    client: Any = played
    return assistance(client, played, number=number), played


def test_an_errand_is_driven_reported_and_said_once() -> None:
    tree, robot = played(GO, SAY, SAY, SAY | {"reason": {"suggestions": 1}}, number=2)
    robot.at = iter((None, None, True))
    assert [outcome(tree) for _ in range(3)] == [SUCCESS] * 3
    say = "say (fetch box-a) to ann"
    assert robot.done == ["go to ann", "arrived at ann", say, say]
    assert robot.asked == 2


@pytest.mark.parametrize(
    ("errands", "there", "done"),
    [
        ([STAY], True, []),
        ([RefusedError(403, "only the operator may do this")], True, []),
        ([ConnectionRefusedError("no service")], True, []),
        ([GO], False, ["go to ann"]),
        ([GO, RefusedError(404, "'ann' is not in the team")], True, ["go to ann", "arrived at ann"]),
        ([GO, STAY], True, ["go to ann", "arrived at ann"]),
    ],
)
def test_a_round_fails_if_nothing_is_to_be_done_or_can_be(
    errands: list[dict[str, Any] | Exception], there: bool, done: list[str]
) -> None:
    tree, robot = played(*errands)
    robot.at = iter((there,))
    assert outcome(tree) is FAILURE
    assert robot.done == done


def test_a_tree_that_turns_to_something_else_stops_the_robot() -> None:
    tree, robot = played(GO, STAY)
    robot.at = iter([None] * 10_000)
    while not robot.done:
        tree.tick_once()
    tree.stop(INVALID)
    assert robot.done == ["go to ann", "stop"]
    assert outcome(tree) is FAILURE
