"""Writes random tasks as PDDL in all forms that the grammar allows, with a fault on request.

A file is a tree of words and lists until it is printed. Faults change the tree or the printed words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from random_tasks import Action, Drawn, Formula, Kinds, Parameters

Tree = list[Any]
CONNECTIVES = ("and", "or", "not", "imply", "forall", "exists", "when")
TYPED = (":objects", ":constants", ":parameters", ":predicates", ":functions", ":derived")


@dataclass(frozen=True)
class Written:
    """The two files of a task, and the fault in one of them."""

    domain: str
    problem: str
    fault: str


class _Writer:
    def __init__(self, task: Drawn, rng: np.random.Generator) -> None:
        self.task = task
        self.rng = rng

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def one(self, items: Any) -> Any:
        items = list(items)
        return items[int(self.rng.integers(len(items)))]

    def mixed(self, items: Any) -> list[Any]:
        items = list(items)
        return [items[at] for at in self.rng.permutation(len(items))]

    # Parts of a file.

    def kind(self, kinds: Kinds) -> Any:
        if len(kinds) == 1 and not self.chance(0.05):
            return kinds[0]
        return ["either", *self.mixed(kinds)]

    def typed(self, items: list[tuple[str, Kinds]], several: bool = True) -> Tree:
        """Return a typed list; neighbours of the same type may share it, and untyped items come last."""
        found: Tree = []
        for at, (name, kinds) in enumerate(items):
            found.append(name)
            rest = {other for _, other in items[at:]}
            if rest == {("object",)} and self.chance(0.5):
                return found + [other for other, _ in items[at + 1 :]]
            if at + 1 == len(items) or items[at + 1][1] != kinds or self.chance(0.4):
                found += ["-", self.kind(kinds) if several else kinds[0]]
        return found

    def types(self) -> Tree:
        """Return the types. A root is below `object` or itself, listed last, or only mentioned as a supertype."""
        found, alone = [], []
        for name, parent in self.mixed(self.task.parents.items()):
            way = self.rng.integers(4) if parent == "object" else 0
            if way == 1:
                found += [name, "-", name]
            elif way == 2:
                alone.append(name)
            elif way == 0 or name not in self.task.parents.values():
                found += [name, "-", parent]
        if self.chance(0.25):
            alone.append("object")
        return [":types", *found, *self.mixed(alone)]

    def formula(self, formula: Formula) -> Tree:
        head, *parts = formula
        if head == "and" and not parts and self.chance(0.3):
            return []
        if head in ("forall", "exists"):
            return [head, self.typed(list(parts[0])), self.formula(parts[1])]
        if head in CONNECTIVES:
            inner = [self.formula(part) for part in parts]
            if head == "and" and len(inner) == 1 and self.chance(0.3):
                return inner[0]
            return [head, *inner]
        return [head, *parts]

    def effect(self, variables: Parameters, condition: Formula, positive: bool, atom: Formula) -> Tree:
        found: Tree = list(atom) if positive else ["not", list(atom)]
        if self.chance(0.1):
            found = ["and", found]
        always = condition == ("and",) and self.chance(0.8)
        names = {name for name, _ in variables}
        if variables and not always and not names & set(_words(condition)) and self.chance(0.5):
            return ["when", self.formula(condition), ["forall", self.typed(list(variables)), found]]
        if not always:
            found = ["when", self.formula(condition), found]
        return ["forall", self.typed(list(variables)), found] if variables else found

    def cost(self, cost: Formula | int) -> Tree:
        amount: Any = list(cost) if isinstance(cost, tuple) else f"{cost}{'.0' * self.chance(0.1)}"
        return ["increase", ["total-cost"], amount]

    def action(self, action: Action) -> Tree:
        effects = [self.effect(*each) for each in action.effects]
        if action.cost is not None:
            effects.insert(int(self.rng.integers(len(effects) + 1)), self.cost(action.cost))
        if len(effects) > 1 and self.chance(0.2):
            effects = [effects[0], ["and", *effects[1:]]]
        effect = effects[0] if len(effects) == 1 and self.chance(0.5) else ["and", *effects]
        found = [":action", action.name]
        if action.parameters or self.chance(0.7):
            found += [":parameters", self.typed(list(action.parameters))]
        if action.precondition != ("and",) or self.chance(0.7):
            found += [":precondition", self.formula(action.precondition)]
        return [*found, ":effect", effect if effects or self.chance(0.5) else []]

    def arguments(self, kinds: tuple[Kinds, ...]) -> Tree:
        return self.typed([(f"?{'abc'[at]}", each) for at, each in enumerate(kinds)])

    def domain(self) -> Tree:
        task = self.task
        predicates = [[name, *self.arguments(kinds)] for name, kinds in self.mixed(task.predicates.items())]
        if self.chance(0.1):
            predicates.append(["=", "?a", "?b"])
        functions: Tree = []
        for name, kinds in self.mixed([*task.functions.items(), ("total-cost", ())]):
            if name != "total-cost" or self.chance(0.9):
                functions += [[name, *self.arguments(kinds)], *(["-", "number"] if self.chance(0.7) else [])]
        parts: list[Tree] = [self.types(), [":predicates", *predicates], *(self.action(each) for each in task.actions)]
        if functions or self.chance(0.5):
            parts.append([":functions", *functions])
        if task.constants or self.chance(0.2):
            parts.append([":constants", *self.typed([(a, (b,)) for a, b in self.mixed(task.constants.items())], False)])
        if task.rule is not None:
            name, variables, body = task.rule
            parts.append([":derived", [name, *self.typed(list(variables))], self.formula(body)])
        if self.chance(0.8):
            parts.append([":requirements", ":adl", ":typing", *([":action-costs"] if self.chance(0.7) else [])])
        return ["define", ["domain", "made-up"], *(self.mixed(parts) if self.chance(0.5) else _ordered(parts))]

    def problem(self) -> Tree:
        task = self.task
        init: list[Any] = [list(fact) for fact in task.facts]
        init += [["=", list(of), f"{value}{'.' * self.chance(0.1)}"] for of, value in task.values.items()]
        init += [list(fact) for fact in task.facts if self.chance(0.1)]
        derived = task.rule[0] if task.rule else ""
        for name, kinds in task.predicates.items():
            atom = (name, *(self.one(task.of(each) or [""]) for each in kinds))
            if name != derived and "" not in atom and atom not in task.facts and self.chance(0.3):
                init.append(["not", list(atom)])
        if self.chance(0.6):
            init.append(["=", ["total-cost"], "0"])
        parts: list[Tree] = [[":init", *self.mixed(init)], [":goal", self.formula(task.goal) or ["and"]]]
        if task.objects or self.chance(0.3):
            parts.append([":objects", *self.typed([(a, (b,)) for a, b in self.mixed(task.objects.items())], False)])
        if task.metric:
            parts.append([":metric", "minimize", ["total-cost"]])
        parts.append([":domain", "made-up"])
        return ["define", ["problem", "one"], *(self.mixed(parts) if self.chance(0.5) else _ordered(parts))]

    # The text.

    def text(self, words: list[str]) -> str:
        """Return words as text, with random white space, comments and letter case."""
        end, found = self.one(["\n", "\n", "\r\n", "\r"]), []
        loud, glued = self.one([0.0, 0.0, 0.3, 1.0]), self.chance(0.1)
        for before, word in zip(["", *words], words, strict=False):
            near = before == "(" or word in "()" or before == ")"
            if found and not (near and self.chance(0.7)) and not (glued and word.startswith("?")):
                found.append(self.one([" ", " ", " ", "  ", "\t", end, f"{end}   "]))
                if self.chance(0.03):
                    found.append(self.one(["; (not", f";; ?x - t-a){end};", "; caf\u00e9 \u201cquoted\u201d"]) + end)
            found.append("".join(a.upper() if self.chance(loud) else a for a in word) if loud else word)
        return self.one(["", "", "\ufeff", f"; a file{end}"]) + "".join(found) + self.one(["", end])


def _ordered(parts: list[Tree]) -> list[Tree]:
    order = [
        ":domain", ":requirements", ":types", ":constants", ":predicates", ":functions", ":derived", ":action",
        ":objects", ":init", ":goal", ":metric",
    ]  # fmt: skip
    return sorted(parts, key=lambda part: order.index(part[0]))


def _words(part: Any) -> Iterator[str]:
    if isinstance(part, str):
        yield part
    else:
        for each in part:
            yield from _words(each)


def _printed(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
        return
    yield "("
    for part in tree:
        yield from _printed(part)
    yield ")"


def _lists(tree: Tree) -> Iterator[Tree]:
    yield tree
    for part in tree:
        if isinstance(part, list):
            yield from _lists(part)


def write(task: Drawn, rng: np.random.Generator, faulty: bool) -> Written:
    """Write a task, with a fault or without."""
    writer = _Writer(task, rng)
    domain, problem = writer.domain(), writer.problem()
    fault = ""
    while faulty and not fault:
        name = writer.one(FAULTS)
        if FAULTS[name](_Faults(writer, domain, problem)):
            fault = name
    words = [list(_printed(tree)) for tree in (domain, problem)]
    while faulty and fault in ("a parenthesis is missing", "a parenthesis too many"):
        at = words[int(rng.integers(2))]
        places = [number for number, word in enumerate(at) if word in "()"]
        if fault == "a parenthesis is missing":
            del at[writer.one(places)]
        else:
            at.insert(writer.one(places), writer.one("()"))
        break
    return Written(writer.text(words[0]), writer.text(words[1]), fault)


@dataclass
class _Faults:
    """Ways to spoil the files. Each returns whether it found a place for its fault."""

    writer: _Writer
    domain: Tree
    problem: Tree

    def _section(self, head: str) -> Tree:
        return next((part for part in (*self.domain, *self.problem) if part[0] == head), [])

    def _actions(self) -> list[Tree]:
        return [part for part in self.domain if part[0] == ":action"]

    def _formulas(self) -> list[Tree]:
        """Return all lists in actions, rules, the initial state and the goal."""
        found = [part for action in self._actions() for part in action[3:] if isinstance(part, list)]
        found += [self._section(":init"), self._section(":goal"), self._section(":derived")[2:]]
        return [each for part in found for each in _lists(part)]

    def _pick(self, wanted: Callable[[Tree], bool], within: list[Tree] | None = None) -> Tree | None:
        found = [
            each
            for each in (self._formulas() if within is None else within)
            if each and isinstance(each[0], str) and wanted(each)
        ]
        return self.writer.one(found) if found else None

    def _atom(self, arguments: int = 0) -> Tree | None:
        known = self.writer.task.predicates
        return self._pick(lambda each: each[0] in known and len(each) > arguments)

    def predicate(self) -> bool:
        if atom := self._atom():
            atom[0] += "q"
        return atom is not None

    def connective(self) -> bool:
        if found := self._pick(lambda each: each[0] in CONNECTIVES):
            found[0] = found[0][0] + found[0][2:] + "q"
        return found is not None

    def arity(self) -> bool:
        if atom := self._atom():
            if len(atom) > 1 and self.writer.chance(0.5):
                atom.pop()
            else:
                atom.append(self.writer.one(self.writer.task.constants or ["?x"]))
        return atom is not None

    def argument(self) -> bool:
        if atom := self._atom(1):
            atom[int(self.writer.rng.integers(1, len(atom)))] += "q"
        return atom is not None

    def wrong_type(self) -> bool:
        task = self.writer.task
        known = {**task.constants, **task.objects}
        atom = self._pick(lambda each: each[0] in task.predicates and any(word in known for word in each[1:]))
        if atom is None:
            return False
        places = [at for at, word in enumerate(atom) if at and word in known]
        at = self.writer.one(places)
        wrong = [name for name in known if name not in task.of(task.predicates[atom[0]][at - 1])]
        if wrong:
            atom[at] = self.writer.one(wrong)
        return bool(wrong)

    def _typed_lists(self) -> list[Tree]:
        within = [each for part in (*self.domain, *self.problem) if part[0] in TYPED for each in _lists(part)]
        return within + [each for action in self._actions() for each in _lists(action)]

    def hyphen(self) -> bool:
        found = self._pick(
            lambda each: "-" in each[1:-1] and isinstance(each[each.index("-") + 1], str), self._typed_lists()
        )
        if found is not None:
            at = found.index("-")
            if self.writer.chance(0.7) or not isinstance(found[at - 1], str):
                found[at : at + 2] = [f"-{found[at + 1]}"]
            else:
                found[at - 1 : at + 1] = [f"{found[at - 1]}-"]
        return found is not None

    def unknown_type(self) -> bool:
        found = self._pick(
            lambda each: "-" in each[1:-1] and isinstance(each[each.index("-") + 1], str), self._typed_lists()
        )
        if found is not None:
            found[found.index("-") + 1] += "q"
        return found is not None

    def circle(self) -> bool:
        types = list(self.writer.task.parents)
        if len(types) > 1:
            self._section(":types")[1:1] = [types[0], "-", types[1], types[1], "-", types[0]]
        return len(types) > 1

    def _increase(self) -> Tree | None:
        return self._pick(lambda each: each[0] == "increase")

    def function(self) -> bool:
        found = self._pick(lambda each: each[0] == "increase" and isinstance(each[2], list))
        if found:
            found[2][0] += "q"
        return found is not None

    def function_arity(self) -> bool:
        found = self._pick(lambda each: each[0] in self.writer.task.functions)
        if found:
            found.append("?x")
        return found is not None

    def amount(self) -> bool:
        if found := self._increase():
            found[2] = self.writer.one(["two", "1,5", "1e1", "-1", "1.5", ["+", "1", "2"], [], "f", ["-", "1"], "0x1"])
        return found is not None

    def fluent(self) -> bool:
        if found := self._increase():
            found[self.writer.one([0, 1])] = self.writer.one(["decrease", ["fuel"], "assign"])
        return found is not None

    def two_costs(self) -> bool:
        found = self._pick(lambda each: any(isinstance(part, list) and part[:1] == ["increase"] for part in each))
        if found is None or found[0] != "and":
            return False
        found.append(["increase", ["total-cost"], "1"])
        return True

    def conditional_cost(self) -> bool:
        found = self._pick(
            lambda each: each[0] == "and" and any(isinstance(p, list) and p[:1] == ["increase"] for p in each)
        )
        if found is None:
            return False
        at = next(at for at, part in enumerate(found) if isinstance(part, list) and part[:1] == ["increase"])
        found[at] = ["when", ["and"], found[at]]
        return True

    def value(self) -> bool:
        found = self._pick(
            lambda each: each[0] == "=" and isinstance(each[1], list), list(_lists(self._section(":init")))
        )
        if found:
            found[2] = self.writer.one(["many", "-1", "1.5", "1e2", ["f0"], "?x"])
        return found is not None

    def object_twice(self) -> bool:
        section = self._section(self.writer.one([":objects", ":constants"]))
        if len(section) > 1:
            section.insert(1, section[1])
        return len(section) > 1

    def action_twice(self) -> bool:
        actions = self._actions()
        actions[0][1] = actions[1][1]
        return True

    def keyword(self) -> bool:
        found = self.writer.one([*self.domain[2:], *self.problem[2:]])
        places = [at for at, word in enumerate(found) if isinstance(word, str) and word.startswith(":")]
        at = self.writer.one(places)
        if found[0] == ":requirements" and at:
            return False
        found[at] = found[at][:2] + found[at][3:]
        return True

    def section_twice(self) -> bool:
        file = self.writer.one([self.domain, self.problem])
        found = self.writer.one([part for part in file[2:] if part[0] not in (":action", ":derived")])
        file.append(list(found))
        return True

    def parameter(self) -> bool:
        action = self.writer.one(self._actions())
        if ":parameters" not in action or not (names := [w for w in action[3] if w[0] == "?"]):
            return False
        name = self.writer.one(names)
        if name not in set(_free(action[4:])):
            return False
        at = action[3].index(name)
        alone = action[3][at + 1 : at + 2] == ["-"] and (at == 0 or action[3][at - 2 : at - 1] == ["-"])
        del action[3][at : at + (3 if alone else 1)]
        return True

    def letter(self) -> bool:
        if atom := self._atom():
            atom[0] += self.writer.one(["\u200b", "\u00e9", "\u2013", "\u00a0"])
        return atom is not None

    def derived_effect(self) -> bool:
        rule = self.writer.task.rule
        effect = self.writer.one(self._actions())[-1]
        if rule is None or rule[1] or effect[:1] != ["and"]:
            return False
        effect.append([rule[0]])
        return True

    def domain_name(self) -> bool:
        self.domain[1][1] += "q"
        return True

    def no_goal(self) -> bool:
        del self._section(":goal")[1:]
        return True


def _free(part: Any) -> Iterator[str]:
    """Yield the variables that occur outside of quantifiers."""
    if isinstance(part, str):
        yield part
    elif part[:1] not in (["forall"], ["exists"]):
        for each in part:
            yield from _free(each)


FAULTS: dict[str, Callable[[_Faults], bool]] = {
    "a parenthesis is missing": lambda _: True,
    "a parenthesis too many": lambda _: True,
    "a misspelt predicate": _Faults.predicate,
    "a misspelt connective": _Faults.connective,
    "a wrong number of arguments": _Faults.arity,
    "a misspelt object or variable": _Faults.argument,
    "an object of a wrong type": _Faults.wrong_type,
    "a hyphen without a blank": _Faults.hyphen,
    "an unknown type": _Faults.unknown_type,
    "a circle of types": _Faults.circle,
    "an unknown function in a cost": _Faults.function,
    "a wrong number of a function's arguments": _Faults.function_arity,
    "a cost that is no whole number": _Faults.amount,
    "an effect on another number": _Faults.fluent,
    "two costs": _Faults.two_costs,
    "a conditional cost": _Faults.conditional_cost,
    "a value that is no whole number": _Faults.value,
    "an object twice": _Faults.object_twice,
    "an action twice": _Faults.action_twice,
    "a misspelt keyword": _Faults.keyword,
    "a section twice": _Faults.section_twice,
    "a missing parameter": _Faults.parameter,
    "a letter outside ASCII": _Faults.letter,
    "an effect on a derived predicate": _Faults.derived_effect,
    "another domain's name": _Faults.domain_name,
    "no goal": _Faults.no_goal,
}
