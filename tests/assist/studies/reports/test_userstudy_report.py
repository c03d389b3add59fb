"""A rehearsal in one command, its export, which other programs read, and its correct figures."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import math
import re
import statistics
import time
import zipfile
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, invoke, thinned
from hypothesis import given
from hypothesis import strategies as st
from test_userstudy_analysis import rows_of
from userstudies import PLAN, exported, written

from assist.declare import catalogue
from assist.studies.repeated_measures import detectable_within, within_participants
from assist.studies.reports import study_report, userstudy_report
from assist.studies.statistics import between_groups, cronbach_alpha, detectable
from assist.studies.userstudy.csv_tables import rows
from assist.studies.userstudy.csv_tables import written as written_rows
from assist.studies.userstudy.export import REGISTERED
from assist.studies.userstudy.tables import COLUMNS
from assist.web.user_study import rehearsal
from planner.system.errors import InputFileError, MissingExtraError


def run(*words: object) -> Any:
    result = invoke(*words)
    assert result.exit_code == 0, result.output
    return result


def read(folder: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO((folder / name).read_text())))


@pytest.mark.slow
def test_a_rehearsal_goes_from_the_file_to_the_drawn_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # All arrive at once, and the leaver is slow, so that for a while one place is missing.
    monkeypatch.setattr(rehearsal.Rehearsal, "at_once", 9)
    step = rehearsal.SimulatedParticipant._step

    def slowly(self: Any, seen: dict[str, Any]) -> dict[str, Any]:
        if self._leaves is not None:
            time.sleep(0.5)
        return step(self, seen)

    monkeypatch.setattr(rehearsal.SimulatedParticipant, "_step", slowly)
    file = written(tmp_path / "study.toml", PLAN.replace("seed = 3", "seed = 3\nparticipants = 8"))
    data, unpacked = tmp_path / "data", tmp_path / "export"
    public = ("--public-url", "https://host.example/kits/")  # which a rehearsal does not need to be there
    said = run("serve", "--study", file, "--rehearse", 8, "--data", data, "--port", 0, *public)
    assert set(links := json.loads(said.stdout)) == {"url", "operator", "join"}
    assert links["join"]["everybody"].startswith(f"{links['url']}/study#")
    assert links["url"] == "https://host.example/kits"
    late = invoke("serve", "--study", file, "--data", data)
    assert (late.exit_code, "has a rehearsal; expected another folder for the study itself" in late.stderr) == (2, True)
    with zipfile.ZipFile(data / "user-study.zip") as packed:
        packed.extractall(unpacked)

    people, tasks, actions, answers = (
        read(unpacked, f"{name}.csv") for name in ("participants", "tasks", "actions", "answers")
    )
    done = [one for one in people if one["status"] == "done"]
    assert [one["condition"] for one in done].count("none") == len(done) / 2 == 4
    assert len(people) == 9  # one left before the task, and counts in no condition
    assert [one["condition"] for one in people if one["status"] != "done"] == [""]
    assert len({one["completion_code"] for one in done}) == 8
    assert len(answers) == 8 * (6 + 2 + 1)
    for name in ("participants", "tasks", "actions", "answers", "events"):
        columns = [one["column"] for one in read(unpacked, "dictionary.csv") if one["table"] == name]
        assert (unpacked / f"{name}.csv").read_text().splitlines()[0] == ",".join(columns)
    for task in tasks:
        own = [one for one in actions if one["participant"] == task["participant"] and one["task"] == "tiny"]
        assert int(task["actions"]) == len(own)
        assert int(task["suggestions"]) == sum(one["suggestion"] != "" for one in own)
        worse = [one for one in own if float(one["cost_after"]) >= float(one["cost_before"])]  # as each action costs 1
        assert int(task["suboptimal_actions"]) == len(worse) == sum(one["optimal"] == "false" for one in own)
        assert (task["finished"], own[-1]["cost_after"], task["optimal_cost"]) == ("true", "0.0", "6.0")

    summary = json.loads((data / "report" / "summary.json").read_text())
    assert summary["simulated"]
    counted = [float(one["actions"]) for one in tasks if one["condition"] == "none"]
    cell = summary["measures"][0]["cells"][0]
    assert (cell["n"], cell["mean"]) == (4, pytest.approx(statistics.mean(counted)))
    of_none = {one["participant"] for one in done if one["condition"] == "none"}
    given = {(a["participant"], a["item"]): int(a["answer"]) for a in answers if a["questionnaire"] == "trust"}
    trust = {one["measure"]: one for one in summary["measures"]}["trust"]  # of which one item is reversed
    means = [(given[who, "rely"] + 8 - given[who, "wary"]) / 2 for who in of_none]
    assert trust["cells"][0]["mean"] == pytest.approx(statistics.mean(means))
    assert [row["reached"] for row in summary["flow"]][-1] == 8
    assert sum(row["left"] for row in summary["flow"]) == 1

    assert json.loads((unpacked / "versions.json").read_text())["kitassist"] == metadata.version("kitassist")
    text = (data / "report" / "report.md").read_text()
    assert "**Rehearsal.** Participants are simulated" in text
    assert "**Few participants.** Fewer than 10 in every condition" in text
    for name in ("outcomes", "differences", "flow", "scales-nasa-tlx", "scales-trust"):
        assert f"](figures/{name}.png)" in text
        assert (data / "report" / "figures" / f"{name}.svg").stat().st_size > 1000

    # An export gives the same report as the folder, and `fit` reads its log.
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(userstudy_report, "_pictures", lambda *_: iter(()))  # which are drawn already
        assert json.loads(run("study-report", unpacked, "--json").stdout) == summary
        assert json.loads(run("study-report", data / "user-study.zip", "--json").stdout) == summary
        assert "actions per task" in run("study-report", data, "--out", tmp_path / "again").stdout
    fitted = json.loads(run("fit", KITTING / "tiny.pddl", unpacked / "log-tiny.jsonl", "--json").stdout)
    assert {one["person"]: one["actions"] for one in fitted} == {
        one["participant"]: int(one["actions"]) for one in tasks
    }


def test_a_study_in_which_hardly_anybody_took_part_says_so(tmp_path: Path) -> None:
    nobody = run("study-report", exported(tmp_path / "nobody"), "--out", tmp_path / "report")
    assert "actions per task" in nobody.stdout
    text = (tmp_path / "report" / "report.md").read_text()
    assert "Conditions with fewer than two participants cannot be compared." in text
    assert "rehearsal" not in text
    assert "](figures/" not in text


FRAGMENT = re.compile(r"[^{}]{14,}")


def german(folder: Path, plan: str) -> Path:
    """Write an unpacked export of a study in German, in which four people finished and two left."""
    rows = [(name, name, 1, 6 + n, 1 + n) for n, name in enumerate(["none", "attention"] * 2)]
    tables = rows_of(rows, who=lambda n: f"P{n + 1}")
    for n, row in enumerate(tables.tasks):
        row |= {"suggestions": n % 2, "followed": n % 2, "seconds": 2.5 * n, "suboptimal_actions": n}
    gone = [("gone", None), ("withdrew", None), ("declined", "zu spät")]
    tables.participants += [
        {"participant": f"P{n}", "status": status, "stage": "consent", "excluded": why, "failed_checks": 0}
        for n, (status, why) in enumerate(gone, start=5)
    ]
    for row in tables.participants:
        row["simulated"] = True
    exported(folder, tables=vars(tables))
    written(folder / "study.toml", plan.replace("seed = 3", 'seed = 3\nlanguage = "de"'))
    return folder


@pytest.mark.slow
def test_the_report_of_a_german_study_is_german_also_in_its_figures(tmp_path: Path) -> None:
    plan = PLAN.replace("seed = 3", 'seed = 3\nconfirmatory = ["actions"]')
    folder = german(tmp_path / "data", plan)
    assert "Aktionen pro Aufgabe" in run("study-report", folder).stdout
    text, page = ((folder / "report" / f"report.{kind}").read_text("utf-8") for kind in ("md", "html"))
    drawn = "\n".join(file.read_text("utf-8") for file in (folder / "report" / "figures").glob("*.svg"))
    assert '<html lang="de">' in page
    for said in (
        "**Probe.** Die Teilnehmenden sind simuliert", "| gekommen | 7 |",
        "zurückgetreten; ihre Daten sind entfernt | 1 |", "| von der Studienleitung ausgeschlossen: zu spät | 1 |",
        "| Aktionen pro Aufgabe | 7,0 (",
        "### Konfirmatorisch", "Wenige Teilnehmende", "Cronbachs Alpha über seine Fragen: 1,00.",
        "![Verlauf der Teilnehmenden](figures/flow.png)", "Umgekehrte Fragen sind umgepolt.",
        "| confirmatory | [\"actions\"] |", "| seed | 3 |",
    ):  # fmt: skip
        assert said in text, said
    assert "Teilnehmende, die diesen Abschnitt erreichten" in drawn
    assert re.search(r"<!-- \d+,\d+ -->", drawn)  # numbers at the axes
    english = catalogue("en").section("report")
    fragments = {one.strip() for words in english.values() for one in FRAGMENT.findall(words) if " " in one.strip()}
    assert len(fragments) > 50
    assert [one for one in fragments if one in text or one in page or one in drawn] == []


def test_the_template_of_the_report_has_no_words_of_its_own() -> None:
    source = (Path(userstudy_report.__file__).with_name("userstudy_report.md.jinja")).read_text(encoding="utf-8")
    own = re.sub(r"\{%.*?%\}|\{\{.*?\}\}", "", source, flags=re.DOTALL)
    assert not re.search(r"[A-Za-z]", own), own


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('design = "within"', "Verglichen wird innerhalb der Personen"),
        ('[group]\nsize = 2\nthen = "start"', "Die Einheit der Auswertung ist die Gruppe"),
    ],
)
def test_every_design_has_a_german_report(tmp_path: Path, more: str, said: str) -> None:
    folder = exported(tmp_path / "data")
    plan = PLAN.replace("simulated = 2", "simulated = 0").replace("seed = 3", 'seed = 3\nlanguage = "de"')
    plan = f"{plan}\n{more}" if more.startswith("[") else plan.replace("seed = 3", f"seed = 3\n{more}")
    written(folder / "study.toml", plan)
    run("study-report", folder)
    assert said in (folder / "report" / "report.md").read_text("utf-8")


@pytest.mark.usefixtures("no_figures")
def test_what_people_typed_breaks_neither_the_page_nor_a_table(tmp_path: Path) -> None:
    away = [
        {"participant": f"P{number}", "status": "gone", "stage": "consent", "excluded": "left | <ran>"}
        for number in range(2)
    ]
    folder = exported(tmp_path / "data", participants=away)
    written(folder / "study.toml", PLAN.replace("A small study", "Kits </title> & 'trays'"))
    run("study-report", folder)
    assert r"| excluded by the researchers: left \| &lt;ran> | 2 |" in (folder / "report" / "report.md").read_text()
    assert "<title>Kits &lt;/title&gt; &amp; &#39;trays&#39;</title>" in (folder / "report" / "report.html").read_text()


@pytest.mark.parametrize("package", ["jinja2", "markdown"])
@pytest.mark.parametrize("report", [study_report, userstudy_report])
def test_without_a_package_the_extra_is_named(report: Any, package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else found(name))
    with pytest.raises(MissingExtraError, match=rf"reports need {package}: .*\[study\]"):
        report.require()


def test_an_export_that_was_changed_is_refused(tmp_path: Path) -> None:
    folder = german(tmp_path / "export", PLAN)
    for table, was, now, words in (
        ("tasks", ",6,", ",six,", "tasks.csv:2: expected a number"),
        ("tasks", ",6,", ",nan,", "tasks.csv:2: expected a number"),
        ("tasks", ",6,", ",inf,", "tasks.csv:2: expected a number"),
        ("tasks", "actions,", "", r"tasks.csv:2: expected \d+ columns, as in line 1"),
        ("tasks", "period", "periods", "tasks.csv:1: expected the columns participant"),
        ("tasks", "P1,none", "P1,nobody", "tasks.csv:2: condition 'nobody'; expected one of the study"),
        ("tasks", "P1,none,", "P1,,", "tasks.csv:2: condition ''; expected one of the study"),
        ("tasks", "P3,none", "P1,none", "tasks.csv:4: task 'tiny' of 'P1' in 'none'; expected it once"),
        ("tasks", "P3,none", "P8,none", "tasks.csv:4: participant 'P8'; expected one of participants"),
        ("answers", "P1,none", "P1,nobody", "answers.csv:2: condition 'nobody'; expected one of the study"),
        ("answers", "P1,none", "P1,", "answers.csv:2: the condition of 'trust'; expected a condition"),
        ("answers", ",trust,", ",truth,", "answers.csv:2: questionnaire 'truth'; expected one of the study"),
        ("participants", "P2,", "P1,", "participants.csv:3: participant 'P1'; expected each once"),
        ("participants", "thanks", "thank", "participants.csv:2: stage 'thank'; expected one of the study"),
        ("participants", "attention", "attention > none", "participants.csv:3: condition 'attention > none'"),
    ):
        file = folder / f"{table}.csv"
        right = file.read_text()
        assert was in right
        file.write_text(right.replace(was, now, 1))
        with pytest.raises(InputFileError, match=words):
            userstudy_report.of_folder(folder)
        file.write_text(right)
    assert userstudy_report.of_folder(folder)


@pytest.mark.usefixtures("no_figures")
def test_a_packed_export_has_its_report_beside_it(tmp_path: Path) -> None:
    folder = exported(tmp_path / "export")
    with zipfile.ZipFile(tmp_path / "user-study.zip", "w") as packed:
        for file in folder.iterdir():
            packed.write(file, file.name)
    said = run("study-report", tmp_path / "user-study.zip").stdout
    assert said.endswith(f"the report is {tmp_path / 'user-study-report' / 'report.md'}\n")
    run("study-report", folder, "--out", tmp_path / "again")
    first, second = (tmp_path / name / "summary.json" for name in ("user-study-report", "again"))
    assert first.read_text() == second.read_text()
    refused = invoke("study-report", folder / "study.toml")
    assert (refused.exit_code, refused.stderr) == (
        1, f"{folder / 'study.toml'}: no ZIP file; expected the folder of a study, or an export of one\n",
    )  # fmt: skip


def test_a_folder_without_a_study_is_refused_in_one_line(tmp_path: Path) -> None:
    refused = invoke("study-report", tmp_path)
    assert refused.exit_code == 1
    assert refused.stderr == (
        f"{tmp_path}: no study.toml; expected the folder of a study that has begun, or an unpacked export\n"
    )


@given(st.text(st.sampled_from("'=+-@\t\r\nab,\""), min_size=1))
def test_a_text_is_read_back_as_it_was(text: str) -> None:
    """Whatever somebody wrote, an export's report has it too; carriage returns become line feeds."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "answers.csv"
        file.write_text(written_rows(COLUMNS["answers"], [dict.fromkeys(COLUMNS["answers"]) | {"answer": text}]))
        (row,) = csv.reader(file.read_text().splitlines(keepends=True)[1:])
        assert not row[list(COLUMNS["answers"]).index("answer")].startswith(("=", "+", "-", "@", "\t"))
        (found,) = rows(file, COLUMNS["answers"])
    assert found["answer"] == text.replace("\r\n", "\n").replace("\r", "\n")


