"""No policy exceeds a bound, in random settings of tasks, costs, people, travel, truncation, prices and sample
paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pytest
from crosscheck import Case, Outcome, check

pytestmark = pytest.mark.long

REFUSED = 0.02
"""The share of comparisons that the program may refuse by design."""


QUICK = (0, 2, 9)
"""Settings with most kinds of comparisons, of a second each."""

SETTINGS = [number for number in range(9, 210, 4) if number != 193]
"""Fifty settings. Number 193 takes half a minute; `bench/crosscheck.py 200` checks it and those between."""


def assert_no_violation(numbers: Sequence[int]) -> list[Outcome]:
    outcomes = [check(Case.of(number)) for number in numbers]
    for outcome in outcomes:
        assert not outcome.violations, f"{Case.of(outcome.number)}\n" + "\n".join(outcome.violations)
    return outcomes


@pytest.mark.parametrize("numbers", [QUICK, pytest.param(range(8), marks=pytest.mark.slow)], ids=["quick", "eight"])
def test_no_policy_exceeds_a_bound(numbers: Sequence[int]) -> None:
    outcomes = assert_no_violation(numbers)
    compared = Counter(kind for outcome in outcomes for kind in outcome.kinds)
    assert compared["none"] == compared["reactive"] == compared["priority"] == compared["attention"] == len(outcomes)
    assert compared["priority, goals known"] > 0
    assert compared["priority at the bound's prices"] > 0
    assert compared["part against whole"] > 0
    assert sum(outcome.refused for outcome in outcomes) <= REFUSED * compared.total()
    # A bound that is far above all policies would show nothing: most are near.
    near = [outcome for outcome in outcomes if outcome.upper - outcome.mean < 0.05 * abs(outcome.mean) + 0.05]
    assert len(near) >= len(outcomes) / 2


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 50, 10))
def test_no_policy_exceeds_a_bound_in_fifty_settings(first: int) -> None:
    outcomes = assert_no_violation(SETTINGS[first : first + 10])
    compared = sum(len(outcome.kinds) for outcome in outcomes)
    assert sum(outcome.refused for outcome in outcomes) <= 2 * REFUSED * compared
