"""Studies: as data, carried out, interrupted and resumed, in numbers, and as a report."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from conftest import DOMAINS, KITTING, ROOT, kitassist
from matplotlib.text import Text
from scipy import stats

from assist.people.choices import Choices
from assist.people.decision import perceived_cost
from assist.people.human import Human, HumanModel, Population
from assist.person.pomdp import AssistPOMDP
from assist.simulation.simulate import simulate
from assist.study import protocol, statistics
from assist.study.cells import carry_out, check, pool_of
from assist.study.protocol import read
from assist.study.report import Report, write_report
from assist.study.runner import load_study, profile, run_study
from assist.study.study import Study, StudyError
from assist.study.summary import Found
from assist.study.wording import interval
from assist.team.pool import Pool
from assist.team.settings import Setting
from assist.team.state import PolicyError
from planner import Instance
from planner.errors import DamagedFileError

TINY = f"""
title = "small"
seed = 3
repeats = 3
instances = ["{KITTING}/tiny.pddl"]
humans = [1, 2]
pool = 4
draws = 2
trials = 2

[setting]
c_suggest = 0.2

[populations.everybody]

[populations.novices]
beta = [0.1, 0.5]

[[conditions]]
name = "first"

[[conditions]]
name = "dear"
policies = ["attention"]
settings = [{{ c_suggest = 0.6 }}, {{ c_suggest = 0.2, c_move = 2.0 }}]
repeats = 2

