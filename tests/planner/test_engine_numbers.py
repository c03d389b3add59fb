"""Problems that are built in Python, also with numbers and durations: plans cost what the library's search finds.

The search goes through the library's own simulator. A durative action is two plain ones that follow each other: its
start, and its end.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import pytest
from conftest import thinned
from random_problems import random_problem
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.environment import get_environment
from unified_planning.exceptions import UPInvalidActionError
from unified_planning.model import (
    ClosedDurationInterval,
    ClosedTimeInterval,
    DurativeAction,
    EndTiming,
    FixedDuration,
    Fluent,
    GlobalStartTiming,
    InstantaneousAction,
    LeftOpenDurationInterval,
    Object,
    OpenTimeInterval,
    Problem,
    RightOpenDurationInterval,
    SimulatedEffect,
    StartTiming,
    TimePointInterval,
    Variable,
)
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeActionCosts,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
    MinimizeSequentialPlanLength,
)
from unified_planning.model.walkers import StateEvaluator
from unified_planning.shortcuts import GE, TRUE, BoolType, Equals, Int, IntType, Not, Plus, Real, RealType, UserType

from planner import PDDLError, astar, load, sweep
from planner.engine import Engine
from planner.pddl.built_problems import SUPPORTED

pytestmark = pytest.mark.usefixtures("one_name_for_two")

START, END = StartTiming(), EndTiming()


def numbers(seed: int) -> Problem:
    """Return a problem of two bins with numbers of all supported kinds, with durations in every second."""
    rng, env = random.Random(seed), get_environment()
    types, make = env.type_manager, env.expression_manager
    timed = seed % 2 == 1
    problem = Problem("numbers", env)
    place = types.UserType("Bin")
    bins = [problem.add_object(Object(f"Bin{n}", place, env)) for n in range(2)]
    stock = Fluent("Stock", types.IntType(0, rng.randint(1, 3)), environment=env, b=place)
    level = Fluent("level", types.RealType(Fraction(0), Fraction(rng.randint(1, 3), 2)), environment=env)
    size = Fluent("size", types.IntType(), environment=env, b=place)
    pace = Fluent("pace", types.RealType(), environment=env)
    free = Fluent("free", types.IntType(), environment=env)
    lit, ajar = (Fluent(name, types.BoolType(), environment=env, b=place) for name in ("lit", "ajar"))
    for fluent, value in (
        (stock, rng.randint(0, 1)),
        (level, Fraction(1, 2)),
        (size, 1),
        (free, 0),
        (lit, False),
        (ajar, True),
    ):
        problem.add_fluent(fluent, default_initial_value=value)
    problem.add_fluent(pace, default_initial_value=Fraction(rng.choice([1, 2, 5]), 4))
    for one in bins:
        problem.set_initial_value(size(one), rng.randint(1, 2))
        problem.set_initial_value(lit(one), rng.random() < 0.3)

    def number(terms: list[Any]) -> Any:
        where = rng.choice(terms)
        return rng.choice([make.Int(rng.randint(0, 2)), size(where), stock(where), make.Plus(level(), pace()),
                           make.Times(2, pace()), make.Minus(size(where), 1), make.Real(Fraction(1, 2))])  # fmt: skip

    def condition(terms: list[Any]) -> Any:
        where = rng.choice(terms)
        compare = rng.choice([make.LE, make.LT, make.GE, make.GT, make.Equals])
        left = rng.choice([stock(where), level(), make.Plus(stock(where), stock(rng.choice(terms)))])
        found = rng.choice([compare(left, number(terms)), lit(where), make.GE(stock(where), 1)])
        return make.Not(found) if rng.random() < 0.25 else found

    def change(action: Any, when: tuple[Any, ...], terms: list[Any], used: dict[Fluent, Any]) -> None:
        where, amount = rng.choice(terms), make.Int(rng.choice([1, 1, 1, 2]))
        test = condition(terms) if rng.random() < 0.3 else make.TRUE()
        kind = rng.choice(["up", "up", "down", "two", "level", "set", "every", "lit", "copy"])
        target = {"level": level, "lit": lit}.get(kind, stock)
        before = used.setdefault(target, {})
        if when in before or (before and (test != make.TRUE() or kind == "every" or not all(before.values()))):
            return  # a condition beside a change at another time is not supported
        before[when] = test == make.TRUE() and kind != "every"
        if kind == "up":
            action.add_increase_effect(*when, stock(where), make.Int(1), test)
        elif kind == "down":
            action.add_decrease_effect(*when, stock(where), amount, test)
        elif kind == "two":  # perhaps the same bin
            action.add_increase_effect(*when, stock(where), make.Int(1), test)
            action.add_decrease_effect(*when, stock(rng.choice(terms)), make.Int(1))
        elif kind == "level":
            half = rng.choice([make.Real(Fraction(1, 2)), pace()])
            rng.choice([action.add_increase_effect, action.add_decrease_effect])(*when, level, half, test)
        elif kind == "set":
            action.add_effect(*when, stock(where), rng.choice([make.Int(0), make.Minus(size(where), 1)]), test)
        elif kind == "copy":
            action.add_effect(*when, stock(where), stock(rng.choice(terms)))
        elif kind == "every":
            each = make.VariableExp(variable := Variable("w", place, env))
            action.add_increase_effect(*when, stock(each), make.Int(1), lit(each), forall=[variable])
        else:
            value = rng.choice([make.TRUE(), make.TRUE(), make.FALSE(), ajar(where)])
            action.add_effect(*when, lit(where), value, test)

    costs: dict[Any, Any] = {}
    for index in range(3):
        parameters = {"b": place} if index else {}
        if index == 2:
            parameters["c"] = place
        used: dict[Fluent, Any] = {}
        if timed and (index or rng.random() < 0.5):
            action: Any = DurativeAction(f"Act{index}", _env=env, **parameters)
        else:
            action = InstantaneousAction(f"Act{index}", _env=env, **parameters)
        terms = [make.ObjectExp(one) for one in bins] + 3 * [make.ParameterExp(one) for one in action.parameters]
        costs[action] = rng.choice([make.Int(2), make.Real(Fraction(1, 2)), size(terms[-1]), make.Plus(pace(), 1),
                                    stock(terms[-1]), make.Plus(level(), size(terms[0]))])  # fmt: skip
        if isinstance(action, DurativeAction):
            least = rng.choice([make.Int(1), make.Real(Fraction(3, 2)), size(terms[-1]), make.Times(pace(), 2),
                                make.Plus(stock(terms[-1]), 1)])  # fmt: skip
            interval = rng.choice([FixedDuration, FixedDuration, ClosedDurationInterval, RightOpenDurationInterval])
            ends = (least,) if interval is FixedDuration else (least, rng.choice([make.Int(3), make.Plus(least, 1)]))
            action.set_duration_constraint(interval(*ends))
            spans = [TimePointInterval(START), TimePointInterval(END), OpenTimeInterval(START, END)]
            spans.append(ClosedTimeInterval(START, END))
            for _ in range(rng.randint(0, 2)):
                action.add_condition(rng.choice(spans), condition(terms))
            for _ in range(rng.randint(1, 3)):
                change(action, (rng.choice([START, END]),), terms, used)
        else:
            for _ in range(rng.randint(0, 2)):
                action.add_precondition(condition(terms))
            for _ in range(rng.randint(1, 3)):
                change(action, (), terms, used)
        problem.add_action(action)
    some = rng.choice([stock(bins[0]), stock(bins[1]), make.Plus(stock(bins[0]), stock(bins[1]))])
    problem.add_goal(make.GE(some, rng.randint(1, 3)))
    problem.add_goal(rng.choice([lit(bins[0]), make.LE(level(), Fraction(1, 2)), make.Equals(stock(bins[1]), 1)]))
    problem.self_overlapping = timed and seed % 4 == 1
    metrics = [None, MinimizeActionCosts(costs, environment=env), MinimizeSequentialPlanLength(environment=env)]
    metric = rng.choice([*metrics, MinimizeMakespan(environment=env)] if timed else metrics)
    if metric is not None:
        problem.add_quality_metric(metric)
    return problem


def in_halves(problem: Problem) -> tuple[Problem, dict[str, Any]]:
    """Return the problem with a plain action for the start of each durative one, and the plain actions of the ends."""
    found = problem.clone()
    env = found.environment
    found.clear_actions()
    found.clear_quality_metrics()
    ends = {}
    for action in problem.actions:
        if isinstance(action, InstantaneousAction):
            found.add_action(action)
            continue
        kinds = {one.name: one.type for one in action.parameters}
        start, end = (InstantaneousAction(name, _env=env, **kinds) for name in (action.name, f"{action.name} ends"))
        least, most = action.duration.lower, action.duration.upper
        compare = env.expression_manager.LT if action.duration.is_right_open() else env.expression_manager.LE
        start.add_precondition(compare(least, most))
        for span, several in action.conditions.items():
            for one in several:
                if span in (TimePointInterval(START), ClosedTimeInterval(START, END)):
                    start.add_precondition(one)
                if span != TimePointInterval(START):
                    end.add_precondition(one)
        for time, effects in action.effects.items():
            for effect in effects:
                (start if time == START else end)._add_effect_instance(effect)
        found.add_actions([start, end])
        ends[action.name] = end
    return found, ends


def applied(simulator: Any, state: Any, action: Any, arguments: Any) -> Any:
    """Return the state after an action; None if it is not applicable (`is_applicable` fails at some conditions)."""
    try:
        return simulator.apply(state, action, arguments)
    except UPInvalidActionError:
        return None


def cheapest(problem: Problem) -> float:
    """Return the cost of a cheapest sequential plan, by a search through the library's own simulator."""
    halves, ends = in_halves(problem)
    value, make = StateEvaluator(halves).evaluate, problem.environment.expression_manager
    metric = next(iter(problem.quality_metrics), None)
    own = {action.name: action for action in problem.actions}
    halves_of = {name: halves.action(name) for name in own}

    def price(name: str, arguments: Any, state: Any) -> Fraction:
        action = own[name]
        cost = make.Int(1)
        if isinstance(metric, MinimizeActionCosts):
            cost = metric.get_action_cost(action)
        elif not isinstance(metric, MinimizeSequentialPlanLength):
            if isinstance(action, DurativeAction):
                cost = action.duration.lower
            elif metric is not None:
                cost = make.Int(0)
        given = dict(zip(map(make.ParameterExp, action.parameters), arguments, strict=True))
        return Fraction(value(cost.substitute(given), state).constant_value())

    with problem.environment.factory.SequentialSimulator(halves) as simulator:
        names = list(halves.initial_values)
        first, count = simulator.get_initial_state(), itertools.count()
        queue, done = [(Fraction(0), next(count), first)], set()
        while queue:
            cost, _, state = heapq.heappop(queue)
            key = tuple(state.get_value(name).constant_value() for name in names)
            if key in done:
                continue
            done.add(key)
            if simulator.is_goal(state):
                return float(cost)
            for name, action in halves_of.items():
                for chosen in itertools.product(*(halves.objects(one.type) for one in action.parameters)):
                    arguments = tuple(map(make.ObjectExp, chosen))
                    after = applied(simulator, state, action, arguments)
                    if after is not None and name in ends:
                        after = applied(simulator, after, ends[name], arguments)
                    if after is not None:
                        heapq.heappush(queue, (cost + price(name, arguments, state), next(count), after))
    return math.inf


