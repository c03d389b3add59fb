"""A simulated person of a live session is the same person as in a simulation."""

from __future__ import annotations

import numpy as np
import pytest
from silence import ThreeInARow

from assist.live.simulated_person import SimulatedPerson
from assist.people import ChoiceModel, Choices, Population, TrustRule, boltzmann
from assist.person import ObservationModel, Setting
from assist.team import Pool, simulate
from assist.team.common_random_numbers import CommonRandomNumbers
from assist.team.trace import Trace
from planner import OnDemand, load, sweep

TINY = sweep(load("kitting/tiny"))


def short_sighted(choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
    return boltzmann(choices, np.minimum(q, 4.0) + np.where(choices.applicable, 0.0, np.inf), beta)


PLACES = 3


@pytest.mark.parametrize(
    ("trust", "noise", "on_demand"),
    [  # in make test, each rule and each noise
        pytest.param(trust, noise, (i + j) % 2 == 1, marks=[pytest.mark.slow] * (i % 3 != j))
        for i, trust in enumerate(("paper", "outcome", "reliability", ThreeInARow(0.3, 0.1)))
        for j, noise in enumerate(("state", "action", short_sighted))
    ],
)
def test_the_same_person_with_the_same_numbers_acts_as_in_a_simulation(
    trust: str | TrustRule, noise: str | ChoiceModel, on_demand: bool
) -> None:  # fmt: skip
    population = Population(chooses=noise) if callable(noise) else Population(noise=noise)  # type: ignore[arg-type]
    setting = Setting(trust=trust, c_suggest=0.05, c_move=0.0, suggestions="all")
    pool, trace = Pool.sample(TINY, PLACES, seed=7, setting=setting, population=population), Trace()
    simulate(pool, "priority", humans=[0, 1, 2], episodes=[4], seed=9, trace=trace)
    drawn = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(0,)))
    humans = population.sample(None, PLACES, drawn)
    people = [SimulatedPerson(human, trust=setting.trust_rule()) for human in humans]
    task = OnDemand(load("kitting/tiny"), jobs=1) if on_demand else TINY
    states, advised = [task.initial] * PLACES, 0
    numbers, step, uniform = CommonRandomNumbers(9, np.array([4]), PLACES), -1, np.empty(PLACES)
    for row in trace:
        k = row["place"]
        if row["step"] > step:
            step, uniform = row["step"], numbers.draw(1, np.array([0]))[0]
        rows = task.choices([states[k]])
        names = [task.task.actions[action] for action in rows.actions]
        assert people[k].theta == pytest.approx(row["theta"], abs=1e-12)
        done = people[k].act(task, states[k], names, row["suggestion"], uniform=float(uniform[k]))
        assert done == row["action"]
        advised += row["suggestion"] is not None
        states[k] = int(rows.targets[names.index(done)])
    assert advised > 3


def test_actions_that_are_missed_or_confused_are_those_of_the_whole_task() -> None:
    model = ObservationModel(miss=0.3, confusion=0.4)
    found = []
    for task in (TINY, OnDemand(load("kitting/tiny"), jobs=1)):
        person, seen = SimulatedPerson(Population(), seed=4), list[str | None]()
        person.state = task.initial
        while not task.is_goal([person.state])[0]:
            seen.append(person.act_unseen(task, None, model))
        found.append((seen, person.reported))
    assert found[0] == found[1]
    assert None in found[0][0]
