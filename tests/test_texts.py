"""Texts of people's pages: complete in each language, in no page itself, and in the page's language when refused."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from conftest import ROOT
from test_userstudy_pages import Web
from userstudies import PLAN, written

from assist.texts import catalogue, languages
from assist.userstudy.plan_file import read
from assist.web.tokens import VISITOR
from planner import Table
from planner.system.errors import InputFileError

WEB = ROOT / "assist" / "web"
PAGES = [WEB / "pages" / f"{name}.html" for name in ("worker", "nowhere")]
PAGES += [WEB / "user_study" / "pages" / f"{name}.html" for name in ("visit", "part")]
SCRIPTS = [WEB / "pages" / f"{name}.js" for name in ("worker", "connection", "page")]
SCRIPTS += [WEB / "user_study" / "pages" / f"{name}.js" for name in ("visit", "part", "questions")]
SPOKEN = {"aria-label", "alt", "placeholder", "title", "value"}
GERMAN = PLAN.replace("seed = 3", 'seed = 3\nlanguage = "de"')


class Shown(HTMLParser):
    """Collects what a page says."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []

    def handle_data(self, data: str) -> None:
        self.said += [data]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.said += [value or "" for name, value in attrs if name in SPOKEN and tag != "progress"]


def test_all_languages_have_the_same_texts() -> None:
    """A text may leave out a placeholder; none is empty."""
    first = catalogue("en")
    for language in languages():
        found = catalogue(language)
        assert set(found.texts) == set(first.texts)
        assert all(text.strip() for text in found.texts.values())
        assert found.tag == language


@pytest.mark.parametrize("file", PAGES, ids=lambda file: file.stem)
def test_no_page_has_texts_of_its_own(file: Path) -> None:
    shown = Shown()
    shown.feed(file.read_text(encoding="utf-8"))
    own = re.sub(r"\{\w+\.\w+\}", "", " ".join(shown.said))
    assert not re.search(r"[A-Za-z]", own), own