@pytest.mark.parametrize("seed", thinned(range(40), 3))
def test_random_problems_with_numbers_cost_what_a_search_finds(seed: int) -> None:
    assert_costs_what_a_search_finds(numbers(seed))


@pytest.mark.parametrize("seed", thinned(range(30)))
def test_random_problems_cost_what_a_search_finds(seed: int) -> None:
    assert_costs_what_a_search_finds(random_problem(seed))


def assert_costs_what_a_search_finds(problem: Problem) -> None:
    timed = any(isinstance(one, DurativeAction) for one in problem.actions)
    assert Engine.supports(problem.kind), problem.kind
    expected = cheapest(problem)
    before = str(problem)
    result = Engine()._solve(problem)
    said = [message.message for message in result.log_messages or []]
    assert str(problem) == before
    if expected == math.inf:
        assert result.status is (Status.UNSOLVABLE_INCOMPLETELY if timed else Status.UNSOLVABLE_PROVEN), said
        assert ("no plan for one person who acts in sequence" in said) == timed
        return
    assert result.status is (Status.SOLVED_SATISFICING if timed else Status.SOLVED_OPTIMALLY), said
    factory = problem.environment.factory
    with factory.PlanValidator(problem_kind=problem.kind, plan_kind=result.plan.kind) as validator:
        assert validator.validate(problem, result.plan), f"{problem}{result.plan}"
    task = load(problem)
    assert astar(task)[0] == pytest.approx(expected, abs=1e-9)
    table = sweep(task)
    assert table[table.initial] == pytest.approx(expected, abs=1e-9)


