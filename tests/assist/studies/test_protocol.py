"""Study protocols: reading, errors with their place, and the same people in all settings."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from conftest import DOMAINS, KITTING, ROOT
from studies import TINY, write

from assist.people.ranges import Population
from assist.person.settings import Setting
from assist.studies import check, pool_of, read
from planner.system.errors import InputFileError


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


def test_tasks_are_sought_beside_the_study_and_then_in_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert [one.problem.name for _, one in read("paper").instances] == ["paper.pddl", "paper-fixed.pddl"]
    file = write(tmp_path)
    own = tmp_path / "study" / "kitting" / "tiny"
    own.parent.mkdir(parents=True)
    moved = own.parent.parent / "study.toml"
    moved.write_text(re.sub("^instances = .*", 'instances = ["kitting/tiny"]', file.read_text(), flags=re.M))
    assert read(moved).instances[0][1].problem == DOMAINS / "kitting" / "tiny.pddl"
    own.write_text("")
    assert read(moved).instances[0][1].problem == own
    moved.write_text(moved.read_text().replace("kitting/tiny", "kiting/tiny"))
    with pytest.raises(InputFileError, match="kiting/tiny: no such file or folder; with the package come kitting/tiny"):
        read(moved)


def test_a_study_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    file = write(tmp_path)
    plain = read(file)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read(file) == plain
    file.write_bytes(b'title = "\xe4"\n')
    with pytest.raises(InputFileError, match=r"small.toml:1: byte 9 is not UTF-8; expected a text file"):
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


def test_a_reference_has_the_savings_of_a_headline(tmp_path: Path) -> None:
    published = "[reference]\nname = 'me'\nsource = 'me'\nheadline = { costs_vs_none = 3 }\n[populations.everybody]"
    text = TINY.replace("[populations.everybody]", published)
    reference = read(write(tmp_path, text)).reference
    assert reference is not None
    assert dict(reference.headline) == {"costs_vs_none": 3}
    assert read(write(tmp_path, text), baseline="reactive").reference == reference  # the file is what it was
    with pytest.raises(InputFileError, match=r"headline.costs_vs_none: unknown; did you mean 'costs_vs_reactive'"):
        read(write(tmp_path, text.replace("seed = 5", "seed = 5\nbaseline = 'reactive'")))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 5", "seed = ", "not TOML (column 8: Invalid value)"),
        ("seed = 5", "sed = 3", "sed: unknown; did you mean 'seed'?"),
        (
            "[populations.everybody]",
            "[reference]\nsource = 'me'\nheadline = { actions_vs_non = 3 }\n[populations.everybody]",
            "reference.headline.actions_vs_non: unknown; did you mean 'actions_vs_none'?",
        ),
        (
            "[populations.everybody]",
            "[reference]\nsource = 'me'\nheadline = { actions_vs_attention = 3 }\n[populations.everybody]",
            "reference.headline.actions_vs_attention: unknown; ",
        ),
        ("pool = 4", "pool = 1", "conditions[1].humans: 2 people in a team; expected at most 1, the size of the pool"),
        ("tiny.pddl", "tinny.pddl", "tinny.pddl: no such file"),
        ("c_suggest = 0.2\n", "c_sugest = 0.2\n", "setting.c_sugest: unknown; did you mean 'c_suggest'?"),
        ("c_move = 2.0", "c_move = -2.0", "conditions[2].settings[2].c_move: -2.0; expected a number from 0"),
        ("beta = [0.1, 0.5]", "beta = [0.5, 0.1]", "populations.novices.beta: [0.5, 0.1]; expected two numbers"),
        ("beta = [0.1, 0.5]", 'file = "people.json"', "populations.novices.file: "),
        ("[setting]", "setting = 3\n[other]", "setting: 3; expected a table"),
        ('name = "novices"', 'name = "novices"\nrepeat = 2', "conditions[3].repeat: unknown; did you mean 'repeats'?"),
        ('policies = ["attention"]', 'policies = ["atention"]', "'atention'; did you mean 'attention'?"),
        ('policies = ["attention"]', 'policies = ["mine.py:mine"]', "mine.py: no such file"),
        ('populations = ["novices"]', 'populations = ["experts"]', "'experts'; expected one of everybody, novices"),
        ('priors = ["own", "everybody"]', 'priors = ["none"]', "'none'; expected one of own, everybody"),
        ('name = "dear"', 'name = "first"', "there are two conditions 'first'"),
        ('name = "dear"', "", "conditions[2].name: is missing; expected a text"),
        ("pool = 4", "pool = 4\nconditions = []", "conditions: []; expected one table or more"),
        ("beta = [0.1, 0.5]", 'beta = [0.1, 0.5]\nfile = "people.json"',
         "populations.novices: file also sets beta; expected one of them"),
        ("beta = [0.1, 0.5]", "advice_takers = true\ntheta = [0.1, 0.5]",
         "populations.novices: advice_takers also sets theta; expected one of them"),
        ('policies = ["attention"]', 'policies = ["own.py:none"]',
         "'none' is a policy of the package; expected another"),
        ('policies = ["attention"]', 'policies = ["own.py:attention_never"]',
         "'attention-never' is a policy of the package; expected another"),
        ('policies = ["attention"]', 'policies = ["own.py:mine", "./other/../own.py:mine"]',
         "two policies are called 'mine'; expected different names"),
    ],
)  # fmt: skip
def test_a_malformed_study_is_refused_with_the_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in TINY
    (tmp_path / "own.py").touch()
    (tmp_path / "other").mkdir()
    text = TINY[: TINY.index("[[")] if "conditions = []" in new else TINY
    file = write(tmp_path, text.replace(old, new, 1))
    with pytest.raises(InputFileError) as caught:
        read(file)
    lines = file.read_text().splitlines()
    key = words.partition(":")[0].rpartition(".")[2]
    line = lines.index(new) + 1 if new in lines and new.startswith(key) else r"\d+"
    assert re.match(rf"{re.escape(str(file))}:{line}: ", str(caught.value))
    assert words in str(caught.value)


def test_what_can_be_read_but_not_done_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"setting.gamma: 1.5; expected a number above 0 and below 1"):
        check(read(write(tmp_path, TINY.replace("c_suggest = 0.2\n", "gamma = 1.5\n"))))
    with pytest.raises(InputFileError, match="the goal cannot be reached"):
        check(read(write(tmp_path, TINY.replace("tiny.pddl", "unsolvable.pddl"))))
    with pytest.raises(InputFileError, match=r"episodes; expected at most 100,000,000"):
        check(read(write(tmp_path), repeats=10**20))
    idle = TINY.replace("c_suggest = 0.2\n", 'c_suggest = 0.2\ntrust = "constant"\neta = 0.5\n', 1)
    with pytest.raises(InputFileError, match=r"setting: eta 0.5 has no effect without trust 'paper'; expected 0.2"):
        check(read(write(tmp_path, idle)))
    check(read(write(tmp_path, idle.replace("c_suggest = 0.6", 'c_suggest = 0.6, trust = "paper"'))))  # which it has
    (tmp_path / "mine.py").write_text("other = 1\n")
    with pytest.raises(InputFileError, match=r"mine.py: has no function 'mine'"):
        check(read(write(tmp_path, TINY.replace('["attention"]', '["mine.py:mine"]'))))
    (tmp_path / "mine.py").write_text("import nothing_of_this_name\n")
    with pytest.raises(InputFileError, match=r"mine.py:1: ModuleNotFoundError: No module named 'nothing"):
        check(read(write(tmp_path, TINY.replace('["attention"]', '["mine.py:broken"]'))))


def test_the_fingerprint_is_that_of_the_results(tmp_path: Path) -> None:
    for name in ("tiny.pddl", "domain.pddl"):
        shutil.copy(KITTING / name, tmp_path)
    text = TINY.replace(f"{KITTING}/", "")
    first = read(write(tmp_path, text)).fingerprint()
    assert read(write(tmp_path, text), repeats=9).fingerprint() == first
    assert read(write(tmp_path, text.replace("small", "other"))).fingerprint() == first
    assert read(write(tmp_path, text.replace("seed = 5", "seed = 4"))).fingerprint() != first
    with (tmp_path / "tiny.pddl").open("a") as stream:
        stream.write("; a comment\n")
    assert read(write(tmp_path, text)).fingerprint() != first
    text = text.replace('policies = ["attention"]', 'policies = ["mine.py:mine"]')
    (tmp_path / "mine.py").write_text("from helping import mine\n")
    found = set()
    for content in ("mine = 1\n", "mine = 2\n"):
        (tmp_path / "helping.py").write_text(content)
        found.add(read(write(tmp_path, text)).fingerprint())
    assert len(found) == 2


def test_the_shipped_example_is_of_another_domain() -> None:
    study = read(ROOT / "docs" / "examples" / "lockers.toml")
    assert all(DOMAINS / "lockers" in files.problem.resolve().parents for _, files in study.instances)
    assert study.focus == "furthest_first"


def test_who_sees_whom_is_a_factor_of_the_shipped_study() -> None:
    study = read("neighbours")
    labels = [label for label, _ in study.conditions[0].settings]
    assert labels[1] == "neighbours (rule (rule outcome, eta_seen 0.02), sees next)"
    graphs = {
        (one.neighbours.sees, one.neighbours.rule.eta_seen) for _, one in study.conditions[0].settings if one.neighbours
    }  # type: ignore[attr-defined]
    assert graphs == {(sees, rate) for sees in ("next", "everybody") for rate in (0.02, 0.1)}
    assert study.record()["conditions"][0]["settings"][2][1]["neighbours"]["rule"] == {
        "rule": "outcome", "eta_seen": 0.02, "utility_scale": 1.0
    }  # fmt: skip
    assert study.fingerprint() == read("neighbours").fingerprint() != read("trust").fingerprint()


def test_settings_of_a_condition_are_different_and_have_labels_that_are(tmp_path: Path) -> None:
    condition = '[[conditions]]\nname = "others"\nsettings = [{{ c_suggest = 0.1234567 }}, {{ c_suggest = {} }}]\n'
    file = write(tmp_path, TINY + condition.format(0.1234568))
    labels = [name for name, _ in read(file).condition("others").settings]
    assert labels == ["c_suggest 0.1234567", "c_suggest 0.1234568"]
    file = write(tmp_path, TINY + condition.format(0.1234567))
    with pytest.raises(InputFileError, match=r"settings\[2\]: is there twice; expected different settings"):
        read(file)
    file = write(tmp_path, TINY.replace("populations.novices", "populations.own"))
    with pytest.raises(InputFileError, match=r"populations.own: means the true population in `priors`"):
        read(file)
