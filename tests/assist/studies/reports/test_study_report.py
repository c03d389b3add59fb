"""Results of a study: the summary and the report."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import KITTING
from fuzz import here
from matplotlib.text import Text
from scipy import stats
from studies import TINY, write

from assist import Pool, simulate
from assist.people.neighbours import Neighbours
from assist.person import ObservationModel, Setting
from assist.studies import Study, load_study, read, run_study
from assist.studies.reports.study_report import Report, notes
from assist.studies.reports.study_summary import ARM, Found, has_same_baseline
from assist.team.policy_names import BASELINES
from planner import InputFileError, Instance, cost_to_go, load


@pytest.fixture(scope="module", autouse=True)
def in_this_process() -> Iterator[None]:
    """Run cells in this process, since a worker takes a second to start."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("assist.studies.runner.outcomes", here)
        yield


def test_the_summary_is_computed_over_pools(small_study: tuple[Study, Path, dict]) -> None:
    study, out, printed = small_study
    assert printed == json.loads((out / "summary.json").read_text())
    frame = load_study(out)
    own = frame[(frame["condition"] == "first")]
    (cell,) = [
        c for c in printed["cells"]
        if (c["condition"], c["humans"], c["policy"]) == ("first", 2, "reactive")
    ]  # fmt: skip
    part = own[(own["humans"] == 2) & (own["policy"] == "reactive")]
    for column in ("human_actions_per_person", "cost_per_person", "interventions", "moves"):
        assert cell[column]["mean"] == pytest.approx(part[column].mean())
        assert cell[column]["sd"] == pytest.approx(part[column].std())
        assert cell[column]["n"] == len(part) == 12
        means = part.groupby("repeat")[column].mean()
        ends = (cell[column]["low"], cell[column]["high"])
        if means.std():
            assert ends == pytest.approx(stats.t.interval(0.95, 2, means.mean(), stats.sem(means)))
        else:
            assert ends == (None, None)
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


def test_savings_by_team_size_differ_by_the_decline_that_is_reported(small_study: tuple[Study, Path, dict]) -> None:
    _, _, printed = small_study
    for found in printed["decline"]:
        small, large = (
            next(
                row["mean"] for row in printed["comparisons"]
                if all(row[name] == found[name] for name in (*ARM, "policy", "against", "measure"))
                and row["humans"] == humans
            )
            for humans in found["humans"]
        )  # fmt: skip
        assert found["mean"] == pytest.approx(small - large)
    assert {row["against"] for row in printed["decline"]} == {"none", "reactive"}


def test_a_study_has_another_baseline_and_the_focus_is_given_as_its_policy_is(
    small_study: tuple[Study, Path, dict], tmp_path: Path
) -> None:
    study, out, printed = small_study
    other = Report.of(read(study.file, baseline="reactive"), out)
    assert other.summary["fingerprint"] == printed["fingerprint"]
    assert {row["against"] for row in other.summary["comparisons"]} == {"reactive"}
    arms = [row for row in other.summary["comparisons"] if row["condition"] == "first" and row["humans"] is None]
    assert {row["policy"] for row in arms} == {"none", "attention"}
    assert "| actions | reactive | none |" in other.text
    assert not any(key.endswith("vs_none") for key in other.summary["headline"])
    with pytest.raises(InputFileError, match=r"^baseline 'reactiv'; did you mean 'reactive'"):
        read(study.file, baseline="reactiv")
    (tmp_path / "mine.py").write_text("def own(team):\n    pass\n")
    plan = TINY.replace("repeats = 3", 'repeats = 3\npolicies = ["none", "mine.py:own"]\nfocus = "mine.py:own"', 1)
    assert read(write(tmp_path, plan)).focus == "own"


def test_a_condition_without_baselines_borrows_them(small_study: tuple[Study, Path, dict]) -> None:
    _, out, printed = small_study
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


def test_a_policy_that_never_acts_saves_nothing_in_teams_of_any_size(tmp_path: Path) -> None:
    """Savings are those of the same teams, also against no assistance."""
    dear = TINY.split("[[conditions]]")[0].replace("c_suggest = 0.2", "c_suggest = 900.0")
    summary = report_of(tmp_path, dear, 3).summary
    rows = [row for kind in ("comparisons", "decline") for row in summary[kind]]
    found = {
        (row["mean"], row["low"], row["high"])
        for row in rows if (row["policy"], row["against"], row["measure"]) == ("attention", "none", "actions")
    }  # fmt: skip
    assert found == {(0.0, None, None)}