def ways_of_known_length() -> Problem:
    """Return a problem in which only some ways have a length, so that the others cannot be gone."""
    problem = Problem("ways")
    place = UserType("Place")
    here, length = Fluent("here", BoolType(), p=place), Fluent("length", RealType(), a=place, b=place)
    problem.add_fluent(here, default_initial_value=False)
    problem.add_fluent(length)
    shelf, bench, door = (problem.add_object(name, place) for name in ("shelf", "bench", "door"))
    for a, b, metres in ((shelf, bench, 2), (bench, door, 1), (shelf, shelf, 1)):
        problem.set_initial_value(length(a, b), metres)
    problem.set_initial_value(here(shelf), True)
    go = InstantaneousAction("go", a=place, b=place)
    a, b = go.parameters
    go.add_precondition(here(a))
    go.add_effect(here(a), False)
    go.add_effect(here(b), True)
    problem.add_action(go)
    problem.add_quality_metric(MinimizeActionCosts({go: length(a, b)}))
    problem.add_goal(here(door))
    return problem


def test_a_number_without_a_value_keeps_from_acting() -> None:
    problem = ways_of_known_length()
    assert Engine.supports(problem.kind)
    result = Engine()._solve(problem)
    assert [str(step) for step in result.plan.actions] == ["go(shelf, bench)", "go(bench, door)"]
    assert astar(load(problem))[0] == 3


