"""Random small planning tasks, and their solutions by brute force, without any PDDL.

Formulas are nested tuples, such as `("and", ("p", "?x"), ("not", ("q",)))`. The declared types of a predicate restrict
what may be written, but not what holds.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Kinds = tuple[str, ...]
Parameters = tuple[tuple[str, Kinds], ...]
Formula = tuple[Any, ...]
Atom = tuple[str, ...]
State = frozenset[Atom]
FEWEST, LARGEST = 6, 3_000
"""Smallest and largest number of states; other tasks are rejected."""
GOALS = 12
"""Number of goals that are drawn; the one with the largest cost is used."""


@dataclass(frozen=True)
class Action:
    """An action. Its effects are tuples of variables, a condition, whether the atom becomes true, and the atom."""

    name: str
    parameters: Parameters
    precondition: Formula
    effects: tuple[tuple[Parameters, Formula, bool, Formula], ...]
    cost: Formula | int | None


@dataclass(frozen=True)
class Drawn:
    """A task.

    Attributes
    ----------
    parents : mapping of str to str
        The supertype of each type, "object" for roots.
    objects, constants : mapping of str to str
        Types of objects and constants.
    predicates, functions : mapping of str to tuple of tuple of str
        Types of each argument.
    rule : tuple or None
        A derived predicate's name, variables and condition.
    values : mapping of tuple of str to int
    """

    parents: Mapping[str, str]
    constants: Mapping[str, str]
    objects: Mapping[str, str]
    predicates: Mapping[str, tuple[Kinds, ...]]
    functions: Mapping[str, tuple[Kinds, ...]]
    actions: tuple[Action, ...]
    rule: tuple[str, Parameters, Formula] | None
    facts: State
    values: Mapping[Atom, int]
    goal: Formula
    metric: bool

    def above(self, kind: str) -> Iterator[str]:
        """Yield a type and its supertypes."""
        while kind != "object":
            yield kind
            kind = self.parents[kind]
        yield kind

    def of(self, kinds: Kinds) -> list[str]:
        """Return the objects of some types."""
        everything = {**self.constants, **self.objects}
        return [name for name, kind in everything.items() if set(kinds) & set(self.above(kind))]

    def overlap(self, kinds: Kinds, others: Kinds) -> bool:
        """Whether one of some types is a supertype of one of others, or the other way round."""
        return any(a in self.above(b) or b in self.above(a) for a in kinds for b in others)


@dataclass(frozen=True)
class Answer:
    """The answer of brute force."""

    cost: float
    states: int


class _Hand:
    """Draws the parts of a task."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def one(self, items: Any) -> Any:
        items = list(items)
        return items[int(self.rng.integers(len(items)))]

    def kinds(self, types: list[str]) -> Kinds:
        """Draw the type of an argument: one, several, or "object"."""
        if self.chance(0.15):
            return ("object",)
        if len(types) > 1 and self.chance(0.2):
            return tuple(str(name) for name in self.rng.choice(types, 2, replace=False))
        return (self.one(types),)


def draw(rng: np.random.Generator) -> Drawn:
    """Draw a task with a moderate number of states; most need several steps to solve."""
    hand = _Hand(rng)
    simple = hand.chance(0.1)
    while True:
        task = _draw(hand)
        best = reached(task)
        if len(best) > LARGEST or not (simple or len(best) >= FEWEST):
            continue
        if simple:
            return task
        goals = [_goal(hand, task) for _ in range(GOALS)]
        costs = [cheapest(replace(task, goal=goal), best) for goal in goals]
        most = max((cost for cost in costs if cost < math.inf), default=0)
        if most > 0:
            return replace(task, goal=goals[costs.index(most)])


def _goal(hand: _Hand, task: Drawn) -> Formula:
    return _formula(hand, task, (), list(task.predicates), {**task.constants, **task.objects}, 2)


