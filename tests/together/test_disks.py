"""Disks that are really full, and folders that cannot be written: what people see, and that nothing is lost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING, invoke
from disks import full, sealed, small
from networks import conducted, running
from serving import TINY
from test_cases_networks import Line, has_done, says
from test_cases_withdrawal import answered
from test_event_store import content
from test_userstudy_pages import PATIENCE
from userstudies import ALONE, PLAN, Part, written

from assist.live import Acted, Joined, Session
from assist.live.store import JournalError, stored
from assist.person.settings import Setting
from assist.studies.userstudy.plan_file import read
from assist.studies.userstudy.session import JOURNAL, StudySession
from assist.web.server import listen
from planner import Table

UNSAVED = "No space left on device at the last attempt"


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with small(tmp_path / "disk") as folder:
        yield folder


def test_events_of_a_team_are_refused_while_the_disk_is_full_and_none_is_lost(tiny: Table, disk: Path) -> None:
    """Whatever was acknowledged is there after a restart; what was refused had no effect, and can be sent again."""
    session = Session({"tiny": tiny}, disk / "data" / "journal.sqlite")
    session.report_all([Joined(person=name) for name in ("ann", "bob")])
    done, refused = 0, 0
    with full(disk):
        for number in range(60):
            event = Acted(person="ann", action=("(fetch box-a)", "(return box-a)")[done % 2], id=f"{number}")
            try:
                (outcome,) = session.report_all([event])
            except JournalError as error:
                outcome = error
            done, refused = done + isinstance(outcome, dict), refused + isinstance(outcome, JournalError)
            assert session.person("ann")["steps"] == done
        assert refused
        assert session.fault() == UNSAVED
    assert session.observe("ann", ("(fetch box-a)", "(return box-a)")[done % 2], id="again")["steps"] == done + 1
    assert session.fault() is None
    before = [session.person(name) for name in ("ann", "bob")]
    session.close()
    with closing(Session({"tiny": tiny}, disk / "data" / "journal.sqlite")) as again:
        assert [again.person(name) for name in ("ann", "bob")] == before


@pytest.mark.parametrize("how", ["withdraw", "erase"])
def test_who_withdraws_or_is_erased_on_a_full_disk_is_removed_when_there_is_room(
    tiny: Table, disk: Path, tmp_path: Path, how: str
) -> None:
    study = read(written(tmp_path / "study.toml", ALONE))
    session = StudySession(study, {"tiny": tiny, "practice": tiny}, disk / "data")
    eve, ann = answered(session, "eve", "ann")

    def remove() -> None:
        eve.report("withdrew", id="asked") if how == "withdraw" else session.erase("eve", "wrote a letter")

    with full(disk):
        for _ in range(2):
            with pytest.raises(JournalError, match="No space left on device"):
                remove()
        assert session.fault() is not None
        assert ann.kind == "thanks"
    remove()
    assert session.fault() is None
    assert b"words of eve" not in content(disk / "data")
    assert b"words of ann" in content(disk / "data")
    session.close()
    with closing(StudySession(study, {"tiny": tiny, "practice": tiny}, disk / "data")) as again:
        assert again.person("ann")["study"]["kind"] == "thanks"
        assert ("eve" in again.people) == (how == "withdraw")


def without_preparing(said: str) -> list[str]:
    """Return the lines of a service that ended, but for that which says what it prepares."""
    return [line for line in said.splitlines() if not line.startswith("preparing ")]


@pytest.mark.parametrize("study", [False, True], ids=["team", "study"])
def test_a_folder_that_cannot_be_written_is_said_in_one_line(tmp_path: Path, study: bool) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    file = written(tmp_path / "study.toml")
    words = ["--study", file] if study else [KITTING / "tiny.pddl", "--humans", 2]
    with sealed(folder):
        for data in (folder, folder / "below"):
            refused = invoke("serve", *words, "--data", data, "--port", 0)
            assert refused.exit_code == 1, refused.output
            (said,) = without_preparing(refused.stderr)
            assert "Read-only file system" in said
            assert str(data) in said


@pytest.mark.parametrize("study", [False, True], ids=["team", "study"])
def test_a_second_service_on_one_folder_is_refused_in_one_line_and_disturbs_nobody(
    tiny: Table, tmp_path: Path, study: bool
) -> None:
    folder, file = tmp_path / "data", written(tmp_path / "study.toml")
    tasks = {"tiny": tiny, "practice": tiny}
    with closing(StudySession(read(file), tasks, folder) if study else Session(tiny, folder / JOURNAL)) as first:
        words = ["--study", file] if study else [TINY, "--humans", 2]
        again = invoke("serve", *words, "--data", folder, "--port", 0)
        assert (again.exit_code, len(without_preparing(again.stderr))) == (2, 1), again.output
        assert "the folder is in use by a running session; expected another folder" in again.stderr
        if study:
            Part(first, "ann").come()
        else:
            first.join("ann")
        assert first.people == ("ann",)


@pytest.fixture
def completed(tiny: Table, tmp_path: Path) -> Path:
    """The folder of a study in which one participant has come to the end."""
    study = read(written(tmp_path / "study.toml", ALONE))
    with closing(StudySession(study, {"tiny": tiny}, tmp_path / "data")) as session:
        answered(session, "ann")
    return tmp_path / "data"


@pytest.mark.usefixtures("no_figures")
def test_a_study_whose_folder_cannot_be_written_any_more_can_be_reported(completed: Path, tmp_path: Path) -> None:
    with sealed(completed):
        refused = invoke("study-report", completed)
        assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1)
        assert "Read-only file system" in refused.stderr
        made = invoke("study-report", completed, "--out", tmp_path / "out")
        assert made.exit_code == 0, made.output
        assert len(stored(completed / JOURNAL)[1]) > 5


@pytest.mark.usefixtures("no_figures")
def test_a_report_for_which_there_is_no_room_is_said_in_one_line_and_leaves_nothing(
    disk: Path, completed: Path
) -> None:
    words = ["study-report", completed, "--out", disk / "report"]
    with full(disk):
        refused = invoke(*words)
        assert (refused.exit_code, refused.stderr.count("\n")) == (1, 1), refused.output
        assert "No space left on device" in refused.stderr
        assert [file.name for file in disk.rglob("*") if file.is_file()] == ["ballast"]
    assert invoke(*words).exit_code == 0
    assert (disk / "report" / "report.html").stat().st_size > 1000


@pytest.mark.long
@pytest.mark.slow
def test_people_and_the_operator_of_a_team_see_that_the_disk_is_full_and_nothing_is_lost(
    chromium: Any, tiny: Table, disk: Path
) -> None:
    listening = listen("127.0.0.1", 0)
    here = Line(tiny, disk, chromium, f"http://127.0.0.1:{listening.getsockname()[1]}")
    with running(here.app, listening):
        page, operator = here.page(), here.page(None)
        says(page, "Connected")
        with full(disk):
            for steps, action in enumerate(["(fetch box-a)", "(return box-a)"] * 30):
                page.click(f'#actions button[data-action="{action}"]')
                page.wait_for_function(
                    "n => document.getElementById('steps').textContent === String(n + 1)"
                    " || !document.getElementById('problem').hidden", arg=steps,
                )  # fmt: skip
                if page.locator("#problem").is_visible():
                    break
            assert "No space left on device; nothing was recorded" in page.inner_text("#problem")
            for one in (page, operator):
                says(one, "Connected, but with a fault")
            assert f"Actions cannot be saved at the moment ({UNSAVED})." in page.inner_text("#fault")
            assert f"Events cannot be saved: {UNSAVED}." in operator.inner_text("#fault")
            assert here.session.person("ann")["steps"] == steps
        has_done(page, steps + 1)  # the page sends it again by itself
        for one in (page, operator):
            says(one, "Connected")
            assert one.locator("#fault").is_hidden()
        assert page.locator("#problem").is_hidden()
        here.context.close()
    here.session.close()
    with closing(
        Session({"tiny": tiny}, disk / "journal.sqlite", setting=Setting(suggestions="all", c_suggest=0.02))
    ) as again:
        assert again.person("ann")["steps"] == steps + 1
    assert here.faults == []


@pytest.mark.long
@pytest.mark.slow
def test_a_participant_and_the_researcher_see_that_the_disk_is_full_and_nothing_is_lost(
    chromium: Any, tiny: Table, disk: Path
) -> None:
    german = PLAN.replace("seed = 3", 'seed = 3\nlanguage = "de"')
    with conducted(tiny, disk, german) as service:
        context = chromium.new_context()
        page, researcher = context.new_page(), context.new_page()
        page.set_default_timeout(PATIENCE)
        researcher.set_default_timeout(PATIENCE)
        page.goto(service.join_url())
        page.wait_for_selector("#form button")
        researcher.goto(service.operator_url())
        researcher.wait_for_selector("#people td")
        (person,) = service.session.people
        with full(disk):
            page.click("#form button")  # agrees
            page.wait_for_function(
                "() => !document.getElementById('problem').hidden"
                " || document.getElementById('stage-title').textContent === 'Was Sie tun werden'"
            )
            if page.locator("#problem").is_hidden():  # there was room on the last page
                page.click("#form button")
                page.wait_for_selector("#problem:not([hidden])")
            assert "Der Server kann im Moment nichts speichern." in page.inner_text("#problem")
            researcher.wait_for_selector(f"text=vents cannot be saved: {UNSAVED}")
            before = service.session.person(person)["study"]["stage"]
        page.wait_for_selector("#problem", state="hidden")
        page.wait_for_function("stage => !document.body.textContent.includes(stage)", arg="nichts speichern")
        assert service.session.person(person)["study"]["stage"] != before
        researcher.wait_for_selector(f"text=vents cannot be saved: {UNSAVED}", state="hidden")
