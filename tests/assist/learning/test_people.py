"""From a log to people: `fit` in Python, and the command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import KITTING, invoke, kit
from recorded import FETCH, WRONG, lines, people_at_work, write_log

from assist.learning import FittedPeople, Log, Method, read_log
from assist.learning.fit import fit
from assist.people.choices import Choices
from planner import InputFileError, OnDemand, Table

TINY = KITTING / "tiny.pddl"
PLAN = kit("tiny").optimal_plan() or []


@pytest.fixture(scope="module")
def rows(tiny: Table) -> list[dict]:
    rng = np.random.default_rng(6)
    return people_at_work(Choices.of(tiny), [0.3, 0.8, 1.5], rng, suggest=0.4, episodes=4)


@pytest.mark.slow
def test_people_by_their_names(tiny: Table, rows: list[dict], tmp_path: Path) -> None:
    """The command prints the results of the Python function, on a table and on demand."""
    file = write_log(tmp_path / "log.jsonl", rows)
    people = fit(tiny, read_log(file))
    assert list(people) == ["p0", "p1", "p2"]
    assert people.complete
    ann = people["p0"]
    assert ann.beta is not None
    assert ann.theta is not None
    assert ann.theta_interval is not None
    assert ann.beta_interval[0] <= ann.beta <= ann.beta_interval[1] < 1.5
    assert ann.actions == sum(row["person"] == "p0" for row in rows)
    with pytest.raises(KeyError, match="zoe"):
        people["zoe"]
    result = invoke("fit", TINY, file, "--json")
    assert (result.exit_code, json.loads(result.stdout)) == (0, people.as_dicts())
    asked = fit(OnDemand(tiny.task), read_log(file), method=Method(level=0.95, seed=0))
    assert asked.as_dicts() == people.as_dicts()
    drawn = people.population().sample(Choices.of(tiny), 500, np.random.default_rng(0))
    assert people.sigma == (0.0, 0.0)
    assert np.mean([human.beta for human in drawn]) == pytest.approx(people.distribution().beta.mean, rel=0.15)


def test_what_cannot_be_used_is_not_passed_over(tiny: Table) -> None:
    log = Log.of([*lines(*PLAN), *lines(FETCH, FETCH, person="bob"), *lines(FETCH, FETCH, person="cyd")])
    with pytest.warns(UserWarning, match=r"log:8: person 'bob', episode '1', which is left out: .* \(and 1 more"):
        people = fit(tiny, log)
    assert (list(people), list(people.unknown), len(people.faults)) == (["ann"], ["bob", "cyd"], 2)
    assert not people.complete
    assert [record["error"] for record in people.as_dicts()] == [None, *["no episode can be used"] * 2]
    with pytest.raises(InputFileError, match="log:8: person 'bob'"):
        fit(tiny, log, strict=True)
    with pytest.raises(InputFileError, match="log: no recorded actions"):
        fit(tiny, Log.of([]))
    with (
        pytest.warns(UserWarning, match="log:1") as warned,
        pytest.raises(InputFileError, match="is it the log of another instance"),
    ):
        fit(tiny, Log.of(lines("(stack a b)")))
    assert warned[0].filename == __file__  # where it was asked for
    with pytest.raises(ValueError, match="drop nosuch"):
        fit(tiny, log, drop=["nosuch"])


def test_misconceptions_of_several_people(tiny: Table, rows: list[dict]) -> None:
    told: list[tuple[str, int, int | None]] = []
    few = Log.of([row for row in rows if row["person"] != "p2" and row["episode"] < "2"])
    people: FittedPeople = fit(tiny, few, model="misconceptions", progress=lambda *what: told.append(what))
    assert told == [("evaluating states", 0, None), *(("fitting people", done, 2) for done in range(3))]
    found = [record.misconception for record in people.values()]
    low, high = people.sigma
    assert all(m is not None and m.sigma >= 0 for m in found)
    assert low <= np.median([m.sigma for m in found if m is not None]) <= high
    assert people.population().sigma == people.sigma
    assert all("facts" in state for state in people.as_dicts()[0]["misconception"]["states"])


def test_what_is_not_identified_has_no_value(tiny: Table, tmp_path: Path) -> None:
    """An expert who follows one good suggestion gives no information about how trust changes."""
    people = fit(tiny, Log.of(lines(*PLAN, told={1: PLAN[1]})))
    record = people["ann"]
    assert (record.eta, record.eta_interval) == (None, (0.0, 1.0))
    assert "these actions say nothing about eta" in record.notes
    shown = people.as_dicts()[0]
    assert (shown["eta"], shown["eta_interval"], shown["eta_open"]) == (None, [0.0, 1.0], ["below", "above"])
    file = write_log(tmp_path / "log.jsonl", lines(*PLAN, told={1: PLAN[1]}))
    result = invoke("fit", TINY, file)
    assert "? (0.000 to 1.000+)" in result.stdout
    silent = fit(tiny, Log.of(lines(FETCH)))["ann"]
    assert (silent.beta, silent.theta, silent.theta_interval) == (None, None, None)


@pytest.mark.slow
def test_eta_of_a_population_only_where_it_is_known(tiny: Table) -> None:
    several = [row for name in "abcd" for row in lines(*PLAN, person=name, told={1: PLAN[1]})]
    assert fit(tiny, Log.of(several)).distribution().eta is None
    assert fit(tiny, Log.of(several), method=Method(eta=0.2)).distribution().eta == 0.2
    many = people_at_work(Choices.of(tiny), [0.5] * 8, np.random.default_rng(1), suggest=0.6, episodes=8)
    eta = fit(tiny, Log.of(many)).distribution().eta
    assert eta == pytest.approx(0.2, abs=0.1)


def test_actions_to_drop_that_a_log_does_not_have_are_said_and_stop_nothing(tmp_path: Path) -> None:
    """The same options may be given with several logs."""
    file = write_log(tmp_path / "log.jsonl", lines(FETCH, "pause", WRONG))
    result = invoke(
        "fit", KITTING / "tiny.pddl", file, *(word for one in ("nosuch", "pause", "none") for word in ("--drop", one))
    )
    unknown = "".join(f"{file}: --drop {one}: no action is called so\n" for one in ("nosuch", "none"))
    assert (result.exit_code, unknown in result.stderr) == (0, True)
    assert "pause" not in result.stderr


SPOILT = '{"person": "a", "episode": 1, "step": 0, "action": "(stack a b)"}'


@pytest.mark.parametrize(
    ("options", "text", "words"),
    [
        ("--out {0}/x --write-population {0}/x", None, "--write-population {0}/x: the same file as --out"),
        ("--out {0}/log.jsonl", None, "--out {0}/log.jsonl: the same file as LOG"),
        ("--write-population {0}/tiny.pddl", None, "--write-population {0}/tiny.pddl: the same file as INSTANCE"),
        ("--out {0}/domain.pddl", None, "--out {0}/domain.pddl: the same file as its domain"),
        ("--family uniform --json", None, "--family: expected --write-population"),
        ("--set largest_beta=1e300", None, "largest_beta: 1e+300; expected a number from 1e-09 to 1e+09"),
        ("--set utility_scale=1e-300", None, "utility_scale: 1e-300; expected a number from 1e-09 to 1e+09"),
        ("--set eta=-1", None, "eta: -1; expected a number from 0"),
        ("--set level=2", None, "level: 2; expected a number above 0 and below 1"),
        ("--rename nosuch=fetch", None, "rename nosuch=fetch: no action in "),
        ("--rename fetch=nosuch", None, "rename fetch=nosuch: no action of the task is called 'nosuch'"),
        ("--rename fetch=return --rename fetch=place", None, "--rename fetch=place: 'fetch' is renamed already"),
        ("--rename a", None, "expected OLD=NEW"),
        ("--columns person", None, "--columns person: expected NAME=COLUMN"),
        ("--columns person=a,person=b", None, "--columns person=b: 'person' has a column already"),
        ("--columns worker=person", None, "a log has no column 'worker'; did you mean person=worker?"),
        ("--columns person=a,action=A", None, "columns action=A: 'A' stands for another column already"),
        ("--columns person=workr", '{"worker": "a"}', "has no column 'workr'; did you mean 'worker'?"),
        ("--columns person=who", '{"a": 1, "b": 2}', "has no column 'who'; it has a, b"),
        ("", "", "log.jsonl: no recorded actions"),
        ("", SPOILT, "log of another instance?"),
        ("", "no json", "log.jsonl:1: not JSON"),
        ("", "[1]", "log.jsonl:1: expected an object"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(
    tmp_path: Path, options: str, text: str | None, words: str
) -> None:
    for name in ("tiny.pddl", "domain.pddl"):
        (tmp_path / name).write_text((KITTING / name).read_text())
    file = write_log(tmp_path / "log.jsonl", lines(FETCH, WRONG))
    if text is not None:
        file.write_text(text + "\n" * bool(text))
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    arguments = options.format(tmp_path).split()
    result = invoke("fit", tmp_path / "tiny.pddl", file, *arguments)
    assert (result.exit_code, result.stdout) == (2 if options else 1, "")  # 1 where the log is at fault
    assert words.format(tmp_path) in result.stderr
    assert "Traceback" not in result.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


def test_people_are_kept_where_their_population_finds_no_room(tmp_path: Path) -> None:
    file = write_log(tmp_path / "log.jsonl", lines(*PLAN))
    out = tmp_path / "people.jsonl"
    result = invoke("fit", TINY, file, "--out", out, "--write-population", "/dev/full")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "/dev/full" in result.stderr
    assert [json.loads(line)["person"] for line in out.read_text().splitlines()] == ["ann"]
