"""Texts of people's pages: complete in each language, in no page itself, and in the page's language when refused."""

from __future__ import annotations

import ast
import pickle
import re
import string
from collections.abc import Iterator
from datetime import date
from html.parser import HTMLParser
from pathlib import Path

import pytest
from conftest import ROOT
from test_userstudy_pages import Web
from userstudies import PLAN, written

from assist.declare import InapplicableError, Refusal, catalogue, languages
from assist.studies.userstudy.plan_file import read
from assist.web.tokens import VISITOR
from planner import InputFileError, Table

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
        ann = web.take_part("ann")
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


ASSIST = ROOT / "assist"
KINDS = {kind.__name__ for kind in (Refusal, *Refusal.__subclasses__())}
TEXTS = {key.removeprefix("refusals."): text for key, text in catalogue().texts.items() if key.startswith("refusals.")}


def raised() -> Iterator[tuple[str, str, set[str]]]:
    """Yield the place, key and values of each refusal with a constant key in the source."""
    for file in ASSIST.rglob("*.py"):
        source = file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if any(f"{kind}(" in source for kind in KINDS) else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in KINDS:
                key = node.args[0]
                if isinstance(key, ast.Constant):
                    yield f"{file.name}:{node.lineno}", key.value, {str(one.arg) for one in node.keywords}


def placeholders(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


def test_every_refusal_has_a_text_and_the_values_of_its_placeholders_in_each_language() -> None:
    found = list(raised())
    assert len(found) > 60
    for place, key, values in found:
        assert key in TEXTS, place
        for language in languages():
            needed = placeholders(catalogue(language).texts[f"refusals.{key}"])
            assert needed <= values, (place, language, needed)


def test_every_text_of_a_refusal_is_used_and_is_translated() -> None:
    source = "".join(file.read_text(encoding="utf-8") for file in ASSIST.rglob("*.py"))
    assert [key for key in TEXTS if f'"{key}"' not in source] == []
    for language in set(languages()) - {"en"}:
        texts = catalogue(language).texts
        assert [key for key, text in TEXTS.items() if texts[f"refusals.{key}"] == text] == []


def test_a_refusal_is_one_sentence_in_the_language_of_the_reader_and_can_be_pickled() -> None:
    error = pickle.loads(pickle.dumps(InapplicableError("too_late", day=date(2027, 3, 31))))
    assert isinstance(error, InapplicableError)
    assert str(error) == "data could be withdrawn until 2027-03-31"
    german = catalogue("de")
    assert german.refusal(error.key, **error.values) == "Daten konnten bis zum 31.03.2027 zurückgezogen werden."
    other = Refusal("other", why="task 'x': expected one of a, b")
    assert str(other) == "task 'x': expected one of a, b"
    assert german.refusal(other.key, **other.values) == "Das ist im Moment nicht möglich."


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
