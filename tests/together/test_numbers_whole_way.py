"""Tasks with numbers and durations go the whole way: people, policies, bounds, logs, pages, drawings, other programs.

Everywhere a user looks, actions and numbers are those of the file, and costs are in its unit.
"""

from __future__ import annotations

import json
import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DOMAINS, invoke, table_of, write_instance
from fuzz import here
from gymnasium.utils.env_checker import check_env
from teams import equal, run

from assist import Pool
from assist.connect import TeamEnv
from assist.connect.observed import Observed
from assist.drawing import Artist, plan_frames, read_state, save
from assist.drawing.raster import png
from assist.live import Explanation, Session, contrast
from assist.people import Choices, HumanModel, Population
from assist.person import AssistPOMDP, OfRobots, Setting, qmdp
from planner import Instance, Table, load, sweep

DOMAIN = """(define (domain mixing) (:requirements :typing :durative-actions :numeric-fluents) (:types tank)
(:predicates (done ?t - tank))
(:functions (litres ?t - tank) (wanted ?t - tank) (battery) (filled))
(:durative-action fill :parameters (?t - tank) :duration (= ?duration 2.5)
  :condition (and (at start (< (litres ?t) 1.5)) (at start (>= (battery) 0.3)))
  :effect (and (at start (decrease (battery) 0.3)) (at end (increase (litres ?t) 0.5)) (at end (increase (filled) 1))))
(:durative-action drain :parameters (?t - tank) :duration (= ?duration 1.25)
  :condition (at start (>= (litres ?t) 0.5)) :effect (at end (decrease (litres ?t) 0.5)))
(:durative-action seal :parameters (?t - tank) :duration (= ?duration 0.1)
  :condition (and (over all (= (litres ?t) (wanted ?t))) (at start (>= (filled) 2))) :effect (at end (done ?t))))"""
PROBLEM = """(define (problem mix) (:domain mixing) (:objects tank-a - tank)
(:init (= (litres tank-a) 0) (= (wanted tank-a) 1) (= (battery) 1.7) (= (filled) 0))
(:goal (done tank-a)) (:metric minimize (total-time)))"""
ACTIONS = {"fill": 2.5, "drain": 1.25, "seal": 0.1}
NOVICES = Population(beta=(0.1, 0.6))
EXPERTS = ("--set", "population.beta=[2, 8]")
EAGER = Setting(c_suggest=0.02, c_move=0.01)


def shipped(name: str) -> Table:
    return table_of(Instance(DOMAINS / f"{name}.pddl", (DOMAINS / name).parent / "domain.pddl"))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Instance:
    return write_instance(tmp_path_factory.mktemp("mixing"), DOMAIN, PROBLEM)


@pytest.fixture(scope="module")
def mixing(files: Instance) -> Table:
    return sweep(load(files))


@pytest.fixture(scope="module")
def trace(mixing: Table) -> list[dict[str, Any]]:
    """The actions of two people in twenty episodes, with the suggestions of a robot that makes many."""
    found: list[dict[str, Any]] = []
    pool = Pool.sample(mixing, 2, population=NOVICES, seed=1, setting=EAGER)
    pool_run = run(pool, "reactive", 2, 20, 1, trace=found)
    assert pool_run.interventions.sum() > 0
    return found


def is_of_the_file(text: str, table: Table) -> bool:
    """Whether a text has no names of the compilation: no value objects, no predicates and actions that it made."""
    made = re.findall(r"[\w@-]*(?:value-|new-axiom|is-f)[\w-]*", text)
    actions = [one for one in re.findall(r"\([^()<>]*\)", text) if one.split()[0][1:] in ACTIONS]
    return not made and set(actions) <= set(table.task.actions)


def test_the_numbers_of_a_state_are_those_of_the_file(mixing: Table) -> None:
    start = mixing.task.facts(mixing.task.initial)
    assert start == ["battery() = 1.7", "filled() = 0", "litres(tank-a) = 0"]
    after = mixing.space.follow(["(fill tank-a)", "(fill tank-a)"])
    assert mixing.task.facts(mixing.values([after])[0]) == [
        "battery() = 1.1", "filled() = 2 or more", "litres(tank-a) = 1"
    ]  # fmt: skip
    assert mixing[mixing.initial] == 5.1
    assert mixing.choices([after]).actions.size == 3


