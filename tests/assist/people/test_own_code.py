"""Trials of users' own code: what is right passes, and what is wrong is told in one sentence."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import ROOT, thinned

import assist
from assist.cli import main
from assist.people import TERMS, EquationSeven, LogitSteps, Reliability, UserCodeError, user_code
from assist.studies import own_code_trials
from assist.team import UserPolicy, assigned

EXAMPLES = ROOT / "docs" / "examples"


def only(found: Any, what: str) -> str:
    """Return what a trial says; every other one, if it fails, does so too."""
    told = {trial.what: trial.fault for trial in found.trials}
    assert told[what] is not None, str(found)
    return str(told[what])


def in_every_form(team: Any) -> Any:
    """Send the first robot to the first person who has not finished."""
    person = np.full(team.location.shape, -1)
    first = person if person.ndim == 1 else person[:, 0]
    first[:] = np.where(team.active.any(axis=1), team.active.argmax(axis=1), -1)
    return team.act(person, np.zeros(team.active.shape, dtype=int))


def only_in(monkeypatch: pytest.MonkeyPatch, *situations: str) -> None:
    """Try simulations in some situations; there are a dozen, of which some take a tenth of a second."""
    every = own_code_trials._situations
    monkeypatch.setattr(
        own_code_trials, "_situations", lambda *given: (one for one in every(*given) if one[0] in situations)
    )


@pytest.fixture
def one_situation(monkeypatch: pytest.MonkeyPatch) -> None:
    only_in(monkeypatch, "three people")


def by_the_mean(team: Any) -> Any:
    return team.act(assigned(team, (team.mean_theta() - team.mean_beta() / 10)[:, None] + 0.1), team.first_optimal())


def test_a_policy_that_uses_beliefs_and_an_assignment_passes_everywhere() -> None:
    found = assist.check(by_the_mean)
    assert (found.kind, found.faults) == ("policy", ()), str(found)
    assert len(found.trials) >= 12


def test_a_policy_in_a_file_is_taken_by_its_name_in_python(tmp_path: Path) -> None:
    (file := tmp_path / "own.py").write_text(
        "def first(team):\n    return team.act(team.active.argmax(axis=1), team.first_optimal())\n"
    )
    name, pool = f"{file}:first", assist.Pool.sample("kitting/tiny", 2, seed=0)
    (row,) = assist.compare(pool, [name], humans=2, episodes=4, seed=0)
    assert row.policy == name
    with pytest.raises(UserCodeError, match=r"own.py.*'second'"):
        assist.simulate(pool, f"{file}:second", humans=2, episodes=4, seed=0)


def test_a_policy_for_one_robot_says_so_with_two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one line for both situations."""
    only_in(monkeypatch, "three people", "two robots", "two robots that differ")
    (file := tmp_path / "own.py").write_text(
        "def in_turn(team):\n    return team.act(team.active.argmax(axis=1), team.first_optimal())\n"
    )
    found = assist.check(f"{file}:in_turn")
    assert {"two robots", "two robots that differ"} == {one.what for one in found.faults}
    assert "own.py:2" in only(found, "two robots")
    assert str(found).splitlines()[0].startswith(f"{file}:in_turn (policy), two robots (and 1 more of 4 trials): ")
    assert len(str(found).splitlines()) == 1


class Stuck:
    """Helps those who have not come closer for long; it remembers by rows, in which other teams are later."""

    def __call__(self, team: Any) -> Any:
        far = team.cost_to_go()
        if team.step == 0 or self.best.shape != far.shape:
            self.best, self.since = far.copy(), np.zeros(far.shape)
        self.since = np.where(far < self.best, 0, self.since + 1)
        self.best = np.minimum(self.best, far)
        return team.act(assigned(team, np.where(self.since > 1, self.since, -1.0)[:, None]), team.first_optimal())


class Alternating:
    """Does not help the same person twice in succession."""

    last: Any = None

    def __call__(self, team: Any) -> Any:
        worth = np.where(team.active, 1.0, -1.0)[:, None, :] - team.to()
        if self.last is not None and len(self.last) == len(worth):
            rows, robots = np.nonzero(self.last >= 0)
            worth[rows, :, self.last[rows, robots]] = -1
        person = assigned(team, worth)
        self.last = person.reshape(len(worth), -1).copy()
        return team.act(person, team.first_optimal())


