"""Cases met in the use of `simulate`, `bound`, `study` and `export`, and of the environments."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from conftest import KITTING, invoke, kit, thinned
from fuzz import here
from studies import write

from assist import Pool, simulate
from assist.cli import main
from assist.connect import pomdp, pomdpx
from assist.connect.observed import Observed, bytes_needed
from assist.live import TraceReasons
from assist.people import Choices, HumanModel, Population, UserCodeError
from assist.person import QMDP, AssistPOMDP, ObservationModel, OfRobots, Robot, Setting, solve
from assist.person import solver as person_solver
from assist.person.qmdp import qmdp
from assist.studies import cells, load_study, read, run_study
from assist.studies.reports import study_report, write_report
from assist.team import TeamAction, TeamState, UserPolicy
from planner import Table

pytestmark = pytest.mark.cases

TINY = str(KITTING / "tiny.pddl")
STUDY = f"""
title = "dear"
seed = 5
repeats = 2
instances = ["{TINY}"]
humans = [1]
pool = 2
draws = 1
trials = 2

[populations.everybody]

[[conditions]]
name = "first"
settings = [{{ c_suggest = 0.05, c_move = 0.05 }}, {{ c_suggest = 40.0 }}]
"""


def pool_at(table: Table, c_suggest: float, **options: Any) -> Pool:
    setting = Setting(c_suggest=c_suggest, c_move=0.1)
    return Pool.sample(table, 4, seed=1, setting=setting, population=Population(beta=(0.5, 2.0)), **options)


@pytest.mark.parametrize("policy", thinned(["attention", "attention-never", "priority", "whittle", "rollout"]))
def test_a_policy_that_weighs_costs_says_that_none_was_worth_it(policy: str, tiny: Table) -> None:
    """Nothing else is solved to say it."""
    solved: list[AssistPOMDP] = []

    def solver(problem: AssistPOMDP) -> QMDP:
        solved.append(problem)
        return qmdp(problem)

    pool, episodes = pool_at(tiny, 40.0, solver=solver), 2 if policy == "rollout" else 20
    found = simulate(pool, policy, humans=2, episodes=episodes, seed=3)
    assert not found.interventions.any()
    assert len(solved) <= len(pool.people)
    summary = found.summary()
    assert str(summary).endswith("; no suggestion was worth its cost (c_suggest 40)")
    assert summary.record()["c_suggest_too_high"] == 40.0
    speaks = simulate(pool_at(tiny, 0.05), policy, humans=2, episodes=episodes, seed=3)
    assert speaks.c_suggest_too_high is None
    assert "worth" not in str(speaks.summary())


def test_only_policies_that_weigh_a_cost_say_so(tiny: Table) -> None:
    pool = pool_at(tiny, 40.0)
    for policy in ("none", lambda team: pool.policy("attention")(team)):
        assert simulate(pool, policy, humans=2, episodes=5, seed=3).c_suggest_too_high is None
    differ = Setting(robots=(Robot(c_suggest=40.0), Robot(c_suggest=50.0)))
    two = Pool.sample(tiny, 2, seed=1, setting=differ)
    assert simulate(two, "attention", humans=2, episodes=5, seed=3).c_suggest_too_high is None  # which of the two?


def test_a_person_who_is_best_left_alone(tiny: Table) -> None:
    for c_suggest, suggests in ((40.0, False), (0.2, True)):
        problem = AssistPOMDP.of(HumanModel.exact(Choices.of(tiny)), robot=OfRobots(c_suggest=c_suggest))
        assert solve(problem, gap=0.01).suggests is suggests
    assert solve(problem, gap=0.0, time_limit=0.0).suggests  # it may


def test_commands_say_that_no_suggestion_was_worth_its_cost() -> None:
    options = (TINY, "--c-suggest", 40)
    line = "no suggestion was worth its cost (c_suggest 40) (--c-suggest)"
    assert json.loads(invoke("policy", *options, "--json").stdout)["c_suggest_too_high"] == 40.0
    assert json.loads(invoke("policy", TINY, "--c-suggest", 0.2, "--json").stdout)["c_suggest_too_high"] is None
    assert invoke("policy", *options).stdout.splitlines()[-1] == line
    team = (*options, "--humans", 2, "--episodes", 5, "--policy", "none", "--policy", "attention")
    none, attention = json.loads(invoke("simulate", *team, "--json").stdout)["policies"]
    assert (none["c_suggest_too_high"], attention["c_suggest_too_high"]) == (None, 40.0)
    assert f"attention: {line}" in invoke("simulate", *team).stdout.splitlines()


def test_a_study_says_where_a_policy_is_no_assistance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_report, "draw_all", lambda *_, **__: None)
    monkeypatch.setattr("assist.studies.runner.outcomes", here)
    study = read(write(tmp_path, STUDY))
    out = tmp_path / "out"
    assert run_study(study, out) == []
    summary = write_report(study, out).summary
    (row,) = summary["seldom_assisted"]
    assert (row["policy"], row["setting"], row["assisted"], row["c_suggest"]) == ("attention", "c_suggest 40", 0, 40.0)
    note = (
        "attention suggests something to 0 % of people (first, c_suggest 40, everybody, tiny): "
        "hardly any suggestion is worth its cost (c_suggest 40); set a lower one in `[setting]`"
    )
    assert note in study_report.notes(summary)
    assert f"\n\n**Note.** {note}.\n\n" in (out / "report.md").read_text()


def test_any_number_of_jobs_gives_the_same_bytes(tmp_path: Path) -> None:
    printed = {}
    for jobs in (1, 2):
        out, trace = (tmp_path / f"{jobs}-{name}.jsonl" for name in ("out", "trace"))
        command = ("simulate", TINY, "--humans", 2, "--policy", "priority", "--episodes", 70, "--c-suggest", 0.2)
        result = invoke(*command, "--jobs", jobs, "--out", out, "--trace", trace)
        assert result.exit_code == 0, result.stderr
        printed[jobs] = (result.stdout, out.read_bytes(), trace.read_bytes())
    assert printed[1] == printed[2]
    steps = [json.loads(line) for line in printed[1][2].splitlines()]
    order = [(int(row["episode"].rpartition("-")[2]), row["step"], row["place"]) for row in steps]
    assert order == sorted(order)


@pytest.mark.parametrize(
    ("setting", "options"),
    [
        (Setting(c_suggest=0.1, robots=2), {"goals": "inferred"}),
        (Setting(c_suggest=0.1, observation=ObservationModel(0.1, 0.1)), {}),
        (Setting(c_suggest=0.1), {"world": "model"}),
    ],
)
def test_episodes_do_not_depend_on_how_they_are_divided(tiny: Table, setting: Setting, options: dict[str, Any]) -> None:
    pool = Pool.sample(tiny, 4, seed=1, setting=setting)
    one, other = (
        list(simulate(pool, "attention", humans=3, episodes=70, seed=3, jobs=jobs, **options)) for jobs in (1, 4)
    )
    assert one == other
    assert one[60:] == list(simulate(pool, "attention", humans=3, episodes=range(60, 70), seed=3, **options))


def test_phases_have_their_own_names_and_count_what_is_done(tiny: Table) -> None:
    """People are solved before the simulation, also where only the reasons need it, and no estimate is made early."""
    told: list[tuple[str, int, int | None]] = []
    pool = pool_at(tiny, 0.05)
    reasons, trace = TraceReasons(pool.policies, tiny), list[Any]()
    options = {"humans": 2, "episodes": 5, "seed": 3, "progress": lambda *what: told.append(what)}
    simulate(pool, "reactive", trace=trace, reasons=reasons, **options)
    assert any("explanation" in row for row in trace)
    what = [*dict.fromkeys(name for name, *_ in told)]
    assert what == ["solving people's POMDPs", "simulating reactive and explaining its suggestions"]
    assert [done for name, done, _ in told if name == what[1]] == [0, 1, 2, 3, 4, 5]
    told.clear()
    simulate(pool, "none", **options | {"episodes": 100})
    assert told == [("simulating none", done, 100) for done in (0, 64, 100)]


def test_what_a_function_of_the_user_solves_has_its_own_phase(tiny: Table) -> None:
    """Nobody knows before its first step whether it does; the simulation's estimate begins after it."""

    def mine(team: TeamState) -> TeamAction:
        return team.act(team.q_values().max(axis=2).argmax(axis=1), team.first_optimal())

    told: list[tuple[str, int, int | None]] = []
    pool = Pool.sample(tiny, 2, seed=1)
    simulate(pool, mine, humans=2, episodes=70, seed=3, progress=lambda *what: told.append(what))
    assert told[0] == ("simulating mine", 0, 70)
    simulating = ("simulating mine", 0, 70)
    assert [what for what in told if what[1] == 0] == [
        simulating, *[("solving a person's POMDP: sweeps", 0, None), simulating] * 2
    ]  # fmt: skip
    assert [done for what, done, _ in told if what == "simulating mine"] == [0, 0, 0, 64, 70]


