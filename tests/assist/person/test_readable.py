"""Where a function has a readable and a compiled definition, they give the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import costly
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from assist.people.belief import ImpossibleObservationError
from assist.people.type_kernels import exclude_reached, is_mistake
from assist.person.belief_filter import update, update_compiled
from assist.person.belief_update import mistaken, update_readable, updated, without_reached
from assist.person.dynamics import act_readable
from assist.person.dynamics_kernel import act_compiled
from assist.person.people_arrays import Minds, PeopleArrays
from assist.person.problem_arrays import Acts, ProblemArrays, read_only
from assist.person.ties import NEAR, first_best, ranked
from planner.system.jit import ReadableFirst

VALUES = np.array([0.0, 0.3, 0.9, 1.0])
"""Values of theta; a rule that counts outcomes repeats them."""


def problem(
    rng: np.random.Generator, goals: int, *, answers: bool, lapse: float, outcomes: int = 0
) -> ProblemArrays:  # fmt: skip
    """Return a problem of random numbers, in the shapes of a real one: some choices and suggestions are impossible."""
    states, slots, robots, betas, thetas = 5, 4, 3, 2, len(VALUES) * (outcomes + 1)
    n, types = states, goals * betas
    counts = rng.integers(1, slots + 1, n)
    chosen = rng.random((n, slots, types)) * (np.arange(slots) < counts[:, None])[:, :, None]
    chosen[rng.random(chosen.shape) < 0.2] = 0.0
    chosen[:, 0] += 1e-3
    chosen /= chosen.sum(axis=1, keepdims=True)
    suggested = np.column_stack([np.full(n, -1), *(rng.integers(-1, counts) for _ in range(robots - 1))])
    afterstate = np.where(suggested < 0, rng.integers(0, states, (n, robots)), np.arange(n)[:, None])
    afterstate[:, 0] = np.arange(n)
    p = np.take_along_axis(chosen, np.maximum(suggested, 0)[:, :, None], axis=1)
    tables = [rng.integers(0, thetas - 1, (n, robots, goals, thetas)) for _ in range(2)]
    weights = [rng.choice([0.0, 0.25, 1.0, rng.random()], (n, robots, goals, thetas)) for _ in range(2)]
    goal = rng.random((goals, n)) < 0.2
    arrays = {
        "counts": counts, "targets": rng.integers(0, states, (n, slots)),
        "costs": rng.random((n, slots)), "goal": goal, "final": goal, "ends": goal.all(axis=0),
        "goal_of": np.repeat(np.arange(goals), betas), "robot_actions": np.full(n, robots),
        "suggested": suggested, "afterstate": afterstate, "robot_costs": rng.random((n, robots)), "chosen": chosen,
        "unsuggested": np.maximum(0.0, 1.0 - p),
        "moves": (suggested >= 0) | (rng.random(suggested.shape) < 0.5), "low": tables[0], "weight": weights[0],
        "followed_low": tables[answers], "followed_weight": weights[answers],
        "theta": np.tile(VALUES, outcomes + 1),
    }  # fmt: skip
    return ProblemArrays(
        **{name: read_only(array) for name, array in arrays.items()}, uses_answer=answers, gamma=0.99, lapse=lapse,
    )  # fmt: skip


def beliefs(rng: np.random.Generator, people: int, m: ProblemArrays) -> np.ndarray:
    found = rng.random((people, len(m.goal_of), len(m.theta)))
    found[rng.random(found.shape) < 0.2] = 0.0
    found[:, 0, 0] += 1e-9
    return found / found.sum(axis=(1, 2), keepdims=True)


SEEDS, GOALS = st.integers(0, 10**6), st.sampled_from([1, 3])
LAPSES = st.sampled_from([0.0, 0.001, 0.3])


@costly(8, 50)
@given(SEEDS, GOALS, st.booleans(), LAPSES, st.sampled_from([None, 0, 2]), st.sampled_from([0, 1, 2, 50]))
def test_a_step_of_people(
    seed: int, goals: int, answers: bool, lapse: float, outcomes: int | None, people: int
) -> None:  # fmt: skip
    """With a number of outcomes that the rule counts, people are those of the robot's model, on its grid."""
    rng, on_grid, outcomes = np.random.default_rng(seed), outcomes is not None, outcomes or 0
    m = problem(rng, goals, answers=answers, lapse=max(lapse, 1e-6), outcomes=outcomes)
    p = rng.random((3, len(m.counts), m.chosen.shape[1])) * (rng.random((3, len(m.counts), 1)) < 0.9) + 1e-6
    value = rng.choice([0.0, -1.0, -np.inf, -2.5], (3, len(m.counts)))
    minds = Minds(read_only(rng.integers(0, goals, 3)), p, value, float(rng.choice([0.0, 0.2])), lapse, on_grid)
    states = rng.integers(0, len(m.counts), people)
    first = PeopleArrays(
        states, rng.integers(0, 3, people), rng.integers(0, 3, people), rng.choice(m.theta, people),
        rng.integers(0, outcomes + 1, people), rng.random((people, 2)), np.full(people, -1), np.zeros(people),
    )  # fmt: skip
    rows = np.flatnonzero(rng.random(people) < 0.8)
    both = [PeopleArrays(*(array.copy() for array in first)) for _ in range(2)]
    act_readable(rows, both[0], minds, m)
    act_compiled(rows, both[1], minds, m)
    for name, one, other in zip(first._fields, *both, strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)


