"""Random small numeric and durative tasks as PDDL text, for comparisons with the direct search.

A task has a few objects of one type, two predicates, functions that are static, bounded by guards, only growing, going
both ways with a conserved sum, without an initial value, or read by nothing, and two to four actions. Each draw chooses
which of these it has, with or without durations and a metric. With `free`, functions that nothing bounds but what can
be reached go up, down, or by the value of another one, often in turn. With `edges`, numbers begin beyond what is
compared, assignments read what they assign, conditions of effects read numbers of all objects, and a type has none.
With `costs`, actions cost differences of numbers, mostly under a condition that these are not negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Texts:
    """The two files of a task."""

    domain: str
    problem: str


@dataclass(frozen=True)
class _Function:
    """A function of the draw: its name, its number of arguments, its kind and its largest value."""

    name: str
    arity: int
    kind: str
    top: int

    def of(self, *terms: str) -> str:
        return f"({' '.join((self.name, *terms[: self.arity]))})"


KINDS = ("static", "guarded", "grows", "pair", "unset", "dead", "price")
CHANCES = (0.35, 0.2, 0.15, 0.1, 0.05, 0.15)
"""How often each kind but the first is drawn."""
FREE_KINDS, FREE_CHANCES = ("free", "guarded", "price"), (0.6, 0.25, 0.15)
"""The same of draws with functions that nothing bounds."""


class _Draw:
    def __init__(self, rng: np.random.Generator, free: bool, edges: bool, costs: bool) -> None:
        self.rng = rng
        self.costs = costs
        self.edges = edges
        self.free = free
        self.durative = bool(rng.random() < 0.5)
        self.objects = [f"o{i}" for i in range(rng.integers(1, 4))]
        self.decimals = bool(rng.random() < 0.3)
        kinds_of, chances = (FREE_KINDS, FREE_CHANCES) if free else (KINDS[1:], CHANCES)
        kinds = ["static", *(str(kind) for kind in rng.choice(kinds_of, rng.integers(1, 4), p=chances))]
        kinds += ["guarded", "price"] if costs else []
        self.functions = [
            _Function(f"f{i}", int(rng.integers(0, 2)), kind, int(rng.integers(2, 5))) for i, kind in enumerate(kinds)
        ]
        self.metric = "price" if costs else str(rng.choice(["none", "time", "price", "both"]))
        self.priced = [each for each in self.functions if each.kind == "price"]

    def often(self, chance: float) -> bool:
        return bool(self.rng.random() < chance)

    def any(self, options: list[str]) -> str:
        return options[int(self.rng.integers(len(options)))]

    def number(self, low: int, high: int) -> str:
        value = int(self.rng.integers(low, high + 1))
        return self.any([f"{value}.5", f"{value}.25", str(value)]) if self.decimals and self.often(0.3) else str(value)

    def some(self, *kinds: str) -> _Function | None:
        found = [each for each in self.functions if each.kind in kinds]
        return found[int(self.rng.integers(len(found)))] if found else None

    def static(self, term: str) -> str:
        """Return an expression that reads static functions and numbers only."""
        function = self.some("static")
        assert function is not None
        options = [function.of(term), self.number(1, 3), f"(+ {function.of(term)} {self.number(0, 2)})",
                   f"(* {function.of(term)} {self.number(1, 2)})", f"(/ {function.of(term)} 2)"]  # fmt: skip
        return self.any(options)

    def condition(self, tree: str) -> str:
        if not self.timed:
            return tree
        return f"({self.any(['at start', 'over all', 'at end'])} {tree})"

    def effect(self, tree: str) -> str:
        return f"({self.any(['at start', 'at end', 'at end'])} {tree})" if self.timed else tree

    def comparison(self, term: str) -> str:
        function = self.some("guarded", "grows", "unset", "pair", "free") or self.some("static")
        assert function is not None
        sign = self.any(["<", ">", "<=", ">=", "="])
        other = self.some("guarded", "pair") if self.often(0.25) else None
        right = self.number(0, function.top) if other is None else other.of(term)
        if self.often(0.15):
            right = f"(+ {right} 1)"
        found = f"({sign} {function.of(term)} {right})"
        return f"(not {found})" if self.often(0.2) else found

    def change(self, term: str, other: str) -> tuple[list[str], list[str]]:
        """Return the conditions and the effects of one change of a function."""
        function = self.functions[int(self.rng.integers(len(self.functions)))]
        if self.costs and self.often(0.4):
            function = self.priced[-1]
        step = self.number(1, 2)
        kind = function.kind
        if kind == "static":
            return [], []
        target = function.of(term)
        if self.edges and kind in ("guarded", "unset", "grows") and self.often(0.4):
            change = f"(assign {target} {self.any([f'(+ {target} {step})', f'(+ 1 {target})', f'(- {target} -1)'])})"
            within = self.any(["{}", "(forall (?z - thing) {})", "(forall (?z - thing) (when (p ?z) {}))"])
            return [f"(<= {target} {function.top})"], [within.format(change)]
        if kind in ("guarded", "unset"):
            way = self.any(["up", "up", "down", "assign", "copy", "when"])
            if way == "up":
                return [f"(<= (+ {target} {step}) {function.top})"], [f"(increase {target} {step})"]
            if way == "down":
                return [f"(>= {target} {step})"], [f"(decrease {target} {step})"]
            if way == "assign":
                return [], [f"(assign {target} {self.number(0, function.top)})"]
            if way == "copy" and function.arity == 1 and term != other:
                return [], [f"(assign {target} {function.of(other)})"]
            return [f"(<= (+ {target} 1) {function.top})"], [f"(when (p {term}) (increase {target} 1))"]
        if kind == "free":
            other = self.some("guarded", "free") or function
            amount = self.any([step, step, other.of(term)]) if other != function else step
            way = self.any(["up", "down", "up in turn", "down in turn", "up in turn", "down in turn", "once"])
            if way == "once":
                return [f"(q {term})"], [f"(decrease {target} {amount})", f"(not (q {term}))"]
            turn = [] if "turn" not in way else [f"(p {term})"] if "down" in way else [f"(not (p {term}))"]
            after = [] if "turn" not in way else [f"(not (p {term}))"] if "down" in way else [f"(p {term})"]
            return turn, [f"({'decrease' if 'down' in way else 'increase'} {target} {amount})", *after]
        if kind == "pair" and function.arity == 1:
            return [f"(>= {target} 1)"], [f"(decrease {target} 1)", f"(increase {function.of(other)} 1)"]
        if kind == "pair":
            return [f"(>= {target} 1)"], [f"(decrease {target} 1)"]
        if kind == "price" and self.costs:
            read, least = self.some("guarded", "pair"), self.some("guarded", "pair", "static")
            assert read is not None
            assert least is not None
            taken = self.any([least.of(term), self.number(0, 2)])
            condition = self.any([f"(>= {read.of(term)} {taken})", f"(not (< {read.of(term)} {taken}))"])
            amount = f"(- {read.of(term)} {taken})"
            return [condition] if self.often(0.8) else [], [f"(increase {target} {amount})"]
        amount = self.static(term) if kind in ("price", "dead") or self.often(0.3) else step
        return [], [f"(increase {target} {amount})"]

    def without_objects(self, fact: str) -> str:
        """Return a condition with a quantifier over no objects, which does not always decide it."""
        some = self.any(
            [f"(exists (?e - none) {fact})", "(exists (?e - none) (and))", "(not (forall (?e - none) (and)))"]
        )
        return self.any([f"(forall (?e - none) {fact})", f"(not {some})", f"(or {fact} {some})"])

    def action(self, index: int) -> str:
        self.timed = self.durative and self.often(0.85)
        terms = ["?x", "?y"][: int(self.rng.integers(1, 3))]
        first, last = terms[0], terms[-1]
        conditions, effects = [], []
        if self.often(0.35):
            conditions.append(self.any([f"(p {first})", f"(not (p {first}))", f"(q {last})", "(or (p ?x) (q ?x))"]))
        if self.often(0.3):
            conditions.append(self.comparison(first))
        if self.often(0.08):
            conditions.append(f"(forall (?z - thing) (or (p ?z) {self.comparison('?z')}))")
        if len(terms) == 2 and self.often(0.5):
            conditions.append("(not (= ?x ?y))")
        for _ in range(int(self.rng.integers(1, 3))):
            more, changes = self.change(first, last)
            touched = {word for each in changes for word in each.replace("(", " ").split() if word.startswith("f")}
            if touched & {word for each in effects for word in each.replace("(", " ").split() if word.startswith("f")}:
                continue
            conditions += more
            effects += changes
        if self.often(0.5) or not effects:
            effects.append(self.any([f"(p {first})", f"(q {last})", f"(not (p {last}))", f"(not (q {first}))"]))
        if self.often(0.2):
            effects.append(f"(when {self.comparison(first)} (q {first}))")
        if self.often(0.2):
            effects.append("(forall (?z - thing) (when (q ?z) (p ?z)))")
        if self.edges and self.often(0.5):
            effects.append(f"(forall (?z - thing) (when {self.comparison('?z')} ({self.any(['p', 'q'])} ?z)))")
        if self.edges and self.often(0.3):
            conditions.append(self.without_objects(f"(p {first})"))
        name = f"a{index}"
        parameters = f":parameters ({' '.join(terms)} - thing)"
        if self.timed:
            options = [self.number(1, 3), self.static(first), self.static(last)]
            duration = f"(= ?duration {self.any(options)})"
            if self.often(0.15):
                duration = f"(and (>= ?duration {self.number(1, 2)}) (<= ?duration {self.number(3, 5)}))"
            shown = map(self.effect, effects)
            return (f"  (:durative-action {name} {parameters}\n    :duration {duration}\n"
                    f"    :condition (and {' '.join(map(self.condition, conditions))})\n"
                    f"    :effect (and {' '.join(shown)}))")  # fmt: skip
        return (f"  (:action {name} {parameters}\n    :precondition (and {' '.join(conditions)})\n"
                f"    :effect (and {' '.join(effects)}))")  # fmt: skip

    def texts(self) -> Texts:
        actions = [self.action(index) for index in range(int(self.rng.integers(2, 5)))]
        declared = " ".join(f"({each.name}{' ?x - thing' if each.arity else ''})" for each in self.functions)
        init = [f"(p {name})" for name in self.objects if self.often(0.3)]
        init += [f"(q {name})" for name in self.objects if self.often(0.3)]
        for each in self.functions:
            for name in self.objects if each.arity else [""]:
                if each.kind == "unset" and self.often(0.7):
                    continue
                low = 1 if each.kind == "static" else 0
                top = each.top + 3 if self.edges and each.kind == "grows" else each.top - 1
                value = self.number(low, top) if each.kind != "pair" else str(self.rng.integers(0, 3))
                init.append(f"(= ({f'{each.name} {name}'.strip()}) {value})")
        goals = [f"({self.any(['p', 'q'])} {self.any(self.objects)})"] if self.often(0.7) else []
        function = self.some("guarded", "grows", "pair", "unset", "free")
        if function is not None and (self.often(0.7) or not goals):
            sign = self.any([">=", ">=", "=", ">", "<="])
            name = self.any(self.objects)
            goals.append(f"({sign} {function.of(name)} {self.number(1 if sign == '<=' else 2, function.top)})")
        if self.often(0.5):
            goals.append(f"(not (q {self.any(self.objects)}))")
        if self.edges and self.often(0.3):
            goals.append(self.without_objects(f"(p {self.any(self.objects)})"))
        if not goals:
            goals.append(f"(p {self.objects[0]})")
        metric = ""
        parts = []
        if self.metric in ("time", "both"):
            parts.append(self.any(["(total-time)", "(* 2 (total-time))", "(* 0.5 (total-time))"]))
        if self.metric in ("price", "both"):
            for each in self.priced:
                parts += [f"(* {self.number(1, 2)} {each.of(name)})" for name in (self.objects if each.arity else [""])]
        parts = [part.replace(" )", ")") for part in parts]
        if parts:
            whole = parts[0]
            for part in parts[1:]:
                whole = f"(+ {whole} {part})"
            metric = f"\n  (:metric minimize {whole})"
        types = "thing none" if self.edges else "thing"
        needed = ":durative-actions :duration-inequalities" if self.durative else ""
        domain = (f"(define (domain drawn)\n  (:requirements :adl :typing :numeric-fluents {needed})\n"
                  f"  (:types {types})\n  (:predicates (p ?x - thing) (q ?x - thing))\n  (:functions {declared})\n"
                  + "\n".join(actions) + ")\n")  # fmt: skip
        problem = (f"(define (problem drawn-1) (:domain drawn)\n  (:objects {' '.join(self.objects)} - thing)\n"
                   f"  (:init {' '.join(init)})\n  (:goal (and {' '.join(goals)})){metric})\n")  # fmt: skip
        return Texts(domain, problem)


def draw(seed: int, *, free: bool = False, edges: bool = False, costs: bool = False) -> Texts:
    """Return the task of a seed."""
    return _Draw(np.random.default_rng(seed), free, edges, costs).texts()
