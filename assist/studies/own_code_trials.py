"""The situations in which code of a user's own is tried: small tasks that come with the package.

Each function yields what is tried, and a function that tries it and says what is wrong.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from planner import Table, cost_to_go, instance, load, sweep_goals

from ..people.choice_model import chances
from ..people.choices import Choices
from ..people.decision import Floats, perceived_cost
from ..people.given_rules import fault_of_attributes, fault_of_updates, possible
from ..people.goals import Goals
from ..people.memory import remembered
from ..people.neighbours import Neighbours, SeenAlone, SeenRule
from ..people.ranges import Population
from ..people.terms import Situation
from ..people.trust_rules import TrustRule
from ..people.user_code import UserChoiceModel, UserCodeError, UserRule
from ..person.observation_model import ObservationModel
from ..person.robots import Robot
from ..person.settings import Setting
from ..team.memory_trial import fault_of_memory
from ..team.policies import UserPolicy
from ..team.pool import Pool
from ..team.simulate import simulate
from ..team.state import TeamPolicy

TINY, DEAD_ENDS, LARGER = "kitting/tiny", "stations/one-way", "kitting/paper"

WALK = """
(define (domain walk) (:requirements :strips) (:predicates (at ?x) (road ?x ?y))
  (:action go :parameters (?x ?y) :precondition (and (at ?x) (road ?x ?y)) :effect (and (not (at ?x)) (at ?y))))
"""
PLACES = """
(define (problem to-{goal}) (:domain walk) (:objects a b c d e)
  (:init (at a) (road a b) (road b a) (road b c) (road c b) (road b d) (road d b) (road d e) (road e d))
  (:goal (at {goal})))
