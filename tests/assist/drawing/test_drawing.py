"""Drawings: every object is shown, the goal is marked, and equal states give equal bytes."""

from __future__ import annotations

import json
import re
import shutil
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import DOMAINS, KITTING, ROOT, invoke, thinned
from PIL import Image

from assist.declare import catalogue
from assist.drawing import Artist, Profile, draw, draw_frames, draw_strip, episode_frames, plan_frames, read_state
from assist.drawing.files import page
from assist.drawing.frames import episode_of
from assist.drawing.profile import guess
from assist.drawing.subject import Subject
from planner import InputFileError, load
from planner.grounding.fast_downward import optimal_plan

SVG = "{http://www.w3.org/2000/svg}"
INSTANCES = [
    "kitting/paper", "kitting/costs/ways", "stations/two-benches", "lockers/two-lockers", "gripper/balls-03",
    "blocks/blocks-4", "delivery/three-parcels", "depot/two-boxes", "tower/swap", "stock/refill", "timed/cell",
]  # fmt: skip


@cache
def artist(name: str) -> Artist:
    return Artist(load(DOMAINS / f"{name}.pddl"))


def copied(folder: Path) -> Path:
    """Copy a kit and its domain to a folder, where it has no look; return the file of the kit."""
    for file in ("domain.pddl", "tiny.pddl"):
        shutil.copy(KITTING / file, folder)
    return folder / "tiny.pddl"


def objects_in(svg: str) -> list[str]:
    return [
        node.attrib["data-object"]
        for node in ElementTree.fromstring(svg).iter(f"{SVG}g")
        if "data-object" in node.attrib
    ]


def written_on(svg: str, name: str) -> list[str]:
    node = next(n for n in ElementTree.fromstring(svg).iter(f"{SVG}g") if n.attrib.get("data-object") == name)
    return [text.text or "" for text in node.iter(f"{SVG}text")]


@pytest.mark.parametrize("guessed", thinned([False, True]))
@pytest.mark.parametrize("name", INSTANCES)
def test_pictures_of_a_plan_show_each_object_once_and_the_goal(name: str, guessed: bool) -> None:
    drawn = artist(name)
    if guessed:
        drawn = Artist(drawn.subject.task, guess(drawn.subject))
    task, subject = drawn.subject.task, drawn.subject
    shown = sorted(one for one in subject.objects if not drawn.profile.look(subject, one).hidden)
    for values in subject.follow(optimal_plan(task.sas) or ()):
        picture = drawn.draw(values)
        assert sorted(objects_in(picture.svg)) == shown
        root = ElementTree.fromstring(picture.svg)
        assert root.attrib["role"] == "img"
        assert root.find(f"{SVG}title") is not None
        assert root.findtext(f"{SVG}desc") == picture.text
        for rectangle in root.iter(f"{SVG}rect"):  # nothing is drawn outside
            for start, size, whole in (("x", "width", picture.width), ("y", "height", picture.height)):
                assert float(rectangle.attrib[start]) >= 0
                assert float(rectangle.attrib[start]) + float(rectangle.attrib[size]) <= whole + 0.1
        reached, parts = sum(values[variable] == value for variable, value in task.goal), len(task.goal)
        assert sum(done for _, done in drawn.scene(values).goal) == reached  # no part of these goals always holds
        below = picture.svg.rpartition("Goal: ")[2]
        assert below.startswith(f"{reached} of {parts}<")
        assert (below.count('class="ka-tick"'), below.count('class="ka-ring"')) == (reached, parts - reached)
    assert reached == parts
    if not guessed:
        in_german(drawn)


def in_german(english: Artist) -> None:
    german = Artist(english.subject.task, language="de")
    picture = german.draw()
    assert (german.profile.language, english.profile.language, "Ziel: " in picture.text) == ("de", "en", True)
    assert '<svg xmlns="http://www.w3.org/2000/svg" class="ka" role="img" lang="de"' in picture.svg
    assert objects_in(picture.svg) == objects_in(english.draw().svg)
    actions = [action for action in english.subject.task.actions if english.has_words(action)]
    assert actions
    assert all(german.say(action) != english.say(action) for action in actions)


