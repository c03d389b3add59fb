"""First estimates, in numpy: their likelihood is that of compiled code, and they are near the precise ones."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import invoke, kit
from recorded import lines, people_at_work, write_log
from test_goal_fit import METHOD, fitted

from assist.learning import Method, Observations, log_likelihood, observed
from assist.learning.first_estimates import first_estimates
from assist.learning.fit import with_model
from assist.learning.likelihood import Data
from assist.learning.likelihood_arrays import log_likelihoods
from assist.learning.maximum_likelihood import maximum_likelihood
from assist.people import Choices, boltzmann

PAPER = kit("paper")
ROWS = people_at_work(Choices.of(PAPER), [0.4, 2.5], np.random.default_rng(7), suggest=0.4)


def people(kind: str) -> tuple[list[Observations], Method]:
    if kind == "goals":
        return [one.observations for one in fitted().values()], METHOD
    seen = observed(PAPER, ROWS)
    return (with_model(seen, boltzmann, PAPER, 5.0) if kind == "own model" else seen), Method(
        lapse=0.01, utility_scale=2.0
    )


@pytest.mark.parametrize("kind", ["goal known", "goals", "own model"])
def test_the_likelihood_is_that_of_compiled_code(kind: str) -> None:
    seen, method = people(kind)
    theta, eta = np.array([0.0, 0.2, 0.7, 1.0]), np.array([0.0, 0.3, 1.0])
    beta = np.array([0.0, 0.05, 0.8, 3.0, 4.9])
    pairs = [axis.ravel() for axis in np.meshgrid(theta, eta, indexing="ij")]
    for one in seen:
        found = log_likelihoods(Data.of(one, method), beta, *pairs).reshape(len(beta), len(theta), len(eta))
        assert found == pytest.approx(log_likelihood(one, beta, theta, eta, method), rel=1e-11)


@pytest.mark.parametrize("kind", [pytest.param("goal known", marks=pytest.mark.slow), "goals"])
def test_first_estimates_are_near_the_precise_ones(kind: str) -> None:
    """Their likelihood is that much lower at most for 19 of 20 simulated people, as the module says."""
    seen, method = people(kind)
    for first, precise in zip(first_estimates(seen, method), maximum_likelihood(seen, method), strict=True):
        assert first.person == precise.person
        assert precise.log_likelihood - 0.03 < first.log_likelihood < precise.log_likelihood + 1e-6
        for name, ends in first.intervals.items():
            one = precise.estimates[name]
            width = one.interval[1] - one.interval[0]
            assert first.values[name] == pytest.approx(one.value, abs=0.05 * width)
            assert ends == pytest.approx(one.interval, abs=0.16 * width)


def test_what_the_actions_do_not_say_is_left_out() -> None:
    (plain,) = first_estimates(observed(PAPER, lines("(fetch box-a)")), Method())
    assert str(plain) == "ann: the actions say nothing yet"
    told = first_estimates(observed(PAPER, ROWS), Method(eta=0.2))
    assert all("beta" in one.values and "eta" not in one.values for one in told)
    assert str(told[0]).startswith(f"{told[0].person}: beta {told[0].values['beta']:.2f} (")


def test_the_command_prints_them_where_the_search_must_be_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, search = write_log(tmp_path / "log.jsonl", ROWS[:8]), import_module("assist.learning.maximum_likelihood")
    for at_hand, count in ((True, 0), (False, 1)):
        monkeypatch.setattr(search, "at_hand", lambda at_hand=at_hand: at_hand)
        result = invoke("fit", "kitting/paper", file, "--json")
        assert result.exit_code == 0
        assert result.stderr.count("first, ") == count
