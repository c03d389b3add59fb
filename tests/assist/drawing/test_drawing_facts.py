"""Each fact and each part of the goal is visible in rendered pictures, and objects stay where they are."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import DOMAINS, thinned
from PIL import Image

from assist.drawing import Artist, draw_frames, draw_strip, episode_frames, plan_frames, read_state
from assist.drawing.layout import Box, Layout
from assist.drawing.profile import guess
from assist.drawing.raster import png
from assist.drawing.scene import TASK
from assist.drawing.subject import Atom, Subject, words_for
from assist.drawing.svg import document, draw_layout
from planner import InputFileError, cost_to_go, load
from planner.grounding.fast_downward import optimal_plan
from planner.grounding.translation import in_the_files_terms
from planner.pddl.compilation import Compilation
from planner.pddl.reader import read

SVG = "{http://www.w3.org/2000/svg}"
WIDTH = 760
LEAST_TEXT = 9  # pixels
pytestmark = pytest.mark.cases

PACKING = """(define (domain packing-cell) (:requirements :typing :negative-preconditions)
  (:types place part hand level - object bin bench printer - place)
  (:predicates (worker-at ?p - place) (stored ?x - part ?b - bin) (free ?h - hand) (holds ?h - hand ?x - part)
   (checked ?x - part) (in-tote ?x - part) (load ?l - level) (next ?l ?m - level) (label-in ?h - hand)
   (labelled) (sealed))
  (:action walk :parameters (?a ?b - place) :precondition (worker-at ?a)
   :effect (and (not (worker-at ?a)) (worker-at ?b)))
  (:action pick :parameters (?x - part ?b - bin ?h - hand)
   :precondition (and (worker-at ?b) (stored ?x ?b) (free ?h))
   :effect (and (not (stored ?x ?b)) (not (free ?h)) (holds ?h ?x)))
  (:action check :parameters (?x - part ?h - hand ?p - bench)
   :precondition (and (worker-at ?p) (holds ?h ?x)) :effect (checked ?x))
  (:action pack :parameters (?x - part ?h - hand ?p - bench ?l ?m - level)
   :precondition (and (worker-at ?p) (holds ?h ?x) (checked ?x) (not (sealed)) (load ?l) (next ?l ?m))
   :effect (and (not (holds ?h ?x)) (free ?h) (in-tote ?x) (not (load ?l)) (load ?m)))
  (:action print :parameters (?h - hand ?p - printer) :precondition (and (worker-at ?p) (free ?h) (not (labelled)))
   :effect (and (not (free ?h)) (label-in ?h)))
  (:action stick :parameters (?h - hand ?p - bench) :precondition (and (worker-at ?p) (label-in ?h))
   :effect (and (free ?h) (not (label-in ?h)) (labelled)))
  (:action seal :parameters (?p - bench) :precondition (and (worker-at ?p) (labelled)) :effect (sealed)))"""
CELL = """(define (problem cell) (:domain packing-cell)
  (:objects bin-a bin-b - bin bench-1 - bench printer-1 - printer left right - hand bolt nut - part kg0 kg1 kg2 - level)
  (:init (worker-at bench-1) (free left) (free right) (load kg0) (next kg0 kg1) (next kg1 kg2) (stored bolt bin-a)
   (stored nut bin-b))
  (:goal (and (sealed) (in-tote bolt) (in-tote nut))))"""
SMALL = [
    "kitting/tiny", "stations/one-bench", "lockers/one-parcel", "gripper/balls-01", "blocks/blocks-3",
    "delivery/one-parcel", "depot/two-boxes", "tower/swap",
]  # fmt: skip
LARGER = [
    "kitting/paper", "kitting/sealed", "stations/two-benches", "lockers/keys", "gripper/balls-05", "blocks/blocks-6",
    "delivery/three-parcels", "depot/two-columns", "tower/turn",
]  # fmt: skip
OWN, GUESSED = False, True
CASES = [(name, guessed) for name in [*SMALL, *LARGER] for guessed in (OWN, GUESSED)] + [("packing", GUESSED)]
QUICK = [("kitting/tiny", OWN)]


def some(cases: list[tuple[str, bool]]) -> list:
    """Return cases for a test, all but a few of them marked as slow."""
    return [case if case in QUICK else pytest.param(case, marks=pytest.mark.slow) for case in cases]


@pytest.fixture(scope="module")
def packing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packing")
    (folder / "domain.pddl").write_text(PACKING)
    (folder / "cell.pddl").write_text(CELL)
    return folder / "cell.pddl"


@cache
def artist_of(file: Path, guessed: bool) -> tuple[Artist, tuple[str, ...]]:
    """Return the artist of a task, with its own profile or an inferred one, and an optimal plan."""
    drawn = Artist(load(file))
    if guessed:
        drawn = Artist(drawn.subject.task, guess(drawn.subject))
    return drawn, tuple(optimal_plan(drawn.subject.task.sas) or ())


@pytest.fixture
def drawn(request: pytest.FixtureRequest, packing: Path) -> tuple[Artist, tuple[str, ...]]:
    name, guessed = request.param
    return artist_of(packing if name == "packing" else DOMAINS / f"{name}.pddl", guessed)


@dataclass(frozen=True)
class Lacking(Subject):
    """A task whose states lack a fact."""

    missing: Atom = ()

    def facts(self, values: object) -> frozenset[Atom]:
        return super().facts(values) - {self.missing}  # type: ignore[arg-type]


def pixels(layout: Layout) -> np.ndarray:
    """Return a layout as it is rendered, shape (height, width, 3), a pixel for each of its own."""
    size = layout.width + 4, layout.height + 4
    svg = document(draw_layout(layout, 2, 2), *size, "", "", "light")
    with Image.open(io.BytesIO(png(svg, size[0], 1.0))) as image:
        return np.array(image.convert("RGB"))


def boxes_in(
    boxes: list[Box], x: float = 0.0, y: float = 0.0, chain: str = ""
) -> Iterator[tuple[Box, float, float, str]]:
    """Yield boxes with their corners, and the names of what they are in."""
    for box in boxes:
        inner = f"{chain}/{box.node.key.removesuffix('##tower')}"
        if not box.is_tower:
            yield box, x + box.x, y + box.y, inner
        yield from boxes_in(box.boxes, x + box.x, y + box.y, inner)


def changed(before: Layout, after: Layout, names: set[str]) -> bool:
    """Return whether pixels differ in the box of any of these nodes."""
    one, other = pixels(before), pixels(after)
    assert one.shape == other.shape
    for layout in (before, after):
        for box, x, y, _ in boxes_in(layout.boxes):
            if box.node.key in names:
                part = np.s_[int(y + 2) : int(y + box.height + 3), int(x + 2) : int(x + box.width + 3)]
                if (one[part] != other[part]).any():
                    return True
    return False


def together(artist: Artist, subject: Subject, values: list[int]) -> tuple[Layout, Layout]:
    """Return layouts of a state, with the subject of the artist and with another one, as two frames of one picture."""
    other = Artist(artist.subject.task, artist.profile)
    other.subject = subject
    first, second = artist._arranger.layouts([artist.scene(values), other.scene(values)], WIDTH)
    return first, second


@pytest.mark.parametrize("drawn", some(CASES), indirect=True)
def test_a_fact_that_is_taken_away_is_missed_in_the_box_of_its_object(drawn: tuple[Artist, tuple[str, ...]]) -> None:
    artist, plan = drawn
    seen = set[Atom]()
    for values in artist.subject.follow(plan):
        for fact in sorted(artist.subject.facts(values) & artist.subject.changing):
            if fact[0] in artist.profile.hidden or fact in seen:
                continue
            seen.add(fact)
            lacking = Lacking(
                **{each.name: getattr(artist.subject, each.name) for each in fields(Subject)}, missing=fact
            )
            names = set(fact[1:]) or {TASK, *(f"#{name}" for name in artist.profile.things)}
            assert changed(*together(artist, lacking, values), names), fact
    assert len(seen) >= 4


@pytest.mark.parametrize("drawn", some(CASES), indirect=True)
def test_each_part_of_the_goal_is_visible_whether_it_holds_or_not(drawn: tuple[Artist, tuple[str, ...]]) -> None:
    artist, plan = drawn
    states = artist.subject.follow(plan)
    for values in (states[0], states[-1]):
        for wanted in artist.subject.goal:
            without = replace(artist.subject, goal=tuple(one for one in artist.subject.goal if one is not wanted))
            names = set(wanted.atom[1:]) or {TASK}
            names |= {f"#{name}" for name in artist.profile.things}
            assert changed(*together(artist, without, values), names), wanted.text


@pytest.mark.parametrize("drawn", thinned(CASES, 3), indirect=True)
def test_objects_stay_where_they_are_and_text_is_large_enough(drawn: tuple[Artist, tuple[str, ...]]) -> None:
    artist, plan = drawn
    layouts = artist.layouts(artist.subject.follow(plan), WIDTH / 2)
    frames = [
        {box.node.key: (chain, x, y) for box, x, y, chain in boxes_in(layout.boxes)} for layout in layouts
    ]  # fmt: skip
    stayed = 0
    for before, after in pairwise(frames):
        for key in before.keys() & after.keys():
            if before[key][0] == after[key][0]:
                assert before[key][1:] == pytest.approx(after[key][1:], abs=0.01), key
                stayed += 1
    assert stayed > len(plan)
    assert len({(layout.width, layout.height) for layout in layouts}) == 1
    for layout in layouts:  # siblings do not cover each other
        for boxes in (layout.boxes, *(box.boxes for box, *_ in boxes_in(layout.boxes))):
            for number, one in enumerate(boxes):
                for two in boxes[:number]:
                    apart = max(one.x, two.x) >= min(one.x + one.width, two.x + two.width) - 0.1 or (
                        max(one.y, two.y) >= min(one.y + one.height, two.y + two.height) - 0.1
                    )
                    assert apart, (one.node.key, two.node.key)
    # Text is large enough where pictures are as wide as a page.
    rows, states = plan_frames(artist, plan), artist.subject.follow(plan)
    pictures = [artist.draw(states[0]), artist.draw(states[-1]), draw_strip(artist, rows), draw_frames(artist, rows)[0]]
    for picture in pictures:
        smallest = 12 * min(1.0, WIDTH / picture.width)  # the font of labels and notes, as in `drawing.css`
        assert smallest >= LEAST_TEXT, picture.width
        root = ElementTree.fromstring(picture.svg)
        for node in root.iter(f"{SVG}rect"):
            assert float(node.attrib["x"]) + float(node.attrib["width"]) <= picture.width + 0.1


@pytest.mark.parametrize("drawn", some([case for case in CASES if case[0] not in LARGER]), indirect=True)
def test_no_two_states_look_alike(drawn: tuple[Artist, tuple[str, ...]]) -> None:
    """What a profile hides is told by what it shows."""
    artist, _ = drawn
    table = cost_to_go(artist.subject.task)
    count = min(len(table), 1_500)
    states = np.linspace(0, len(table) - 1, count).astype(int)
    looks = {repr(artist.scene(values.tolist()).roots) for values in table.values(states)}
    assert len(looks) == len(set(states.tolist()))


def test_facts_and_goals_without_arguments_are_in_every_picture(packing: Path) -> None:
    artist, plan = artist_of(packing, GUESSED)
    rows = plan_frames(artist, plan)
    for picture in (
        artist.draw(rows[0][-1].values, goal=False),
        draw_frames(artist, rows)[-1],
        draw_strip(artist, rows),
    ):
        last = picture.svg[picture.svg.rindex(">Also<") :]
        assert [f">{word}<" in last for word in ("labelled", "sealed")] == [True, True]
        assert 'class="ka-tick"' in last
    first = draw_frames(artist, rows)[0].svg
    assert first[first.index(">Also<") :].count('class="ka-ring"') == 1


def test_an_episode_of_many_steps_fits_a_page(packing: Path) -> None:
    artist, plan = artist_of(packing, GUESSED)
    trace = [
        {"person": person, "episode": "1", "step": step, "action": action}
        for person in ("ann", "bob")
        for step, action in enumerate(plan)
    ]
    strip = draw_strip(artist, episode_frames(artist, trace))
    assert strip.width <= WIDTH
    assert strip.svg.count('class="ka-step"') == 2 * (len(plan) + 1)
    with pytest.raises(ValueError):
        episode_frames(artist, trace, "7")


BINS = """(define (domain bins) (:requirements :typing) (:types bin level)
  (:predicates (stock-is ?b - bin ?n - level) (done-is ?n - level) (next ?n ?m - level))
  (:action take :parameters (?b - bin ?n ?m ?d ?e - level)
   :precondition (and (stock-is ?b ?n) (next ?m ?n) (done-is ?d) (next ?d ?e))
   :effect (and (not (stock-is ?b ?n)) (stock-is ?b ?m) (not (done-is ?d)) (done-is ?e))))"""
THREE = """(define (problem three) (:domain bins) (:objects bin-1 bin-2 - bin n0 n1 n2 - level)
  (:init (stock-is bin-1 n2) (stock-is bin-2 n1) (done-is n0) (next n0 n1) (next n1 n2))
  (:goal (and (stock-is bin-1 n1) (stock-is bin-2 n0))))"""


@pytest.fixture
def bins(tmp_path: Path) -> Artist:
    """The artist of a task whose numbers were compiled away, as a grounded task has them, without files."""
    (tmp_path / "domain.pddl").write_text(BINS)
    (tmp_path / "three.pddl").write_text(THREE)
    task, values = load(tmp_path / "three.pddl"), {f"n{n}": str(n) for n in range(3)}
    reading = read(task.instance)
    for name in ("domain.pddl", "three.pddl"):
        (tmp_path / name).unlink()
    numbers = {"stock-is": ("stock", values), "done-is": ("done", values)}
    return Artist(in_the_files_terms(task, Compilation(reading, numbers=numbers)))


def test_numbers_are_marks_on_their_objects_and_of_the_task(bins: Artist) -> None:
    assert list(bins.subject.objects)[:2] == ["bin-1", "bin-2"]
    layout = bins.layouts([bins.subject.initial])[0]
    marks = {box.node.key: box.node.marks for box, *_ in boxes_in(layout.boxes)}
    assert (marks["bin-1"], marks["bin-2"], marks[TASK]) == (["stock = 2"], ["stock = 1"], ["done = 0"])
    assert {box.node.key: box.node.wants for box, *_ in boxes_in(layout.boxes)}["bin-1"] == [("stock = 1", False)]


@pytest.mark.parametrize(
    "text",
    [
        "(= (stock bin-1) 1) (= (stock bin-2) 1) (= (done) 1) (= (weight bin-1) 7)",
        '["stock(bin-1) = 1", "stock(bin-2) = 1", "done() = 1"]',
        "stock(bin-1) = 1 stock(bin-2) = 1\ndone() = 1",
    ],
)
def test_numbers_of_a_state_are_read(bins: Artist, tmp_path: Path, text: str) -> None:
    (tmp_path / "state").write_text(text)
    values = read_state(tmp_path / "state", bins.subject)
    assert {"stock bin-1 = 1", "stock bin-2 = 1", "done = 1"} == {words_for(one) for one in bins.subject.facts(values)}
    (tmp_path / "state").write_text(text.replace("bin-2) = 1", "bin-2) = 9").replace("bin-2) 1", "bin-2) 9"))
    with pytest.raises(InputFileError, match=r"\(= \(stock bin-2\) 9\) is no fact of the task; expected 0, 1"):
        read_state(tmp_path / "state", bins.subject)


def test_a_long_condition_of_the_goal_wraps_and_is_in_every_frame(tmp_path: Path) -> None:
    goal = "(or (sealed) (forall (?x - part) (or (in-tote ?x) (and (checked ?x) (exists (?h - hand) (holds ?h ?x))))))"
    (tmp_path / "domain.pddl").write_text(PACKING.replace(":typing", ":typing :adl"))
    (tmp_path / "cell.pddl").write_text(CELL.replace("(and (sealed) (in-tote bolt) (in-tote nut))", goal))
    artist = Artist(load(tmp_path / "cell.pddl"))
    rows = plan_frames(artist, ["(walk bench-1 bin-a)"])
    for picture in (*draw_frames(artist, rows), draw_strip(artist, rows)):
        assert picture.width <= WIDTH
        said = " ".join(re.findall(r'class="ka-small">([^<]+)<', picture.svg[picture.svg.rindex(">Also<") :]))
        assert goal in said


def test_a_comparison_in_the_goal_is_shown_as_in_the_file(tmp_path: Path) -> None:
    domain = """(define (domain d) (:requirements :typing :fluents) (:types bin) (:functions (v ?b - bin))
      (:action add :parameters (?b - bin) :precondition (< (v ?b) 2) :effect (increase (v ?b) 1)))"""
    (tmp_path / "domain.pddl").write_text(domain)
    goal = "(< (v a) (v b))"
    problem = f"(define (problem p) (:domain d) (:objects a b - bin) (:init (= (v a) 0) (= (v b) 0)) (:goal {goal}))"
    (tmp_path / "p.pddl").write_text(problem)
    artist = Artist(load(tmp_path / "p.pddl"))
    before, after = (artist.scene(values) for values in artist.subject.follow(["(add b)"]))
    assert (before.goal, after.goal) == ([(goal, False)], [(goal, True)])
    assert "v b = 1" in after.said