def _draw(hand: _Hand) -> Drawn:
    types = [f"t-{letter}" for letter in "abcd"[: hand.rng.integers(1, 5)]]
    parents = {name: hand.one(["object", *types[:at]]) for at, name in enumerate(types)}
    names = [f"{hand.one(['box', 'nut', 'o', 'x-'])}{number}" for number in range(hand.rng.integers(2, 5))]
    kinds = {name: hand.one(types) if hand.chance(0.95) else "object" for name in names}
    constants = {name: kind for name, kind in kinds.items() if hand.chance(0.3)}
    objects = {name: kind for name, kind in kinds.items() if name not in constants}
    predicates = {f"p{n}": _declared(hand, types, (0, 3)) for n in range(hand.rng.integers(2, 5))}
    derived = f"d{hand.rng.integers(9)}" if hand.chance(0.25) else None
    if derived is not None:
        predicates[derived] = _declared(hand, types, (0, 2))
    functions = {f"f{n}": _declared(hand, types, (0, 3)) for n in range(hand.rng.integers(0, 3))}
    shell = Drawn(parents, constants, objects, predicates, functions, (), None, frozenset(), {}, ("and",), True)
    everything = {**constants, **objects}
    basic = [name for name in predicates if name != derived]
    values: dict[Atom, int] = {}
    for name, wanted in functions.items():
        for arguments in itertools.product(everything, repeat=len(wanted)):
            fits = all(a in shell.of(w) for a, w in zip(arguments, wanted, strict=True))
            if fits and hand.chance(0.92):
                values[(name, *arguments)] = int(hand.rng.integers(0, 5))
    facts = set()
    for name in basic:
        for arguments in itertools.product(*(shell.of(wanted) for wanted in predicates[name])):
            if hand.chance(0.4):
                facts.add((name, *arguments))
    rule = None
    if derived is not None:
        scope = tuple((f"?v{n}", _narrowed(hand, shell, wanted)) for n, wanted in enumerate(predicates[derived]))
        body = _formula(hand, shell, scope, basic, constants, 2)
        if predicates[derived] and hand.chance(0.5):  # a recursive rule
            other = (
                "exists",
                (("?w", predicates[derived][0]),),
                (
                    "and",
                    (derived, "?w"),
                    _atom(hand, shell, (*scope, ("?w", predicates[derived][0])), basic, constants),
                ),
            )
            if int(derived[1:]) % 2:  # for all objects
                beside = _formula(hand, shell, (*scope, ("?w", predicates[derived][0])), basic, constants, 1)
                other = ("forall", (("?w", predicates[derived][0]),), ("imply", beside, (derived, "?w")))
            body = ("or", body, other)
        rule = derived, scope, body
    actions = tuple(_action(hand, shell, f"a{n}", predicates, basic, constants) for n in range(hand.rng.integers(2, 5)))
    goal = _goal(hand, shell)
    return Drawn(
        parents, constants, objects, predicates, functions, actions, rule, frozenset(facts), values, goal,
        hand.chance(0.7),
    )  # fmt: skip


def _declared(hand: _Hand, types: list[str], count: tuple[int, int]) -> tuple[Kinds, ...]:
    return tuple(hand.kinds(types) for _ in range(hand.rng.integers(*count)))


def _narrowed(hand: _Hand, task: Drawn, kinds: Kinds) -> Kinds:
    """Draw types that overlap others: equal ones, supertypes or subtypes."""
    if hand.chance(0.7):
        return kinds
    near = [name for name in (*task.parents, "object") if task.overlap((name,), kinds)]
    return (hand.one(near),)


def _atom(hand: _Hand, task: Drawn, scope: Parameters, predicates: list[str], known: Mapping[str, str]) -> Formula:
    """Draw an atom whose arguments are compatible with the declared types."""
    for _ in range(20):
        name = hand.one(predicates)
        found = []
        for wanted in task.predicates[name]:
            fits = [variable for variable, kinds in scope if task.overlap(kinds, wanted)]
            fits += [each for each in known if each in task.of(wanted)]
            found.append(hand.one(fits) if fits else "")
        if all(found):
            return (name, *found)
    return ("and",)


def _formula(
    hand: _Hand, task: Drawn, scope: Parameters, predicates: list[str], known: Mapping[str, str], depth: int
) -> Formula:
    if depth == 0 or hand.chance(0.3):
        if scope and hand.chance(0.1):
            same = ("=", hand.one(scope)[0], hand.one([name for name, _ in scope] + list(known)))
            return same if hand.chance(0.3) else ("not", same)
        atom = _atom(hand, task, scope, predicates, known)
        return ("not", atom) if hand.chance(0.3) else atom
    head = hand.one(["and", "and", "or", "not", "imply", "forall", "exists"])
    if head in ("forall", "exists"):
        # A variable may shadow one of the same name.
        names = [f"?{letter}" for letter in "xyz"[: hand.rng.integers(1, 3)]]
        inner = tuple((name, hand.kinds(list(task.parents))) for name in names)
        outer = tuple(each for each in scope if each[0] not in names)
        return (head, inner, _formula(hand, task, (*outer, *inner), predicates, known, depth - 1))
    count = {"not": 1, "imply": 2}.get(head) or int(hand.rng.integers(1, 4))
    return (head, *(_formula(hand, task, scope, predicates, known, depth - 1) for _ in range(count)))