def test_what_can_never_happen_says_nothing_of_costs(tmp_path: Path) -> None:
    """The compilation leaves no action, and the file has no (total-cost)."""
    domain = """(define (domain d) (:requirements :durative-actions) (:predicates (lid-open) (taken))
    (:durative-action take :parameters () :duration (= ?duration 2) :condition (over all (lid-open))
      :effect (and (at start (not (lid-open))) (at end (taken)))))"""
    task = load(write_instance(tmp_path, domain, "(define (problem p) (:domain d) (:init (lid-open)) (:goal (taken)))"))
    assert task.note == "no metric: the cost is the sum of durations"


def test_a_persons_time_is_the_sum_of_durations_and_a_step_is_an_action(
    mixing: Table, trace: list[dict[str, Any]]
) -> None:
    assert {row["action"] for row in trace} == {f"({name} tank-a)" for name in ACTIONS}
    assert {row["suggestion"] for row in trace} <= {None, *mixing.task.actions}
    assert all(row["cost"] == ACTIONS[row["action"].strip("()").split()[0]] for row in trace)
    pool = Pool.sample(mixing, 2, population=NOVICES, seed=1, setting=EAGER)
    result = run(pool, "reactive", 2, 20, 1)
    for episode in result:
        for place in range(2):
            mine = [row for row in trace if row["episode"] == f"reactive-{episode.episode}" and row["place"] == place]
            assert [row["step"] for row in mine] == list(range(episode.actions[place]))
            assert episode.costs[place] == pytest.approx(sum(row["cost"] for row in mine))
    summary = result.summary()
    assert summary.costs[0] == pytest.approx(result.costs.mean())
    assert f"cost per person {summary.costs[0]:.2f}" in str(summary)


