"""Misconceptions are functions of person and state, independent of how and in which order states are numbered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain import explore
from scipy import stats

from assist.people import Choices, Misconception, Population, keys_of
from assist.people.misconception import standard_normal
from planner import OnDemand, Table

MANY = np.arange(40_000, dtype=np.uint64)


def test_numbers_are_those_of_a_standard_normal_distribution() -> None:
    """Keys that differ in few bits, as states' numbers do, and seeds likewise."""
    for eps in (standard_normal(7, MANY), np.array([standard_normal(seed, [5])[0] for seed in range(4000)])):
        assert stats.kstest(eps, "norm").pvalue > 1e-3
        assert abs(np.corrcoef(eps[1:], eps[:-1])[0, 1]) < 4 / np.sqrt(len(eps))
    assert abs(np.corrcoef(standard_normal(7, MANY), standard_normal(8, MANY))[0, 1]) < 4 / np.sqrt(len(MANY))


def test_a_sweep_and_answers_on_demand_give_the_same_people(tiny: Table) -> None:
    """On demand, states are numbered in the order of their visits, here in a random order."""
    met = np.random.default_rng(1).permutation(len(tiny))
    asked = OnDemand(tiny.task)
    numbers = asked.numbers(tiny.values(met))
    assert not np.array_equal(numbers, met)
    np.testing.assert_array_equal(keys_of(asked, numbers), keys_of(tiny, met))
    assert len(np.unique(keys_of(tiny, met))) == len(tiny)


def test_a_person_is_the_same_in_a_part_of_the_task(tiny: Table) -> None:
    """A part whose rows are in another order, and another numbering of the whole."""
    whole = Choices.of(tiny)
    (person,), (same,) = (Population().sample(choices, 1, np.random.default_rng(3)) for choices in (whole, None))
    assert isinstance(same.h, Misconception)
    assert (same.beta, same.theta, same.sigma) == (person.beta, person.theta, person.sigma)
    np.testing.assert_array_equal(same.expects(whole), person.h)

    rows = np.random.default_rng(2).permutation(len(whole))[:9]
    part = replace(
        whole, h=whole.h[rows], goal=whole.goal[rows], key=keys_of(tiny, rows), actions=whole.actions[rows],
        applicable=whole.applicable[rows], targets=np.zeros_like(whole.targets[rows]), costs=whole.costs[rows],
        optimal=whole.optimal[rows], initial=0,
    )  # fmt: skip
    np.testing.assert_array_equal(same.expects(part), person.expects(whole)[rows])

    space = explore(tiny.task)
    other = space.numbers(tiny.values(np.arange(len(tiny))))
    again = same.h.of(replace(whole, key=keys_of(Table(space, tiny.distance[np.argsort(other)]), other)))
    np.testing.assert_array_equal(again, person.h)


@pytest.mark.parametrize("noise", ["state", "action"])
def test_people_differ(tiny: Table, noise: str) -> None:
    first, second = Population(noise=noise).sample(Choices.of(tiny), 2, np.random.default_rng(0))  # type: ignore[arg-type]
    assert not np.isclose(first.expects(Choices.of(tiny)), second.expects(Choices.of(tiny))).all()