class Draws:
    """Goes to anybody."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def __call__(self, team: Any) -> Any:
        return team.act(assigned(team, self.rng.random(team.active.shape)[:, None]), team.first_optimal())


def of_the_batch(team: Any) -> Any:
    """Go to somebody only in the first of all teams: a slip between rows and teams."""
    taken = in_every_form(team)
    person = taken.person.copy()
    person[1:] = -1
    return team.act(person, np.zeros(team.active.shape, dtype=int) + team.active)


def outside(team: Any) -> Any:
    return team.act(np.full(team.location.shape, team.active.shape[1]), team.first_optimal())


def broken(team: Any) -> Any:
    return team.no_such_thing


@pytest.mark.usefixtures("one_situation")
@pytest.mark.parametrize(
    ("policy", "what", "said"),
    [
        (of_the_batch, "each team by itself", "other teams"),
        (Stuck(), "each team by itself", "without memory"),
        (Alternating(), "each team by itself", "called again in the same state"),
        (Draws, "each team by itself", "without random numbers"),
        (outside, "three people", "expected 0 to 2"),
        (broken, "three people", "no_such_thing"),
        (lambda _: None, "three people", "TeamAction"),
    ],
)
def test_what_is_wrong_with_a_policy(policy: Callable[..., Any], what: str, said: str) -> None:
    assert said in only(assist.check(policy, "policy"), what)


def uniform(choices: Any, q: Any, beta: Any) -> Any:  # noqa: ARG001
    share = choices.applicable / np.maximum(choices.applicable.sum(axis=1, keepdims=True), 1)
    return np.broadcast_to(share, (len(beta), *share.shape)).copy()


def ranked(choices: Any, q: Any, beta: Any) -> Any:
    """Depends on the place of a type among the others."""
    return uniform(choices, q, beta) if len(beta) == 1 else _greedy(choices, q, beta)


def _greedy(choices: Any, q: Any, beta: Any) -> Any:
    best = np.zeros((len(beta), *q.shape))
    rows = np.flatnonzero(choices.applicable.any(axis=1))
    best[:, rows, np.where(choices.applicable, q, np.inf)[rows].argmin(axis=1)] = 1.0
    return best


def in_place(choices: Any, q: Any, beta: Any) -> Any:
    q += 1.0
    return uniform(choices, q, beta)


def overflowing(choices: Any, q: Any, beta: Any) -> Any:
    with np.errstate(all="ignore"):
        weight = np.exp(beta[:, None, None] * (40 - q)) * choices.applicable
        return weight / weight.sum(axis=2, keepdims=True)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (lambda choices, q, beta: uniform(choices, q, beta)[0], "shape"),
        (lambda choices, q, beta: 2 * uniform(choices, q, beta), "adding up to 1"),
        (ranked, "alone than among others"),
        (in_place, "changes the array q"),
        (overflowing, "adding up to 1"),
    ],
)
@pytest.mark.usefixtures("one_situation")
def test_what_is_wrong_with_a_choice_model(model: Callable[..., Any], said: str) -> None:
    assert said in only(assist.check(model), "probabilities of all choices")


@pytest.mark.parametrize("rule", thinned([LogitSteps(0.1, 0.5, 1.0), EquationSeven(), Reliability()], 3))
def test_shipped_trust_rules_pass(rule: Any) -> None:
    found = assist.check(rule)
    assert (found.kind, found.faults) == ("trust", ()), str(found)


@dataclass(frozen=True)
class Up:
    """A rule of one's own, with each part that may be wrong."""

    step: float = 0.1
    feedback: Any = "never"
    uses_answer: Any = False

    def update(self, theta: Any, event: Any) -> Any:
        return theta + self.step + 0 * event.gain


class Answers(Up):
    def update(self, theta: Any, event: Any) -> Any:
        return np.clip(theta + np.where(event.followed, 0.1, 0.0) + 0 * event.gain, 0, 1)


class Mutating(Up):
    def update(self, theta: Any, event: Any) -> Any:
        theta *= 0.5
        return theta + 0 * event.gain


