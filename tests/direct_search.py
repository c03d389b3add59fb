"""A direct search over the original meaning of numeric and durative PDDL, as a reference for what is compiled away.

One person does one action after the other. Numbers are exact fractions, states are sets of atoms with the values of
functions, and Dijkstra's algorithm enumerates what is reachable. Nothing here is shared with `planner`: the text is
read, grounded and executed by the few definitions below.

A durative action: its conditions `at start` are read in the state s before it; its effects at start give s1; its
conditions `over all` and `at end` are read in s1, and its effects at end change s1. A condition `at start` of an effect
at end is read in s. Its duration is read in s; of an inequality the least value is taken.
"""

from __future__ import annotations

import heapq
import itertools
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

Tree = Any
"""A word or a list of trees."""
Term = tuple[str, ...]
"""A ground atom or a ground function: its name and its arguments."""

COMPARISONS = {"=": operator.eq, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge}
CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
MOST_BINDINGS = 400_000  # of one action's parameters, about ten seconds
TIMES = (["at", "start"], ["over", "all"], ["at", "end"])


class UnsupportedError(ValueError):
    """The reference does not know this part of PDDL."""


class TooLargeError(ValueError):
    """There are more states or ground actions than the caller allows."""


def parse(text: str) -> Tree:
    """Return the only list of a PDDL text as nested lists of lower-case words."""
    text = re.sub(r";[^\n]*", " ", text.lower())
    stack: list[list[Tree]] = [[]]
    for token in re.findall(r"[()]|[^\s()]+", text):
        if token == "(":
            stack.append([])
        elif token == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    (whole,) = stack[0]
    return whole


def typed(words: Sequence[Tree]) -> list[tuple[str, list[str]]]:
    """Return the names of a typed list, each with its types."""
    found: list[tuple[str, list[str]]] = []
    waiting: list[str] = []
    at = 0
    while at < len(words):
        if words[at] == "-":
            kind = words[at + 1]
            kinds = kind[1:] if isinstance(kind, list) else [kind]
            found += [(name, kinds) for name in waiting]
            waiting = []
            at += 2
        else:
            waiting.append(words[at])
            at += 1
    return found + [(name, ["object"]) for name in waiting]


@dataclass(frozen=True)
class Timed:
    """A condition or an effect, with the index of its time in `TIMES`; 0 for those of plain actions."""

    time: int
    tree: Tree


@dataclass(frozen=True)
class Schema:
    """An action; `duration` is None for a plain one, else its constraints as (comparison, expression)."""

    name: str
    parameters: list[tuple[str, list[str]]]
    conditions: list[Timed]
    effects: list[Timed]
    duration: list[tuple[str, Tree]] | None


@dataclass(frozen=True)
class State:
    """Atoms that hold, and the values of functions that have one."""

    atoms: frozenset[Term]
    values: Mapping[Term, Fraction]
    key: Any = field(repr=False)


def section(tree: Tree, head: str) -> list[Tree]:
    """Return the elements of the first list that begins with the word; empty if there is none."""
    return next((part[1:] for part in tree if isinstance(part, list) and part and part[0] == head), [])


def timed(tree: Tree) -> list[Timed]:
    """Return the parts of a durative action's condition or effect with their times."""
    if not tree:
        return []
    if tree[0] == "and":
        return [each for part in tree[1:] for each in timed(part)]
    if tree[:2] in TIMES:
        return [Timed(TIMES.index(tree[:2]), tree[2])]
    if tree[0] == "forall":
        return [Timed(each.time, ["forall", tree[1], each.tree]) for each in timed(tree[2])]
    if tree[0] == "when":
        return [Timed(each.time, ["when at", timed(tree[1]), each.tree]) for each in timed(tree[2])]
    raise UnsupportedError(f"a part without a time: {tree}")


def fraction(word: Tree) -> Fraction | None:
    """Return the number that a word is; None if it is none."""
    return Fraction(word) if isinstance(word, str) and re.fullmatch(r"-?(\d+\.?\d*|\.\d+)", word) else None


