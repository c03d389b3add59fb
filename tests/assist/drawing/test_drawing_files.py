"""Plans, traces and states as input files of drawings, and drawings as output files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import ROOT, invoke, kit
from hypothesis import given
from hypothesis import strategies as st

from assist.drawing import Artist, draw, draw_strip, episode_frames, plan_frames, read_state
from planner.system.errors import InputFileError

TINY = kit("tiny")
ARTIST = Artist(TINY.task)
PLAN = TINY.optimal_plan() or []
FETCHED = ["(on-platform box-a)", "(in-storage box-b)", "(contains box-a hammer)", "(contains box-b wrench)",
           "(slot-free slot-1)", "(slot-free slot-2)"]  # fmt: skip


def called(action: str) -> str:
    name, *arguments = action.strip("()").split()
    return f"{name}({', '.join(arguments)})"


def test_plans_are_drawn_as_other_planners_print_them(tmp_path: Path) -> None:
    wanted = plan_frames(ARTIST, PLAN)
    for form in (
        [called(a) for a in PLAN],
        [a.strip("()").upper() for a in PLAN],
        [a.replace("slot-1 box-a)", "slot-1)") for a in PLAN],
    ):
        assert plan_frames(ARTIST, form) == wanted
    (tmp_path / "plan.txt").write_text("SequentialPlan:\n" + "".join(f"    {called(a)}\n" for a in PLAN))
    found = invoke("draw", "kitting/tiny", "--plan", tmp_path / "plan.txt", "--out", tmp_path / "plan.svg", "--json")
    assert json.loads(found.stdout)["frames"] == len(PLAN) + 1
    assert (tmp_path / "plan.svg").read_text() == draw_strip(ARTIST, wanted).svg
    (tmp_path / "plan.txt").write_text("(fetch box-a\n")
    found = invoke("draw", "kitting/tiny", "--plan", tmp_path / "plan.txt", "--out", tmp_path / "plan.svg")
    assert "plan.txt: step 0: (fetch box-a opens 1 and closes 0 brackets" in found.stderr


def test_episodes_are_drawn_in_every_form() -> None:
    rows = [
        {"person": "ann", "episode": "1", "step": n, "action": action, "suggestion": PLAN[n] if n < 2 else None}
        for n, action in enumerate(PLAN)
    ]
    other = [
        dict(row, action=called(row["action"]), suggestion=row["suggestion"] and called(row["suggestion"]))
        for row in rows
    ]
    assert episode_frames(ARTIST, other) == episode_frames(ARTIST, rows)
    assert [frame.advice.endswith("(followed)") for frame in episode_frames(ARTIST, other)[0]][:3] == [
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(FETCHED),
        " ".join(FETCHED).upper(),
        "\n".join(map(called, FETCHED)),
        f"; after the first action\n(:init {' '.join(FETCHED)} (fits hammer slot-1) (= (total-cost) 0))",
        f"(and {' '.join(FETCHED)} (not (platform-free)))",
        f"; a problem\n(define (problem p) (:domain kitting)\n (:init {' '.join(FETCHED)}) (:goal (and)))",
        json.dumps(FETCHED),
        json.dumps([called(fact) for fact in FETCHED], indent=1),
        json.dumps(TINY.space.facts(TINY.space.follow([PLAN[0]]))),  # as records of `fit` have them
    ],
    ids=[str(n) for n in range(9)],
)
def test_a_state_is_read_in_every_form(tmp_path: Path, text: str) -> None:
    file = tmp_path / "state"
    file.write_text(text)
    values = ARTIST.subject.follow(PLAN[:1])[-1]
    assert read_state(file, ARTIST.subject) == values
    out = tmp_path / "state.svg"
    assert invoke("draw", "kitting/tiny", "--state", file, "--out", out).exit_code == 0
    assert out.read_text() == ARTIST.draw(values).svg


@given(st.data())
def test_every_state_is_read_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    state = data.draw(st.integers(0, len(TINY) - 1))
    values = TINY.values([state])[0].tolist()
    facts = [f"({' '.join(fact)})" for fact in ARTIST.subject.facts(values)]
    file = tmp_path_factory.mktemp("state") / "state.pddl"
    file.write_text("\n".join(data.draw(st.permutations(facts))))
    assert read_state(file, ARTIST.subject) == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n".join(FETCHED).replace("(in-storage", "(in-strage"),
         ":2: (in-strage box-b) is no fact of the task; did you mean (in-storage box-b)?"),
        ("\n".join([*FETCHED, "(platform-free)"]),
         ":7: (platform-free) cannot hold together with (on-platform box-a) on line 1"),
        ("\n".join(FETCHED[:-1]),
         ": too few facts; expected one of (in-slot hammer slot-2), (in-slot wrench slot-2), (slot-free slot-2)"),
        ("\n".join(FETCHED)[:-1], ":1: ')' is missing between here and the end of the file"),
        ("(on-platform box-a)\non-platform", ":2: on-platform; expected a fact, (predicate argument ...)"),
        ("(on-platform (box-a))", ":1: (on-platform (box-a)); expected a fact, (predicate argument ...)"),
        ("(define (problem p))", ": there is no (:init ...)"),
        ("[1]", ": 1; expected a fact as text"),
        ('["(on-platform box-a)",\n "(in-strage box-b)"]', ":2: (in-strage box-b) is no fact of the task"),
        ("[\n", ":2: not JSON; expected a list of facts"),
    ],
    ids=[str(n) for n in range(10)],
)  # fmt: skip
def test_states_that_cannot_be_are_refused_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "state"
    file.write_text(text)
    with pytest.raises(InputFileError) as error:
        read_state(file, ARTIST.subject)
    assert str(error.value).startswith(f"{file}{message}")
    found = invoke("draw", "kitting/tiny", "--state", file, "--out", tmp_path / "a.svg")
    assert (found.exit_code, found.stderr) == (1, f"{error.value}\n")


def test_an_episode_shows_how_probable_each_goal_was(tmp_path: Path) -> None:
    kits = ROOT / "docs" / "examples" / "kits"
    actions = ("(fetch box-a)", "(place hammer slot-1 box-a)", "(return box-a)", "(fetch box-c)")
    rows = [{"person": "ann", "episode": "one", "step": n, "action": action} for n, action in enumerate(actions)]
    trace, out = tmp_path / "trace.jsonl", tmp_path / "episode.svg"
    trace.write_text("".join(json.dumps(row) + "\n" for row in rows))
    options = ["draw", kits / "travel.pddl", "--goals", kits, "--log", trace, "--out", out]
    assert invoke(*options).exit_code == 0
    shown = [set(text.split(", ")) for text in re.findall(">goal: ([^<]+)<", out.read_text())]
    each = [{"travel 33%", "mend 33%", "mount 33%"}] * 2 + [{"travel 49%", "mend 49%", "mount 3%"}]
    assert shown == [*each, {"travel 50%", "mend 50%", "mount 0%"}, {"travel 97%", "mend 3%", "mount 0%"}]
    assert "Goal:" not in out.read_text()  # that of the instance is one of several
    refused = invoke(*options[:-4], "--out", out)
    assert (refused.exit_code, "expected --log as well" in refused.stderr) == (2, True)


def test_a_picture_is_saved_in_the_format_that_its_name_asks_for(tmp_path: Path) -> None:
    picture = draw(TINY.task)
    picture.save(tmp_path / "a.svg")
    assert (tmp_path / "a.svg").read_text() == picture.svg
    picture.save(str(tmp_path / "a.PNG"))
    ARTIST.draw(theme="light").save(tmp_path / "light.png")
    invoke("draw", "kitting/tiny", "--out", tmp_path / "command.png")
    same = (tmp_path / "light.png").read_bytes()
    assert (tmp_path / "a.PNG").read_bytes() == same == (tmp_path / "command.png").read_bytes()
    draw_strip(ARTIST, plan_frames(ARTIST, PLAN)).save(tmp_path / "strip.png")
    assert len((tmp_path / "strip.png").read_bytes()) > 2 * len(same)
    for name in ("a.jpg", "a", "a.html"):
        with pytest.raises(ValueError, match=r"expected a name that ends in \.svg or \.png"):
            picture.save(tmp_path / name)
    assert repr(picture).startswith(
        f"<Picture of {picture.width:.0f} x {picture.height:.0f} pixels: box-a in storage; "
    )