def test_a_baseline_is_borrowed_for_the_same_teams_and_setting_only_and_rows_are_told_apart(tmp_path: Path) -> None:
    """Two robots intervene more often than one, so that the reactive policy of one robot is no baseline for them."""
    head = TINY.split("[[conditions]]")[0]
    more = [
        'name = "first"\nsettings = [{ c_suggest = 0.3 }]\n',
        'name = "few"\nhumans = [1, 3]\npolicies = ["attention"]\n',
        'name = "own"\nhumans = [1, 3]\n',
        'name = "other"\npolicies = ["attention"]\n'
        'settings = [{ robots = 2 }, { knowledge = "exact" }, { c_suggest = 0.4 }]\n',
    ]
    report = report_of(tmp_path, "[[conditions]]\n".join([head, *more]), 2)
    whole = [row for row in report.summary["comparisons"] if row["humans"] is None]
    assert {row["condition"] for row in whole if row["policy"] == "attention"} == {"first", "own", "other"}
    assert "| first | c_suggest 0.3 | attention |" in report.text
    assert "| own | default | attention |" in report.text
    usual = report.text.partition("The default setting, unless a condition differs: ")[2].partition("\n")[0]
    assert "c_suggest 0.2" in usual
    compared = {(row["setting"], row["against"]) for row in whole if row["condition"] == "other"}
    labels = {setting for setting, _ in compared}
    assert len(labels) == 3
    assert {setting for setting, against in compared if against == "none"} == labels
    assert {setting for setting, against in compared if against == "reactive"} == {"c_suggest 0.4"}


CHANGED = {
    "gamma": 0.5, "c_suggest": 3.0, "c_move": 2.0, "travel_time": 2.0, "eta": 0.9, "utility_scale": 0.1, "lapse": 0.3,
    "knowledge": "exact", "suggestions": "all", "execute": True, "c_execute": 0.1, "max_steps": 3, "robots": 1,
    "trust": "constant", "believed_trust": "outcome", "c_ask": 0.1, "ask_error": 0.3,
    "observation": ObservationModel(0.4, 0.1), "neighbours": Neighbours(rule="followed", sees="everybody"),
}  # fmt: skip


@pytest.mark.parametrize("policy", BASELINES)
def test_settings_with_one_baseline_have_the_same_results(policy: str) -> None:
    """Whatever counts as irrelevant to a baseline changes none of its measures."""
    one = Setting(robots=2)
    others = {field.name: replace(one, **{field.name: CHANGED[field.name]}) for field in fields(Setting)}
    table = cost_to_go(load(KITTING / "tiny.pddl"))

    def measured(setting: Setting) -> np.ndarray:
        episodes = simulate(Pool.sample(table, 4, seed=1, setting=setting), policy, humans=3, episodes=8, seed=3)
        return np.c_[episodes.actions, episodes.interventions, episodes.moves]

    asked = {"c_ask", "ask_error"}  # which studies refuse
    alike = {name for name, other in others.items() if has_same_baseline(policy, one, other)} - asked
    assert {"gamma", "c_suggest", "c_move"} <= alike
    expected = measured(one)
    assert [name for name in alike if (measured(others[name]) != expected).any()] == []


def test_the_report_says_what_was_found_and_shows_its_pictures(small_study: tuple[Study, Path, dict]) -> None:
    _, out, printed = small_study
    text, page = (out / "report.md").read_text(), (out / "report.html").read_text()
    saved = printed["headline"]["actions_vs_none"]
    for words in ("# small", "## What was run", "## Headline", "## Team sizes", "## Sensitivity", "cut off"):
        assert words in text
    assert f"| actions against none | tiny | {saved['mean']:.1f} ({saved['low']:.1f} to {saved['high']:.1f}) |" in text
    shown = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert {Path(name).stem for name in shown} >= {"team-size", "benefit", "trade-off", "belief"}
    assert "<table>" in page
    assert page.count("<picture>") == len(shown)
    files = {*shown, *re.findall(r'(?:src|srcset)="([^"]+)"', page)}
    assert len(files) == 3 * len(shown)
    drawn = [
        out / name for name in files if Path(name).name.startswith("team-size")
    ]  # the only one drawn, see the fixture
    assert [file.is_file() for file in drawn] == [True] * 3


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
    """Return all text in a picture."""
    (picture,) = [each for each in report.pictures if each.name == name]
    return [text.get_text() for text in picture.figure().findobj(Text) if text.get_text()]


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """A study of two populations and two pools, without a reference."""
    return report_of(tmp_path_factory.mktemp("several"), SEVERAL, 2)


def rows_below(text: str, title: str) -> list[list[str]]:
    """Return the first table below a title, without its head."""
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
    assert len(effects) == 1  # and not two that cannot be distinguished
    assert len({tuple(row) for row in rows_below(text, "Team sizes")}) == 2 * 2 * 3
    assert "(population 'everybody')](figures/team-size.png)" in text
    assert {"everybody", "novices"} <= set(words_in(several, "categories"))
    assert "| default | attention | tiny |" in text.split("## Sensitivity")[1]