@pytest.mark.parametrize(
    ("rule", "what", "said"),
    [
        (Up(), "events of all kinds", "theta 1.1; expected a number from 0 to 1"),
        (Up(feedback="often"), "its attributes", "'often'; expected one of perceived, true, never"),
        (Up(uses_answer=None), "its attributes", "uses_answer"),
        (Answers(), "events of all kinds", "`uses_answer` is False"),
        (Mutating(), "events of all kinds", "changes the array theta"),
    ],
)
@pytest.mark.usefixtures("one_situation")
def test_what_is_wrong_with_a_trust_rule(rule: Any, what: str, said: str) -> None:
    assert said in only(assist.check(rule), what)


def test_terms_are_tried_where_there_is_no_last_action() -> None:
    for term in TERMS.values():
        assert not assist.check(term, "term").faults
    assert "finite" in only(assist.check(lambda s: np.where(s.goals_after > 0, np.inf, 0.0), "term"), "a small task")
    by_place = assist.check(lambda s: np.arange(len(s.state))[:, None] + 0.0 * s.actions, "term")
    assert "each row by itself" in only(by_place, "a small task")


def test_the_command_says_what_is_wrong_and_ends_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_in(monkeypatch, "three possible goals")
    own = tmp_path / "own.py"
    own.write_text(
        "def policy(team):\n    return 1 / 0\n\n\nclass Rule:\n    def __init__(self, step):\n        pass\n"
    )
    run = CliRunner().invoke(main, ["check", f"{own}:policy"])
    assert run.exit_code == 1
    assert all(f"{own}:2: ZeroDivisionError" in line for line in run.output.splitlines())
    for name, said in (("absent", "has no function 'absent'"), ("Rule", "expected a class without arguments")):
        run = CliRunner().invoke(main, ["check", f"{own}:{name}"])
        assert (run.exit_code, said in run.output) == (1, True)
    run = CliRunner().invoke(main, ["check", f"{EXAMPLES / 'short_sighted.py'}:short_sighted"])
    assert (run.exit_code, run.output.strip().endswith("all 3 trials passed")) == (0, True)
    with pytest.raises(UserCodeError, match=r"expected FILE\.py:NAME"):
        assist.check("attention")


@pytest.mark.cases
def test_a_file_may_import_others_of_its_folder(tmp_path: Path) -> None:
    """Each folder has its own, they are read anew, and a study goes on only with the same."""
    for folder in ("a", "b"):
        (tmp_path / folder / "more").mkdir(parents=True)
        (tmp_path / folder / "helping.py").write_text(
            f"from more import last\ndef best(team): return {folder!r} + last\n"
        )
        (tmp_path / folder / "more" / "__init__.py").write_text("last = '1'\n")
        (tmp_path / folder / "mine.py").write_text("from helping import best\n")
    paths, mine = list(sys.path), tmp_path / "a" / "mine.py"
    assert [user_code.load(tmp_path / folder / "mine.py", "best")(None) for folder in "ab"] == ["a1", "b1"]
    (tmp_path / "a" / "more" / "__init__.py").write_text("last = 'two'\n")
    assert user_code.load(mine, "best")(None) == "atwo"
    assert (sys.path, {"helping", "more"} & set(sys.modules)) == (paths, set())
    assert [path.name for path in user_code.sources(mine)] == ["helping.py", "mine.py", "__init__.py"]
    (tmp_path / "a" / "helping.py").write_text("best =\n")
    with pytest.raises(UserCodeError, match=r"mine\.py:1: SyntaxError: invalid syntax \(helping\.py, line 1\)$"):
        user_code.load(mine, "best")
    assert user_code.sources(mine) == (mine,)
    mine.write_text("def best(team):\n    import helping\n")
    with pytest.raises(UserCodeError, match=r"mine\.py:2: ModuleNotFoundError: .*expected its import at the beginning"):
        UserPolicy.load(mine, "best")(None)  # type: ignore[arg-type]
    mine.write_text("import no_such_package\n")
    with pytest.raises(UserCodeError, match=r"No module named 'no_such_package'$"):
        user_code.load(mine, "best")


@pytest.mark.cases
def test_a_misspelt_function_is_told_with_the_right_one(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from math import sqrt\ndef furthest_first(team): ...\n")
    with pytest.raises(UserCodeError, match=r"has no function 'furthest'; did you mean 'furthest_first'\?"):
        user_code.load(tmp_path / "mine.py", "furthest")
    with pytest.raises(UserCodeError, match=r"has no function 'x'; expected one of furthest_first$"):
        user_code.load(tmp_path / "mine.py", "x")