@pytest.mark.parametrize("file", SCRIPTS, ids=lambda file: file.stem)
def test_no_script_has_texts_of_its_own(file: Path) -> None:
    """A string of a script is a key, a name or a part of an address: no word with a capital or next to a blank."""
    code = re.sub(r"^\s*(//|/\*\*).*$|\s// .*$", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    strings = re.findall(r'"([^"\n]*)"', code) + re.findall(r"`([^`]*)`", code)
    keys = set(catalogue("en").texts)
    used = set(re.findall(r'\btext\("([\w.]+)"', code))
    assert used <= keys | {key.removesuffix("_one") for key in keys}
    names = re.compile(
        r"(kitassist|Bearer) .*|Kitassist-Caller|Content-Type|Authorization|GET|POST|Arrow\w+|Enter|Escape"
    )
    sentence = re.compile(r"[A-Z][a-z]+ [a-z]|^[A-Z][a-z]+[.!?…]?$|[a-z] [a-z]+[.!?…]$")
    for one in strings:
        own = re.sub(r"\$\{[^{}]*\}", "", one)
        assert names.fullmatch(own) or not sentence.search(own), one


def test_participants_are_refused_in_the_studys_language(tiny: Table, tmp_path: Path) -> None:
    web = Web(tiny, tmp_path, GERMAN.replace("seed = 3", "seed = 3\nparticipants = 1"))
    with web.client:
        ann = web.come("ann").json()["person"]
        onward = f"/api/study/participants/{ann}/onward"
        page = web.client.get("/study").text
        assert '<html lang="de">' in page
        assert "Willkommen" in page
        assert '<html lang="en">' in web.client.get("/study/operator").text
        form = web.ask("GET", "/api/study/form", ann).json()
        assert form["questionnaires"]["nasa-tlx"]["title"] == "Beanspruchung"
        assert form["questionnaires"]["trust"]["items"]["rely"]["low"] == "Stimme gar nicht zu"
        assert form["texts"]["thanks"] == "<p>Vielen Dank für Ihre Teilnahme.</p>"
        refused = [
            (409, web.come("bob"), "Die Studie ist im Moment voll. Vielleicht wird später ein Platz frei."),
            (404, web.ask("POST", "/api/study/withdrawals", VISITOR, json={"code": "x"}), "Diesen Code gibt es nicht."),
            (409, web.ask("POST", f"/api/people/{ann}/actions", ann, json={"action": "(a)"}), "Im Moment ist keine"),
            (409, web.ask("POST", onward, ann, json={"stage": "thanks"}), "Dieser Teil ist schon abgeschlossen"),
            (422, web.ask("POST", onward, ann, json={"stage": 1}), "Das ist im Moment nicht möglich."),
            (403, web.ask("POST", onward, VISITOR, json={"stage": "consent"}), "Dieser Link gehört einer anderen"),
            (409, web.ask("GET", f"/api/people/{ann}/explanation", ann), "Im Moment ist keine Aktion möglich."),
            (404, web.ask("GET", "/api/people/P-X"), "'P-X' is not in the team"),  # the researcher asks
        ]
        for status, answer, said in refused:
            assert (answer.status_code, answer.json()["detail"][: len(said)]) == (status, said)
        for stage in ("consent", "instructions"):
            assert web.onward(ann, stage).status_code == 200
        seen = web.ask("GET", f"/api/people/{ann}/drawing", ann).json()
        assert seen["language"] == "de"
        assert seen["words"]["(fetch box-a)"] == "box-a auf die Plattform holen"
        assert seen["text"].startswith("box-a in Lager; ")
        web.onward(ann, "practice")


MET = [
    "the study is full at the moment; places may become free later", "not possible within a user study",
    "P-2B4C6D is not taking part", "data could be withdrawn until 2027-03-31",
    "too many participants of this network have not begun a task yet; try again later",
    "too many pages are open; close some of them", "this task is over",
    "P-2B4C6D is at task tiny, not at 'practice'", "the study is complete", "the task is not finished",
    "the task begins when the group is complete", "answers: expected none at consent", "acted: not at consent",
    "P-2B4C6D is at consent; no action is possible there", "explanations are not shown here",
    "'P-2B4C6D' is not in the study", "'P-2B4C6D' is not in the team", "this link belongs to another person",
    "only the operator may do this", "requests of other sites' pages are refused", "there is no such page",
    "this link is for visitors; participants have joined already",
    "this link is for visitors; participants withdraw on their own page",
    "there is no such code; expected one like P-2B4C6D-23456789, from the last page",
    "this participant has joined on another device; continue there",
    "another participant has begun in this browser and has not finished",
    "this study admits participants by links of their own; use the complete link",
    "the link has another participant's signature; use the complete link",
    "expected a signed link, or the key of a browser", "participant: expected an ID of letters, digits or signs",
    "too many withdrawal codes were tried; try again in 30 seconds", "too many requests; try again later",
    "too many participants join at once; try again in 3 seconds", "the body is larger than 65536 bytes",
    "the body did not arrive within 30 seconds", "No space left on device; nothing was recorded",
    "answers.rely: expected a whole number from 1 to 7", "12 reports are waiting to be saved; try again later",
    "the service failed at this request (ZeroDivisionError); see its log",
    "(fetch box-a) is not applicable; it needs a free platform",
]  # fmt: skip
"""What participants can be told."""


@pytest.mark.parametrize("language", [one for one in languages() if one != "en"])
def test_every_refusal_that_participants_meet_has_a_text_of_its_own(language: str) -> None:
    found = catalogue(language)
    assert [said for said in MET if found.refusal(said) == found("refusals.other")] == []
    assert len({found.refusal(said) for said in MET}) >= len(MET) - 1


def test_a_language_of_the_studys_own_is_a_file_beside_it(tmp_path: Path) -> None:
    own = tmp_path / "fr.toml"
    own.write_text(catalogue("en").file.read_text(encoding="utf-8").replace('"Workload"', '"Charge"'), encoding="utf-8")
    file = written(tmp_path / "study.toml", GERMAN.replace('"de"', '"fr.toml"'))
    study = read(file)
    assert (study.catalogue.tag, study.questionnaire("nasa-tlx").title) == ("fr", "Charge")
    own.unlink()
    assert read(file, carried_out=True).catalogue.tag == "en"
    for wrong, said in (("fr.toml", "fr.toml"), ("xx", "'xx': expected one of en, de, or a .toml file")):
        with pytest.raises(InputFileError, match=re.escape(said)) as error:
            read(written(tmp_path / "study.toml", GERMAN.replace('"de"', f'"{wrong}"')))
        assert "language" in str(error.value)


def test_a_day_is_written_as_in_the_language() -> None:
    english = "data could be withdrawn until 2027-03-31"
    assert catalogue().refusal(english) == english
    assert catalogue("de").refusal(english) == "Daten konnten bis zum 31.03.2027 zurückgezogen werden."