def test_the_example_of_a_domain_of_ones_own_is_drawn_in_german() -> None:
    in_german(Artist(load(ROOT / "docs" / "examples" / "shelf" / "bookshelf.pddl")))


def test_things_are_drawn_where_they_are() -> None:
    drawn = artist("kitting/paper")
    start = drawn.draw().svg
    assert written_on(start, "box-a") == ["box-a", "hammer", "pliers"]
    assert written_on(start, "slot-1") == ["slot-1", "hammer"]  # the wanted item
    after = drawn.draw(drawn.subject.follow(["(fetch box-a)", "(place pliers slot-1 box-a)"])[-1]).svg
    assert written_on(after, "box-a") == ["box-a", "hammer"]
    assert written_on(after, "slot-1") == ["slot-1", "hammer", "pliers"]
    assert "ka-done" not in re.search(r'<g class="([^"]*)" data-object="pliers"', after)[1]  # type: ignore[index]


BOXES = """(define (domain boxes) (:predicates (box ?b) (part ?p) (in ?p ?b) (sealed ?b) (lies ?p) (open ?b))
  (:action put :parameters (?p ?b) :precondition (and (part ?p) (box ?b) (lies ?p) (open ?b))
   :effect (and (in ?p ?b) (not (lies ?p))))
  (:action seal :parameters (?b) :precondition (and (box ?b) (open ?b)) :effect (and (sealed ?b) (not (open ?b))))
  (:action unseal :parameters (?b) :precondition (sealed ?b) :effect (and (open ?b) (not (sealed ?b)))))"""
ONE_BOX = """(define (problem one-box) (:domain boxes) (:objects bin nut cap)
  (:init (box bin) (part nut) (part cap) (lies nut) (lies cap) (open bin))
  (:goal (and (sealed bin) GOAL)))"""


@pytest.mark.parametrize("goal", ["(in nut bin) (in cap bin)", "(forall (?p) (imply (part ?p) (in ?p bin)))"])
@pytest.mark.parametrize("guessed", [True, False])
def test_a_frame_is_green_when_all_parts_of_the_goal_that_name_the_object_hold(
    tmp_path: Path, goal: str, guessed: bool
) -> None:
    (tmp_path / "domain.pddl").write_text(BOXES)
    (tmp_path / "one-box.pddl").write_text(ONE_BOX.replace("GOAL", goal))
    if not guessed:
        (tmp_path / "drawing.toml").write_text('[places]\nin = "?1 in ?2"\n[marks]\nsealed = "?1 sealed"\n')
    drawn = Artist(load(tmp_path / "one-box.pddl"))

    def green(*plan: str) -> set[str]:
        content = drawn.draw(drawn.subject.follow(plan)[-1]).svg
        found = re.findall(r'<g class="([^"]*)" data-object="([^"]*)"', content)
        return {name for classes, name in found if "ka-done" in classes}

    parts = {"nut", "cap"} if goal.startswith("(in") else set()  # the other goal does not name its parts
    assert green() == set()
    assert green("(seal bin)") == set()  # it is empty
    assert green("(put nut bin)", "(seal bin)") == parts & {"nut"}
    assert green("(put nut bin)", "(put cap bin)") == parts
    assert green("(put nut bin)", "(put cap bin)", "(seal bin)") == parts | {"bin"}


def test_towers_stand_on_each_other() -> None:
    drawn = artist("blocks/blocks-5")
    tops = {
        node.attrib["data-object"]: float(node[0].attrib["y"])
        for node in ElementTree.fromstring(drawn.draw().svg).iter(f"{SVG}g")
        if "data-object" in node.attrib
    }
    assert tops["c"] < tops["b"] < tops["a"]
    assert tops["a"] == tops["d"] > tops["e"]


@pytest.mark.parametrize("name", ["stations/two-benches", "depot/two-boxes"])
def test_the_same_state_gives_the_same_bytes(name: str) -> None:
    again = Artist(load(DOMAINS / f"{name}.pddl"))
    again.draw(width=400)  # what was drawn before does not matter
    assert again.draw().svg == artist(name).draw().svg == draw(again.subject.task).svg


