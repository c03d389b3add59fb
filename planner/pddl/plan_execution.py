"""Execution of a plan by the meaning of its files, with exact numbers and durations.

One person does one action after the other. This checks plans of instances with numbers, durations or derived
predicates. It shares nothing with their compilation and search but the reading of words, objects and types: conditions
and effects are taken from the files' text.

A durative action turns a state s into s1 by its effects at start, and s1 into the next state by those at end. Its
conditions at start are read in s, those over all and at end in s1. A condition at start of an effect at end is read in
s. The duration is read in s; of an interval it is the least value.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

from ..system.errors import MismatchError, UnsuitedError
from . import declarations, instances
from .declarations import Typed
from .instances import Expression, Instance

Term = tuple[str, ...]
"""A ground atom, or a function with its arguments."""

Scope = Mapping[str, "str | Fraction"]
"""The object of each variable, and the value of `?duration`."""

COMPARISONS = {"=": operator.eq, "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
MOST_RULES = 3_000_000
"""Largest number of times that a rule of a derived predicate is tried with objects, about twenty seconds."""
CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
TIMES = (("at", "start"), ("over", "all"), ("at", "end"))


@dataclass(frozen=True)
class _State:
    """A state: the atoms that hold, derived ones included, and the values of functions."""

    atoms: frozenset[Term]
    values: Mapping[Term, Fraction]


class _Moments(NamedTuple):
    """The states in which conditions are read: before an action, and after its effects at start."""

    start: _State
    later: _State


class _Effect(NamedTuple):
    """A change of one atom or number, at the start or at the end, with its conditions."""

    at_start: bool
    conditions: tuple[Expression, ...]
    scope: Scope
    change: Expression


class Executed(NamedTuple):
    """The cost of a plan, and the duration of each of its actions, None for one without a duration."""

    cost: Fraction
    durations: tuple[Fraction | None, ...]


def execute(instance: Instance, plan: Sequence[str]) -> Executed:
    """Execute a plan, ground actions as `(name argument ...)`, by the meaning of the files.

    If an action is unknown or not applicable, or the goal does not hold at the end, this raises a `MismatchError`. An
    `UnsuitedError` says that derived predicates have too many objects.
    """
    files = _Files(instance)
    state, durations = files.initial, list[Fraction | None]()
    for step, action in enumerate(plan):
        try:
            state, duration = files.after(state, action)
        except ArithmeticError as error:
            raise MismatchError(f"step {step}: {action} reads {error or 'a quotient by zero'}") from None
        except MismatchError as error:
            raise MismatchError(f"step {step}: {action} {error}") from None
        durations.append(duration)
    if not files.holds(files.goal, {}, _Moments(state, state)):
        raise MismatchError("the goal does not hold after the plan")
    if files.metric is None:
        cost = sum((Fraction(1) if each is None else each for each in durations), Fraction(0))
    else:
        plain = Fraction(0 if files.durative else 1)
        cost = files.minimized(state, sum((plain if each is None else each for each in durations), Fraction(0)))
    return Executed(cost, tuple(durations))


class _Files:
    """The two files of an instance as text that is interpreted."""

    def __init__(self, instance: Instance) -> None:
        domain, problem = (
            instances.nested(file, instances.text(file, kind))
            for file, kind in ((instance.domain, "domain"), (instance.problem, "problem"))
        )
        self.types = declarations.types(instance.domain, domain.section(":types"))
        self.objects = {
            **declarations.objects(instance.domain, domain.section(":constants"), self.types, {}, ""),
            **declarations.objects(instance.problem, problem.section(":objects"), self.types, {}, ""),
        }
        single = {part.head for part in _functions(domain) if len(part.parts) == 1} - self.objects.keys()
        domain, problem = _bracketed(domain, single), _bracketed(problem, single)
        self._instance = instance
        self._tried = 0
        self.actions = {
            part.parts[1].word: part for part in domain.parts if part.head in (":action", ":durative-action")
        }
        self.durative = any(part.head == ":durative-action" for part in self.actions.values())
        self.rules = [part for part in domain.parts if part.head == ":derived"]
        goal, metric, init = (problem.section(head) for head in (":goal", ":metric", ":init"))
        assert goal is not None
        assert init is not None
        self.goal, self.metric = goal.parts[1], None if metric is None else metric.parts[2]
        self.priced = set[str]() if metric is None else {part.head or part.word for part in metric.walk()}
        self.read = self._read([*domain.parts, *problem.parts])
        atoms, values = set[Term](), dict[Term, Fraction]()
        for fact in init.parts[1:]:
            if fact.head == "=":
                values[tuple(fact.parts[1].words)] = Fraction(fact.parts[2].word)
            elif fact.head != "not":
                atoms.add(tuple(fact.words))
        self.initial = self._derived(atoms, values)

    def _read(self, parts: Sequence[Expression]) -> frozenset[str]:
        """Return the functions that something reads, other than the metric and what nothing reads."""
        read, sources = set[str](), list[tuple[str, set[str]]]()
        waiting = [part for part in parts if part.head not in (":functions", ":predicates", ":metric", ":init")]
        while waiting:
            part = waiting.pop()
            if part.head in CHANGES:
                sources.append((part.parts[1].head, {inner.head for inner in part.parts[2].walk()}))
            else:
                read.add(part.head)
                waiting += part.parts
        while more := set[str]().union(*(of for to, of in sources if to in read | self.priced)) - read:
            read |= more
        return frozenset(read)

    # States

    def _derived(self, atoms: set[Term], values: Mapping[Term, Fraction]) -> _State:
        """Return a state with its derived atoms: the least fixed point, level by level of negation."""
        if not self.rules:
            return _State(frozenset(atoms), values)
        names = {rule.parts[1].head for rule in self.rules}
        found = {atom for atom in atoms if atom[0] not in names}
        for level in sorted(set(self._levels.values())):
            grown = True
            while grown:
                state = _State(frozenset(found), values)
                new = {
                    head
                    for rule in self.rules
                    if self._levels[rule.parts[1].head] == level
                    for scope in self._counted(self.bindings(rule.parts[1].parts[1:]))
                    if (head := (rule.parts[1].head, *map(str, scope.values()))) not in found
                    and self.holds(rule.parts[2], scope, _Moments(state, state))
                }
                grown = bool(new)
                found |= new
        return _State(frozenset(found), values)

    def _counted(self, scopes: Iterator[dict[str, str | Fraction]]) -> Iterator[dict[str, str | Fraction]]:
        for scope in scopes:
            self._tried += 1
            if self._tried > MOST_RULES:
                raise UnsuitedError("too many combinations of objects in derived predicates")
            yield scope

    @cached_property
    def _levels(self) -> dict[str, int]:
        """The level of each derived predicate: above those that its rules read negated, not below the others."""
        level = {rule.parts[1].head: 0 for rule in self.rules}
        for _ in level:
            for rule in self.rules:
                for name, negated in _read(rule.parts[2], False):
                    if name in level:
                        level[rule.parts[1].head] = max(level[rule.parts[1].head], level[name] + negated)
        return level

    def bindings(self, variables: Sequence[Expression]) -> Iterator[dict[str, str | Fraction]]:
        """Yield the objects of a typed list of variables, in all combinations."""
        typed = declarations.parameters(self._instance.domain, variables, self.types)
        for objects in itertools.product(*map(self._fitting, typed)):
            yield dict(zip((one.name for one in typed), objects, strict=True))

    def _fitting(self, variable: Typed) -> list[str]:
        return [name for name, each in self.objects.items() if self.types.fits(each.kinds[0], variable.kinds)]

    # Numbers and conditions

    def value(self, expression: Expression, scope: Scope, state: _State) -> Fraction:
        """Return the value of a numeric expression."""
        if expression.word:
            bound = scope.get(expression.word)
            return bound if isinstance(bound, Fraction) else Fraction(expression.word)
        head, parts = expression.head, expression.parts[1:]
        if head not in ("+", "-", "*", "/"):
            term = _ground(expression, scope)
            if term not in state.values and (head in self.read or head not in self.priced):
                raise ArithmeticError(f"({' '.join(term)}), which has no value")
            return state.values.get(term, Fraction(0))
        first, *others = (self.value(part, scope, state) for part in parts)
        if head == "-" and not others:
            return -first
        for other in others:
            operation = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}[head]
            first = operation(first, other)
        return first

    def holds(
        self, condition: Expression, scope: Scope, moments: _Moments, *, later: bool = False, negated: bool = False
    ) -> bool:
        """Return whether a condition holds, or its negation. A comparison without a value does not, negated or not.

        A quotient by zero is no value either.
        """
        head, parts = condition.head, condition.parts[1:]

        def inner(part: Expression, own: Scope = scope, *, turned: bool = False) -> bool:
            return self.holds(part, own, moments, later=later, negated=negated != turned)

        if _time(condition) is not None:
            return self.holds(parts[1], scope, moments, later=_time(condition) != TIMES[0], negated=negated)
        if head == "not":
            return inner(parts[0], turned=True)
        if head in ("", "and", "or"):
            return (any if (head == "or") != negated else all)(inner(part) for part in parts)
        if head == "imply":
            return (all if negated else any)((inner(parts[0], turned=True), inner(parts[1])))
        if head in ("forall", "exists"):
            each = (inner(parts[1], {**scope, **own}) for own in self.bindings(parts[0].parts))
            return (any if (head == "exists") != negated else all)(each)
        state = moments.later if later else moments.start
        if head in COMPARISONS and (head != "=" or any(self._is_number(part, scope) for part in parts)):
            try:
                left, right = (self.value(part, scope, state) for part in parts)
            except ArithmeticError:  # a function has no value there, or a divisor is 0
                return False
            return bool(COMPARISONS[head](left, right)) != negated
        term = _ground(condition, scope)
        return (term[1] == term[2] if head == "=" else term in state.atoms) != negated

    def _is_number(self, part: Expression, scope: Scope) -> bool:
        bound = scope.get(part.word)
        return bool(part.parts) or isinstance(bound, Fraction) or (bound is None and part.word not in self.objects)

    # Actions

    def after(self, state: _State, action: str) -> tuple[_State, Fraction | None]:
        """Return the state after a ground action, and its duration, if it has one.

        A `MismatchError` says why the action is not applicable.
        """
        name, *arguments = action[1:-1].split()
        if name not in self.actions:
            raise MismatchError("is no action of the domain")
        part = self.actions[name]
        given = {key.word: value for key, value in itertools.pairwise(part.parts[2:]) if key.word.startswith(":")}
        none = Expression("")
        typed = declarations.parameters(self._instance.domain, given.get(":parameters", none).parts, self.types)
        if len(arguments) != len(typed) or any(
            a not in self._fitting(t) for a, t in zip(arguments, typed, strict=True)
        ):
            raise MismatchError("has arguments of other types")
        scope: dict[str, str | Fraction] = dict(zip((one.name for one in typed), arguments, strict=True))
        durative = part.head == ":durative-action"
        duration = None
        if durative:
            duration = scope["?duration"] = self._duration(given[":duration"], scope, state)
        effects = list(self._effects(given.get(":effect", none), scope, not durative, ()))
        later = self._changed(state, [one for one in effects if one.at_start], _Moments(state, state))
        condition = given.get(":condition" if durative else ":precondition", none)
        if not self.holds(condition, scope, _Moments(state, later)):
            raise MismatchError("is not applicable")
        return self._changed(later, [one for one in effects if not one.at_start], _Moments(state, later)), duration

    def _duration(self, constraint: Expression, scope: Scope, state: _State) -> Fraction:
        """Return the least duration that satisfies a conjunction of constraints."""
        bounds: list[tuple[str, Fraction]] = []
        waiting = [constraint]
        while waiting:
            one = waiting.pop()
            if one.head == "and":
                waiting += one.parts[1:]
            elif _time(one) is not None:
                waiting.append(one.parts[2])
            elif one.parts:
                bounds.append((one.head, self.value(one.parts[2], scope, state)))
        least = max((value for sign, value in bounds if sign in ("=", ">=", ">")), default=Fraction(0))
        if least < 0 or not all(COMPARISONS[sign](least, value) for sign, value in bounds):
            raise MismatchError("has no duration")
        return least

    def _effects(
        self, effect: Expression, scope: Scope, at_start: bool, conditions: tuple[Expression, ...]
    ) -> Iterator[_Effect]:
        """Yield the single changes of an effect."""
        head, parts = effect.head, effect.parts[1:]
        if (time := _time(effect)) is not None:
            yield from self._effects(parts[1], scope, time == TIMES[0], conditions)
        elif head in ("", "and"):
            for part in parts:
                yield from self._effects(part, scope, at_start, conditions)
        elif head == "forall":
            for own in self.bindings(parts[0].parts):
                yield from self._effects(parts[1], {**scope, **own}, at_start, conditions)
        elif head == "when":
            yield from self._effects(parts[1], scope, at_start, (*conditions, parts[0]))
        else:
            yield _Effect(at_start, conditions, scope, effect)

    def _changed(self, state: _State, effects: Sequence[_Effect], moments: _Moments) -> _State:
        """Return the state after effects at one time: all are read before any is made, and additions come last."""
        deleted, added = set[Term](), set[Term]()
        changes: dict[Term, list[tuple[str, Fraction]]] = {}
        for _, conditions, scope, change in effects:
            later = state is moments.later
            if not all(self.holds(one, scope, moments, later=later) for one in conditions):
                continue
            if change.head == "not":
                deleted.add(_ground(change.parts[1], scope))
            elif change.head in CHANGES:
                if change.parts[1].head not in self.read and change.parts[1].head not in self.priced:
                    continue  # it makes no difference
                term, amount = _ground(change.parts[1], scope), self.value(change.parts[2], scope, state)
                if change.head != "assign":
                    self.value(change.parts[1], scope, state)  # it has to have a value
                changes.setdefault(term, []).append((change.head, amount))
            else:
                added.add(_ground(change, scope))
        if not (deleted or added or changes):
            return state
        values = {**state.values}
        for term, several in changes.items():
            values[term] = _combined(values.get(term, Fraction(0)), several)
        return self._derived(set((state.atoms - deleted) | added), values)

    def minimized(self, state: _State, clock: Fraction) -> Fraction:
        """Return the value of the metric in a state at a time, minus its value at the beginning."""
        assert self.metric is not None
        begin, end = (
            _State(one.atoms, {("total-time",): time, **one.values})
            for one, time in ((self.initial, Fraction(0)), (state, clock))
        )
        return self.value(self.metric, {}, end) - self.value(self.metric, {}, begin)


def _combined(value: Fraction, changes: Sequence[tuple[str, Fraction]]) -> Fraction:
    """Return the value of a function after changes at the same time."""
    kinds = {"increase" if kind == "decrease" else kind for kind, _ in changes}
    if kinds == {"increase"}:
        return value + sum((-amount if kind == "decrease" else amount for kind, amount in changes), Fraction(0))
    if len(set(changes)) > 1:
        raise MismatchError("changes a number in two ways at once")
    kind, amount = changes[0]
    return amount if kind == "assign" else value * amount if kind == "scale-up" else value / amount


def _functions(domain: Expression) -> Sequence[Expression]:
    """Return the functions that a domain declares, each with its parameters."""
    section = domain.section(":functions")
    return [part for part in (() if section is None else section.parts[1:]) if part.parts]


def _bracketed(expression: Expression, functions: Set[str]) -> Expression:
    """Return an expression in which functions without arguments, which may be words in numbers, have brackets."""

    def inner(part: Expression) -> Expression:
        if part.word in functions and expression.head in (*COMPARISONS, *CHANGES, *"+-*/", ":metric"):
            return Expression("", (part,), part.place)
        return _bracketed(part, functions)

    return expression if expression.word else expression._replace(parts=tuple(map(inner, expression.parts)))


def _ground(expression: Expression, scope: Scope) -> Term:
    """Return an atom, or a function with its arguments, with objects in place of variables."""
    return tuple(str(scope.get(part.word, part.word)) for part in expression.parts)


def _time(expression: Expression) -> tuple[str, str] | None:
    """Return the time of `(at start ...)`, `(over all ...)` or `(at end ...)`; None for others, as for a predicate."""
    if len(expression.parts) != 3 or not expression.parts[2].parts:
        return None
    time = expression.head, expression.parts[1].word
    return time if time in TIMES else None


def _read(condition: Expression, negated: bool) -> Iterator[tuple[str, bool]]:
    """Yield the predicates that a condition reads, and whether it reads them negated."""
    head, parts = condition.head, condition.parts[1:]
    if head in ("forall", "exists"):
        yield from _read(parts[1], negated)
    elif head in ("", "and", "or", "not", "imply"):
        for place, part in enumerate(parts):
            yield from _read(part, negated != (head == "not" or (head == "imply" and place == 0)))
    else:
        yield head, negated
