"""Refusals of Python functions and their messages; each says what would be valid."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from conftest import KITTING, invoke
from recorded import log_of
from teams import state
from test_qmdp import make

from assist.connect import TeamEnv, TeamVectorEnv, parallel_env
from assist.declare import InapplicableError, Refusal
from assist.drawing import Artist, episode_frames
from assist.learning import Log, comparison, logit_likelihood, population, replayed
from assist.learning.fit import fit
from assist.learning.maximum_likelihood import Method
from assist.live import Advice, Assistant, Elapsed, Joined, Left, TeamRecord
from assist.live.event_base import TeamEvent
from assist.live.team import Team
from assist.people import (
    Choices,
    Human,
    Misconception,
    Population,
    UserCodeError,
    Weighted,
    boltzmann,
    perceived_cost,
    user_code,
)
from assist.people.action_names import Matcher
from assist.people.choice_model import value
from assist.person import AssistPOMDP, Travel, VectorPolicy
from assist.person.qmdp import qmdp
from assist.studies.userstudy import Item, Questionnaire
from assist.team import Pool, Schedule, TeamAction
from assist.team.action_check import check
from assist.team.simulate import simulate
from assist.web import Client, request_limits
from assist.web.tokens import AccessTokens
from planner import InputFileError, PDDLError, Table, load
from planner.engine import Engine
from planner.grounding.translation import from_sas
from planner.system.files import writable


class Given(NamedTuple):
    table: Table
    choices: Choices
    pool: Pool
    folder: Path


@pytest.fixture
def given(tiny: Table, tiny_choices: Choices, pool: Pool, tmp_path: Path) -> Given:
    return Given(tiny, tiny_choices, pool, tmp_path)


def of_no_python_file(folder: Path) -> None:
    (folder / "own.txt").touch()
    user_code.load(folder / "own.txt", "mine")


def another_way(choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
    return boltzmann(choices, q, beta)


def speaks_to_the_first() -> TeamAction:
    return TeamAction(np.zeros((1, 1), dtype=np.int64), np.ones((1, 1), dtype=np.int64))


def of_vectors(pomdp: AssistPOMDP, first: np.ndarray) -> VectorPolicy:
    return VectorPolicy(pomdp, np.zeros((0, *pomdp.grid.shape)), np.zeros(0, dtype=np.int64), first)


def says(text: str, folder: Path) -> Path:
    (folder / "secret").write_text(text)
    return folder / "secret"


def saved_by_another(given: Given) -> None:
    desk = Assistant(given.table, people=["ann"])
    Assistant.from_json(json.dumps(json.loads(desk.to_json()) | {"format": 0}), given.table)


def saved_with_an_own_policy(given: Given) -> None:
    desk = Assistant(given.table, people=["ann"], policy=given.pool.policy("reactive"))
    Assistant.from_json(desk.to_json(), given.table)


def comes_back_to_another(given: Given) -> None:
    desk = Assistant(given.table, people=["ann"])
    desk.leave("ann")
    desk.join("ann", given.table)


ACTIONS: list[dict[str, Any]] = [
    {"person": "ann", "episode": "1", "step": step, "action": action}
    for step, action in enumerate(("(fetch box-a)", "(place hammer slot-2 box-a)", "(return box-a)"))
]


def learned(table: Any, rows: list[dict[str, Any]], **options: Any) -> Any:
    return fit(table, log_of(rows), **options)


def happen(table: Table, *events: TeamEvent) -> None:
    team = Team({"tiny": table})
    for event in events:
        team.happen(event, 0.0)


def in_bytes(folder: Path, content: bytes) -> None:
    (folder / "task.pddl").write_bytes(content)
    load(folder / "task.pddl", KITTING / "domain.pddl")


REFUSED: list[tuple[Callable[[Given], Any], type[Exception], str]] = [
    (lambda g: (g.folder / "morning.csv").touch() or fit(g.table, g.folder / "mornings.csv"),
     InputFileError, "mornings.csv: no such file; did you mean"),
    (lambda g: fit(g.table, g.folder), InputFileError, "Is a directory"),
    (lambda g: (g.folder / "kits.pddl").touch() or load(g.folder / "kit.pddl"),
     PDDLError, "kit.pddl: no such problem file; did you mean"),
    (lambda g: (g.folder / "domain.pddl").touch() or load(KITTING / "tiny.pddl", g.folder / "domains.pddl"),
     PDDLError, "domains.pddl: no such domain file; did you mean"),
    (lambda g: Assistant.from_json("", g.table), ValueError, "no saved team: line 1 is no JSON; expected a text of"),
    (lambda g: learned(g.table, ACTIONS, influence="paper"),
     TypeError, "influence: expected fit_influence(replayed(task, log), rule)"),
    # People and pools.
    (lambda _: Population.mixed((Population(), Population(chooses=another_way)), (0.5, 0.5)),
     ValueError, "parts with different choice models; expected the same for all"),
    (lambda _: Misconception(0.5, 1, "both"), ValueError, "noise 'both': expected 'state' or 'action'"),
    (lambda g: user_code.load(g.folder / "x.py", "mine"), user_code.UserCodeError, "x.py: no such file"),
    (lambda g: of_no_python_file(g.folder), user_code.UserCodeError, "expected a Python file, whose name ends"),
    (lambda g: AssistPOMDP.of(g.pool.policies[0].pomdp.model, suggestions="best"),
     ValueError, "suggestions 'best': expected 'optimal' or 'all'"),
    (lambda g: replace(g.pool, people=()), ValueError, "0 people, model (5,): expected one entry for each"),
    (lambda g: replace(g.pool, model=g.pool.model + len(g.pool.policies)),
     ValueError, "model: expected numbers from 0 to"),
    (lambda g: replace(g.pool, setting=replace(g.pool.setting, gamma=0.9)),
     ValueError, "gamma 0.99: expected that of the setting, 0.9"),
    (lambda _: Pool.joined([]), ValueError, "joined: expected one pool or more"),
    (lambda g: Pool.joined([g.pool, replace(g.pool, setting=replace(g.pool.setting, c_move=0.9))]),
     ValueError, "joined: c_move is"),
    (lambda _: Human(-1.0, 0.5, 0.0, np.zeros(2)), ValueError, "beta -1, theta 0.5"),
    (lambda _: Human(1.0, 1.5, 0.0, np.zeros(2)), ValueError, "theta from 0 to 1"),
    # Teams.
    (lambda _: Travel(np.zeros((2, 3)), np.ones(1), np.zeros(1)),
     ValueError, "distance, shape (2, 3): expected a square, one row for each place and base"),
    (lambda _: Travel(np.zeros((2, 2)), np.ones(2), np.array([0.0, -1.0])),
     ValueError, "travel_time -1: expected a number from 0"),
    (lambda g: simulate(g.pool, "none", humans=2, episodes=1, seed=0, travel=Travel.of(2, c_move=[0.1, 0.2])),
     ValueError, "travel of 2 robots: expected that of 1"),
    (lambda _: Schedule.of(2, joins=3, leaves=2), ValueError, "join at step 0 or later and"),
    (lambda g: simulate(g.pool, "none", humans=2, episodes=1, seed=0, travel=g.pool.setting.travel(3)),
     ValueError, "travel for 3, presence for 2: expected 2 people"),
    (lambda g: state(g.pool, [0, 0], belief=np.empty((0, 1, 1))).q_values(),
     ValueError, "the policy has said that it uses no beliefs"),
    (lambda g: check(state(g.pool, [0, 0]), TeamAction(np.zeros((1, 1)), np.zeros((1, 1), dtype=np.int64))),
     UserCodeError, "step 0: the policy "),
    (lambda g: check(state(g.pool, [0, 0], travel=Travel.of(2, travel_time=2.0)), speaks_to_the_first()),
     UserCodeError, "speaks to a person before the robot has arrived"),
    # Environments.
    (lambda g: TeamEnv(g.pool, 0), ValueError, "humans 0: expected 1 to 5, the size of the pool"),
    (lambda g: parallel_env(g.pool, 6), ValueError, "humans 6: expected 1 to 5, the size of the pool"),
    (lambda g: TeamEnv(g.pool, render_mode="ansi"), ValueError, "render_mode 'ansi': expected rgb"),
    (lambda g: TeamEnv(g.pool).step(0), gymnasium.error.ResetNeeded, "expected reset before it"),
    (lambda g: TeamVectorEnv(g.pool, 3).step(np.zeros(3, dtype=np.int64)),
     gymnasium.error.ResetNeeded, "expected reset before it"),
    (lambda g: TeamEnv(replace(g.pool, known=None), render_mode="rgb_array").render(),
     TypeError, "expected an environment of one task, and this pool has none to draw"),
    # Learning.
    (lambda _: logit_likelihood.Likelihood.of([], Method()), ValueError, "terms need people; there are no obs"),
    (lambda _: population.fit_population([]), ValueError, "a population needs people; there are"),
    (lambda _: comparison.folds_of(3, 1), ValueError, "folds 1: expected 2 or more"),
    (lambda _: Matcher(["(go)"]).slot((), np.array([0])), Refusal, "an empty action; nearest in"),
    (lambda _: Matcher(["(go)"]).slot(("go",), np.array([], dtype=np.int32)),
     Refusal, "(go) is not applicable; a person can only wait here, (wait)"),
    (lambda g: learned({"kit": g.table}, ACTIONS, model="terms"),
     ValueError, "several goals, and misconceptions, terms or a choice model: expected one of them"),
    (lambda g: fit(replayed(g.table, log_of(ACTIONS)), log_of(ACTIONS)),
     TypeError, "a replayed log, and a log or options of reading one: expected one of them"),
    (lambda g: learned(g.table, ACTIONS, model="terms").distribution(family="uniform"),
     ValueError, "family 'uniform': expected log-normal, which beta is taken to be where terms are"),
    (lambda g: fit(g.table, Log((), people=frozenset({"ann"}))), InputFileError, "no episode can be used"),
    (lambda _: comparison.Comparison((), np.zeros(0, dtype=np.int64), 0.95, ())["goals"], KeyError, "goals"),
    (lambda g: of_vectors(g.pool.policies[0].pomdp, np.ones(len(g.choices) + 1, dtype=np.int64)),
     ValueError, "first: expected ascending offsets from 0 to 0"),
    # The live assistant.
    (lambda g: happen(g.table, Joined(person="ann"), Left(person="ann"), Joined(person="ann", task="tiny")),
     InapplicableError, "ann returns to the task that they left"),
    (lambda g: episode_frames(Artist(g.table.task), []), ValueError, "the log is empty"),
    (lambda _: Client("http://127.0.0.1:9/operator#secret").see(),
     ValueError, "expected the name of a person, since the link is not that of one"),
    (lambda _: Questionnaire("text", items=(Item("why", "Why?", "text"),)).check({"why": "x" * 100_000}),
     ValueError, "answers.why: expected a text of 1 to"),
    (lambda _: Team({}), ValueError, "there is no task; expected one or more"),
    (lambda g: AccessTokens.kept(says("short", g.folder), "http://x"), OSError, "bytes of the session's secret;"),
    (lambda _: TeamRecord(n=1, event=Elapsed(), step=1, advices=(Advice(None, "(go)", None, arrived=True),)),
     ValueError, "advices: advice for nobody"),
    (saved_by_another, ValueError, "no saved team that can be restored: format 0; expected"),
    (saved_with_an_own_policy, ValueError, "the policy was a function; expected it as `policy`"),
    (comes_back_to_another, ValueError, "ann returns to the task that they left; `begin` gives"),
    (lambda g: Assistant(g.table, people=["ann"]).join("bob", qmdp(make(g.choices))),
     ValueError, "bob: a belief of shape (2, 3); expected (6, 10), as in others"),
    (lambda g: Assistant(g.table, people=["ann"]).begin("ann", qmdp(make(g.choices))),
     ValueError, "ann: the next task distinguishes other values of beta and theta; expected the same"),
    # Tasks.
    (lambda _: Engine(speed=3), TypeError, "speed: this engine has no such options"),
    (lambda g: from_sas("begin_variable\n", g.table.task.instance),
     ValueError, "SAS text: expected 'begin_version', found 'begin_variable'"),
    (lambda g: writable(g.folder), OSError, "is a folder, not a file"),
    (lambda g: in_bytes(g.folder, b"(define (problem p\xe4))"), PDDLError, "task.pddl:1: not a text file in UTF-8"),
    (lambda g: in_bytes(g.folder, "(define)".encode("utf-16")),
     PDDLError, "task.pddl:1: this is UTF-16; save it as UTF-8"),
    (lambda g: in_bytes(g.folder, "(define)".encode("utf-32")),
     PDDLError, "task.pddl:1: this is UTF-32; save it as UTF-8"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "kind", "words"), REFUSED, ids=[words for *_, words in REFUSED])
def test_what_cannot_be_is_refused(
    given: Given, call: Callable[[Given], Any], kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=re.escape(words)):
        call(given)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("solve kitting/tiny --resume", "--resume needs --out"),
        ("draw kitting/tiny --plan tiny.plan --log t.jsonl --out a.svg", "--plan and --log: expected one of them"),
        ("live kitting/tiny", "There is no command 'live'; did you mean 'serve'?"),
        ("serve nosuch --humans 2", "nosuch: no such file or folder; `kitassist domains` lists the tasks that come"),
        ("export nosuch --out a.pomdp",
         "nosuch: no such file or folder; `kitassist domains` lists the tasks that come"),
        ("slove kitting/tiny", "There is no command 'slove'; did you mean 'solve'?"),
    ],
)  # fmt: skip
def test_words_of_a_command_that_do_not_go_together(words: str, message: str, tmp_path: Path) -> None:
    for name in ("tiny.plan", "t.jsonl"):
        (tmp_path / name).touch()
    result = invoke(*(str(tmp_path / word) if (tmp_path / word).is_file() else word for word in words.split()))
    assert (result.exit_code, message in result.stderr) == (2, True), result.stderr


def test_a_service_forgets_who_has_not_called_for_longest() -> None:
    """A caller over the limit waits, unless enough other callers came that it was forgotten."""
    allowance = request_limits.Allowance(rate=1.0, burst=1.0, callers=2, clock=lambda: 0.0)
    assert [allowance.wait(caller) for caller in ("ann", "ann", "bob", "ann", "cat", "dan", "ann")] == [
        0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip


def test_agents_see_beliefs_unless_they_are_not_to(pool: Pool) -> None:
    for beliefs in (True, False):
        env = parallel_env(pool, 2, beliefs=beliefs)
        seen, _ = env.reset(seed=1)
        assert all(("belief" in seen[agent]) == beliefs for agent in env.agents)
        assert all(env.observation_space(agent).contains(seen[agent]) for agent in env.agents)


def test_an_environment_draws_nothing_unless_asked_to(pool: Pool) -> None:
    env = TeamEnv(pool)
    env.reset(seed=1)
    assert env.render() is None
    vector = TeamVectorEnv(pool, 2)
    vector.reset(seed=1)
    said = r"actions: expected whole numbers from 0 to 6 in an array of shape \(2,\)"
    for numbers in ([0], [0, 10**6], [0, -1]):
        with pytest.raises(ValueError, match=said):
            vector.step(np.array(numbers))


def test_who_can_only_stand_still_is_understood() -> None:
    assert Matcher(["(go)"]).slot(("wait",), np.array([], dtype=np.int32)) == 0


def test_a_choice_model_without_terms_is_the_papers(tiny_choices: Choices) -> None:
    q = perceived_cost(tiny_choices, tiny_choices.h)
    beta = np.array([0.3, 2.0])
    assert (Weighted()(tiny_choices, q, beta) == boltzmann(tiny_choices, q, beta)).all()

    class Worthless:
        def __call__(self, choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
            return boltzmann(choices, q, beta)

        def value(self, _: Choices, q: np.ndarray) -> np.ndarray:
            return q[:3, 0]

    with pytest.raises(UserCodeError, match=r"Worthless: value of shape \(3,\); expected a number for each of \d+"):
        value(Worthless(), tiny_choices, q)