def test_what_words_say() -> None:
    drawn = artist("kitting/paper")
    assert drawn.say("(place hammer slot-1 box-a)") == "Put hammer into slot-1"
    assert artist("depot/two-boxes").say("(lift box-a box-b)") == "Lift box-a off box-b"
    plain = Artist(artist("depot/two-boxes").subject.task, Profile())
    assert plain.say("(lift box-a box-b)") == "lift box-a, box-b"
    assert drawn.draw().text.startswith("box-a in storage; ")
    assert "Goal: 3 of 7 done. Open: hammer in slot-1;" in drawn.draw().text


def test_objects_without_types_are_known_by_what_always_holds_of_them() -> None:
    drawn = artist("depot/two-columns")
    shape = {name: drawn.profile.look(drawn.subject, name).shape for name in ("box-a", "kind-a", "pallet-1", "bench")}
    assert shape == {"box-a": "crate", "kind-a": "chip", "pallet-1": "block", "bench": "block"}
    assert "n0" not in objects_in(drawn.draw().svg)
    plan = ["(lift box-a box-b)", "(put box-a bench)", "(take kind-a box-a bench n1 n2 n0 n1)"]
    states = drawn.subject.follow([*plan, "(show kind-a column-2 n0 n1 n0 n1)"])
    assert written_on(drawn.draw(states[0]).svg, "kind-a") == ["kind-a", "stock: n2", "tray: n0"]
    assert written_on(drawn.draw(states[3]).svg, "kind-a") == ["kind-a", "stock: n1", "tray: n1"]
    assert ("column-2 n1: kind-a", True) in drawn.scene(states[4]).goal
    assert "column-2 in display, n1: kind-a" in drawn.draw(states[4]).text


def test_every_shipped_domain_has_a_drawing_and_is_among_those_tested() -> None:
    shipped = {file.parent for file in DOMAINS.rglob("domain.pddl")}
    assert [folder for folder in shipped if not (folder / "drawing.toml").is_file()] == []
    assert {(DOMAINS / name).parent for name in INSTANCES} == shipped - {KITTING / "paper"}


GERMAN = (KITTING / "drawing.toml").read_text(encoding="utf-8")


def test_a_drawing_without_the_language_stays_in_its_own(tmp_path: Path) -> None:
    """All its texts then have one language, which is named."""
    tiny = copied(tmp_path)
    english, german = GERMAN.split("[texts.de]")[0], GERMAN
    french = tmp_path / "fr-CA.toml"
    shutil.copy(catalogue("en").file, french)
    for content, asked, language, heading in (
        (english, "de", "en", "Goal: "),
        (german, str(french), "en", "Goal: "),
        (f'language = "de"\n{english}', "en", "de", "Ziel: "),
        (german.replace("texts.de", "texts.fr"), str(french), "fr", "Goal: "),  # a variety of the language
        ("", "de", "de", "Ziel: "),  # there is nothing to translate
    ):
        (tmp_path / "drawing.toml").write_text(content, encoding="utf-8")
        drawn = Artist(load(tiny), language=asked)
        assert (drawn.profile.language, heading in drawn.draw().text) == (language, True)


def test_goals_that_are_no_list_of_facts(tmp_path: Path) -> None:
    shutil.copy(KITTING / "domain.pddl", tmp_path)
    text = (KITTING / "tiny.pddl").read_text().replace(":strips", ":adl")
    goal = (
        "(:goal (and (forall (?c - container) (in-storage ?c)) (or (in-slot hammer slot-1) (in-slot hammer slot-2))))))"
    )
    (tmp_path / "p.pddl").write_text(text[: text.index("(:goal")] + goal[:-1])
    drawn = Artist(load(tmp_path / "p.pddl"))
    states = drawn.subject.follow(["(fetch box-a)", "(place hammer slot-2 box-a)", "(return box-a)"])
    assert not all(done for _, done in drawn.scene(states[2]).goal)
    assert all(done for _, done in drawn.scene(states[3]).goal)


FOREIGN = """(define (domain odd)
  (:requirements :adl :derived-predicates)
  (:predicates (box ?x) (room ?x) (in ?x ?y) (moved ?x) (free ?x))
  (:derived (free ?y) (not (exists (?x) (in ?x ?y))))
  (:action bring :parameters (?x ?y ?z) :precondition (and (box ?x) (in ?x ?y) (free ?z) (not (= ?y ?z)))
    :effect (and (in ?x ?z) (not (in ?x ?y)) (moved ?x))))"""
