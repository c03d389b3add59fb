"""Runs of studies: killed and resumed, damaged, and with failing policies."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import invoke
from fuzz import here
from studies import TINY, contents, write

from assist.studies import Study, load_study, profile, read, run_study
from assist.studies.reports.study_report import write_report
from planner.system.errors import InputFileError


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run cells in this process, since a worker takes a second to start."""
    monkeypatch.setattr("assist.studies.runner.outcomes", here)


@pytest.mark.slow
@pytest.mark.usefixtures("one_picture")
def test_a_killed_study_resumes_to_the_same_bytes(small_study: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, whole, _ = small_study
    out = tmp_path / "out"
    arguments = ["study", "--protocol", str(study.file), "--out", str(out), "--jobs", "2"]
    process = subprocess.Popen([str(Path(sys.executable).with_name("kitassist")), *arguments], start_new_session=True)
    episodes = out / "episodes.jsonl"
    while process.poll() is None and not (episodes.exists() and episodes.stat().st_size):
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = episodes.read_text().count("\n")
    assert 0 < before < (whole / "episodes.jsonl").read_text().count("\n")
    with episodes.open("a") as stream:  # as a line that was being written
        stream.write(episodes.read_text().splitlines()[0][:70])
    assert invoke(*arguments).exit_code == 2
    result = invoke(*arguments, "--resume")
    assert result.exit_code == 0, result.stderr
    assert contents(out) == contents(whole)
    drawn = {file.name: file.read_bytes() for file in (out / "figures").iterdir()}
    assert len(drawn) == 4  # a picture, for light and for dark pages
    assert drawn == {name: (whole / "figures" / name).read_bytes() for name in drawn}


@pytest.mark.usefixtures("one_picture", "in_this_process")
@pytest.mark.slow
def test_repeats_can_be_added_and_another_study_is_refused(
    small_study: tuple[Study, Path, dict], tmp_path: Path
) -> None:
    study, whole, _ = small_study
    out, seen = tmp_path / "out", []
    assert run_study(read(study.file, repeats=1), out, progress=lambda *told: seen.append(told)) == []
    assert seen[-1] == ("episodes", len(load_study(out)), len(load_study(out)))
    first = write_report(read(study.file, repeats=1), out).summary  # a single pool has no intervals
    assert first["headline"]["actions_vs_none"]["low"] is None
    assert "## Sensitivity" in (out / "report.md").read_text()
    assert run_study(study, out, jobs=2, resume=True) == []
    assert (out / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    with pytest.raises(InputFileError, match="exists; resume it, or choose another folder"):
        run_study(study, out)
    with pytest.raises(InputFileError, match="expected --repeats 3 or more"):
        run_study(read(study.file, repeats=1), out, resume=True)
    with pytest.raises(InputFileError, match="the results belong to another study"):
        run_study(read(write(tmp_path, TINY.replace("seed = 5", "seed = 4"))), out, resume=True)
    assert (out / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    assert set(profile(out)) >= {"people's POMDPs", "simulating none", "simulating attention"}


def spoil(file: Path, number: int, line: bytes) -> None:
    lines = file.read_bytes().split(b"\n")
    lines[number - 1] = line
    file.write_bytes(b"\n".join(lines))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        (b'{"condition": "fir', "is no JSON; expected a record, all of it on this line"),
        pytest.param(b"\x93NUM", "is not text (UTF-8); expected a record as JSON", marks=pytest.mark.slow),
        pytest.param(b"[1, 2]", "expected a record: a JSON object", marks=pytest.mark.slow),
        pytest.param(b"{}", "lacks fields, or has others than expected", marks=pytest.mark.slow),
        (b'{"condition": ["first"]}', "lacks fields, or has others than expected"),
    ],
)
@pytest.mark.usefixtures("in_this_process")
def test_cells_with_damaged_lines_are_run_again(
    small_study: tuple[Study, Path, dict], results: Path, line: bytes, what: str
) -> None:
    study, whole, _ = small_study
    spoil(results / "episodes.jsonl", 7, line)
    spoil(results / "profile.jsonl", 2, line)
    said, seen = [], []
    told = lambda *told: seen.append(told)  # noqa: E731
    assert run_study(study, results, resume=True, warn=said.append, progress=told) == []
    assert said == [
        f"{results / 'episodes.jsonl'}:7: {what}; the cells of such lines are run again",
        f"{results / 'profile.jsonl'}:2: {what}; the times of these cells are lost",
    ]
    assert (results / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    total = sum(map(study.episodes, study.cells()))
    kept = total - study.episodes(next(study.cells()))  # of all others
    assert seen == [("episodes", done, total) for done in (kept, total)]


@pytest.mark.usefixtures("in_this_process")
def test_lines_that_are_missing_twice_there_or_moved_are_noticed(
    small_study: tuple[Study, Path, dict], results: Path
) -> None:
    study, whole, _ = small_study
    file = results / "episodes.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    for changed in ([*lines[:3], *lines[4:]], [*lines[:4], lines[3], *lines[5:]], lines[::-1]):
        file.write_bytes(b"".join(changed))
        assert run_study(study, results, resume=True, warn=pytest.fail) == []
        assert file.read_bytes() == (whole / "episodes.jsonl").read_bytes()


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b'{\n"schema": 1,\n"finger', "study.json:3: is not valid JSON"),
        (b"\x89PNG\xff", "study.json: is not text (UTF-8)"),
        (b"[]", "study.json: has no field 'schema'"),
        (None, "study.json: is missing"),
    ],
)
def test_results_of_nobody_knows_what_are_neither_continued_nor_replaced(
    small_study: tuple[Study, Path, dict], results: Path, content: bytes | None, what: str
) -> None:
    study, whole, _ = small_study
    if content is None:
        (results / "study.json").unlink()
    else:
        (results / "study.json").write_bytes(content)
    result = invoke("study", "--protocol", study.file, "--out", results, "--resume")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"{results}/{what}")
    assert result.stderr.count("\n") == 1
    assert (results / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    if content is not None:
        with pytest.raises(InputFileError, match="choose another folder"):
            load_study(results)


@pytest.mark.usefixtures("in_this_process")
def test_a_policy_that_fails_is_named_and_stops_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def faulty(team):\n    raise RuntimeError('out of ideas')\n")
    file = write(tmp_path, TINY.replace('policies = ["attention"]', 'policies = ["mine.py:faulty"]'))
    result = invoke("study", "--protocol", file, "--out", tmp_path / "out", "--repeats", 1, "--json")
    assert (result.exit_code, result.stdout) == (1, "")
    lines = result.stderr.splitlines()
    assert (
        lines[0] == f"dear, c_suggest 0.6, everybody, tiny, repeat 0: {tmp_path}/mine.py:2: RuntimeError: out of ideas"
    )
    assert lines[-1] == "2 of 5 cells failed; --resume tries them again"
    assert set(load_study(tmp_path / "out")["condition"]) == {"first", "novices"}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ((), 2, "--out"),
        (("--out", "x", "--protocol", "papers"), 2, "no protocol 'papers'; did you mean 'paper'?"),
        (("--out", "x", "--protocol", "none.toml"), 2, "none.toml: no such file"),
        (("--out", "x", "--repeats", 0), 2, "--repeats"),
    ],
)
def test_the_command_refuses_what_makes_no_sense(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], code: int, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke("study", *arguments)
    assert (result.exit_code, result.stdout) == (code, "")
    assert words in result.stderr
    assert not list(tmp_path.iterdir())


def test_episodes_load_at_once(small_study: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, out, _ = small_study
    frame = load_study(out)
    assert len(frame) == sum(map(study.episodes, study.cells()))
    row = frame.iloc[7]
    assert row["human_actions_per_person"] == sum(row["actions"]) / row["humans"]
    assert len(row["people"]) == len(row["beta"]) == row["humans"]
    assert row["interventions"] == sum(row["helped"])
    # People and random numbers are common: without assistance, costs and conditions make no difference.
    first = frame[frame["condition"] == "first"].set_index(["repeat", "humans", "draw", "trial", "policy"])
    assert first.loc[0, 2, 0, 0, "none"]["people"] == first.loc[0, 2, 0, 1, "attention"]["people"]
    with pytest.raises(InputFileError, match="no results of a study"):
        load_study(tmp_path)
    shutil.copytree(out, tmp_path / "later")
    about = tmp_path / "later" / "study.json"
    about.write_text(about.read_text().replace('"schema": 1', '"schema": 2'))
    with pytest.raises(InputFileError, match="results of schema 2; expected 1"):
        load_study(tmp_path / "later")