@pytest.mark.usefixtures("no_figures")
def test_names_that_look_like_formulas_are_in_the_report_of_an_export(tmp_path: Path) -> None:
    plan = PLAN.replace('name = "attention"', 'name = "+robot"').replace(
        "[[conditions]]",
        """[[questionnaires]]
form = "choice"
name = "change"
items = [{ name = "change", text = "Was it better?", options = ["-1", "0", "+1"] }]

[[conditions]]""",
        1,
    )
    where = {"participant": "P1", "condition": "+robot", "period": 1}
    folder = exported(
        tmp_path / "export",
        participants=[{
            "participant": "P1", "condition": "+robot", "status": "done", "stage": "thanks", "simulated": False,
            "failed_checks": 0,
        }],
        tasks=[where | {"task": "tiny", "finished": True, "actions": 7, "suggestions": 0, "followed": 0}],
        answers=[where | {"questionnaire": "change", "item": "change", "position": 1, "answer": "+1"}],
    )  # fmt: skip
    written(folder / "study.toml", plan)
    summary = json.loads(run("study-report", folder, "--json").stdout)
    cells = {cell["condition"]: cell["n"] for cell in summary["measures"][0]["cells"]}
    assert cells == {"none": 0, "+robot": 1}
    counts = {one["condition"]: one["counts"] for one in summary["answers"] if one["item"] == "change"}
    assert counts["+robot"] == {"-1": 0, "0": 0, "+1": 1}