def test_ctrl_c_leaves_the_policies_that_were_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any phase: while people are solved, while another policy is simulated, and while the figure is drawn."""
    own = tmp_path / "own.py"
    own.write_text("def stop(team):\n    raise KeyboardInterrupt\n")
    out, trace, figure = (tmp_path / name for name in ("out.jsonl", "trace.jsonl", "episode.svg"))
    begin = ("simulate", TINY, "--humans", 2, "--episodes", 10, "--policy")
    alone = invoke(*begin, "none", "--out", out, "--trace", trace)
    want = (alone.stdout, out.read_bytes(), trace.read_bytes())
    said = "interrupted; what was finished by then is shown\n"

    def interrupted(*options: object) -> None:
        result = invoke(*begin, "none", *options, "--out", out, "--trace", trace)
        assert (result.exit_code, result.stderr) == (130, said)
        assert (result.stdout, out.read_bytes(), trace.read_bytes()) == want

    interrupted("--policy", f"{own}:stop")
    first = invoke(*begin, f"{own}:stop", "--policy", "none")
    assert (first.exit_code, first.stdout, first.stderr) == (130, "", "interrupted\n")

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("assist.team.illustration.Illustration.of", stop)
        interrupted("--figure", figure)
    assert not figure.exists()
    monkeypatch.setattr("assist.team.attention.AttentionSwitching.prepare", stop)
    interrupted("--policy", "attention")


def test_ctrl_c_leaves_the_policies_that_were_compared_with_a_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("assist.certify.comparison.FIRST_EPISODES", 1)  # one is not enough for a first answer
    # Whether it remembers calls is tried before, with 24 teams.
    own = tmp_path / "own.py"
    own.write_text(
        "from assist.team.baselines import NoAssistance\n\n\ndef stop(team):\n"
        "    if len(team.active) <= 24:\n        return NoAssistance()(team)\n    raise KeyboardInterrupt\n"
    )
    command = ("bound", TINY, "--humans", 1, "--gap", 0.2, "--value-episodes", 50, "--set", "gamma=0.8")
    result = invoke(*command, "--policy", "none", "--policy", f"{own}:stop")
    assert (result.exit_code, result.stderr) == (130, "interrupted; what was finished by then is shown\n")
    assert [line.split()[0] for line in result.stdout.splitlines()[:2]] == ["policy", "none"]
    alone = invoke(*command, "--policy", f"{own}:stop")
    assert (alone.exit_code, alone.stderr) == (130, "interrupted; what was finished by then is shown\n")
    assert alone.stdout == f"upper bound {result.stdout.split()[11]}, from the problems of 1 of 1 people\n"


def test_it_is_said_that_nobody_knows_how_much_a_bound_with_neighbours_would_be_lower() -> None:
    sees = ("--set", "neighbours.rule=outcome")
    said = invoke("bound", TINY, "--humans", 2, "--policy", "none", "--value-episodes", 4, "--time-limit", 1, *sees)
    assert "it is not known how much an exact solution would lower the gap" in said.stdout


def test_ctrl_c_leaves_the_bounds_on_one_person(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any, bounds: Any, **__: Any) -> None:
        for found in reached:
            bounds(*found)
        raise KeyboardInterrupt

    monkeypatch.setattr("assist.person.solver.solve", stopped)
    command = ("policy", TINY, "--out", tmp_path / "policy.npz")
    reached: list[tuple[float, float, float]] = []
    nothing = invoke(*command)
    assert (nothing.exit_code, nothing.stdout, nothing.stderr) == (130, "", "interrupted\n")
    reached += [(0.1, -9.0, -2.0), (0.2, -4.0, -3.0)]
    some = invoke(*command)
    assert (some.exit_code, some.stderr) == (130, "interrupted; what was finished by then is shown\n")
    assert some.stdout == "lower -4.00000  upper -3.00000  gap 2.50e-01; no policy is saved\n"
    assert json.loads(invoke(*command, "--json").stdout) == {
        "lower": -4.0, "upper": -3.0, "seconds": 0.2, "stopped": "interrupt"
    }  # fmt: skip
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stage", ["the first person", "the second person", "sample paths"])
def test_ctrl_c_leaves_a_bound_on_what_was_computed(stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """People whose problems have not been bounded count as if they had the robot to themselves."""
    more = ("--value-episodes", 2, "--policy", "none", "--jobs", 1, "--set", "gamma=0.8", "--json")
    command = ("bound", TINY, "--humans", 2, "--gap", 0.5, *more)
    several: tuple[object, ...] = ("--samples", 30) if stage == "sample paths" else ("--robots", 2)
    solved: list[float] = []

    def solve(*arguments: Any, **options: Any) -> Any:
        if stage == {0: "the first person", 1: "the second person"}.get(len(solved)):
            raise KeyboardInterrupt
        found = person_solver.solve(*arguments, **options)
        solved.append(found.upper)
        return found

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("assist.certify.computation.solve", solve)
    monkeypatch.setattr("assist.certify.sample_paths.sampled", stop)
    stopped = invoke(*command, *several)
    assert stopped.exit_code == 130
    if stage == "the first person":
        assert (stopped.stdout, stopped.stderr.splitlines()[1:]) == ("", ["interrupted"])
        return
    assert stopped.stderr.splitlines()[1:] == ["interrupted; what was finished by then is shown"]
    found = json.loads(stopped.stdout)
    assert (found["people_bounded"], found["policies"]) == (1 if stage == "the second person" else 2, [])
    if stage == "the second person":
        first, other = solved[0], found["upper"] - solved[0]
        monkeypatch.undo()
        whole = json.loads(invoke(*command, *several).stdout)["upper"]
        assert whole - 1e-6 <= first + other < first  # a bound, and the other person counts
    else:
        assert found["upper"] < min(solved)


def test_a_study_that_fails_before_its_first_episode_does_not_block_the_corrected_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("assist.studies.runner.outcomes", here)
    monkeypatch.setattr(study_report, "draw_all", lambda *_, **__: None)
    own, out = tmp_path / "own.py", tmp_path / "out"
    own.write_text("def mine(team):\n    return 7\n")
    text = STUDY.replace("pool = 2", 'pool = 2\npolicies = ["own.py:mine"]').partition("[[conditions]]")[0]
    command = ("study", "--protocol", write(tmp_path, text), "--out", out, "--repeats", 1)
    failed = invoke(*command)
    assert failed.exit_code == 1, failed.output
    own.write_text("def mine(team):\n    return team.act(team.active.argmax(axis=1), team.first_optimal())\n")
    cells._own.cache_clear()  # as another process does not have the old one
    corrected = invoke(*command)
    assert corrected.exit_code == 0, corrected.output
    again = invoke(*command)
    assert (again.exit_code, "exists; resume it, or choose another folder" in again.stderr) == (2, True)


def test_a_study_says_that_its_episodes_were_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assist.studies.runner.outcomes", here)
    monkeypatch.setattr(study_report, "draw_all", lambda *_, **__: None)
    for limit, cut in ((4, True), (500, False)):
        text = STUDY.partition("[[conditions]]")[0]
        file, out = write(tmp_path, f"{text}\n[setting]\nmax_steps = {limit}\n"), tmp_path / str(limit)
        result = invoke("study", "--protocol", file, "--out", out)
        assert result.exit_code == 0, result.output
        headline = json.loads((out / "summary.json").read_text())["headline"]
        frame = load_study(out)
        assert (headline["cut_off"], headline["episodes"]) == (frame["cut_off"].sum(), len(frame))
        assert (headline["cut_off"] > 0, headline["max_steps"]) == (cut, limit)
        for policy, own in frame.groupby("policy", observed=True):
            assert headline["finished"][policy]["mean"] == pytest.approx(own["finished_percent"].mean())
        assert (headline["finished"]["none"]["mean"] < 100) == cut
        said = f"somebody had not finished after {limit} steps, or could not any more: savings count until then"
        assert (said in result.stdout, said in (out / "report.md").read_text()) == (cut, cut)


WRONG = """
import numpy as np
from assist.team import TeamAction