@pytest.mark.slow
def test_nothing_that_somebody_else_claims_is_in_a_report(several: Report, tmp_path: Path) -> None:
    theirs = ("paper", "24.48", "12.35", "25.94", "3.86", "31.685", "Algorithm 1")
    compared = report_of(tmp_path, SEVERAL + PUBLISHED, 1)
    for report, allowed in ((several, ()), (compared, ("claim", "published", "earlier study"))):
        written = [report.text, *(each.text for each in report.pictures)]
        written += [words for each in report.pictures for words in words_in(report, each.name)]
        for words in (*theirs, "claim", "published", "earlier study"):
            assert any(words in text for text in written) == (words in allowed), words
    (row,) = [row for row in rows_below(compared.text, "Headline") if row[:2] == ["actions against none", "everybody"]]
    assert row[4:] == ["-400.0", "better, without an interval"]
    assert "More interventions for *novices* than for *everybody*" in compared.text
    assert "attention in an earlier study, over all team sizes" in words_in(compared, "benefit")
    assert "attention in an earlier study: 2.5" in words_in(compared, "categories")


def test_few_pools_are_said_to_be_few(small_study: tuple[Study, Path, dict], several: Report) -> None:
    for summary, text in (
        (several.summary, several.text),
        (small_study[2], (small_study[1] / "report.md").read_text()),
    ):
        assert "**Few pools.** All conditions: fewer than 10 pools" in text
        saved = summary["headline"]["actions_vs_none"]
        assert saved["high"] - saved["low"] > 10  # percentage points, of two or three pools


def test_results_that_rest_on_few_of_many_pools_are_said_to(small_study: tuple[Study, Path, dict]) -> None:
    """Here of twelve pools alike, in one of which people take thirty times as many actions without assistance."""
    study, out, _ = small_study
    frame = load_study(out)
    first = frame[(frame["condition"] == "first") & (frame["repeat"] == 0)]
    pools = pd.concat([first.assign(repeat=number) for number in range(12)], ignore_index=True)
    assert Found(study, pools).uneven() == []
    trapped = (pools["repeat"] == 5) & (pools["policy"] == "none")
    pools.loc[trapped, "human_actions_per_person"] *= 30
    (row,) = Found(study, pools).uneven()
    assert (row["policy"], row["measure"], row["pools"]) == ("none", "actions", 12)
    assert row["alike"] == pytest.approx(41**2 / (11 + 30**2))
    (note,) = notes({**small_study[2], "uneven": [row], "seldom_assisted": []})
    least = "none's actions (first, everybody, tiny), where 12 pools weigh as 1.8 alike ones"
    assert f"most of a mean of first, that of {least}" in note
    other = {**row, "measure": "cost", "alike": 1.9}
    (note,) = notes({**small_study[2], "uneven": [row, other], "seldom_assisted": []})
    assert f"most of 2 means of first, such as that of {least}" in note


def test_the_report_names_the_people_and_the_episode_that_is_drawn(several: Report) -> None:
    assert "People: *everybody*, beta 0.1 to 3, theta 0.5 to 0.95, sigma 0.1 to 1; *novices*, beta " in several.text
    assert f"Made with kitassist {version('kitassist')}." in several.text
    assert "Among the episodes of attention with the first pool on tiny with K = 2, it is the one" in several.text


def test_a_single_episode_makes_a_report(tmp_path: Path) -> None:
    least = TINY.replace("draws = 2", "draws = 1").replace("trials = 2", "trials = 1").replace("[1, 2]", "[1]", 1)
    report = report_of(tmp_path, least, 1)
    assert report.summary["cells"][0]["human_actions_per_person"]["sd"] is None
    assert "## Team sizes" in report.text
    assert "| None |" not in report.text  # fields of the plan that are not set
    for name in ("team-size", "belief"):
        assert words_in(report, name)


def test_a_task_whose_goal_holds_at_the_start_makes_a_report(tmp_path: Path) -> None:
    (tmp_path / "domain.pddl").write_text((KITTING / "domain.pddl").read_text())
    task = (KITTING / "tiny.pddl").read_text().replace("(in-slot hammer slot-1) (in-slot wrench slot-2)", "")
    (tmp_path / "done.pddl").write_text(task)
    report = report_of(tmp_path, TINY.replace(f"{KITTING}/tiny.pddl", "done.pddl").split("[[conditions]]")[0], 2)
    assert {cell["human_actions_per_person"]["mean"] for cell in report.summary["cells"]} == {0.0}
    assert "## One episode" not in report.text
    assert words_in(report, "team-size")


@pytest.mark.slow
def test_the_papers_protocol_makes_its_whole_report(tmp_path: Path) -> None:
    """All conditions of the paper, on a task that takes no time; `make study` runs them on the paper's tasks."""
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
        "Which interpretation fits the interventions of the paper best",
        "Sensitivity",
        "One episode",
    ):
        assert f"\n## {title}\n" in report.text
    assert "24.48" in report.text
    assert [each.name for each in report.pictures] == ["team-size", "benefit", "categories", "trade-off", "belief"]
    assert len(report.summary["readings"]) == 3 * (2 * 3 * 2 + 2 + 1)
