"""Forms of questionnaires in user studies: their file, what is accepted, what each participant sees, and the export."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, costly, invoke
from hypothesis import given
from hypothesis import strategies as st
from serving import served
from test_live_pages import violations
from userstudies import PLAN, Open, Part, opened, written

from assist.declare.declared import DeclarationError, names_of
from assist.studies.reports.userstudy_summary import summarise
from assist.studies.userstudy import Item, Questionnaire, UserStudy, read
from assist.studies.userstudy.export import files
from assist.studies.userstudy.session import JOURNAL
from assist.studies.userstudy.tables import tables
from assist.web.user_study.routes import form_of
from planner.system.errors import InputFileError

__all__ = ["opened"]

FORMS = """
[[questionnaires]]
form = "choice"
name = "background"
title = "About you"
when = "before"
items = [
    { name = "age", form = "number", text = "How old are you?", min = 18, max = 99 },
    { name = "hand", text = "Which hand do you write with?", options = ["the left", "the right", "both"] },
    { name = "used", form = "choices", text = "What have you used?", options = ["robots", "games"], required = false },
    { name = "height", form = "number", text = "How tall are you, in m?", max = 3, step = 0.01, required = false },
]

[[questionnaires]]
form = "likert-grid"
name = "ease"
points = 5
labels = ["never", "rarely", "sometimes", "often", "always"]
shuffle = true
items = [
    { name = "clear", text = "I knew what to do." },
    { name = "lost", text = "I was lost.", reversed = true },
    { name = "reads", text = "Mark often here.", correct = 4 },
    { name = "calm", text = "I was calm.", required = false },
    { name = "hints", text = "The suggestions helped me.", conditions = ["attention"] },
]