def one_for_all(team):
    return team.act(team.active.argmax(axis=1), team.first_optimal())

def chance(team):
    q = team.q_values()
    return team.act(np.where(q.max(axis=2).max(axis=1) > 0, 0.5, -1), q.argmax(axis=2))

def too_far(team):
    return team.act(np.full(team.location.shape, 7), team.first_optimal())

def chosen_one(team):
    return team.act(np.zeros(team.location.shape, int), team.first_optimal()[:, 0])

def unlike_any(team):
    return team.act(np.zeros(team.location.shape, int), team.first_optimal() + 99)

def nothing(team):
    return None

def pair(team):
    return np.zeros(len(team.x), int), np.zeros(len(team.x), int)

def lists(team):
    return TeamAction([0] * len(team.x), [0] * len(team.x))

def scalars(team):
    return TeamAction(0, 0)

def turned(team):
    return TeamAction(*np.zeros((2, 3, len(team.x)), int))

def halves(team):
    return TeamAction(*np.full((2, *team.location.shape), 0.5))

def no_array(team):
    return team.act(None, None)
"""


@pytest.mark.parametrize("robots", [1, 2])
def test_what_a_policy_of_ones_own_should_return_is_said(robots: int, tiny: Table, tmp_path: Path) -> None:
    """A policy may leave out the axis of a single robot. Each wrong return is one line: the place, the right shape."""
    (tmp_path / "own.py").write_text(WRONG)
    pool = Pool.sample(tiny, 3, seed=1, setting=Setting(robots=robots))
    shape, each = f"(20, {robots})", f"each of 20 teams and {robots} robot" + "s" * (robots == 2)
    arrays = f"two int arrays of shape {shape}, an entry for each robot of each team"
    person = f"expected whole numbers, shape {shape}, one for {each}, -1 for a robot that stays"
    for name, words in {
        "one_for_all": person if robots > 1 else None,
        "chance": person,
        "too_far": "person 7 in a team of 3: expected 0 to 2, -1 for a robot that stays",
        "chosen_one": "action, int64 array of shape (20,): expected whole numbers, shape (20, 3), a robot",
        "unlike_any": "makes a suggestion that the person's state does not have",
        "nothing": f"returned NoneType; expected a TeamAction, as team.act(person, action) gives it: {arrays}",
        "pair": f"returned tuple; expected a TeamAction, as team.act(person, action) gives it: {arrays}",
        "lists": f"chose [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]; expected {arrays}",
        "scalars": f"chose 0; expected {arrays}",
        "turned": f"an array of int64, shape (3, 20); expected {arrays}",
        "halves": f"an array of float64, shape {shape}; expected {arrays}",
        "no_array": person,
    }.items():
        policy = UserPolicy.load(tmp_path / "own.py", name)
        if words is None:
            assert simulate(pool, policy, humans=3, episodes=20, seed=0).interventions.any()
            continue
        with pytest.raises(UserCodeError) as raised:
            simulate(pool, policy, humans=3, episodes=20, seed=0)
        assert str(raised.value).startswith(f"{tmp_path / 'own.py'}:")
        if name == "unlike_any" and robots == 2:  # both robots with one person
            words = "lets two robots be with one person"
        assert words in str(raised.value)
        assert "UserCodeError" not in str(raised.value)


TEAM = "assist.connect.gymnasium:kitassist/Team-v0"


def idle_returns(env: Any, episodes: int, seed: int) -> list[float]:
    """Return the discounted returns of episodes in which the robot does nothing."""
    found = []
    for number in range(episodes):
        env.reset(seed=seed if number == 0 else None)
        total, discount, over = 0.0, 1.0, False
        while not over:
            _, reward, terminated, truncated, _ = env.step(0)
            total, discount, over = total + discount * reward, discount * 0.99, terminated or truncated
        found.append(total)
    return found


def betas(pool: Pool) -> list[float]:
    return [human.beta for human in pool.people]


def test_the_episodes_of_an_environment_are_those_of_the_command(tmp_path: Path) -> None:
    """The first reset with a seed draws the pool; later ones keep it."""
    gymnasium = pytest.importorskip("gymnasium")
    written = {}
    for seed in (1, 2):
        command = ("simulate", TINY, "--humans", 2, "--policy", "none", "--episodes", 4, "--seed", seed)
        assert invoke(*command, "--out", tmp_path / "out.jsonl").exit_code == 0
        records = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()]
        written[seed] = [record["discounted_return"] for record in records]
    env = gymnasium.make(TEAM, instance=TINY, humans=2, beliefs=False)
    env.reset()  # without a seed
    before = env.observation_space
    assert idle_returns(env, 4, 1) == pytest.approx(written[1])
    people = betas(env.unwrapped.pool)
    assert idle_returns(env, 4, 1) == pytest.approx(written[1])
    other = idle_returns(env, 4, 2)
    assert betas(env.unwrapped.pool) == people
    assert other != pytest.approx(written[2])
    assert env.observation_space == before == env.unwrapped._desk.spaces()[0]
    apart = gymnasium.make(TEAM, instance=TINY, humans=2, beliefs=False)
    assert idle_returns(apart, 4, 2) == pytest.approx(written[2])
    assert idle_returns(apart, 4, 1) != pytest.approx(written[1])
    many = gymnasium.make_vec(TEAM, num_envs=4, instance=TINY, humans=2)
    many.reset(seed=1)
    assert betas(many.unwrapped.pool) == people
    agents = pytest.importorskip("assist.connect.pettingzoo").parallel_env(TINY, humans=2)
    agents.reset(seed=1)
    assert betas(agents.pool) == people
    assert gymnasium.make(TEAM, instance=TINY, humans=14).unwrapped.pool.model.shape == (14,)  # as in the command


def test_environments_refuse_what_has_no_effect(tiny: Table) -> None:
    gymnasium = pytest.importorskip("gymnasium")
    pool, parallel_env = Pool.sample(tiny, 2, seed=1), pytest.importorskip("assist.connect.pettingzoo").parallel_env
    for options, error, words in (
        ({"setting": Setting(c_ask=0.1)}, ValueError, "c_ask 0.1 has no effect without several goals; expected None"),
        ({"setting": Setting(ask_error=0.1)}, ValueError, "ask_error 0.1 has no effect without c_ask; expected 0"),
        ({"setting": Setting(c_execute=2)}, ValueError, "c_execute 2 has no effect without robots that execute"),
        ({"setting": Setting(trust="constant", eta=0.5)}, ValueError, "eta 0.5 has no effect without trust 'paper'"),
        ({"instance": [TINY, TINY]}, TypeError, "a list where a task was expected: its name, such as 'kitting/tiny'"),
        ({"instance": pool, "setting": Setting()}, ValueError, "setting has no effect with a pool"),
    ):
        for make in (
            lambda **given: gymnasium.make(TEAM, **given),
            lambda **given: gymnasium.make_vec(TEAM, num_envs=2, **given),
            parallel_env,
        ):
            with pytest.raises(error, match=re.escape(words)):
                make(**{"instance": TINY, "humans": 2} | options)
    gymnasium.make(TEAM, instance=TINY, setting=Setting(execute=True, c_execute=2, believed_trust="paper", eta=0.5))


def test_a_robot_that_would_ask_about_one_goal_is_refused(tiny: Table, tmp_path: Path) -> None:
    pool = Pool.sample(tiny, 2, seed=1, setting=Setting(c_ask=0.1))
    with pytest.raises(ValueError, match=r"c_ask 0.1 has no effect without several goals"):
        simulate(pool, "none", humans=2, episodes=1, seed=0)
    file = write(tmp_path, f"{STUDY.partition('[[conditions]]')[0]}\n[setting]\nc_ask = 0.1\n")
    result = invoke("study", "--protocol", file, "--out", tmp_path / "out")
    assert (result.exit_code, "setting: c_ask 0.1 has no effect" in result.stderr) == (2, True), result.stderr
    assert not (tmp_path / "out" / "episodes.jsonl").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("bound", TINY, "--humans", 2, "--trace", "x"), "No such option '--trace'; simulate has it"),
        (("policy", TINY, "--gpa", 0.1), "No such option '--gpa'. Did you mean '--gap'?"),
        (
            ("simulate", TINY, "--humans", 2, "--episode", 3),
            "No such option '--episode'; draw has it. Did you mean '--episodes'?",
        ),
        (("bound", TINY, "--xyzzy"), "No such option '--xyzzy'. kitassist bound --help lists the options"),
        (
            (
                "simulate",
                TINY,
                "--humans",
                2,
                "--set",
                "observation.miss=0.1",
                "--policy",
                "none",
                "--policy",
                "rollout",
            ),
            "--policy rollout with observation: expected actions that are all seen as they are, or another policy",
        ),
        (
            ("export", TINY, "--out", "x.pomdpx", "--trust", "outcome"),
            "--trust: a file has no trust that depends on whether advice is followed; expected --trust paper or",
        ),
        (("export", TINY, "--out", "x.txt"), "expected a name that ends in .pomdpx or .pomdp"),
        (("export", TINY, "--out", "x.pomdp", "--format", "pomdpx"), "expected a name that ends in .pomdpx"),
    ],
)
def test_refusals_name_what_is_wrong_and_what_would_be_right(
    command: tuple[object, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, [str(word) for word in command], prog_name="kitassist")
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["small.pomdp", "small.pomdpx"])
def test_the_size_of_an_export_is_said_first_and_the_name_says_the_format(name: str, tmp_path: Path) -> None:
    out = tmp_path / name
    written = invoke("export", TINY, "--out", out, "--json")
    assert (written.exit_code, json.loads(written.stdout)["format"]) == (0, out.suffix[1:])
    size = out.stat().st_size
    out.unlink()
    refused = invoke("export", TINY, "--out", out, "--size-limit", size / 1e6 / 2)
    said = re.fullmatch(rf"--out {re.escape(str(out))}: it would take about (\S+) MB, more than .*\n", refused.stderr)
    assert said, refused.stderr
    assert float(said[1]) * 1e6 == pytest.approx(size, rel=0.3)
    assert (refused.exit_code, out.exists()) == (1, False)


def test_the_size_of_a_large_export_is_found_without_writing_it() -> None:
    table = kit("paper-fixed")
    observed = Observed.of(AssistPOMDP.of(HumanModel.exact(Choices.of(table))), table)
    every = observed.values()
    for lines_of in (pomdp.lines_of, pomdpx.lines_of):
        whole = sum(map(len, lines_of(observed, every)))
        few = sum(map(len, lines_of(observed, every[::8]))) * len(every) / len(every[::8])
        assert bytes_needed(observed, lines_of) == pytest.approx(whole, rel=0.05)
        assert few == pytest.approx(whole, rel=0.3)