[[conditions]]
name = "novices"
populations = ["novices"]
priors = ["own", "everybody"]
"""
RESULTS = ("episodes.jsonl", "summary.json", "report.md", "report.html", "study.json")


def write(folder: Path, text: str = TINY) -> Path:
    file = folder / "small.toml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path, dict]:
    """A study that was carried out by the command with one worker: the study, its folder, and what was printed."""
    folder = tmp_path_factory.mktemp("study")
    file = write(folder)
    result = kitassist("study", "--protocol", file, "--out", folder / "out", "--json")
    assert (result.returncode, result.stderr) == (0, "")
    return read(file), folder / "out", json.loads(result.stdout)


def in_process(*arguments: object) -> Result:
    from assist.cli import main

    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in RESULTS}


# Statistics


def test_a_mean_has_students_interval() -> None:
    x = np.array([1.0, 2.0, 4.0, 9.0])
    estimate = statistics.mean(x)
    assert (estimate.low, estimate.high) == pytest.approx(stats.t.interval(0.95, 3, x.mean(), stats.sem(x)))
    assert statistics.mean([5.0]).record() == {"mean": 5.0, "low": None, "high": None}


def test_the_bootstrap_of_a_saving_is_scipys_and_is_paired() -> None:
    rng = np.random.default_rng(0)
    without = rng.gamma(2.0, 5.0, 30)
    with_it = without * 0.7 + rng.normal(0, 0.2, 30)
    estimate = statistics.saving(with_it, without, np.random.default_rng(1))
    assert estimate.value == pytest.approx(100 * (1 - with_it.mean() / without.mean()))
    theirs = stats.bootstrap(
        (with_it, without), lambda a, b, axis=-1: 100 * (1 - a.mean(axis) / b.mean(axis)), paired=True,
        vectorized=True, method="BCa", n_resamples=20_000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    width = theirs.high - theirs.low
    assert estimate.low == pytest.approx(theirs.low, abs=0.08 * width)
    assert estimate.high == pytest.approx(theirs.high, abs=0.08 * width)
    shuffled = statistics.saving(rng.permutation(with_it), without, np.random.default_rng(1))
    assert shuffled.high - shuffled.low > 5 * width


def test_intervals_of_savings_cover_as_often_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "RESAMPLES", 1500)
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(150):
        without = rng.gamma(1.5, 4.0, 40)
        with_it = 0.6 * without + rng.gamma(1.0, 1.0, 40)
        estimate = statistics.saving(with_it, without, rng)
        covered += estimate.low <= 100 * (1 - (0.6 * 6 + 1) / 6) <= estimate.high
    assert 0.88 <= covered / 150 <= 0.99


@pytest.mark.parametrize("pools", [2, 3, 5, 9])
def test_intervals_of_few_pools_are_as_wide_as_so_little_deserves(pools: int) -> None:
    rng = np.random.default_rng(pools)
    covered = 0
    for _ in range(400):
        without = rng.gamma(1.5, 4.0, pools)
        estimate = statistics.saving(0.6 * without + rng.gamma(1.0, 1.0, pools), without, rng)
        covered += estimate.low <= 100 * (1 - (0.6 * 6 + 1) / 6) <= estimate.high
    assert 0.84 <= covered / 400 <= 0.99  # resampling gives 0.52, 0.71, 0.82 and 0.89


def test_changes_ratios_and_effects() -> None:
    rng = np.random.default_rng(0)
    a, b, c, d = rng.uniform(1, 2, (4, 20))
    change = statistics.change((a, b), (c, d), np.random.default_rng(0))
    assert change.value == pytest.approx(100 * (c.mean() / d.mean() - a.mean() / b.mean()))
    assert statistics.ratio(a, b, rng).value == pytest.approx(a.mean() / b.mean())
    assert statistics.effect(a - b) == pytest.approx((a - b).mean() / (a - b).std(ddof=1))
    alike = statistics.saving(np.full(5, 3.0), np.full(5, 4.0), rng)
    assert (alike.low, alike.value, alike.high) == (25, 25, 25)
    assert statistics.saving([0.0, 0.0], [0.0, 0.0], rng).record() == {"mean": None, "low": None, "high": None}


# What the study needs of simulation


def test_teams_may_differ_from_episode_to_episode(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 4, seed=0)
    teams = np.array([[0, 1], [2, 3], [0, 1]])
    episodes = simulate(pool, pool.policy("attention"), humans=teams, episodes=3, seed=1)
    assert episodes.people.tolist() == teams.tolist()
    alone = simulate(pool, pool.policy("attention"), humans=[2, 3], episodes=[1], seed=1)
    assert episodes[1] == alone[0]
    with pytest.raises(ValueError, match="one row for each of 3 episodes"):
        simulate(pool, pool.policy("none"), humans=teams[:2], episodes=3, seed=1)
    with pytest.raises(ValueError, match="from 0 to 3"):
        simulate(pool, pool.policy("none"), humans=teams + 1, episodes=3, seed=1)


def test_people_may_be_mistaken_about_actions(tiny_choices: Choices) -> None:
    (person,) = Population(sigma=(0.5, 0.5), noise="action").sample(tiny_choices, 1, np.random.default_rng(0))
    q = perceived_cost(tiny_choices, person.h)
    exact = perceived_cost(tiny_choices, tiny_choices.h)
    noise = q[tiny_choices.applicable] - exact[tiny_choices.applicable]
    to_goal = tiny_choices.goal[tiny_choices.targets][tiny_choices.applicable]
    assert (noise[to_goal] == 0).all()
    assert 0.3 < noise[~to_goal].std() < 0.7
    # Two ways into one state look different.
    assert len(np.unique(noise[~to_goal].round(9))) == (~to_goal).sum()
    pool = Pool.sample(tiny_choices, 2, seed=0, population=Population(noise="action"))
    assert simulate(pool, pool.policy("attention"), humans=2, episodes=3, seed=0).finished.all()
    with pytest.raises(ValueError, match="expected 'state' or 'action'"):
        Population(noise="both")  # type: ignore[arg-type]


def test_the_robot_may_take_people_for_others(tiny_choices: Choices) -> None:
    novices = Population(beta=(0.1, 0.5))
    matched = Pool.sample(tiny_choices, 2, seed=0, population=novices)
    general = Pool.sample(tiny_choices, 2, seed=0, population=novices, prior=Population())
    assert [p.beta for p in matched.people] == [p.beta for p in general.people]
    assert matched.policies[0].pomdp.grid.beta.max() < 0.5
    assert general.policies[0].pomdp.grid.beta.max() > 2.5


def test_people_who_are_never_helped_have_the_same_values_from_equations_as_from_sweeps(
    tiny_choices: Choices, monkeypatch: pytest.MonkeyPatch
) -> None:
    h = np.where(tiny_choices.goal, 0.0, tiny_choices.h + np.random.default_rng(0).normal(0, 1, len(tiny_choices)))
    pomdp = AssistPOMDP.of(HumanModel.own(tiny_choices, Human(1.0, 0.7, 1.0, h)))
    never = np.zeros(len(tiny_choices), dtype=np.int64)
    mdp = importlib.import_module("assist.person.qmdp")  # and not the function of that name
    solved = mdp.evaluate(pomdp, never, tolerance=1e-9)
    monkeypatch.setattr(mdp, "DIRECT", 0)
    swept = mdp.evaluate(pomdp, never, tolerance=1e-9)
    np.testing.assert_allclose(solved, swept, atol=1e-8)


# Studies as data


def test_the_papers_protocol_is_the_papers() -> None:
    study = read("paper")
    first = study.conditions[0]
    assert dict(study.populations)["everybody"] == Population()
    assert first.settings == (("", Setting()),)  # the defaults are those of the package
    assert (study.pool, study.draws, study.trials, first.humans) == (12, 6, 5, (1, 2, 3, 4, 5, 6))
    assert {"none", "reactive", "attention"} <= set(first.policies)
    assert study.repeats * study.draws * study.trials * len(first.humans) == 9000
    assert [name for name, _ in study.instances] == ["paper", "paper-fixed"]
    assert dict(study.reference.headline)["actions_vs_none"] == 24.48


def test_the_papers_tasks_are_found_in_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = tmp_path / "assist" / "study" / "protocols"
    shutil.copytree(protocol.PROTOCOLS, installed)
    monkeypatch.setattr(protocol, "PROTOCOLS", installed)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StudyError, match="the project's folder `domains` is needed: run this in a checkout"):
        read("paper")
    (tmp_path / "domains").symlink_to(DOMAINS)
    monkeypatch.chdir(tmp_path / "assist")
    assert len(read("paper").instances) == 2


def test_a_study_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = write(tmp_path)
    plain = read(file)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read(file) == plain
    file.write_bytes(b'title = "\xe4"\n')
    with pytest.raises(StudyError, match=r"small.toml: byte 9 is not UTF-8; expected a text file"):
        read(file)


def test_cells_draw_the_same_people_whatever_the_setting(tmp_path: Path) -> None:
    study = read(write(tmp_path))
    cells = list(study.cells())
    assert len(cells) == len(set(cells)) == 3 * (1 + 2) + 2 * 2
    pools = {cell: pool_of(study, cell) for cell in cells if cell.repeat < 2 and cell.population == "everybody"}
    betas = {(cell.repeat, tuple(p.beta for p in pool.people)) for cell, pool in pools.items()}
    assert len(betas) == 2  # one pool in each repeat
    teams = study.teams(0, 3)
    assert teams.shape == (4, 3)
    assert (teams[0] == teams[1]).all()
    assert (teams[2] == teams[3]).all()
    assert (study.teams(0, 2) == teams[:, :2]).all()
    assert all(len(set(team)) == 3 for team in teams.tolist())
    assert not (study.teams(1, 3) == teams).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 3", "seed = ", "line 3"),
        ("seed = 3", "seed = -1", "seed: -1; expected a whole number of 0 or more"),
        ("seed = 3", "sed = 3", "sed: unknown; expected one of conditions, contrasts"),
        ("pool = 4", "pool = true", "pool: true; expected a whole number"),
        (
            "[populations.everybody]",
            "[reference]\nsource = 'me'\nheadline = { actions_vs_non = 3 }\n[populations.everybody]",
            "reference.headline.actions_vs_non: unknown; expected one of actions_vs_attention",
        ),
        ("pool = 4", "pool = 1", "conditions[1].humans: 2 people in a team, and 1 in a pool"),
        ("humans = [1, 2]", "humans = 2", "humans: 2; expected a list of whole numbers"),
        ("tiny.pddl", "tinny.pddl", "tinny.pddl: no such file"),
        ("c_suggest = 0.2\n", 'c_suggest = "low"\n', 'setting.c_suggest: "low"; expected a number'),
        ("c_suggest = 0.2\n", "c_sugest = 0.2\n", "setting.c_sugest: unknown; expected one of c_execute"),
        ("c_suggest = 0.2\n", 'knowledge = "all"\n', 'setting.knowledge: "all"; expected "own" or "exact"'),
        ("c_move = 2.0", "c_move = -2.0", "conditions[2].settings[2]: c_move -2: expected 0 or more"),
        ("beta = [0.1, 0.5]", "beta = [0.5, 0.1]", "populations.novices: beta range (0.5, 0.1)"),
        ("beta = [0.1, 0.5]", "beta = 0.5", "populations.novices.beta: 0.5; expected two numbers"),
        ("beta = [0.1, 0.5]", 'file = "people.json"', "populations.novices.file: "),
        ("beta = [0.1, 0.5]", 'beta = [0.1, "x"]', 'populations.novices.beta: [0.1, "x"]; expected two numbers'),
        ("beta = [0.1, 0.5]", "betta = [0.1, 0.5]", "populations.novices.betta: unknown; expected one of beta, file"),
        ("beta = [0.1, 0.5]", 'noise = "both"', "populations.novices: noise 'both': expected 'state' or 'action'"),
        ("humans = [1, 2]", "humans = []", "humans: []; expected a list of whole numbers of 1 or more"),
        ("humans = [1, 2]", "humans = [1, 0.5]", "humans: [1, 0.5]; expected a list of whole numbers of 1 or more"),
        ("[setting]", "setting = 3\n[other]", "setting: 3; expected a table"),
        (
            "settings = [{ c_suggest = 0.6 }, { c_suggest = 0.2, c_move = 2.0 }]",
            "settings = [3]",
            "settings: [3]; expected",
        ),
        ('name = "novices"', "name = 3", "conditions[3].name: 3; expected a text"),
        ('name = "novices"', 'name = "novices"\nrepeat = 2', "conditions[3].repeat: unknown; expected one of humans"),
        ('policies = ["attention"]', 'policies = ["atention"]', "'atention'; expected one of none, reactive"),
        ('policies = ["attention"]', 'policies = ["mine.py:mine"]', "mine.py: no such file"),
        ('populations = ["novices"]', 'populations = ["experts"]', "'experts'; expected one of everybody, novices"),
        ('priors = ["own", "everybody"]', 'priors = ["none"]', "'none'; expected one of own, everybody"),
        ('name = "dear"', 'name = "first"', "there are two conditions 'first'"),
        ('name = "dear"', "", "conditions[2].name: is missing; expected a text"),
    ],
)
def test_a_malformed_study_is_refused_with_the_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in TINY
    file = write(tmp_path, TINY.replace(old, new, 1))
    with pytest.raises(StudyError) as caught:
        read(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert words in str(caught.value)


def test_what_can_be_read_but_not_done_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"setting: gamma 1.5: expected 0 < gamma < 1"):
        check(read(write(tmp_path, TINY.replace("c_suggest = 0.2\n", "gamma = 1.5\n"))))
    with pytest.raises(StudyError, match="the goal cannot be reached"):
        check(read(write(tmp_path, TINY.replace("tiny.pddl", "unsolvable.pddl"))))
    with pytest.raises(StudyError, match=r"episodes; at most 100,000,000 are carried out"):
        check(read(write(tmp_path), repeats=10**20))
    (tmp_path / "mine.py").write_text("other = 1\n")
    with pytest.raises(StudyError, match=r"mine.py: has no function 'mine'"):
        check(read(write(tmp_path, TINY.replace('["attention"]', '["mine.py:mine"]'))))
    (tmp_path / "mine.py").write_text("import nothing_of_this_name\n")
    with pytest.raises(StudyError, match=r"mine.py:1: ModuleNotFoundError: No module named 'nothing"):
        check(read(write(tmp_path, TINY.replace('["attention"]', '["mine.py:broken"]'))))


def test_the_fingerprint_is_that_of_the_results(tmp_path: Path) -> None:
    for name in ("tiny.pddl", "domain.pddl"):
        shutil.copy(KITTING / name, tmp_path)
    text = TINY.replace(f"{KITTING}/", "")
    first = read(write(tmp_path, text)).fingerprint()
    assert read(write(tmp_path, text), repeats=9).fingerprint() == first
    assert read(write(tmp_path, text.replace("small", "other"))).fingerprint() == first
    assert read(write(tmp_path, text.replace("seed = 3", "seed = 4"))).fingerprint() != first
    with (tmp_path / "tiny.pddl").open("a") as stream:
        stream.write("; a comment\n")
    assert read(write(tmp_path, text)).fingerprint() != first


# Carrying it out


def test_a_killed_study_resumes_to_the_same_bytes(done: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, whole, _ = done
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
    assert in_process(*arguments).exit_code == 2
    result = in_process(*arguments, "--resume")
    assert result.exit_code == 0, result.stderr
    assert contents(out) == contents(whole)
    assert {f.name: f.read_bytes() for f in (out / "figures").iterdir()} == {
        f.name: f.read_bytes() for f in (whole / "figures").iterdir()
    }


def test_a_cluster_gives_the_same_bytes(done: tuple[Study, Path, dict], tmp_path: Path) -> None:
    from distributed import LocalCluster

    study, whole, _ = done
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        result = kitassist(
            "study", "--protocol", study.file, "--out", tmp_path / "out", "--scheduler", cluster.scheduler_address
        )
    assert result.returncode == 0, result.stderr
    assert contents(tmp_path / "out") == contents(whole)


def test_repeats_can_be_added_and_another_study_is_refused(done: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, whole, _ = done
    out, seen = tmp_path / "out", []
    assert run_study(read(study.file, repeats=1), out, progress=seen.append) == []
    assert sum(seen) == len(load_study(out))
    first = write_report(read(study.file, repeats=1), out)  # a single pool has no intervals
    assert first["headline"]["actions_vs_none"]["low"] is None
    assert "## Sensitivity" in (out / "report.md").read_text()
    assert run_study(study, out, jobs=2, resume=True) == []
    assert (out / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    with pytest.raises(StudyError, match="exists; resume it, or choose another folder"):
        run_study(study, out)
    with pytest.raises(StudyError, match="expected --repeats 3 or more"):
        run_study(read(study.file, repeats=2), out, resume=True)
    with pytest.raises(StudyError, match="these are results of another study"):
        run_study(read(write(tmp_path, TINY.replace("seed = 3", "seed = 4"))), out, resume=True)
    assert (out / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    assert set(profile(out)) >= {"people's POMDPs", "simulating none", "simulating attention"}


def spoil(file: Path, number: int, line: bytes) -> None:
    lines = file.read_bytes().split(b"\n")
    lines[number - 1] = line
    file.write_bytes(b"\n".join(lines))


@pytest.fixture
def results(done: tuple[Study, Path, dict], tmp_path: Path) -> Path:
    return Path(shutil.copytree(done[1], tmp_path / "out", ignore=shutil.ignore_patterns("figures")))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        (b'{"condition": "fir', "is no JSON; expected a record, all of it on this line"),
        (b"\x93NUMPY\x01\x00", "is not text (UTF-8); expected a record as JSON"),
        (b"[1, 2]", "expected a record: a JSON object"),
        (b"{}", "lacks fields, or has others than expected"),
        (b'{"condition": ["first"]}', "lacks fields, or has others than expected"),
    ],
)
def test_cells_with_damaged_lines_are_run_again(
    done: tuple[Study, Path, dict], results: Path, line: bytes, what: str
) -> None:
    study, whole, _ = done
    spoil(results / "episodes.jsonl", 7, line)
    spoil(results / "profile.jsonl", 2, line)
    said, counts = [], []
    assert run_study(study, results, resume=True, warn=said.append, progress=counts.append) == []
    assert said == [
        f"{results / 'episodes.jsonl'}:7: {what}; the cells of such lines are run again",
        f"{results / 'profile.jsonl'}:2: {what}; how long these cells took is forgotten",
    ]
    assert (results / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    total = sum(map(study.episodes, study.cells()))
    assert counts[0] == total - study.episodes(next(study.cells()))  # all others are kept


def test_lines_that_are_missing_twice_there_or_moved_are_noticed(done: tuple[Study, Path, dict], results: Path) -> None:
    study, whole, _ = done
    file = results / "episodes.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    for changed in ([*lines[:3], *lines[4:]], [*lines[:4], lines[3], *lines[5:]], lines[::-1]):
        file.write_bytes(b"".join(changed))
        assert run_study(study, results, resume=True, warn=pytest.fail) == []
        assert file.read_bytes() == (whole / "episodes.jsonl").read_bytes()


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b'{\n"schema": 1,\n"finger', "study.json:3: is no JSON"),
        (b"\x89PNG\xff", "study.json: is not text (UTF-8)"),
        (b"[]", "study.json: has no field 'schema'"),
        (None, "study.json: is missing"),
    ],
)
def test_results_of_nobody_knows_what_are_neither_continued_nor_replaced(
    done: tuple[Study, Path, dict], results: Path, content: bytes | None, what: str
) -> None:
    study, whole, _ = done
    if content is None:
        (results / "study.json").unlink()
    else:
        (results / "study.json").write_bytes(content)
    result = in_process("study", "--protocol", study.file, "--out", results, "--resume")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"{results}/{what}")
    assert result.stderr.count("\n") == 1
    assert (results / "episodes.jsonl").read_bytes() == (whole / "episodes.jsonl").read_bytes()
    if content is not None:
        with pytest.raises(DamagedFileError, match="choose another folder"):
            load_study(results)


@pytest.mark.parametrize(
    ("body", "line", "what"),
    [
        ("    raise RuntimeError('out of\\nideas')", 2, "RuntimeError: out of ideas"),
        ("    team = {}\n    return team['oops']", 3, "KeyError: 'oops'"),
        ("    return None", 1, "expected a TeamAction"),
    ],
)
def test_a_policy_that_fails_is_named_with_its_line_and_words(tmp_path: Path, body: str, line: int, what: str) -> None:
    (tmp_path / "mine.py").write_text(f"def faulty(team):\n{body}\n")
    study = read(write(tmp_path, TINY.replace('policies = ["attention"]', 'policies = ["mine.py:faulty"]')))
    cell = next(cell for cell in study.cells() if cell.condition == "dear")
    with pytest.raises(PolicyError) as caught:
        carry_out(cell, study)
    assert str(caught.value).startswith(f"{tmp_path / 'mine.py'}:{line}: ")
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_policy_that_fails_is_named_and_stops_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def faulty(team):\n    raise RuntimeError('out of ideas')\n")
    file = write(tmp_path, TINY.replace('policies = ["attention"]', 'policies = ["mine.py:faulty"]'))
    result = in_process("study", "--protocol", file, "--out", tmp_path / "out", "--repeats", 1, "--json")
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
        (("--out", "x", "--protocol", "papers"), 2, "no protocol 'papers'; expected paper or a file"),
        (("--out", "x", "--protocol", "none.toml"), 2, "none.toml: no such file"),
        (("--out", "x", "--repeats", 0), 2, "--repeats"),
    ],
)
def test_the_command_refuses_what_makes_no_sense(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], code: int, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = in_process("study", *arguments)
    assert (result.exit_code, result.stdout) == (code, "")
    assert words in result.stderr
    assert not list(tmp_path.iterdir())


# What was found


def test_episodes_load_at_once(done: tuple[Study, Path, dict], tmp_path: Path) -> None:
    study, out, _ = done
    frame = load_study(out)
    assert len(frame) == sum(map(study.episodes, study.cells()))
    row = frame.iloc[7]
    assert row["human_actions_per_person"] == sum(row["actions"]) / row["humans"]
    assert len(row["people"]) == len(row["beta"]) == row["humans"]
    assert row["interventions"] == sum(row["helped"])
    # People and luck are common: without help costs and conditions make no difference.
    first = frame[frame["condition"] == "first"].set_index(["repeat", "humans", "draw", "trial", "policy"])
    assert first.loc[0, 2, 0, 0, "none"]["people"] == first.loc[0, 2, 0, 1, "attention"]["people"]
    with pytest.raises(StudyError, match="no results of a study"):
        load_study(tmp_path)
    shutil.copytree(out, tmp_path / "later")
    about = tmp_path / "later" / "study.json"
    about.write_text(about.read_text().replace('"schema": 1', '"schema": 2'))
    with pytest.raises(StudyError, match="results of schema 2; expected 1"):
        load_study(tmp_path / "later")


def test_the_summary_is_computed_over_pools(done: tuple[Study, Path, dict]) -> None:
    study, out, printed = done
    assert printed == json.loads((out / "summary.json").read_text())
    frame = load_study(out)
    own = frame[(frame["condition"] == "first")]
    (cell,) = [
        c for c in printed["cells"]
        if (c["condition"], c["humans"], c["policy"]) == ("first", 2, "reactive")
    ]  # fmt: skip
    part = own[(own["humans"] == 2) & (own["policy"] == "reactive")]
    for column in ("human_actions_per_person", "interventions", "moves"):
        assert cell[column]["mean"] == pytest.approx(part[column].mean())
        assert cell[column]["sd"] == pytest.approx(part[column].std())
        assert cell[column]["n"] == len(part) == 12
        means = part.groupby("repeat")[column].mean()
        low, high = stats.t.interval(0.95, 2, means.mean(), stats.sem(means)) if means.std() else (means[0],) * 2
        assert (cell[column]["low"], cell[column]["high"]) == pytest.approx((low, high))
    assert (cell["pools"], cell["episodes"], cell["cut_off"]) == (3, 12, 0)
    headline = printed["headline"]
    mean = own.groupby("policy", observed=True)[["human_actions_per_person", "interventions"]].mean()
    for key, column, other in (
        ("actions_vs_none", "human_actions_per_person", "none"),
        ("actions_vs_reactive", "human_actions_per_person", "reactive"),
        ("interventions_vs_reactive", "interventions", "reactive"),
    ):
        saved = 100 * (1 - mean.loc["attention", column] / mean.loc[other, column])
        assert headline[key]["mean"] == pytest.approx(saved)
        assert headline[key] == headline["instances"]["tiny"][key]
        assert headline[key]["low"] <= saved <= headline[key]["high"]
    found = Found(study, frame)
    assert found.summary() == printed


def test_a_condition_without_baselines_borrows_them(done: tuple[Study, Path, dict]) -> None:
    _, out, printed = done
    frame = load_study(out)
    (row,) = [
        r for r in printed["comparisons"]
        if (r["condition"], r["setting"], r["against"], r["measure"]) == ("dear", "c_suggest 0.6", "none", "actions")
    ]  # fmt: skip
    mine = frame[(frame["condition"] == "dear") & (frame["setting"] == "c_suggest 0.6")]
    none = frame[(frame["condition"] == "first") & (frame["policy"] == "none") & (frame["repeat"] < 2)]
    columns = [f["human_actions_per_person"].mean() for f in (mine, none)]
    assert row["mean"] == pytest.approx(100 * (1 - columns[0] / columns[1]))
    assert row["pools"] == 2


def test_the_report_says_what_was_found_and_shows_its_pictures(done: tuple[Study, Path, dict]) -> None:
    _, out, printed = done
    text, page = (out / "report.md").read_text(), (out / "report.html").read_text()
    saved = printed["headline"]["actions_vs_none"]
    for words in ("# small", "## What was run", "## Headline", "## Team sizes", "## Sensitivity", "cut off"):
        assert words in text
    assert f"| actions against none | tiny | {saved['mean']:.1f} ({saved['low']:.1f} to {saved['high']:.1f}) |" in text
    shown = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert {Path(name).stem for name in shown} >= {"team-size", "benefit", "trade-off", "belief"}
    files = {*shown, *re.findall(r'(?:src|srcset)="([^"]+)"', page)}
    assert len(files) == 3 * len(shown)
    assert all((out / name).is_file() for name in files)
    assert "<table>" in page
    assert page.count("<picture>") == len(shown)


SEVERAL = TINY.replace('name = "first"', 'name = "first"\npopulations = ["everybody", "novices"]')
PUBLISHED = """
[[contrasts]]
name = "novices to everybody"
of = ["novices"]
to = ["everybody"]