@pytest.mark.cases
@pytest.mark.usefixtures("no_figures")
def test_a_rehearsal_in_which_a_policy_fails_is_no_success_and_its_report_says_so(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def fails(team):\n    return team.foo\n")
    text = PLAN.replace('policy = "attention"', 'policy = "own.py:fails"').replace("simulated = 2", "simulated = 0")
    file, data = written(tmp_path / "study.toml", text), tmp_path / "data"
    ended = invoke("serve", "--study", file, "--rehearse", 2, "--data", data, "--port", 0)
    assert ended.exit_code == 1, ended.output
    said = "in 1 of 1 tasks, where it then suggested nothing: `{}:2: AttributeError".format(tmp_path / "own.py")
    assert f"The policy of attention failed {said}" in ended.stderr
    with zipfile.ZipFile(data / "user-study.zip") as packed:
        packed.extractall(tmp_path / "export")
    for place in (data, tmp_path / "export"):
        (fault,) = userstudy_report.write_report(place, tmp_path / "report")["faults"]
        assert (fault["condition"], fault["failed"], fault["tasks"]) == ("attention", 1, 1)
        top = (tmp_path / "report" / "report.md").read_text().partition("\n## ")[0]
        assert f"**The policy of attention failed** {said}" in top
    assert [bool(row["fault"]) for row in read(tmp_path / "export", "tasks.csv")].count(True) == 1


def test_what_the_command_refuses(tmp_path: Path) -> None:
    file = written(tmp_path / "study.toml", PLAN.replace("seed = 3", "seed = 3\nparticipants = 8"))
    (registered := tmp_path / "registered").mkdir()
    (registered / REGISTERED).touch()
    for words, message in [
        (["serve"], "expected INSTANCE and --humans K, or --study FILE.toml"),
        (["serve", "--study", file], "--study: expected --data DIR as well"),
        (
            ["serve", "--study", file, "--data", tmp_path, "--policy", "none"],
            "--policy cannot be combined with --study",
        ),
        (["serve", "--study", file, "--data", tmp_path, "--rehearse", "9"], "the study is planned for 8 participants"),
        (
            ["serve", "--study", file, "--data", registered, "--rehearse", "8"],
            "a study is registered there; expected another folder for a rehearsal",
        ),
        (["serve", "--study", written(tmp_path / "bad.toml", "tasks = 1")], "bad.toml:1: tasks: 1; expected a list"),
    ]:
        result = invoke(*words)
        assert (result.exit_code, message in result.stderr) == (2, True), result.stderr


def test_statistics_are_those_worked_out_by_hand() -> None:
    a, b = [1.0, 2.0, 3.0], [2.0, 4.0, 6.0, 8.0]
    compared = between_groups(a, b)
    assert compared.hedges_g.value == pytest.approx(-3 / math.sqrt(4.4) * (1 - 3 / 19))
    assert cronbach_alpha([[1, 1], [2, 3], [3, 2]]) == pytest.approx(2 * (1 - 2 / 3))
    assert cronbach_alpha([[1, 2], [2, 3], [3, 4]]) == pytest.approx(1)
    assert detectable(126, math.sqrt(32)) == pytest.approx(0.5, abs=0.005)  # Cohen (1988): 64 in each group for d = 0.5
    crossed = [(1, 2), (2, 1)]
    assert detectable_within(crossed * 17) == pytest.approx(0.5, abs=0.01)  # as G*Power has it: 34 pairs for d = 0.5
    for nothing in (
        within_participants([1, 1], crossed).difference.low, within_participants([1, 2], crossed).hedges_g.value,
        detectable_within([(1, 2)]), detectable_within(crossed), detectable_within([(1, 2)] * 9),
        between_groups([1], [2, 3]).difference.low, between_groups([1], [2, 3]).hedges_g.value,
        between_groups([1, 1], [2, 2]).p, cronbach_alpha([[1, 2]]), detectable(0, 1.0),
    ):  # fmt: skip
        assert math.isnan(nothing)


@pytest.mark.parametrize(
    "periods", thinned([[(1, 2)] * 2 + [(2, 1)] * 5, [(1, 2), (2, 1)] * 3, [(1, 2), (2, 3), (3, 1)] * 3], every=3)
)
def test_four_of_five_studies_show_the_difference_that_is_called_detectable(periods: list[tuple[int, int]]) -> None:
    """Also in small studies, in which the effects of periods take degrees of freedom, and with unequal orders."""
    effect, rng, studies = detectable_within(periods), np.random.default_rng(5), 600
    learnt = np.array([2.0 * before - 2.0 * after for after, before in periods])
    drawn = effect + learnt + rng.standard_normal((studies, len(periods)))
    shown = [within_participants(one, periods).p < 0.05 for one in drawn]
    assert np.mean(shown) == pytest.approx(0.8, abs=3 * math.sqrt(0.8 * 0.2 / studies))
