"""The main functions of the two packages, with two imports."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING

from assist import Assistant, Pool, simulate
from assist.people import Population
from planner import cost_to_go, load

PROGRAM = """\
from planner import load, cost_to_go
from assist import Assistant, Pool, fit, read_log, simulate

table = cost_to_go(load("domains/kitting/paper.pddl"))          # also: load(a unified_planning Problem)
pool = Pool.sample(table, 12, seed=1)
for policy in ("none", "reactive", "attention", "priority"):
    print(simulate(pool, policy, humans=3, episodes=100, seed=1).summary())

desk = Assistant(table, people=["ann", "bob"], policy="attention")
while not desk.finished:
    advice = desk.recommend()        # .person, .suggestion, .reason (numbers); person None: nothing worth saying
    desk.observe("ann", "(fetch box-a)")

people = fit(table, read_log("log.jsonl"))
print(people["ann"].beta)
pool = Pool.sample(table, 12, population=people.population(), seed=1)
"""
OBSERVED = 'desk.observe("ann", "(fetch box-a)")'


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a small kit in the place of the paper's, and a log of people at it: two experts and a beginner."""
    folder = tmp_path / "domains" / "kitting"
    folder.mkdir(parents=True)
    (folder / "domain.pddl").write_text((KITTING / "domain.pddl").read_text())
    (folder / "paper.pddl").write_text((KITTING / "tiny.pddl").read_text())
    monkeypatch.chdir(tmp_path)
    table = cost_to_go(load("domains/kitting/paper.pddl"))
    rows = []
    for name, beta in (("ann", 2.0), ("bob", 0.4), ("cy", 1.2)):
        alike = Pool.sample(table, 1, seed=3, population=Population(beta=(beta, beta), sigma=(0.0, 0.0)))
        trace: list[dict[str, Any]] = []
        simulate(alike, "reactive", humans=1, episodes=8, seed=3, trace=trace)
        rows += [row | {"person": name} for row in trace]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return tmp_path


def test_the_program_that_it_was_designed_for(place: Path) -> None:
    """The program of a newcomer, in which more than one action is observed, with a fifth of its episodes."""
    assert place.is_dir()
    assert PROGRAM.count(OBSERVED) == 1
    names: dict[str, Any] = {}

    def happens(desk: Assistant) -> None:
        """Each person follows the advice. Those without advice take the first applicable action."""
        if not desk.log():
            exec(OBSERVED, {"desk": desk})
        for name in desk.people:
            person = desk.person(name)
            if not person.finished:
                plan = names["table"].optimal_plan(person.state)
                desk.observe(name, person.suggestion or plan[0])

    names["happens"] = happens
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(PROGRAM.replace(OBSERVED, "happens(desk)").replace("episodes=100", "episodes=20"), names)
    lines = printed.getvalue().splitlines()
    assert [line.split()[0].rstrip(":") for line in lines[:4]] == ["none", "reactive", "attention", "priority"]
    assert names["desk"].finished
    assert names["people"]["ann"].beta > names["people"]["bob"].beta
    assert len(names["pool"].people) == 12