ODD = """(define (problem p) (:domain odd) (:objects a b c x)
  (:init (box x) (room a) (room b) (room c) (in x a)) (:goal (and (in x c) (moved x))))"""


def test_tasks_with_derived_facts_are_drawn(tmp_path: Path) -> None:
    (tmp_path / "domain.pddl").write_text(FOREIGN)
    (tmp_path / "p.pddl").write_text(ODD)
    for profile in ("", "[places]\nin = '?1 in ?2'\n[types]\nroom = {shape = 'panel'}"):
        if profile:
            (tmp_path / "drawing.toml").write_text(profile)
        drawn = Artist(load(tmp_path / "p.pddl"))
        before, after = (drawn.draw(values) for values in drawn.subject.follow(["(bring x a c)"]))
        assert sorted(objects_in(after.svg)) == ["a", "b", "c", "x"]
        assert "Goal: 0 of 2" in before.text
        assert "Goal: 2 of 2" in after.text
        assert "axiom" not in after.svg
    moved = drawn.subject.follow(["(bring x a c)"])[-1]
    for derived in ("", "(free a) (free b)", "(free c)"):  # derived facts in a file are ignored
        (tmp_path / "state").write_text(f"(in x c) (moved x) {derived}")
        assert read_state(tmp_path / "state", drawn.subject) == moved


def test_tasks_whose_files_are_gone_are_drawn(tmp_path: Path) -> None:
    tiny = copied(tmp_path)
    task = load(tiny)
    shutil.rmtree(tmp_path)
    assert {"box-a", "hammer", "slot-1"} <= set(objects_in(draw(task).svg))


WRONG = {
    "[places]\nin-slot = 'somewhere'": "places.in-slot: \"somewhere\"; expected something like '?1 in ?2'",
    "[places]\nin-slot = '?1 in kit'": "'kit' is not among [things]",
    "[places]\nin-slot = '?3 in ?2'": "?3; the predicate has 2 arguments",
    "[types]\nslot = {shape = 'hexagon'}": 'types.slot.shape: "hexagon"; expected "chip" or "crate"',
    "[types]\nslot = {of = 'fits'}": 'types.slot.of: "fits"; expected something like',
    "[marks]\nin-slot = '?1 in ?3'": "?3; the predicate has 2 arguments",
    "[types]\nslot = 3": "types.slot: 3; expected a table",
    "[types]\nslot = {shape = 3}": 'types.slot.shape: 3; expected "chip" or',
    "[colors]\n": "colors: unknown; did you mean 'colours'?",
    "[words]\nfetch = 3": "words.fetch: 3; expected a text",
    "[hide]\npredicates = 3": "hide.predicates: 3; expected a list of predicates",
    "[hide]\nobjects = []": "hide.objects: unknown; ",
    "nothing": "drawing.toml:1: ",
    # Names that the domain does not have: what is misspelt would be left out of pictures without a word.
    "[words]\nfetsh = 'Fetch ?c'": ":2: words.fetsh: there is no action 'fetsh'; did you mean 'fetch'?",
    "[words]\nplace = 'Put ?x away'": "words.place: there is no parameter '?x'; expected one of ?i, ?s, ?c",
    "[marks]\nslot-fre = '?1 free'": ":2: marks.slot-fre: there is no predicate 'slot-fre'; did you mean",
    "[places]\nin-slot = '?1 in ?2.tray'": "there is no part 'tray'; there is none",
    "[marks]\nfits = '?1 fits, sise'": "marks.fits: there is no function 'sise'; ",
    "[types]\nitme = {shape = 'chip'}": "types.itme: there is no type 'itme'; did you mean 'item'?",
    "[types]\nall = {of = 'fit ?1'}": "types.all.of: there is no predicate 'fit'; did you mean 'fits'?",
    "[types]\nslot = {in = 'kti'}\n[things]\nkit = {}": "types.slot.in: there is no thing 'kti'; did you mean",
    "[hide]\npredicates = ['fits', 'slot-fre']": "hide.predicates[2]: there is no predicate 'slot-fre'; ",
    # Texts of a language, also where nobody asks for it.
    GERMAN.replace('"Kit" = "Bausatz"', ""): "texts.de: 'Kit': there is none; expected a text",
    GERMAN.replace('"Kit" = "Bausatz"', '"Kit" = 3'): "texts.de.Kit: 3; expected a text",
    GERMAN.replace('"?i in ?s legen"', '"?i in ?x"'): "'?i in ?x'; expected a text with ?i and ?s",
    GERMAN.replace('"Kit" = "Bausatz"', '"Box" = "Kiste"\n"Kit" = "Satz"'): "'Box' is none of this file's titles",
    GERMAN.replace("[texts.de]", '[texts]\nde = "x"\n[texts.fr]'): 'texts.de: "x"; expected a table',
    GERMAN.replace("[things]", "language = 3\n[things]"): "language: 3; expected a language's tag, such as 'de'",
}