[reference]
name = "an earlier study"
source = "Nobody, 1999"
headline = { actions_vs_none = -400.0, interventions_vs_reactive = 34.0 }
interventions = [{ populations = ["novices"], mean = 2.5 }]
declines = true
contrasts = ["novices to everybody"]
"""


def report_of(folder: Path, text: str, repeats: int) -> Report:
    study = read(write(folder, text), repeats=repeats)
    assert run_study(study, folder / "out") == []
    return Report.of(study, folder / "out")


def words_in(report: Report, name: str) -> list[str]:
    """All that is written in a picture."""
    (picture,) = [each for each in report.pictures if each.name == name]
    return [text.get_text() for text in picture.figure().findobj(Text) if text.get_text()]


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """A study of two populations and two pools, without a reference."""
    return report_of(tmp_path_factory.mktemp("several"), SEVERAL, 2)


def rows_below(text: str, title: str) -> list[list[str]]:
    """The first table below a title, without its head."""
    below = text.split(f"## {title}\n", 1)[1]
    lines = [line for line in below.split("\n## ")[0].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_every_population_of_the_first_condition_has_a_headline(several: Report) -> None:
    summary, text = several.summary, several.text
    headline = summary["headline"]
    assert (headline["condition"], headline["population"]) == ("first", "everybody")
    assert [other["population"] for other in headline["others"]] == ["novices"]
    for group in (headline, *headline["others"]):
        cells = {c["policy"]: c for c in summary["cells"] if c["population"] == group["population"]
                 and c["condition"] == "first" and c["humans"] == 1}  # fmt: skip
        assert set(cells) == {"none", "reactive", "attention"}
        assert 0 < group["actions_vs_none"]["mean"] < 100
    assert headline["actions_vs_none"] != headline["others"][0]["actions_vs_none"]
    rows = rows_below(text, "Headline")
    assert {(row[0], row[1]) for row in rows if row[0] == "actions against none"} == {
        ("actions against none", "everybody"), ("actions against none", "novices"),
    }  # fmt: skip
    effects = [row for row in rows if row[:4] == ["novices", "tiny", "actions", "none"]]
    assert len(effects) == 1  # and not two that nothing tells apart
    assert len({tuple(row) for row in rows_below(text, "Team sizes")}) == 2 * 2 * 3
    assert "(population 'everybody')](figures/team-size.png)" in text
    assert {"everybody", "novices"} <= set(words_in(several, "categories"))
    assert "| default | attention | tiny |" in text.split("## Sensitivity")[1]


def test_nothing_that_somebody_else_claims_is_in_a_report(several: Report, tmp_path: Path) -> None:
    theirs = ("paper", "24.48", "12.35", "25.94", "3.86", "31.685", "Algorithm 1")
    compared = report_of(tmp_path, SEVERAL + PUBLISHED, 1)
    for report, allowed in ((several, ()), (compared, ("claim", "published", "earlier study"))):
        written = [report.text, *(each.text for each in report.pictures)]
        written += [words for each in report.pictures for words in words_in(report, each.name)]
        for words in (*theirs, "claim", "published", "earlier study"):
            assert any(words in text for text in written) == (words in allowed), words
    (row,) = [row for row in rows_below(compared.text, "Headline") if row[:2] == ["actions against none", "everybody"]]
    assert row[4:] == ["-400.0", "better, in a single pool"]
    assert "More interventions for *novices* than for *everybody*" in compared.text
    assert "attention in an earlier study, over all team sizes" in words_in(compared, "benefit")
    assert "attention in an earlier study: 2.5" in words_in(compared, "categories")


def test_few_pools_are_said_to_be_few(done: tuple[Study, Path, dict], several: Report) -> None:
    for summary, text in ((several.summary, several.text), (done[2], (done[1] / "report.md").read_text())):
        assert "**Few pools.** All conditions: fewer than 10 pools" in text
        saved = summary["headline"]["actions_vs_none"]
        assert saved["high"] - saved["low"] > 10  # percentage points, of two or three pools


def test_a_single_episode_makes_a_report(tmp_path: Path) -> None:
    least = TINY.replace("draws = 2", "draws = 1").replace("trials = 2", "trials = 1").replace("[1, 2]", "[1]", 1)
    report = report_of(tmp_path, least, 1)
    assert report.summary["cells"][0]["human_actions_per_person"]["sd"] is None
    assert "## Team sizes" in report.text
    assert {each.name for each in report.pictures if each.figure()} >= {"team-size", "belief"}


def test_the_papers_protocol_makes_its_whole_report(tmp_path: Path) -> None:
    """All conditions of the paper, on a task that takes no time; `make study` has them on the paper's tasks."""
    paper = read("paper", repeats=1)
    conditions = tuple(replace(c, instances=("tiny",), humans=(1, 2)) for c in paper.conditions)
    tiny = Instance(KITTING / "tiny.pddl", KITTING / "domain.pddl")
    study = replace(paper, instances=(("tiny", tiny),), conditions=conditions, pool=2, draws=1, trials=1)
    assert run_study(study, tmp_path) == []
    report = Report.of(study, tmp_path)
    for title in (
        "Headline",
        "Which of the claims of the paper hold",
        "Team sizes",
        "Does the benefit decline with the number of people?",
        "Kinds of people",
        "Which reading comes nearest to the interventions of the paper",
        "Sensitivity",
        "One episode",
    ):
        assert f"\n## {title}\n" in report.text
    assert "24.48" in report.text
    assert [each.name for each in report.pictures] == ["team-size", "benefit", "categories", "trade-off", "belief"]
    assert len(report.summary["readings"]) == 3 * (2 * 3 * 2 + 2 + 1)


def test_the_pages_figures_are_those_of_the_record() -> None:
    record = json.loads((ROOT / "bench" / "records" / "study.json").read_text())["headline"]["instances"]
    page = (ROOT / "docs" / "study.md").read_text().split("saves, reduced |")[1]
    for key in ("actions_vs_none", "actions_vs_reactive", "interventions_vs_reactive"):
        cells = [interval(record[instance][key]) for instance in ("paper", "paper-fixed")]
        assert f"| {key.replace('_vs_', ', against ')} | {' | '.join(cells)} |" in page


def test_the_shipped_example_is_of_another_domain() -> None:
    study = read(ROOT / "docs" / "examples" / "lockers.toml")
    assert all(DOMAINS / "lockers" in files.problem.resolve().parents for _, files in study.instances)
    assert study.focus == "furthest_first"