"""
"""A walk whose goal is one of three places: the roads branch, so that actions tell goals apart."""

MANY = 8
"""Episodes of a trial: enough that several teams are decided on at a time."""

MORE = 40
"""Episodes of the trial in which other teams must not matter: while some teams finish, others are at work for long."""

Trials = Iterator[tuple[str, Callable[[], str | None]]]

Place = tuple[Path, str] | None
"""File and name of code that is in a file."""


def _table(name: str) -> Table:
    found = cost_to_go(load(str(instance(name).problem)))
    assert isinstance(found, Table)
    return found


def _goals() -> Goals:
    """Return a task with three possible goals."""
    with tempfile.TemporaryDirectory() as folder:
        domain = Path(folder) / "domain.pddl"
        domain.write_text(WALK, encoding="utf-8")
        tasks = []
        for goal in "cde":
            problem = Path(folder) / f"{goal}.pddl"
            problem.write_text(PLACES.format(goal=goal), encoding="utf-8")
            tasks.append(load(str(problem)))
        return Goals(dict(zip("cde", sweep_goals(tasks), strict=True)))


def _situations(
    population: Population | None = None, **of_setting: Any
) -> Iterator[tuple[str, Callable[[], Pool], int]]:
    """Yield what is tried, a function that makes the pool, and the number of people of a team."""
    tiny = _table(TINY)
    usual = Setting(**of_setting)

    def pool(task: Any = tiny, **changed: Any) -> Pool:
        setting = replace(usual, **changed.pop("setting", {}))
        given = {"population": population} | changed
        return Pool.sample(task, 4, seed=0, setting=setting, progress=False, **given)

    yield "three people", pool, 3
    yield "one person", pool, 1
    yield "the robot knows the exact costs only", partial(pool, setting={"knowledge": "exact"}), 3
    yield "two robots", partial(pool, setting={"robots": 2}), 3
    different = (Robot(c_move=2.0), Robot(execute=True))
    yield "two robots that differ", partial(pool, setting={"robots": different}), 3
    yield "ways that take two steps", partial(pool, setting={"travel_time": 2.0}), 3
    yield "any applicable action as a suggestion", partial(pool, setting={"suggestions": "all"}), 3
    yield "dead ends", partial(pool, _table(DEAD_ENDS)), 3
    yield "three possible goals", partial(pool, _goals()), 3
    missed = ObservationModel(miss=0.2, confusion=0.1)
    yield "actions that are missed or confused", partial(pool, setting={"observation": missed}), 3
    yield "a truncated task", partial(pool, _table(LARGER), states=1, region=60), 3
    if population is None:
        yield "people with habits", partial(pool, population=Population(weights={"back": (-1.0, 0.0)})), 3


def of_policy(code: TeamPolicy, place: Place) -> Trials:
    """Yield the trials of a team policy."""
    # What it remembers has a trial of its own.
    policy = code if place is None else UserPolicy(*place, code, {1, 3})

    def run(pool: Callable[[], Pool], humans: int) -> None:
        simulate(pool(), policy, humans=humans, episodes=MANY, seed=0, progress=False)

    for what, pool, humans in _situations():
        yield what, partial(run, pool, humans)

    def alone() -> str | None:
        pool = Pool.sample(_table(TINY), 4, seed=0, progress=False)
        return fault_of_memory(
            policy, lambda one, some: simulate(pool, one, humans=3, episodes=some, seed=0, progress=False), MORE
        )

    yield "each team by itself", alone


def of_people(code: Callable[..., Floats], place: Place) -> Trials:
    """Yield the trials of a choice model."""
    model = code if place is None else UserChoiceModel(*place)
    beta = np.array([0.0, 0.5, 3.0, 50.0])

    def direct(task: str) -> str | None:
        choices = Choices.of(_table(task))
        q = perceived_cost(choices, choices.h)
        given = q.copy()
        found = chances(model, choices, q, beta)
        if not np.array_equal(q, given, equal_nan=True):
            return "changes the array q; expected a new array"
        for number, one in enumerate(beta):
            if not np.allclose(chances(model, choices, q, beta[number : number + 1])[0], found[number], 0, 1e-12):
                return f"gives other probabilities for beta {one:g} alone than among others; expected each by itself"
        if not np.array_equal(found, chances(model, choices, q, beta)):
            return "gives other probabilities at the second call; expected a function of its arguments alone"
        return None

    yield "probabilities of all choices", partial(direct, TINY)
    yield "probabilities where some choices lead into dead ends", partial(direct, DEAD_ENDS)

    def run(pool: Callable[[], Pool], humans: int) -> None:
        simulate(pool(), "attention", humans=humans, episodes=MANY, seed=0, progress=False)

    for what, pool, humans in _situations(Population(chooses=model)):
        yield what, partial(run, pool, humans)


def of_trust(code: TrustRule, place: Place) -> Trials:
    """Yield the trials of a trust rule."""
    rule: Any = code if place is None else UserRule(*place)
    yield "its attributes", partial(fault_of_attributes, rule)
    if fault_of_attributes(rule) is not None:
        return
    yield "events of all kinds", partial(fault_of_updates, rule)
    try:
        possible(rule)
    except UserCodeError:
        return  # it says what the events said

    def run(setting: dict[str, Any], policy: str) -> None:
        drawn = Pool.sample(_table(TINY), 4, seed=0, setting=Setting(**setting), progress=False)
        simulate(drawn, policy, humans=3, episodes=MANY, seed=0, progress=False)

    yield "people whose theta moves so, and a robot that knows it", partial(run, {"trust": rule}, "attention")
    yield "a robot that believes so", partial(run, {"believed_trust": rule}, "attention")
    yield "any applicable action as a suggestion", partial(run, {"trust": rule, "suggestions": "all"}, "attention")


def of_term(term: Callable[[Situation], Floats], _: Place) -> Trials:
    """Yield the trials of a term of choices."""
    for name, what in ((TINY, "a small task"), (DEAD_ENDS, "dead ends")):
        yield what, partial(_values, term, name)


def _values(term: Callable[[Situation], Floats], task: str) -> str | None:
    met: list[tuple[Situation, Floats]] = []

    def noted(situation: Situation) -> Floats:
        met.append((situation, np.array(term(situation), dtype=float)))
        return met[-1][1]

    remembered(_table(task), {str(getattr(term, "__name__", "term")): noted})
    by_row = ("state", "applicable", "actions", "targets", "goals", "goals_after", "last", "previous")
    for situation, values in met:
        half = replace(situation, **{name: getattr(situation, name)[::2] for name in by_row})
        if not np.array_equal(np.asarray(term(half), dtype=float)[half.applicable], values[::2][half.applicable]):
            return "gives other values for some rows alone than among others; expected each row by itself"
    return None


def of_neighbours(code: SeenRule, place: Place) -> Trials:
    """Yield the trials of a rule of what people see of their neighbours."""
    rule: Any = code if place is None else UserRule(*place)
    yield "suggestions to neighbours of all kinds", partial(fault_of_updates, SeenAlone(rule))
    try:
        possible(SeenAlone(rule))
    except UserCodeError:
        return  # it says what these said

    def run(policy: str) -> None:
        setting = Setting(neighbours=Neighbours(rule=rule))
        drawn = Pool.sample(_table(TINY), 4, seed=0, setting=setting, progress=False)
        simulate(drawn, policy, humans=3, episodes=MANY, seed=0, progress=False)

    yield "people whose theta moves so, and a robot that knows it", partial(run, "attention")
    yield "a robot that considers those who see it", partial(run, "attention-outlook")


TRIALS: dict[str, Callable[[Any, Place], Trials]] = {
    "policy": of_policy, "people": of_people, "trust": of_trust, "neighbours": of_neighbours, "term": of_term,
}  # fmt: skip
"""The trials of each kind of code."""