def test_random_problems_have_all_features_that_are_supported() -> None:
    drawn = [numbers(seed) for seed in range(40)] + [random_problem(seed) for seed in range(30)]
    drawn.append(ways_of_known_length())
    missing = set().union(*SUPPORTED.values()) - set().union(*(problem.kind.features for problem in drawn))
    # The library never says these two: it compares fluents with the expressions in which they stand.
    assert missing <= {"STATIC_FLUENTS_IN_NUMERIC_ASSIGNMENTS", "STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS"}


def counter(kind: Any, *, start: int = 0) -> tuple[Problem, Fluent]:
    """Return a problem with one number, an action that adds 2, and one that takes away 3."""
    problem = Problem("counter")
    number = Fluent("N", kind)
    problem.add_fluent(number, default_initial_value=start)
    up, down = InstantaneousAction("up"), InstantaneousAction("down")
    up.add_increase_effect(number, 2)
    down.add_decrease_effect(number, 3)
    problem.add_actions([up, down])
    return problem, number


def test_an_action_that_would_leave_the_bounds_is_not_applicable() -> None:
    problem, number = counter(IntType(0, 4))
    problem.add_goal(Equals(number, 3))
    table = sweep(load(problem))
    shown = [table.task.facts(table.values([state])[0]) for state in range(len(table))]
    assert sorted(shown) == [[f"N() = {n}"] for n in range(5)]
    assert table.optimal_plan() == ["(up)", "(up)", "(down)", "(up)"]


@pytest.mark.slow
def test_a_number_that_grows_for_ever_is_refused_by_name() -> None:
    problem, number = counter(IntType())
    problem.clear_actions()
    double = InstantaneousAction("double")
    double.add_effect(number, Plus(number, number, 1))
    problem.add_action(double)
    problem.add_goal(Equals(number, -1))
    assert Engine.supports(problem.kind)
    result = Engine()._solve(problem)
    assert result.status is Status.UNSUPPORTED_PROBLEM
    assert result.log_messages[0].message.startswith("counter: (n) grows without a limit (double)")


def cell() -> tuple[Problem, DurativeAction, InstantaneousAction]:
    """Return a problem in which parts are made in time, and shipped at once."""
    problem = Problem("cell")
    made = Fluent("Made Parts", IntType(0, 5))
    problem.add_fluent(made, default_initial_value=0)
    problem.add_fluent(Fluent("shipped", BoolType()), default_initial_value=False)
    make, ship = DurativeAction("make"), InstantaneousAction("Ship it")
    make.set_closed_duration_interval(Fraction(5, 4), 3)
    make.add_increase_effect(EndTiming(), made, 1)
    ship.add_precondition(GE(made, 2))
    ship.add_effect(problem.fluent("shipped"), True)
    problem.add_actions([make, ship])
    problem.add_goal(problem.fluent("shipped"))
    return problem, make, ship