@costly(8, 50)
@given(SEEDS, GOALS, st.booleans(), LAPSES, st.booleans(), st.sampled_from([1, 2, 40]))
def test_the_beliefs_after_a_step(
    seed: int, goals: int, answers: bool, lapse: float, believed: bool, people: int
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    m = problem(rng, goals, answers=answers, lapse=max(lapse, 1e-6))
    optimal = read_only(rng.random((*m.chosen.shape[:2], goals)) < 0.5)
    possible = read_only(rng.choice([0.0, 0.5], (len(m.goal_of), 1)))
    rows = np.flatnonzero(rng.random(people) < 0.8)
    x, action = rng.integers(0, len(m.counts), len(rows)), rng.integers(0, 3, len(rows))
    slot = np.where(rng.random(len(rows)) < 0.1, -1, rng.integers(0, m.counts[m.afterstate[x, action]]))
    known = beliefs(rng, people, m) if believed else np.empty((0, 1, 1))
    goes_on = rng.random(len(rows)) < 0.7
    found = [(known.copy(), np.ones(people, dtype=bool)) for _ in range(2)]
    for update_by, (belief, erred) in zip((update_readable, update_compiled), found, strict=True):
        update_by(rows, Acts(x, action, slot, goes_on), belief, erred, optimal, possible, m)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@settings(max_examples=40, deadline=None)
@given(SEEDS, GOALS, st.booleans(), LAPSES, st.sampled_from([0, 1, 2, 40]))
def test_a_belief_after_a_choice(seed: int, goals: int, answers: bool, lapse: float, people: int) -> None:
    rng = np.random.default_rng(seed)
    m = problem(rng, goals, answers=answers, lapse=lapse)
    before, x = beliefs(rng, people, m), rng.integers(0, len(m.counts), people)
    action = rng.integers(0, 3, people)
    slot = rng.integers(0, m.counts[m.afterstate[x, action]])
    single, work, impossible = before.copy(), np.empty(before.shape[1] * before.shape[2]), 0
    for i in range(people):
        try:
            update(single[i].reshape(-1), work, int(x[i]), int(action[i]), int(slot[i]), m)
        except ImpossibleObservationError:
            impossible += 1
    if impossible:
        with pytest.raises(ImpossibleObservationError):
            updated(before, x, action, slot, m)
        return
    np.testing.assert_array_equal(updated(before, x, action, slot, m), single)
    after = without_reached(single, x, m)
    for i in range(people):
        exclude_reached(single[i], int(x[i]), m.goal, m.goal_of)
    np.testing.assert_array_equal(after, single)
    optimal = rng.random((people, goals)) < 0.5
    found = mistaken(optimal, single, x, m)
    assert found.tolist() == [is_mistake(optimal[i], single[i], int(x[i]), m.goal, m.goal_of) for i in range(people)]


def test_the_compiled_definition_takes_over_after_enough_work() -> None:
    doubled = ReadableFirst(lambda _: "readable", lambda _: "compiled", lambda work: work)
    assert [doubled(doubled.enough // 2) for _ in range(5)] == ["readable"] * 3 + ["compiled"] * 2


@pytest.mark.parametrize(("pause", "last"), [(0.5, "compiled"), (100, "readable")])
def test_work_that_takes_a_small_share_of_the_time_is_never_worth_compiling(
    pause: float, last: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report of a person now and then, for a whole day; or one after the other."""
    now = [1]
    monkeypatch.setattr("planner.system.jit.time.monotonic_ns", lambda: now[0])
    doubled = ReadableFirst(lambda _: "readable", lambda _: "compiled", lambda work: work)
    work = doubled.enough // 1000
    for _ in range(100_000):
        found = doubled(work)
        now[0] += int(work * pause)
    assert found == last


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