[[questionnaires]]
form = "slider"
name = "trust-now"
conditions = ["attention"]
items = [{ name = "now", text = "How much do you trust it now?", low = "not at all", high = "fully", step = 10 }]
"""
PLAIN = PLAN[: PLAN.index("[[questionnaires]]")] + PLAN[PLAN.index("[[conditions]]") :]
WITH_FORMS = PLAIN.replace("seed = 3", "seed = 3\nexclude_failed_checks = 1") + FORMS
BACKGROUND = {"age": 30, "hand": "both", "used": ["games"], "height": 1.75}
EASE = {"clear": 5, "lost": 2, "reads": 4, "calm": None}


def study_of(folder: Path, text: str = WITH_FORMS) -> UserStudy:
    return read(written(folder / "study.toml", text))


def test_what_is_wrong_with_a_form_is_said_with_its_line(tmp_path: Path) -> None:
    items = "questionnaires[1].items"
    for right, wrong, message in [
        ('form = "choices"', 'form = "choises"', f"{items}[3].form: 'choises'; did you mean 'choices'"),
        ("min = 18", "min = 100", f"{items}[1].max: 99; expected a number above min (100)"),
        ("step = 0.01", "step = 0", f"{items}[4].step: 0; expected a number above 0"),
        ("min = 18", "points = 5", f"{items}[1].points: not a key of the form number"),
        ('options = ["robots", "games"]', 'options = ["robots"]', f"{items}[3].options: [\"robots\"]; expected two"),
        ('when = "before"', 'when = "soon"', "questionnaires[1].when: \"soon\"; expected \"before\" or \"after\" or"),
        ('when = "before"', 'when = "before"\npoints = 5', "questionnaires[1].points: not a key of the form choice"),
        ("correct = 4", "correct = 6", 'questionnaires[2].items[3].correct: 6; expected a whole number from 1 to 5'),
        ("points = 5", "points = 4", "questionnaires[2].items[1].labels: 5 labels; expected one for each of 4 points"),
        ('conditions = ["attention"]\nitems', 'conditions = ["alone"]\nitems', "questionnaires[3].conditions: 'alone'"),
        ('name = "ease"', 'name = "ease"\nwhen = "before"', "questionnaires[2].items[5].conditions: expected none"),
        ('max = 99 }', 'max = 99, reversed = true }', f"{items}[1].reversed: true; expected a likert item or a slider"),
    ]:  # fmt: skip
        with pytest.raises(InputFileError) as refused:
            study_of(tmp_path, WITH_FORMS.replace(right, wrong, 1))
        assert message in str(refused.value)
        assert str(refused.value).startswith(f"{tmp_path / 'study.toml'}:")
        assert "\n" not in str(refused.value)


def test_a_form_that_there_is_not_is_refused() -> None:
    for made in (lambda: Item("a", "?", "choises"), lambda: Questionnaire("choises")):
        with pytest.raises(DeclarationError, match="form: 'choises'; did you mean 'choices'"):
            made()


CHOICE = Item("a", "?", "choice", options=("x", "y"))
CHOICES = Item("a", "?", "choices", options=("x", "y"))
NUMBER = Item("a", "?", "number", min=0.5, max=2, step=0.1)
TEXT = Item("a", "?", "text", required=False)
LIKERT = Item("a", "?", "likert-grid", points=5)


@pytest.mark.parametrize(
    ("item", "right", "wrong"),
    [
        (CHOICE, ["x", "y"], ["z", "", None, 0, True, ["x"], {"x": 1}]),
        (CHOICES, [["x"], ["x", "y"]], [[], None, "x", ["z"], ["x", "x"], [["x"]], {"x": 1}]),
        (NUMBER, [0.5, 0.7, 1, 2], [0.55, 2.1, -1, "1", True, None, float("nan"), float("inf"), 10**400, [1]]),
        (TEXT, ["", "words", "=1+1"], [1, ["words"], "x" * 4001, False]),
        (LIKERT, [1, 5], [0, 6, 2.5, 3.0, "3", True, None]),
    ],
)
def test_only_answers_of_the_form_are_accepted(item: Item, right: list[Any], wrong: list[Any]) -> None:
    for answer in right:
        assert item.check(answer) == answer
    for answer in wrong:
        with pytest.raises(ValueError, match=r"^expected (one|a |a whole )"):
            item.check(answer)


JSON = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), st.lists, max_leaves=4)


@costly(10, 100)
@given(st.sampled_from([CHOICE, CHOICES, NUMBER, TEXT, LIKERT]), JSON)
def test_whatever_is_answered_is_accepted_or_refused_in_one_sentence(item: Item, answer: Any) -> None:
    try:
        found = item.check(answer)
    except ValueError as error:
        found, said = None, str(error)
    else:
        said = ""
        assert item.check(found) == found
    assert "\n" not in said
    score = item.score(found)
    assert score is None or item.ends[0] <= score <= item.ends[1]


def test_participants_see_the_questions_of_their_condition_in_an_order_of_their_own(opened: Open) -> None:
    session, orders = opened(WITH_FORMS), {}
    for name in ("ann", "bob", "cid", "dora"):
        part = Part(session, name)
        part.come()
        assert session.person(name)["study"]["items"] == []
        part.onward()
        part.onward()
        assert session.person(name)["study"]["items"] == list(BACKGROUND)
        with pytest.raises(ValueError, match=r"answers\.hand: expected one of the left, the right, both"):
            part.onward(BACKGROUND | {"hand": "none"})
        part.onward(BACKGROUND)
        part.to("questionnaire ease")
        orders[name] = session.person(name)["study"]["items"]
        told = session.cohort.participants[name].condition == "attention"
        assert ("hints" in orders[name]) == told
        with pytest.raises(ValueError, match=r"answers.\w+: expected a whole number from 1 to 5"):
            part.onward({"hints": 3} if told else {"reads": 4})
        part.onward(EASE | ({"hints": 3} if told else {}) | ({"reads": 3} if name == "ann" else {}))
        assert part.stage == ("questionnaire trust-now" if told else "thanks")  # others never see it
        if told:
            part.onward({"now": 70})
    assert len({tuple(order) for order in orders.values()}) >= 3
    before = {name: session.person(name) for name in orders}
    found = tables(session.study, session.folder / JOURNAL)
    session.close()
    again = opened(WITH_FORMS)
    assert {name: again.person(name) for name in orders} == before
    for name, order in orders.items():
        own = [row for row in found.answers if (row["participant"], row["questionnaire"]) == (name, "ease")]
        assert [row["item"] for row in own] == order
        assert [row["position"] for row in own] == list(range(1, len(order) + 1))

    # One row for each answer, and for each option of several choices.
    exported = {name: list(csv.DictReader(io.StringIO(text))) for name, text in files(session.folder)
                if name.endswith(".csv")}  # fmt: skip
    ann = [row for row in exported["answers.csv"] if row["participant"] == "ann"]
    given = {(row["item"], row["option"]): (row["answer"], row["score"], row["passed"]) for row in ann}
    assert given["age", ""] == ("30", "30", "")
    assert given["height", ""] == ("1.75", "1.75", "")
    assert given["hand", ""] == ("both", "", "")
    assert (given["used", "robots"], given["used", "games"]) == (("false", "", ""), ("true", "", ""))
    assert (given["lost", ""], given["reads", ""], given["calm", ""]) == (
        ("2", "4", ""),
        ("3", "3", "false"),
        ("",) * 3,
    )
    assert {row["item"]: row["form"] for row in exported["items.csv"]}["used"] == "choices"

    # Who fails an attention check is excluded, as the study's file says; the check is in no score.
    people = {row["participant"]: row for row in found.participants}
    assert people["ann"]["excluded"] == "failed 1 or more attention checks"
    assert (people["ann"]["failed_checks"], people["bob"]["failed_checks"]) == (1, 0)
    summary = summarise(session.study, found)
    ease = next(one for one in summary["measures"] if one["measure"] == "ease")
    assert sum(cell["n"] for cell in ease["cells"]) == 3
    assert {cell["mean"] for cell in ease["cells"]} == {4.5}  # of clear and lost, which are asked in all conditions
    assert summary["participants"]["excluded"] == {"failed 1 or more attention checks": 1}
    asked = {(one["item"], one["condition"]): one for one in summary["answers"]}
    assert asked["hand", "all participants"]["counts"] == {"the left": 0, "the right": 0, "both": 3}
    assert asked["used", "all participants"]["counts"] == {"robots": 0, "games": 3}
    assert asked["age", "all participants"]["mean"] == 30
    assert (asked["hints", "attention"]["mean"], asked["hints", "none"]["n"]) == (3, 0)


def test_the_pages_learn_neither_conditions_nor_right_answers(tmp_path: Path) -> None:
    told = json.dumps(form_of(study_of(tmp_path)))
    assert "condition" not in told
    assert "correct" not in told


def test_within_participants_what_is_asked_once_is_asked_once(tmp_path: Path) -> None:
    text = WITH_FORMS.replace("seed = 3", 'seed = 3\ndesign = "within"')
    text = text.replace('conditions = ["attention"]\nitems', 'when = "end"\nitems')
    assert [stage.name for stage in study_of(tmp_path, text).stages] == [
        "consent", "instructions", "questionnaire background", "practice", "task tiny 1", "questionnaire ease 1",
        "task tiny 2", "questionnaire ease 2", "questionnaire trust-now", "thanks",
    ]  # fmt: skip


def test_the_page_describes_every_key_and_its_example_is_accepted(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "forms.md").read_text()
    example = page.split("```toml\n")[1].split("```")[0]
    assert [one.name for one in study_of(tmp_path, PLAIN + "\n" + example).questionnaires] == ["background"]
    keys = {*names_of(Item), *names_of(Questionnaire)}
    assert [key for key in keys - {"name", "text", "form"} if f"`{key}`" not in page] == []


@pytest.mark.slow
def test_all_forms_can_be_answered_in_a_browser(chromium: Any, tmp_path: Path) -> None:
    """With keyboard and mouse, on a desktop and a phone."""
    text = WITH_FORMS.replace('when = "before"\n', "")
    ease = text[text.index('form = "likert-grid"') : text.index('[[questionnaires]]\nform = "slider"')]
    # Everything is asked before the task.
    text = text.replace(ease, ease.replace('name = "ease"', 'name = "ease"\nwhen = "before"'))
    text = text.replace(', conditions = ["attention"] }', " }").replace('conditions = ["attention"]\n', "")
    text = text.replace('name = "background"', 'name = "background"\nwhen = "before"')
    text = text.replace('name = "trust-now"', 'name = "trust-now"\nwhen = "before"')
    file = written(tmp_path / "study.toml", text)
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    page, faults = context.new_page(), list[str]()
    page.on("pageerror", lambda error: faults.append(str(error)))

    def is_well(name: str) -> None:
        for width, height, dark in ((1280, 800, True), (360, 740, False)):
            page.set_viewport_size({"width": width, "height": height})
            page.screenshot(path=tmp_path / f"{name}-{width}.png", full_page=True)
            assert violations(page, dark=dark) == []
            assert page.evaluate("document.documentElement.scrollWidth") <= width

    with served("--study", file, "--data", tmp_path / "data", instance=None) as study:
        page.goto(study.links["everybody"])
        page.click("text=I agree and take part")
        page.click('h2:text("What you will do") ~ form >> button')
        page.wait_for_selector('h2:text("About you")')
        page.click('button:text("Continue")')
        assert page.locator(".error:visible").all_inner_texts() == ["Please answer this question."] * 2
        is_well("missing")
        age = page.locator('[id="item age"] input')
        age.fill("17")
        page.check('text="the left"')
        page.check('text="games"')
        page.click('button:text("Continue")')
        assert page.locator(".error:visible").all_inner_texts() == ["Please enter a number from 18 to 99."]
        age.fill("42.000")  # forty-two to some, and 42,000 to others
        page.click('button:text("Continue")')
        assert page.locator(".error:visible").all_inner_texts() == ["Please enter a number from 18 to 99."]
        age.fill("42")
        page.locator('[id="item height"] input').fill("1,8")
        page.reload()  # answers survive a reload
        assert page.locator('[id="item age"] input').input_value() == "42"
        is_well("background")
        page.route("**/onward", lambda route: route.abort())
        page.click('button:text("Continue")')
        age.and_(page.locator(":disabled")).wait_for()  # what is being sent cannot be changed
        page.reload()
        age.and_(page.locator(":disabled")).wait_for()
        page.unroute("**/onward")
        page.wait_for_selector('[id="item clear"]')
        for name, value in (("clear", 5), ("lost", 1), ("reads", 4), ("calm", 2), ("hints", 3)):
            page.locator(f'[name="item {name}"][value="{value}"]').check()
        page.click('[id="item calm"] button')  # taken back
        is_well("grid")
        page.click('button:text("Continue")')
        page.wait_for_selector('[id="item now"]')
        page.locator('[id="item now"] input').press("ArrowRight")
        is_well("slider")
        page.click('button:text("Continue")')
        page.wait_for_selector('h1:text("Practice")')
        study.end()
    context.close()
    found = tables(read(file), tmp_path / "data" / JOURNAL).answers
    answers = {(row["item"], row["option"]): row["answer"] for row in found}
    assert answers == {
        ("age", None): 42, ("hand", None): "the left", ("used", "robots"): False, ("used", "games"): True,
        ("height", None): 1.8, ("clear", None): 5, ("lost", None): 1, ("reads", None): 4, ("calm", None): None,
        ("hints", None): 3, ("now", None): 60,
    }  # fmt: skip
    assert faults == []


@pytest.mark.slow
def test_simulated_participants_answer_all_forms(tmp_path: Path) -> None:
    file = written(tmp_path / "study.toml", WITH_FORMS.replace("seed = 3", "seed = 3\nparticipants = 4"))
    assert invoke("serve", "--study", file, "--rehearse", 4, "--data", tmp_path / "data", "--port", 0).exit_code == 0
    report = (tmp_path / "data" / "report" / "report.md").read_text()
    assert "| How old are you? | all participants | 4 |" in report
    assert "| Mark often here. | none | 2 | 2 of 2 passed this attention check |" in report
    assert "attention checks" not in report.partition("## Conditions")[0]  # nobody failed any