@pytest.mark.parametrize("epsilon", [None, Fraction(1, 10)])
def test_a_temporal_plan_is_one_action_after_the_other(epsilon: Fraction | None) -> None:
    problem, make, ship = cell()
    problem.epsilon = epsilon
    gap = epsilon or Fraction(1, 1000)
    long = Fraction(5, 4)
    result = Engine()._solve(problem)
    assert result.status is Status.SOLVED_SATISFICING
    assert [(time, step.action, duration) for time, step, duration in result.plan.timed_actions] == [
        (0, make, long), (long + gap, make, long), (2 * (long + gap), ship, None),
    ]  # fmt: skip
    assert [message.message for message in result.log_messages] == [
        "no metric: the cost is the sum of durations; the least duration is taken for make"
    ]
    assert astar(load(problem))[0] == 3.5  # an action without a duration costs 1 where there is no metric


def metric_of(expression: Callable[[Fluent], Any]) -> tuple[Problem, Fluent]:
    problem, number = counter(IntType(0, 9))
    problem.add_goal(GE(number, 4))
    problem.action("up").add_increase_effect(spent := Fluent("spent", IntType()), 7)
    problem.add_fluent(spent, default_initial_value=0)
    problem.add_quality_metric(expression(spent))
    return problem, spent


def test_the_final_value_of_a_number_is_minimised_where_it_only_grows() -> None:
    """A problem's features do not tell it from one that is maximised, so that `supports` says no."""
    problem, _ = metric_of(lambda spent: MinimizeExpressionOnFinalState(spent()))
    assert not Engine.supports(problem.kind)
    assert astar(load(problem)) == (14, ["(up)", "(up)"])
    with pytest.raises(PDDLError, match=r"^counter: .*maximi"):
        load(metric_of(lambda spent: MaximizeExpressionOnFinalState(spent()))[0])


def test_small_decimals_are_exact() -> None:
    problem, make, _ = cell()
    make.set_fixed_duration(Fraction(1, 10**7))
    assert astar(load(problem))[0] == pytest.approx(1 + 2e-7, abs=1e-12)


def with_duration(interval: Any) -> Callable[[DurativeAction], None]:
    return lambda action: action.set_duration_constraint(interval)


REFUSED: dict[str, tuple[Callable[[DurativeAction], None], str]] = {
    "an open interval": (with_duration(LeftOpenDurationInterval(Int(1), Int(2))), "no least duration"),
    "a third": (with_duration(FixedDuration(Real(Fraction(1, 3)))), r"the number 1/3 has no decimal"),
    "a negative duration": (with_duration(FixedDuration(Int(-1))), "expected a duration of 0 or more"),
    "a time of the whole plan": (
        lambda action: action.add_condition(TimePointInterval(GlobalStartTiming()), TRUE()), "not within it",
    ),
    "a time within an action": (
        lambda action: action.add_condition(TimePointInterval(StartTiming() + 1), TRUE()), "intermediate conditions",
    ),
    "simulated effects": (
        lambda action: action.set_simulated_effect(EndTiming(), SimulatedEffect([GONE()], lambda *_: [TRUE()])),
        "simulated effects: not supported",
    ),
}  # fmt: skip
GONE = Fluent("gone", BoolType())


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_said_in_one_line(what: str) -> None:
    change, said = REFUSED[what]
    problem, make, _ = cell()
    problem.add_fluent(GONE, default_initial_value=False)
    change(make)
    with pytest.raises(PDDLError, match=f"^cell: .*{said}") as error:
        load(problem)
    assert "\n" not in str(error.value)
    assert Engine()._solve(problem).status is Status.UNSUPPORTED_PROBLEM


def test_a_bound_that_two_conditions_share_is_found() -> None:
    """Two effects under different conditions may be on one number; only together they stay within its bounds."""
    problem, number = counter(IntType(0, 3))
    problem.clear_actions()
    for name in ("left", "right"):
        problem.add_fluent(Fluent(name, BoolType()), default_initial_value=False)
        flip = InstantaneousAction(f"flip {name}")
        flip.add_effect(problem.fluent(name), Not(problem.fluent(name)))
        problem.add_action(flip)
    both = InstantaneousAction("both")
    both.add_increase_effect(number, 2, problem.fluent("left"))
    both.add_decrease_effect(number, 1, problem.fluent("right"))
    problem.add_action(both)
    problem.add_goal(Equals(number, 3))
    assert cheapest(problem) == astar(load(problem))[0] == 4
