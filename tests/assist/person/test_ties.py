"""Decisions between values that are equal up to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from assist.person.ties import NEAR, first_best, ranked

LEVELS = st.sampled_from([-np.inf, -1.0, 0.0, 0.5, 2.0])
TABLES = arrays.arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 6)), elements=LEVELS)


def rounded(values: np.ndarray, seed: int) -> np.ndarray:
    """Return values with errors below a third of the smallest difference that counts."""
    return values + np.random.default_rng(seed).uniform(-NEAR / 3, NEAR / 3, values.shape)


@given(values=TABLES, seed=st.integers(0, 9))
def test_rounding_changes_no_choice_and_no_order(values: np.ndarray, seed: int) -> None:
    near = rounded(values, seed)
    assert (first_best(near) == values.argmax(axis=1)).all()
    assert (ranked(near) == np.argsort(-values, axis=1, kind="stable")).all()


@pytest.mark.parametrize("columns", [1, 5, 40])
def test_many_rows_are_chosen_from_as_few_are(columns: int) -> None:
    values = rounded(np.random.default_rng(1).integers(0, 3, (300, 2, columns)).astype(float), 2)
    assert (first_best(values) == [[first_best(one) for one in team] for team in values]).all()