def _action(
    hand: _Hand, task: Drawn, name: str, predicates: Mapping[str, Any], basic: list[str], constants: Mapping[str, str]
) -> Action:
    names = ["?x", "?y", "?x1"][: hand.rng.integers(0, 4)]
    scope = tuple((each, hand.kinds(list(task.parents))) for each in names)
    precondition: Formula = _formula(hand, task, scope, list(predicates), constants, int(hand.rng.integers(0, 3)))
    if hand.chance(0.3):
        precondition = ("and", *(_atom(hand, task, scope, list(predicates), constants) for _ in names))
    effects = []
    for _ in range(hand.rng.integers(1, 4)):
        inner: Parameters = ()
        if hand.chance(0.2):
            inner = ((hand.one(["?z", "?x", "?w"]), hand.kinds(list(task.parents))),)
        seen = (*(each for each in scope if each[0] not in dict(inner)), *inner)
        condition: Formula = ("and",)
        if hand.chance(0.3):
            condition = _formula(hand, task, seen, list(predicates), constants, 1)
        atom = _atom(hand, task, seen, basic, constants)
        if atom != ("and",):
            effects.append((inner, condition, hand.chance(0.6), atom))
    cost: Formula | int | None = None
    if hand.chance(0.8):
        cost = int(hand.rng.integers(0, 6))
        if task.functions and hand.chance(0.6):
            function = hand.one(task.functions)
            found = []
            for wanted in task.functions[function]:
                # The translator grounds actions wrongly if a cost names a parameter twice and lacks a value.
                fits = [each for each, kinds in scope if each not in found and task.overlap(kinds, wanted)]
                fits += [each for each in constants if each in task.of(wanted)]
                found.append(hand.one(fits) if fits else "")
            if all(found):
                cost = (function, *found)
    return Action(name, scope, precondition, tuple(effects), cost)


def holds(task: Drawn, formula: Formula, state: State, bound: Mapping[str, str]) -> bool:
    """Return whether a formula holds in a state that includes its derived facts."""
    head, *parts = formula
    if head == "and":
        return all(holds(task, part, state, bound) for part in parts)
    if head == "or":
        return any(holds(task, part, state, bound) for part in parts)
    if head == "not":
        return not holds(task, parts[0], state, bound)
    if head == "imply":
        return not holds(task, parts[0], state, bound) or holds(task, parts[1], state, bound)
    if head in ("forall", "exists"):
        found = (holds(task, parts[1], state, {**bound, **more}) for more in bindings(task, parts[0]))
        return all(found) if head == "forall" else any(found)
    words = [bound.get(word, word) for word in parts]
    return words[0] == words[1] if head == "=" else (head, *words) in state


def bindings(task: Drawn, variables: Parameters) -> Iterator[dict[str, str]]:
    """Yield all assignments of objects to variables."""
    names = [name for name, _ in variables]
    for objects in itertools.product(*(task.of(kinds) for _, kinds in variables)):
        yield dict(zip(names, objects, strict=True))


def with_derived(task: Drawn, state: State) -> State:
    """Return a state with its derived facts, the least fixed point of the rule."""
    if task.rule is None:
        return state
    name, variables, body = task.rule
    while True:
        more = {
            (name, *bound.values())
            for bound in bindings(task, variables)
            if (name, *bound.values()) not in state and holds(task, body, state, bound)
        }
        if not more:
            return state
        state |= more


def steps(task: Drawn, state: State, ground: list[tuple[Action, dict[str, str], int]]) -> Iterator[tuple[int, State]]:
    """Yield the cost and the successor state of each applicable action."""
    full = with_derived(task, state)
    for action, bound, cost in ground:
        if not holds(task, action.precondition, full, bound):
            continue
        added, removed = set(), set()
        for variables, condition, positive, (name, *arguments) in action.effects:
            for more in bindings(task, variables):
                both = {**bound, **more}
                if holds(task, condition, full, both):
                    atom = (name, *(both.get(word, word) for word in arguments))
                    (added if positive else removed).add(atom)
        yield cost, (state - removed) | added


def reached(task: Drawn) -> dict[State, int]:
    """Ground a task; return its states with the costs of reaching them, or more than `LARGEST` states."""
    ground = []
    for action in task.actions:
        for bound in bindings(task, action.parameters):
            cost: int | None = 0 if action.cost is None else None
            if isinstance(action.cost, int):
                cost = action.cost
            elif action.cost is not None:
                cost = task.values.get(tuple(bound.get(word, word) for word in action.cost))
            if cost is not None:  # not applicable without a value
                ground.append((action, bound, cost if task.metric else 1))
    best: dict[State, int] = {task.facts: 0}
    done: set[State] = set()
    queue: list[tuple[int, int, State]] = [(0, 0, task.facts)]
    count = itertools.count(1)
    while queue and len(best) <= LARGEST:
        cost, _, state = heapq.heappop(queue)
        if state in done:
            continue
        done.add(state)
        for extra, after in steps(task, state, ground):
            if cost + extra < best.get(after, math.inf):
                best[after] = cost + extra
                heapq.heappush(queue, (cost + extra, next(count), after))
    return best


def cheapest(task: Drawn, best: Mapping[State, int]) -> float:
    """Return the smallest cost of a state in which the goal holds."""
    goals = (cost for state, cost in best.items() if holds(task, task.goal, with_derived(task, state), {}))
    return min(goals, default=math.inf)


def solve(task: Drawn) -> Answer:
    """Return the cost of an optimal plan and the number of states, by enumerating all states."""
    best = reached(task)
    return Answer(cheapest(task, best), len(best))