@pytest.mark.cases
def test_a_wrong_drawing_toml_is_said_in_one_line(tmp_path: Path) -> None:
    tiny = copied(tmp_path)
    subject = Subject.of(load(tiny))
    for text, words in WRONG.items():
        (tmp_path / "drawing.toml").write_text(text, encoding="utf-8")
        with pytest.raises(InputFileError, match=re.escape(words)) as error:
            Profile.of(subject)
        assert "drawing.toml" in str(error.value)
    result = invoke("draw", tiny, "--out", tmp_path / "a.svg")
    assert (result.exit_code, result.output.count("\n")) == (1, 1)
    assert not (tmp_path / "a.svg").exists()


PLAN = [
    "(fetch box-a)", "(place hammer slot-1 box-a)", "(return box-a)", "(fetch box-b)", "(place wrench slot-2 box-b)",
    "(return box-b)",
]  # fmt: skip
TRACE = [
    {"person": "ann", "episode": "one", "step": 0, "action": "(fetch box-b)", "suggestion": "(fetch box-a)"},
    {"person": "bob", "episode": "one", "step": 0, "action": "(fetch box-a)", "suggestion": None},
    {"person": "ann", "episode": "one", "step": 1, "action": "(return box-b)", "suggestion": "(return box-b)"},
    {"person": "ann", "episode": "two", "step": 0, "action": "(fetch box-a)", "suggestion": None},
]


def test_strips_and_animations_have_a_frame_for_each_step() -> None:
    drawn = artist("kitting/tiny")
    frames = plan_frames(drawn, PLAN)
    strip = draw_strip(drawn, frames)
    assert len(re.findall('class="ka-step"', strip.svg)) == len(PLAN) + 1
    assert objects_in(strip.svg).count("hammer") == len(PLAN) + 1
    pictures = draw_frames(drawn, frames)
    assert len({(p.width, p.height) for p in pictures}) == 1
    assert [p.text for p in pictures][1] == "Step 2 of 6: Put hammer into slot-1"
    html = page(drawn, draw_frames(drawn, frames, theme=None))
    assert html.count("<figure") == len(PLAN) + 1
    assert not re.search(r"(src|href)=|url\(|https?://(?!www\.w3\.org/2000/svg)", html)


def test_an_episode_shows_the_robot_and_what_it_said() -> None:
    rows = episode_frames(artist("kitting/tiny"), TRACE)
    assert [len(row) for row in rows] == [3, 3]
    first, second, _ = rows[0]
    assert (first.robot, first.advice) == (True, "robot: Fetch box-a onto the platform (not followed)")
    assert second.advice == "robot: Return box-b to storage (followed)"
    assert rows[1][1].done == "has finished"
    strip = draw_strip(artist("kitting/tiny"), rows).svg
    assert strip.count("ka-here") == 2 + 1
    said = re.findall('class="ka-said">([^<]+)<', strip)
    assert " ".join(said) == f"{first.advice} {second.advice}"  # lines of a frame's width