def answered(*arguments: Any) -> Any:
    """Return what a command prints as JSON."""
    done = invoke(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


SHIPPED = [
    pytest.param("stock/one-bin", 3.0, marks=pytest.mark.slow),
    pytest.param("timed/one-part", 2.0, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "best"), [("mixing", 5.1), *SHIPPED])
def test_commands_and_an_environment_agree_about_costs_and_actions(
    files: Instance, name: str, best: float, tmp_path: Path
) -> None:
    """Also the smallest shipped tasks with numbers and with durations."""
    problem = files.problem if name == "mixing" else name
    policy = answered("policy", problem, "--gap", 0.01, "--c-suggest", 0.1, *EXPERTS)
    assert policy["value_never"] <= policy["lower"] <= policy["upper"] <= -0.98 * best
    bound = answered("bound", problem, "--humans", 2, "--value-episodes", 20, "--gap", 0.01, *EXPERTS)
    seldom = 0.05  # what people lose by mistakes that are too rare for twenty episodes
    assert bound["value"] - 4 * bound["value_stderr"] - seldom <= bound["upper"] <= -2 * 0.98 * best

    table, out, log = sweep(load(problem)), tmp_path / "episodes.jsonl", tmp_path / "log.jsonl"
    team = ("--humans", 2, "--pool", 2, "--episodes", 4, "--seed", 1, "--policy", "attention", *EXPERTS)
    (record,) = answered("simulate", problem, *team, "--out", out, "--trace", log)["policies"]
    costs = [cost for line in out.read_text().splitlines() for cost in json.loads(line)["costs"]]
    assert record["cost_per_person"]["mean"] == pytest.approx(sum(costs) / 8)
    assert min(costs) >= best - 1e-9
    assert ("cost per person" in invoke("simulate", problem, *team).stdout) == (name != "stock/one-bin")  # cost 1 each
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    assert {row["action"] for row in rows} <= set(table.task.actions)
    found = answered("fit", problem, log)
    assert (sum(one["actions"] for one in found), {one["error"] for one in found}) == (len(rows), {None})
    log.write_text(json.dumps(rows[0] | {"action": "(nothing)", "suggestion": None}) + "\n")
    wrong = invoke("fit", problem, log)
    assert (wrong.exit_code, is_of_the_file(wrong.stderr, table)) == (1, True)
    assert "if the task calls it otherwise, --rename nothing=NAME (in Python rename={'nothing': NAME})" in wrong.stderr

    (tmp_path / "best.plan").write_text("\n".join(table.optimal_plan() or []))
    drawn = invoke("draw", problem, "--plan", tmp_path / "best.plan", "--out", tmp_path / "plan.html")
    assert (drawn.exit_code, is_of_the_file((tmp_path / "plan.html").read_text(), table)) == (0, True)
    env = TeamEnv(instance=str(problem), humans=2, render_mode="svg")
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    assert seen["cost_to_go"].tolist() == pytest.approx([table[table.initial]] * 2)
    total, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, _ = env.step(0)
        assert is_of_the_file(str(env.render()), table)
        total, over = total + float(reward), terminated or truncated
    assert total <= -2 * best + 1e-6  # both finish, at the least cost or at more


@pytest.mark.parametrize("suffix", ["pomdpx", "pomdp"])
def test_exported_names_are_those_of_the_file(files: Instance, mixing: Table, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"mixing.{suffix}"
    assert invoke("export", files.problem, "--out", out).exit_code == 0
    text = out.read_text()
    assert is_of_the_file(text, mixing)
    assert "suggests (seal tank-a)" in text
    observed = Observed.of(AssistPOMDP.of(HumanModel.exact(Choices.of(mixing))), mixing)
    assert {"start", "battery.1.4__filled.1__litres.tank-a.0.5"} <= {
        "__".join(sorted(name.split("__"))) for name in observed.names
    }
    assert any("filled.2-or-more" in name for name in observed.names)
    assert all(name in text for name in observed.names)


def test_a_study_runs(files: Instance, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    monkeypatch.setattr("assist.studies.reports.study_report.draw_all", lambda *_, **__: None)
    monkeypatch.setattr("assist.studies.runner.outcomes", here)
    (tmp_path / "study.toml").write_text(
        f'instances = ["{files.problem}"]\nrepeats = 2\nhumans = [2]\npool = 2\ndraws = 1\ntrials = 2\n'
        'policies = ["none", "attention"]\n[setting]\nc_suggest = 0.1\n'
    )
    done = invoke("study", "--protocol", tmp_path / "study.toml", "--out", tmp_path / "out", "--jobs", 1)
    assert done.exit_code == 0, done.output
    rows = [json.loads(line) for line in (tmp_path / "out" / "episodes.jsonl").read_text().splitlines()]
    assert len(rows) == 2 * 2 * 2
    assert all(cost >= 5.1 - 1e-9 for row in rows for cost in row["costs"])
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    times = {cell["policy"]: cell["cost_per_person"]["mean"] for cell in summary["cells"]}
    assert times["none"] == pytest.approx(np.mean([row["costs"] for row in rows if row["policy"] == "none"]))
    saved = summary["headline"]["costs_vs_none"]["mean"]
    assert saved == pytest.approx(100 * (1 - times["attention"] / times["none"]))
    report = (tmp_path / "out" / "report.md").read_text()
    assert "| cost per person |" in report
    assert "costs against none" in report


def test_a_live_session_and_its_reasons(mixing: Table, tmp_path: Path) -> None:
    session = Session(mixing, tmp_path / "journal.sqlite", setting=EAGER)
    for person in ("ann", "bob"):
        session.join(person)
    assert session.person("ann")["applicable"] == ["(fill tank-a)"]
    assert session.person("ann")["cost_to_go"] == 5.1
    session.observe("ann", "(fill tank-a)")
    seen = session.observe("bob", "fill(tank-a)")
    session.close()
    assert seen["cost_to_go"] == pytest.approx(2.6)
    assert is_of_the_file(json.dumps(seen), mixing)
    known = contrast(mixing, mixing.space.follow(["(fill tank-a)"]), "(fill tank-a)", "(drain tank-a)")
    text = Explanation(against=known).text()
    assert (known.difference, known.unit) == (pytest.approx(1.25 + 2.5), "cost")
    assert re.search(r"costs 3\.[78] more", text)
    assert is_of_the_file(text, mixing)


def test_a_plan_is_drawn_as_an_animation(mixing: Table, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("resvg_py")
    artist = Artist(mixing.task)
    plan = mixing.optimal_plan()
    assert plan is not None
    save(artist, plan_frames(artist, plan), tmp_path / "plan.gif")
    with image.open(tmp_path / "plan.gif") as animation:
        assert animation.n_frames == len(plan) + 1


def boxes(svg: str) -> dict[str, tuple[float, float, float, float]]:
    """Return x, y, width and height of the frame of each object."""
    found = re.findall(r'data-object="([^"]+)"[^>]*>\s*<rect class="ka-frame" x="([\d.]+)" y="([\d.]+)" '
                       r'width="([\d.]+)" height="([\d.]+)"', svg)  # fmt: skip
    return {name: (float(x), float(y), float(width), float(height)) for name, x, y, width, height in found}


@pytest.mark.parametrize(
    ("name", "action", "where", "shown"),
    [
        ("stock/refill", "(pick bolt bin-bolt tray-1)", ["bin-bolt", "tray-1"], ["parts = 4 of 6", "bolt = 0 of 2"]),
        ("stock/refill", "(refill bin-bolt)", ["bin-bolt"], ["packs = 1"]),
        (None, "(fill tank-a)", ["tank-a"], ["litres = 0", "battery = 1.7"]),
    ],
)
def test_a_number_that_changes_is_seen_in_its_objects_box(
    mixing: Table, name: str | None, action: str, where: list[str], shown: list[str]
) -> None:
    """With the look of `stock`, and without a look; the text stays readable on a page 760 pixels wide."""
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("resvg_py")
    artist = Artist(mixing.task if name is None else shipped(name).task)
    start = artist.subject.initial
    if action == "(refill bin-bolt)":  # it has room for a pack when one bolt is taken
        start = artist.subject.follow(["(pick bolt bin-bolt tray-1)"])[-1]
    states = artist.subject.follow([action], start)
    pictures = [artist.draw(values, width=760, theme="light") for values in states]
    assert all(f">{text}<" in artist.draw(width=760).svg for text in shown)
    pixels = [np.asarray(image.open(BytesIO(png(one.svg, one.width, scale=1))).convert("RGB")) for one in pictures]
    high, wide = (min(one.shape[axis] for one in pixels) for axis in (0, 1))
    differ = (pixels[0][:high, :wide] != pixels[1][:high, :wide]).any(axis=2)
    for key in where:
        x, y, width, height = map(int, boxes(pictures[0].svg)[key])
        assert differ[y : y + height, x : x + width].sum() > 5
    for one in pictures:
        smallest = min(float(size) for size in re.findall(r"font-size: ([\d.]+)px", one.svg))
        assert smallest * min(1, 760 / one.width) >= 9


@pytest.mark.parametrize(
    ("text", "litres", "filled"),
    [
        ("(= (litres tank-a) 0.50) (= (filled) 7) (= (battery) 1.1)", "0.5", "2 or more"),
        ('["litres(tank-a) = 1", "filled() = 2 or more", "battery() = 0.8"]', "1", "2 or more"),
        ("litres(tank-a) = 1/2 filled() = 1 battery() = 1.4", "0.5", "1"),
    ],
)
def test_a_state_may_be_written_with_any_form_of_its_numbers(
    mixing: Table, tmp_path: Path, text: str, litres: str, filled: str
) -> None:
    artist = Artist(mixing.task)
    (tmp_path / "state").write_text(text)
    drawn = artist.draw(read_state(tmp_path / "state", artist.subject)).text
    assert f"litres tank-a = {litres};" in drawn
    assert f"filled = {filled}." in drawn


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(= (litres tank-a) 0.3)", "state:1: (= (litres tank-a) 0.3) is no fact of the task; expected 0, 0.5, 1, 1.5"),
        ("(= (filled) 1)",
         "state: too few facts; expected (= (battery) N), where N is less than 0.3, 0.5, 0.8, 1.1, 1.4, 1.7"),
    ],
)  # fmt: skip
def test_a_number_that_no_state_has_is_refused_with_those_that_there_are(
    files: Instance, tmp_path: Path, text: str, said: str
) -> None:
    (tmp_path / "state").write_text(text)
    done = invoke("draw", files.problem, "--state", tmp_path / "state", "--out", tmp_path / "state.svg")
    assert done.exit_code != 0
    assert said in done.stderr.replace("\n", " ")


def test_a_number_without_a_value_need_not_be_given(tmp_path: Path) -> None:
    domain = """(define (domain d) (:requirements :numeric-fluents) (:functions (n)) (:predicates (done))
    (:action set :parameters () :effect (assign (n) 2))
    (:action end :parameters () :precondition (>= (n) 1) :effect (done)))"""
    instance = write_instance(tmp_path, domain, "(define (problem p) (:domain d) (:init) (:goal (done)))")
    artist = Artist(load(instance))
    assert artist.draw(read_state(instance.problem, artist.subject)).text.startswith("n = undefined.")


def priced(cost: str) -> str:
    return f"""(define (domain walk) (:requirements :typing :action-costs :numeric-fluents) (:types place)
(:predicates (at ?x - place) (road ?x ?y - place)) (:functions (total-cost) (steps))
(:action go :parameters (?x ?y - place) :precondition (and (at ?x) (road ?x ?y) (< (steps) 4))
  :effect (and (not (at ?x)) (at ?y) (increase (steps) 1) (increase (total-cost) {cost}))))"""


WALK = """(define (problem p) (:domain walk) (:objects a b c d - place)
(:init (at a) (= (total-cost) 0) (= (steps) 0) (road a b) (road b d) (road a c) (road c a) (road b a) (road c d))
(:goal (at d)) (:metric minimize (total-cost)))"""


def test_two_and_a_half_and_five_halves_are_one_number(tmp_path: Path) -> None:
    """Also as a duration, and as a sum of two costs: the same people, Q, policies, and costs of choices."""
    durative = priced("0").replace(":action-costs", ":durative-actions").replace("(:action go", "(:durative-action go")
    durative = durative.replace(":precondition (and (at ?x) (road ?x ?y) (< (steps) 4))",
        ":duration (= ?duration 2.5) "
        ":condition (and (at start (at ?x)) (at start (road ?x ?y)) (at start (< (steps) 4)))",
    ).replace("(increase (total-cost) 0)", "").replace("(not (at ?x)) (at ?y) (increase (steps) 1)",
        "(at start (not (at ?x))) (at end (at ?y)) (at end (increase (steps) 1))",
    ).replace("(total-cost) ", "")  # fmt: skip
    timed = WALK.replace("(= (total-cost) 0) ", "").replace("(total-cost)", "(total-time)")
    texts = [(priced("2.5"), WALK), (priced("(/ 5 2)"), WALK), (priced("(* 0.5 (+ 2 3))"), WALK), (durative, timed)]
    tables = [sweep(load(write_instance(tmp_path / f"{n}", *pair))) for n, pair in enumerate(texts)]
    first, *others = tables
    assert first[first.initial] == 5.0
    values = [qmdp(AssistPOMDP.of(HumanModel.exact(Choices.of(one)), robot=OfRobots(c_suggest=0.4))) for one in tables]
    pools = [Pool.sample(one, 4, seed=1, setting=Setting(c_suggest=0.3)) for one in tables]
    for other, value, pool in zip(others, values[1:], pools[1:], strict=True):
        assert np.array_equal(first.h, other.h)
        assert np.array_equal(Choices.of(first).costs, Choices.of(other).costs)
        assert np.array_equal(values[0].q_mdp, value.q_mdp)
        for policy in ("none", "reactive", "attention", "priority"):
            assert equal(run(pools[0], policy, 3, 5, 1), run(pool, policy, 3, 5, 1))