class Direct:
    """A task read from two texts, executed by definition.

    Attributes
    ----------
    initial : State
    changing : set of str
        Functions that an action changes.
    live, priced : set of str
        Functions that something reads, and those that only the metric reads.
    """

    def __init__(self, domain: str | Path, problem: str | Path) -> None:
        texts = [each.read_text(encoding="utf-8") if isinstance(each, Path) else each for each in (domain, problem)]
        self.domain, self.problem = map(parse, texts)
        for part in (*self.domain[2:], *self.problem[2:]):
            if part[0] in (":derived", ":process", ":event", ":constraints"):
                raise UnsupportedError(part[0])
        self.types: dict[str, set[str]] = {}  # supertypes of each type, itself included
        listed = typed(section(self.domain, ":types"))
        for name, above in listed:
            self.types.setdefault(name, {name, "object"}).update(above)
            for each in above:
                self.types.setdefault(each, {each, "object"})
        for _ in self.types:
            for above in self.types.values():
                above.update(*(self.types.get(each, ()) for each in tuple(above)))
        self.objects = dict(typed(section(self.domain, ":constants")) + typed(section(self.problem, ":objects")))
        self.schemas = [self._schema(part) for part in self.domain if part[0] in (":action", ":durative-action")]
        self.durative = any(each.duration is not None for each in self.schemas)
        (self.goal,) = section(self.problem, ":goal")
        metric = section(self.problem, ":metric")
        if metric and metric[0] != "minimize":
            raise UnsupportedError("maximize")
        self.metric = metric[1] if metric else None
        self.changing: set[str] = set()
        self.live, self.priced = self._roles()
        atoms: set[Term] = set()
        values: dict[Term, Fraction] = {}
        for part in section(self.problem, ":init"):
            if part[0] == "=":
                number = fraction(part[2])
                if number is None or not isinstance(part[1], list):
                    raise UnsupportedError(f"an initial value: {part}")
                values[tuple(part[1])] = number
            elif part[0] == "at" and fraction(part[1]) is not None:
                raise UnsupportedError("timed initial literals")
            elif part[0] != "not":
                atoms.add(tuple(part))
        for name in self.priced:
            for term in self._terms(name):
                values.setdefault(term, Fraction(0))
        self.initial = self._state(frozenset(atoms), values)

    def _schema(self, part: Tree) -> Schema:
        keys = dict(zip(part[2::2], part[3::2], strict=True))
        parameters = typed(keys.get(":parameters", []))
        if part[0] == ":action":
            conditions = [Timed(0, keys[":precondition"])] if keys.get(":precondition") else []
            effects = [Timed(0, keys[":effect"])] if keys.get(":effect") else []
            return Schema(part[1], parameters, conditions, effects, None)
        wanted = keys[":duration"]
        wanted = wanted[1:] if wanted and wanted[0] == "and" else [wanted] if wanted else []
        duration = []
        for each in wanted:
            while each[0] == "at":
                each = each[2]
            if each[1] != "?duration":
                raise UnsupportedError(f"a duration: {each}")
            duration.append((each[0], each[2]))
        return Schema(part[1], parameters, timed(keys.get(":condition", [])), timed(keys.get(":effect", [])), duration)

    def _roles(self) -> tuple[set[str], set[str]]:
        """Return the functions that something reads, and those that only the metric reads."""
        names = {part[0] for part in section(self.domain, ":functions") if isinstance(part, list)} | {"total-cost"}

        def mentioned(tree: Tree) -> set[str]:
            if isinstance(tree, Timed):
                return mentioned(tree.tree)
            if not isinstance(tree, list) or not tree:
                return set()
            if isinstance(tree[0], str) and tree[0] in names and all(isinstance(each, str) for each in tree):
                return {tree[0]}
            return set().union(*map(mentioned, tree))

        read = mentioned(self.goal)
        sources: list[tuple[str, set[str]]] = []

        def effects(tree: Tree) -> None:
            if not tree:
                return
            if tree[0] == "and":
                for each in tree[1:]:
                    effects(each)
            elif tree[0] == "forall":
                effects(tree[2])
            elif tree[0] in ("when", "when at"):
                read.update(mentioned(tree[1]))
                effects(tree[2])
            elif tree[0] in CHANGES:
                self.changing.add(tree[1][0])
                sources.append((tree[1][0], mentioned(tree[2])))

        for schema in self.schemas:
            for each in schema.conditions:
                read |= mentioned(each)
            for _, value in schema.duration or ():
                read |= mentioned(value)
            for each in schema.effects:
                effects(each.tree)
        priced = mentioned(self.metric) - {"total-time"} if self.metric is not None else set()
        while True:
            more = set().union(*(of for to, of in sources if to in read | priced)) - read
            # A function whose new value depends on its own value in another way than by adding is read.
            if not more:
                return read, priced - read
            read |= more

    def _terms(self, name: str) -> Iterator[Term]:
        for part in section(self.domain, ":functions"):
            if isinstance(part, list) and part[0] == name:
                for chosen in itertools.product(*(self.of_types(kinds) for _, kinds in typed(part[1:]))):
                    yield (name, *chosen)

    def of_types(self, kinds: Sequence[str]) -> list[str]:
        """Return the objects of any of the types."""
        return [
            name
            for name, own in self.objects.items()
            if any(kind in self.types.get(each, {each, "object"}) for each in own for kind in kinds)
        ]

    def _state(self, atoms: frozenset[Term], values: Mapping[Term, Fraction]) -> State:
        kept = {term: value for term, value in values.items() if term[0] in self.live or term[0] in self.priced}
        key = (atoms, frozenset((term, value) for term, value in kept.items() if term[0] in self.live))
        return State(atoms, kept, key)

    # Expressions and conditions

    def value(self, tree: Tree, bound: Mapping[str, str], state: State) -> Fraction | None:
        """Return the value of an expression; None where something in it has no value."""
        if isinstance(tree, str):
            if tree == "?duration":
                return self._duration  # set while an action's effects are computed
            return fraction(tree) if fraction(tree) is not None else state.values.get((tree,))
        if len(tree) == 1 and fraction(tree[0]) is not None:
            return fraction(tree[0])
        if tree[0] in ("+", "-", "*", "/"):
            parts = [self.value(each, bound, state) for each in tree[1:]]
            if any(each is None for each in parts):
                return None
            if tree[0] == "-" and len(parts) == 1:
                return -parts[0]
            total = parts[0]
            for each in parts[1:]:
                if tree[0] == "/" and each == 0:
                    return None
                total = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}[tree[0]](
                    total, each
                )
            return total
        return state.values.get((tree[0], *(bound.get(word, word) for word in tree[1:])))

    def holds(self, tree: Tree, bound: Mapping[str, str], state: State, wanted: bool = True) -> bool:
        """Return whether a condition is satisfied, or (`wanted=False`) whether its negation is.

        A comparison that reads a function without a value is not satisfied, negated or not.
        """
        if not tree:
            return wanted
        head = tree[0]
        if head in ("and", "or"):
            every = (head == "and") is wanted
            return (all if every else any)(self.holds(each, bound, state, wanted) for each in tree[1:])
        if head == "not":
            return self.holds(tree[1], bound, state, not wanted)
        if head == "imply":
            return self.holds(["or", ["not", tree[1]], tree[2]], bound, state, wanted)
        if head in ("forall", "exists"):
            every = (head == "forall") is wanted
            names = typed(tree[1])
            return (all if every else any)(
                self.holds(
                    tree[2], {**bound, **dict(zip((name for name, _ in names), chosen, strict=True))}, state, wanted
                )
                for chosen in itertools.product(*(self.of_types(kinds) for _, kinds in names))
            )
        if head in COMPARISONS:
            left, right = tree[1:]
            if head == "=" and self._is_object(left) and self._is_object(right):
                return (bound.get(left, left) == bound.get(right, right)) is wanted
            values = self.value(left, bound, state), self.value(right, bound, state)
            return None not in values and COMPARISONS[head](*values) is wanted
        if head == "preference" or tree[:2] in TIMES:
            raise UnsupportedError(str(head))
        return ((head, *(bound.get(word, word) for word in tree[1:])) in state.atoms) is wanted

    def _is_object(self, tree: Tree) -> bool:
        return isinstance(tree, str) and tree != "?duration" and (tree.startswith("?") or tree in self.objects)

    # Actions

    def instances(self, schema: Schema) -> Iterator[dict[str, str]]:
        """Yield the bindings of an action's parameters."""
        for chosen in itertools.product(*(self.of_types(kinds) for _, kinds in schema.parameters)):
            yield dict(zip((name for name, _ in schema.parameters), chosen, strict=True))

    @cached_property
    def ground(self) -> list[tuple[str, Schema, dict[str, str]]]:
        """All actions with their bindings, without those whose static conditions never hold."""
        changed = {"="}

        def note(tree: Tree) -> None:
            if isinstance(tree, Timed):
                note(tree.tree)
            elif isinstance(tree, list) and tree:
                if tree[0] == "not":
                    changed.add(tree[1][0])
                elif isinstance(tree[0], str) and tree[0] not in ("and", "when", "when at", "forall"):
                    changed.add(tree[0])
                for each in tree[1:] if tree[0] not in ("when", "when at") else tree[2:]:
                    note(each)

        for schema in self.schemas:
            for each in schema.effects:
                note(each)

        def fixed(tree: Tree) -> list[Tree]:
            if not tree:
                return []
            if tree[0] == "and":
                return [part for each in tree[1:] for part in fixed(each)]
            plain = tree[1] if tree[0] == "not" else tree
            if plain and (plain[0] == "=" and all(map(self._is_object, plain[1:]))):
                return [tree]
            words = {"and", "or", "imply", "forall", "exists", "not", *COMPARISONS}
            return [tree] if plain and plain[0] not in changed | words else []

        found = []
        for schema in self.schemas:
            static = [part for each in schema.conditions for part in fixed(each.tree)]
            for tried, bound in enumerate(self.instances(schema)):
                if tried > MOST_BINDINGS:
                    raise TooLargeError(f"ground actions of {schema.name}")
                if all(self.holds(part, bound, self.initial) for part in static):
                    name = " ".join((schema.name, *(bound[name] for name, _ in schema.parameters)))
                    found.append((f"({name})", schema, bound))
        return found

    def apply(self, schema: Schema, bound: Mapping[str, str], state: State) -> tuple[State, Fraction] | None:
        """Return the state after an action and the action's cost; None where it is not applicable."""
        if not all(self.holds(each.tree, bound, state) for each in schema.conditions if each.time == 0):
            return None
        duration = Fraction(0)
        if schema.duration is not None:
            low, high = Fraction(0), None
            for comparison, tree in schema.duration:
                value = self.value(tree, bound, state)
                if value is None:
                    return None
                if comparison in ("=", ">="):
                    low = max(low, value) if comparison == ">=" else value
                if comparison in ("=", "<="):
                    high = value if high is None else min(high, value)
            if high is not None and low > high:
                return None
            if low < 0:
                raise UnsupportedError("a negative duration")
            duration = low
        self._duration = duration
        after: State | None = state
        between = state
        for time in (0, 2):
            effects = [each.tree for each in schema.effects if each.time == time]
            after = self._changed(effects, bound, state, between)
            if after is None:
                return None
            if time == 0:
                between = after
                if not all(self.holds(each.tree, bound, between) for each in schema.conditions if each.time > 0):
                    return None
        return after, self.cost(state, after, duration, schema)

    def _changed(self, effects: list[Tree], bound: Mapping[str, str], start: State, state: State) -> State | None:
        added: set[Term] = set()
        deleted: set[Term] = set()
        assigned: dict[Term, Fraction] = {}
        summed: dict[Term, Fraction] = {}
        scaled: dict[Term, Fraction] = {}
        defined = True

        def collect(tree: Tree, bound: Mapping[str, str]) -> None:
            nonlocal defined
            if not tree:
                return
            if tree[0] == "and":
                for each in tree[1:]:
                    collect(each, bound)
            elif tree[0] == "forall":
                names = typed(tree[1])
                for chosen in itertools.product(*(self.of_types(kinds) for _, kinds in names)):
                    collect(tree[2], {**bound, **dict(zip((name for name, _ in names), chosen, strict=True))})
            elif tree[0] == "when":
                if self.holds(tree[1], bound, state):
                    collect(tree[2], bound)
            elif tree[0] == "when at":
                if all(self.holds(each.tree, bound, start if each.time == 0 else state) for each in tree[1]):
                    collect(tree[2], bound)
            elif tree[0] in CHANGES:
                target = (tree[1],) if isinstance(tree[1], str) else tree[1]
                term = (target[0], *(bound.get(word, word) for word in target[1:]))
                if term[0] not in self.live and term[0] not in self.priced:
                    return
                value = self.value(tree[2], bound, state)
                if value is None or (tree[0] != "assign" and term not in state.values):
                    defined = False
                elif tree[0] == "assign":
                    if assigned.setdefault(term, value) != value:
                        raise UnsupportedError("two assignments of one function")
                elif tree[0] in ("increase", "decrease"):
                    summed[term] = summed.get(term, Fraction(0)) + (value if tree[0] == "increase" else -value)
                else:
                    if tree[0] == "scale-down" and value == 0:
                        defined = False
                        return
                    factor = value if tree[0] == "scale-up" else 1 / value
                    scaled[term] = scaled.get(term, Fraction(1)) * factor
            elif tree[0] == "not":
                deleted.add((tree[1][0], *(bound.get(word, word) for word in tree[1][1:])))
            else:
                added.add((tree[0], *(bound.get(word, word) for word in tree[1:])))

        for each in effects:
            collect(each, bound)
        if not defined:
            return None
        if len({*assigned, *summed, *scaled}) < len(assigned) + len(summed) + len(scaled):
            raise UnsupportedError("two kinds of changes of one function")
        values = dict(state.values)
        values.update(assigned)
        for term, value in summed.items():
            values[term] += value
        for term, value in scaled.items():
            values[term] *= value
        return self._state(state.atoms - deleted | added, values)

    def cost(self, before: State, after: State, duration: Fraction, schema: Schema) -> Fraction:
        """Return the cost of an action by the metric, or by durations where there is none."""
        if self.metric is None:
            return duration if schema.duration is not None else Fraction(1)
        clock = duration if self.durative else Fraction(1)
        weigh = [State(each.atoms, {**each.values, ("total-time",): time}, None)
                 for each, time in ((before, Fraction(0)), (after, clock))]  # fmt: skip
        first, last = (self.value(self.metric, {}, each) for each in weigh)
        if first is None or last is None:
            raise UnsupportedError("a metric without a value")
        if last < first:
            raise UnsupportedError("a metric that falls")
        return last - first

    # Search

    def successors(self, state: State) -> Iterator[tuple[str, State, Fraction]]:
        """Yield the applicable actions of a state, each with the state after it and its cost."""
        for name, schema, bound in self.ground:
            found = self.apply(schema, bound, state)
            if found is not None:
                yield name, *found

    def solved(self, state: State) -> bool:
        """Return whether the goal holds."""
        return self.holds(self.goal, {}, state)

    def search(self, most: int = 5_000, *, whole: bool = True) -> Answer:
        """Return the cost of an optimal plan, and the number of reachable states, by Dijkstra's algorithm.

        Where more states than `most` are met, `states` is None, and so is a cost that was not found before.
        """
        best: dict[Any, Fraction] = {self.initial.key: Fraction(0)}
        queue: list[tuple[Fraction, int, State]] = [(Fraction(0), 0, self.initial)]
        count, cost, done = itertools.count(1), None, set()
        while queue:
            so_far, _, state = heapq.heappop(queue)
            if state.key in done:
                continue
            done.add(state.key)
            if cost is None and self.solved(state):
                cost = so_far
                if not whole:
                    return Answer(cost, None, True)
            for _, after, price in self.successors(state):
                total = so_far + price
                if after.key not in best or total < best[after.key]:
                    best[after.key] = total
                    heapq.heappush(queue, (total, next(count), after))
            if len(best) > most:
                return Answer(cost, None, cost is not None)
        return Answer(cost, len(done), True)

    def replay(self, plan: Sequence[str]) -> Fraction:
        """Return the cost of a plan; an error says where it is not one."""
        state, total = self.initial, Fraction(0)
        known = {name: (schema, bound) for name, schema, bound in self.ground}
        for action in plan:
            found = self.apply(*known[action], state)
            assert found is not None, f"{action} is not applicable"
            state, price = found
            total += price
        assert self.solved(state), "the goal does not hold at the end"
        return total


@dataclass(frozen=True)
class Answer:
    """What the search found.

    Attributes
    ----------
    cost : Fraction or None
        Cost of an optimal plan; None where there is none, or where it is not known.
    states : int or None
        Number of reachable states; None where there are too many.
    known : bool
        Whether the cost, or that there is no plan, is certain.
    """

    cost: Fraction | None
    states: int | None
    known: bool
