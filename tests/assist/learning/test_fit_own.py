"""People with a user's choice model: estimated as with the paper's model, and refused if that is impossible."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import invoke, kit
from learning_figures import short_sighted
from recorded import people_at_work, write_log

from assist import fit
from assist.learning import FittedPeople, Log
from assist.people import Choices, boltzmann, perceived_value
from planner import OnDemand

PAPER = kit("paper")
ROWS = people_at_work(Choices.of(PAPER), [0.8], np.random.default_rng(7), suggest=0.4)


def same(choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """The paper's model, as anybody may write it."""
    return boltzmann(choices, q, beta)


def walked(model: object, beta: float, episodes: int) -> list[dict]:
    """Return the log of a person who chooses by a model."""
    choices, rng, rows = Choices.of(PAPER), np.random.default_rng(3), []
    q = np.where(choices.applicable, choices.costs + choices.h[choices.targets], np.inf)
    p = model(choices, q, np.array([beta]))[0]  # type: ignore[operator]
    for episode in range(episodes):
        x, step = choices.initial, 0
        while not choices.goal[x] and step < 40:
            slot = int(rng.choice(p.shape[1], p=p[x]))
            rows.append({"person": "ann", "episode": episode, "step": step, "action": choices.name(x, slot)})
            x, step = int(choices.targets[x, slot]), step + 1
    return rows


@pytest.fixture(scope="module")
def plain() -> FittedPeople:
    return fit(PAPER, Log.of(ROWS))


def test_the_papers_model_as_ones_own_gives_the_papers_estimates(plain: FittedPeople) -> None:
    """Chances are interpolated between values of beta, which changes the third digit at most."""
    own = fit(PAPER, Log.of(ROWS), model=same)
    assert list(own) == list(plain)
    for person, record in own.items():
        expected = plain[person]
        assert record.beta == pytest.approx(expected.beta, rel=2e-3)
        assert record.beta_interval == pytest.approx(expected.beta_interval, rel=2e-3)
        assert record.theta == pytest.approx(expected.theta, abs=5e-3)
        assert record.theta_interval == pytest.approx(expected.theta_interval, abs=5e-3)
        assert record.log_likelihood == pytest.approx(expected.log_likelihood, abs=1e-2)
        np.testing.assert_allclose(record.probabilities(), expected.probabilities(), atol=2e-3)
        assert (record.check.p, record.suboptimal_actions) == (None, expected.suboptimal_actions)


def test_the_likelihood_is_the_models_own() -> None:
    """At the estimate, it is the sum of the model's log-probabilities, lapses included."""
    rows = walked(short_sighted, 1.5, 25)
    found = fit(PAPER, Log.of(rows), model=short_sighted)["ann"]
    low, high = found.beta_interval
    assert low <= 1.5 <= high
    other = fit(PAPER, Log.of(rows))["ann"]
    assert found.log_likelihood > other.log_likelihood + 2
    choices = Choices.of(PAPER)
    q = np.where(choices.applicable, choices.costs + choices.h[choices.targets], np.inf)
    o, rate = found.observations, found.method.lapse
    p = short_sighted(choices, q, np.array([found.beta]))[0][o.state, o.chosen]
    wanted = np.log((1 - rate) * p + rate / o.applicable.sum(axis=1)).sum()
    assert found.log_likelihood == pytest.approx(wanted, abs=1e-2)


class Doubled:
    def __call__(self, choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
        return short_sighted(choices, q, beta)

    def value(self, choices: Choices, q: np.ndarray) -> np.ndarray:
        return 2 * perceived_value(choices, q)


@pytest.mark.slow
def test_trust_looks_at_the_models_own_value() -> None:
    gains = [fit(PAPER, Log.of(ROWS), model=model)["p0"].observations.gain for model in (same, Doubled())]
    np.testing.assert_allclose(gains[1], 2 * gains[0])
    assert np.any(gains[0] != 0)


@pytest.mark.slow
def test_people_like_them_choose_so_too(plain: FittedPeople) -> None:
    found = fit(PAPER, Log.of(ROWS), model=short_sighted)
    assert found.population().chooses is short_sighted
    assert plain.population().chooses is None


@pytest.mark.slow
def test_a_task_solved_on_demand_gives_the_estimates_of_its_table() -> None:
    log = Log.of([row for row in ROWS if row["episode"] == "0"])
    whole, asked = (fit(task, log, model=Doubled()) for task in (PAPER, OnDemand(PAPER.task)))
    for person, one in whole.items():
        other = asked[person]
        np.testing.assert_allclose([other.beta, other.theta], [one.beta, one.theta], rtol=1e-9)
        assert other.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-12)
        np.testing.assert_array_equal(other.observations.gain, one.observations.gain)


MINE = """
import numpy as np

def mine(choices, q, beta):
    worse = np.minimum(q, 4.0)
    weight = np.exp(-beta[:, None, None] * (worse - worse.min(axis=1, keepdims=True))) * choices.applicable
    return weight / np.maximum(weight.sum(axis=2, keepdims=True), 1e-300)

def wrong(choices, q, beta):
    return q

def broken(choices, q, beta):
    return nothing
"""


def test_fit_takes_a_function_of_the_users_own(tmp_path: Path) -> None:
    rows = [row for row in ROWS if row["episode"] == "0"]
    log, mine = write_log(tmp_path / "log.jsonl", rows), tmp_path / "mine.py"
    mine.write_text(MINE)
    people = fit(PAPER, Log.of(rows), model=short_sighted)
    for size in ((), ("--set", "max_states=10")):
        found = invoke("fit", "kitting/paper", log, "--set", f"chooses={mine}:mine", "--json", "--jobs", 1, *size)
        assert found.exit_code == 0
        assert [one["beta"] for one in json.loads(found.stdout)] == [people[name].beta for name in people]
    for people_option, more, code, message in (
        ("other", (), 2, "has no function 'other'"),
        ("wrong", (), 1, "gives an array of shape ("),
        ("broken", (), 1, "mine.py:13: NameError"),
        ("mine", ("--terms",), 2, "--terms and chooses: expected one of them"),
        ("mine", ("--write-population", tmp_path / "p.json"), 2, "a population file has no functions"),
    ):
        refused = invoke("fit", "kitting/paper", log, "--set", f"chooses={mine}:{people_option}", "--jobs", 1, *more)
        assert (refused.exit_code, message in refused.stderr) == (code, True), refused.stderr
    refused = invoke("fit", "kitting/paper", log, "--set", "chooses=mine")
    assert (refused.exit_code, "chooses: 'mine'; expected FILE.py:FUNCTION" in refused.stderr) == (2, True)