def test_an_episode_in_which_the_robot_acts_itself_is_drawn(tmp_path: Path) -> None:
    """People act in the states that the robot's actions led to, and every episode ends in the goal."""
    trace = tmp_path / "trace.jsonl"
    arguments = (
        "simulate kitting/tiny --humans 2 --policy attention --episodes 3 --set execute=true "
        "--set c_execute=0.01 --c-suggest 5 "
        f"--trace {trace}"
    )
    assert invoke(*arguments.split()).exit_code == 0
    trace_rows = [json.loads(line) for line in trace.read_text().splitlines()]
    executed = {(row["episode"], row["person"], row["step"]): row for row in trace_rows if row["executed"]}
    assert executed
    drawn = artist("kitting/tiny")
    for episode in {row["episode"] for row in trace_rows}:
        for frames in episode_frames(drawn, trace_rows, episode):
            facts = drawn.subject.facts(frames[-1].values)
            assert all(drawn.subject.holds(one, facts, frames[-1].values) for one in drawn.subject.goal)
            person = frames[0].title.split(",")[0]
            for step, frame in enumerate(frames[:-1]):
                row = executed.get((episode, person, step))
                assert frame.advice.startswith("robot does: ") == (row is not None)
                assert row is None or frame.robot
    plain = [{key: row[key] for key in ("person", "episode", "step", "action", "executed")} for row in trace_rows]
    assert [row[-1].values for row in episode_frames(drawn, plain)] == [
        row[-1].values for row in episode_frames(drawn, trace_rows)
    ]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"step": None}, "ann, one: step null; expected a whole number in every row"),
        ({"step": "first"}, 'ann, one: step "first"; expected a whole number in every row'),
        ({"step": 0}, "ann, one, step 0: in two rows; are these two episodes, or two people?"),
    ],
)
def test_rows_without_a_step_of_their_own_are_not_drawn(change: dict, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        episode_frames(artist("kitting/tiny"), [*TRACE[:2], TRACE[2] | change])


def test_draw_writes_every_format(tmp_path: Path) -> None:
    (tmp_path / "a.plan").write_text("\n".join([*PLAN, "; cost = 6"]))
    (tmp_path / "t.jsonl").write_text("".join(json.dumps(row) + "\n" for row in TRACE))
    command = ("draw", "kitting/tiny", "--json", "--out")
    for ending in ("svg", "png", "gif", "html"):
        result = invoke(*command, tmp_path / f"a.{ending}", "--plan", tmp_path / "a.plan")
        assert json.loads(result.stdout)["frames"] == len(PLAN) + 1, result.output
    with Image.open(tmp_path / "a.gif") as film, Image.open(tmp_path / "a.png") as strip:
        assert film.n_frames == len(PLAN) + 1  # type: ignore[attr-defined]
        assert len(strip.convert("L").getcolors(2**16) or ()) > 50  # not an empty sheet: letters have soft edges
    result = invoke(*command, tmp_path / "e.svg", "--log", tmp_path / "t.jsonl", "--episode", "two")
    assert (json.loads(result.stdout)["people"], json.loads(result.stdout)["frames"]) == (1, 2)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--out", "a.bmp"], 2, "expected a name that ends in .svg, .png, .gif, .html"),
        (["--out", "a.svg", "--episode", "1"], 2, "--episode 1 has no effect without --log FILE, the log"),
        (
            ["--out", "a.svg", "--plan", "bad.plan"],
            1,
            "bad.plan: step 0: (place hammer slot-1 box-a) is not applicable here; nearest in spelling of the 2",
        ),
        (["--out", "a.svg", "--plan", "empty.plan"], 1, "empty.plan: the file is empty; expected one action per line"),
        (["--out", "a.svg", "--log", "t.jsonl", "--episode", "nine"], 1, "episode 'nine': the log has one, two"),
    ],
)
def test_what_draw_refuses(
    options: list[str], code: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.plan").write_text("(place hammer slot-1 box-a)\n")
    Path("empty.plan").touch()
    Path("t.jsonl").write_text("".join(json.dumps(row) + "\n" for row in TRACE))
    result = invoke("draw", "kitting/tiny", *options)
    assert (result.exit_code, words in result.output) == (code, True), result.output
    assert not Path("a.svg").exists()


def test_png_without_its_extra_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resvg_py", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    result = invoke("draw", "kitting/tiny", "--out", tmp_path / "a.png")
    assert result.exit_code == 1
    assert "[plots]" in result.output


def test_an_episode_of_several_policies_has_to_be_named_whole() -> None:
    rows = [{"episode": name} for name in ("none-3", "none-13", "attention-3")]
    with pytest.raises(ValueError, match=r"episode '3': expected one of none-3, attention-3$"):
        episode_of(rows, "3")
    assert episode_of(rows, "13") == [rows[1]]
