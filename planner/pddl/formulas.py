"""Conditions, effects and costs: checked within the scope of their variables, and normalised for all PDDL readers.

Each argument must be declared. Its type must overlap with the type that the predicate declares: an object of a
supertype may belong to the subtype. The formulas are rewritten without constructs that PDDL readers treat differently:

- no two quantifiers of an action bind variables of the same name, nor of the name of a parameter;
- `(either ...)` is replaced by a type of its own;
- no quantifier is over a type without objects, once these are known (see `reader`);
- `()` is written as `(and)`, and a cost is a whole number or a function;
- `when` occurs inside `forall`, never around it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from .declarations import Names, Symbol, Typed, meant, parameters, refuse, shown
from .expressions import COMPARISONS, DURATION, OPERATIONS, Number, listed, number, word
from .instances import Expression, Place

CONDITIONS = ("and", "or", "not", "imply", "forall", "exists")
CHANGES = ("increase", "decrease", "assign", "scale-up", "scale-down")
EFFECTS = ("and", "not", "when", "forall", *CHANGES)
TIMES = {"at": ("start", "end"), "over": ("all",)}
"""Words of `(at start ...)`, `(at end ...)` and `(over all ...)`."""

LARGEST_COST = 10**12
"""Largest cost of an action. Costs-to-go are 64-bit integers, and are reported as floats, which are exact up to 2^53.
"""

Scope = Mapping[str, Typed]
"""The variables in scope: from the name in the file to the variable's own, unique name and its types."""


@dataclass(frozen=True)
class Cost:
    """The cost of an action: a number, or the value of a function, given by its name and arguments."""

    number: int | None
    function: tuple[str, ...]
    place: Place

    def of(self, bound: Mapping[str, str], values: Mapping[tuple[str, ...], Number]) -> Number | None:
        """Return the cost of a ground action; None if the function has no value for its arguments.

        `bound` maps parameters to objects; `values` maps a function's name and arguments to its value.
        """
        if self.number is not None:
            return self.number
        return values.get(tuple(bound.get(word, word) for word in self.function))


OF_OTHER_LANGUAGES = {
    **dict.fromkeys(("==", "assign"), "; expected (= (FUNCTION ARGUMENT ...) NUMBER)"),
    **dict.fromkeys(("add", "+="), "; expected (increase (FUNCTION ARGUMENT ...) NUMBER)"),
    **dict.fromkeys(("subtract", "-="), "; expected (decrease (FUNCTION ARGUMENT ...) NUMBER)"),
    **dict.fromkeys(("increase", "decrease"), "; it changes a number, and is expected in :effect only"),
}
"""What PDDL writes in place of words for numbers that are not its own, or stand elsewhere."""


def whole_number(expression: Expression) -> int | None:
    """Return the whole number of 0 or more that an expression denotes; None if it denotes none."""
    found = re.fullmatch(r"(\d+)(\.0*)?", expression.word)
    return int(found[1]) if found else None


class Formulas:
    """Reader of the formulas of one file.

    `derived` holds the place of the first rule of each derived predicate. `unions` is filled with a name for each set
    of types of an `(either ...)`. `numeric` becomes true with the first formula beyond classical planning with costs.
    `?duration` may be used where `in_time` is true.
    """

    def __init__(self, file: Path, names: Names, derived: Mapping[str, Place], unions: dict[tuple[str, ...], str]):
        self.file = file
        self.names = names
        self.derived = derived
        self.unions = unions
        self.numeric = False
        self.in_time = False
        self._bound: set[str] = set()

    def refuse(self, at: Expression, message: str) -> NoReturn:
        """Raise a `PDDLError` with the place of the fault."""
        refuse(self.file, at, message)

    def scope(self, variables: Iterable[Typed]) -> Scope:
        """Return the scope of an action's or a rule's parameters, and start a new set of unique names."""
        found = {each.name: each for each in variables}
        self._bound = set(found)
        return found

    def kind(self, kinds: tuple[str, ...]) -> str:
        """Return the type that stands for the union of the given types.

        If none of them contains all others, this is a new type, one for each distinct `(either ...)`.
        """
        types = self.names.types
        kept = types.reduced(kinds)
        if len(kept) == 1:
            return kept[0]
        if kept not in self.unions:
            name = "-or-".join(kept)
            while name in types.parents or name in self.unions.values():
                name += "x"
            self.unions[kept] = name
        return self.unions[kept]

    def variables(self, found: Iterable[Typed]) -> Expression:
        """Return a typed list of variables."""
        words = ((each.name, "-", self.kind(each.kinds)) for each in found)
        return listed(*(word(text) for entry in words for text in entry))

    def _quantified(self, part: Expression, scope: Scope) -> tuple[Expression, Scope]:
        """Read the variables of a quantifier. Return them as a typed list, with the scope inside the quantifier."""
        if part.word:
            self.refuse(part, f"'{part}' is not a list of variables; expected (?VARIABLE - TYPE ...)")
        inner, written = dict(scope), []
        for each in parameters(self.file, part.parts, self.names.types):
            name, number = each.name, 2
            while name in self._bound:
                name, number = f"{each.name}-{number}", number + 1
            self._bound.add(name)
            own = Typed(name, each.kinds, each.place)
            inner[each.name] = own
            written.append(own)
        return self.variables(written), inner

    def _expect(self, formula: Expression, number: int, syntax: str) -> None:
        if len(formula.parts) != number + 1:
            much = {1: "exactly one argument", 2: "exactly two arguments"}[number]
            self.refuse(formula, f"'{formula.head}' expects {much}; expected {syntax}")

    def _headed(self, formula: Expression, what: str, heads: Iterable[str]) -> None:
        if formula.word:
            self.refuse(formula, f"'{formula}' is not expected here: expected {what}")
        if formula.parts and not formula.head:
            near = ", ".join(heads)
            if sign := next((part.word for part in formula.parts if part.word in (*COMPARISONS, "=")), ""):
                self.refuse(formula, f"'{shown(formula)}': '{sign}' stands first; expected ({sign} NUMBER NUMBER)")
            self.refuse(formula, f"'{shown(formula)}' is no {what}: expected a predicate, or one of {near}")

    def condition(self, formula: Expression, scope: Scope) -> Expression:
        """Check a condition, and return it in normalised form."""
        self._headed(formula, "condition", CONDITIONS)
        head, parts = formula.head, formula.parts[1:]
        if not head:
            return listed(word("and"))
        if head in ("and", "or", "not", "imply"):
            if head == "not":
                self._expect(formula, 1, "(not CONDITION)")
            if head == "imply":
                self._expect(formula, 2, "(imply CONDITION CONDITION)")
            return listed(formula.parts[0], *(self.condition(part, scope) for part in parts))
        if head in ("forall", "exists"):
            self._expect(formula, 2, f"({head} (?VARIABLE - TYPE ...) CONDITION)")
            variables, inner = self._quantified(parts[0], scope)
            body = self.condition(parts[1], inner)
            return listed(formula.parts[0], variables, body) if variables.parts else body
        if head in COMPARISONS or (head == "=" and any(self._is_number(part) for part in parts)):
            self._expect(formula, 2, f"({head} NUMBER NUMBER)")
            self.numeric = True
            sides = (self.expression(part, scope) for part in parts)
            return Expression("", (formula.parts[0], *sides), formula.place)
        if head == "=":
            self._expect(formula, 2, "(= TERM TERM)")
            return listed(formula.parts[0], *(self._term(part, scope)[0] for part in parts))
        return self.atom(formula, scope, CONDITIONS)

    def _is_number(self, part: Expression) -> bool:
        if part.word == DURATION:
            return self.in_time
        return bool(part.parts) or (number(part.word) is not None and part.word not in self.names.objects)

    def expression(self, part: Expression, scope: Scope) -> Expression:
        """Check a numeric expression, and return it in normalised form."""
        if part.word == DURATION and DURATION not in scope:
            if not self.in_time:
                self.refuse(part, f"{DURATION} is known in durative actions only")
            return part
        if part.word == "#t":
            self.refuse(part, "continuous effects (#t) are not supported; write the whole change (at end ...)")
        if part.word:
            if number(part.word) is not None:
                return part
            if part.word in self.names.functions:  # PDDL 2.1 allows a function without arguments as a word
                return self._function(Expression("", (part,), part.place), scope)
            self.refuse(part, f"'{part}' is no number; expected a number or (FUNCTION ARGUMENT ...)")
        head, given = part.head, part.parts[1:]
        if head in OPERATIONS:
            fewest, most = {"-": (1, 2), "/": (2, 2)}.get(head, (1, len(given)))
            if not max(fewest, 1) <= len(given) <= most:
                self.refuse(part, f"'{shown(part)}': '{head}' expects two numbers; expected ({head} NUMBER NUMBER)")
            return Expression("", (part.parts[0], *(self.expression(each, scope) for each in given)), part.place)
        return self._function(part, scope)

    def _function(self, part: Expression, scope: Scope) -> Expression:
        """Check a function with its arguments."""
        function = self.names.functions.get(part.head)
        if function is None and part.head == "total-cost":
            function = Symbol("total-cost", (), part.place)
        if function is None and part.head in self.names.predicates:
            self.refuse(part, f"'{part.head}' is a predicate, and a number is expected here")
        if function is None and (sign := next((each.word for each in part.parts[1:] if each.word in OPERATIONS), "")):
            self.refuse(part, f"'{shown(part)}': '{sign}' stands first; expected ({sign} NUMBER NUMBER)")
        if function is None and not part.head:
            self.refuse(part, f"'{shown(part)}' is no number; expected a number or (FUNCTION ARGUMENT ...)")
        if function is None and part.head == "total-time":
            self.refuse(part, "(total-time) is known in (:metric ...) only; expected a function that actions change")
        if function is None:
            near = meant(part.head, {*self.names.functions, *OPERATIONS}) or "; expected a function, or + - * /"
            self.refuse(part, f"no such function '{part.head}' in (:functions ...){near}")
        return Expression("", (part.parts[0], *self.arguments(part, function, scope)), part.place)

    def atom(self, formula: Expression, scope: Scope, besides: Iterable[str] = ()) -> Expression:
        """Check a predicate with its arguments, and return it in normalised form."""
        symbol = self.names.predicates.get(formula.head)
        if symbol is None and formula.head == "preference":
            self.refuse(formula, "preferences are not supported; write what must hold as a plain condition")
        if symbol is None and formula.head in self.names.functions:
            self.refuse(
                formula,
                f"unknown predicate '{formula.head}': it is a function, which gives a number; "
                f"expected a comparison such as (>= {shown(formula)} 1)",
            )
        if symbol is None:
            near = meant(formula.head, {*self.names.predicates, *besides}) or OF_OTHER_LANGUAGES.get(formula.head, "")
            self.refuse(formula, f"unknown predicate '{formula.head}'{near}")
        return listed(formula.parts[0], *self.arguments(formula, symbol, scope))

    def _term(self, part: Expression, scope: Scope) -> tuple[Expression, Typed]:
        """Return an argument in normalised form, and its declaration."""
        if not part.word:
            self.refuse(part, f"'{shown(part)}' is not expected here: expected an object or a variable")
        if (known := scope.get(part.word)) is not None:
            return word(known.name), known
        if (known := self.names.objects.get(part.word)) is not None:
            return part, known
        what = "variable" if part.word.startswith("?") else "object"
        if number(part.word) is not None:
            self.refuse(part, f"'{part}' is a number, and the name of an object is expected here")
        near = meant(part.word, scope if what == "variable" else self.names.objects)
        self.refuse(part, f"unknown {what} '{part}'{near}")

    def arguments(self, formula: Expression, symbol: Symbol, scope: Scope) -> list[Expression]:
        """Check the arguments of a predicate or a function, and return them in normalised form."""
        wanted, given = len(symbol.parameters), len(formula.parts) - 1
        if wanted != given:
            self.refuse(formula, f"'{symbol.name}' takes {wanted} argument{'s' * (wanted != 1)}, not {given}")
        written = []
        for part, parameter in zip(formula.parts[1:], symbol.parameters, strict=True):
            as_written, found = self._term(part, scope)
            written.append(as_written)
            if part.word in scope:
                fits = self.names.types.overlap(found.kinds, parameter.kinds)
            else:
                fits = self.names.types.fits(found.kinds[0], parameter.kinds)
            if not fits:
                self.refuse(
                    part,
                    f"{symbol.name} has an argument of the wrong type: '{part}' is of type "
                    f"{' or '.join(found.kinds)}, and {' or '.join(parameter.kinds)} is expected",
                )
        return written

    def effect(self, formula: Expression, scope: Scope, action: str, costs: list[Cost]) -> Expression:
        """Check an effect, and return it in normalised form; its cost is appended to `costs`."""
        found = self._effect(formula, scope, action, costs, "")
        return listed(word("and"), found) if found.head in CHANGES else found

    def _effect(self, formula: Expression, scope: Scope, action: str, costs: list[Cost], within: str) -> Expression:
        self._headed(formula, "effect", EFFECTS)
        head, parts = formula.head, formula.parts[1:]
        if not head:
            return listed(word("and"))
        if head == "and":
            within_it = (self._effect(part, scope, action, costs, within) for part in parts)
            return listed(formula.parts[0], *within_it)
        if head == "forall":
            self._expect(formula, 2, "(forall (?VARIABLE - TYPE ...) EFFECT)")
            variables, inner = self._quantified(parts[0], scope)
            body = self._effect(parts[1], inner, action, costs, within or "forall")
            return listed(formula.parts[0], variables, body) if variables.parts else body
        if head == "when":
            self._expect(formula, 2, "(when CONDITION EFFECT)")
            condition = self.condition(parts[0], scope)
            return _when(condition, self._effect(parts[1], scope, action, costs, "when"))
        if head in CHANGES:
            if not self._is_cost(formula, within):
                return self._change(formula, scope, action)
            written, cost = self._cost(formula, scope, action)
            if costs:
                other = costs[0].place.line
                self.refuse(formula, f"action '{action}' has two costs, on line {other} as well; expected one")
            costs.append(cost)
            return written
        changed = formula
        if head == "not":
            self._expect(formula, 1, "(not (PREDICATE ARGUMENT ...))")
            changed = parts[0]
            self._headed(changed, "predicate", ())
        if changed.head in ("=", *CONDITIONS, *COMPARISONS):
            self.refuse(
                formula,
                f"'{shown(formula)}' is not an effect; expected (PREDICATE ARGUMENT ...) or {', '.join(EFFECTS)}",
            )
        atom = self.atom(changed, scope, EFFECTS)
        if (rule := self.derived.get(changed.head)) is not None:
            self.refuse(formula, f"action '{action}' changes '{changed.head}', which is derived (line {rule.line})")
        return listed(formula.parts[0], atom) if head == "not" else atom

    def _is_cost(self, formula: Expression, within: str) -> bool:
        """Whether a change of a number is the cost of a plain action: a whole number, a function, or a faulty word."""
        if formula.head != "increase" or within or self.in_time or len(formula.parts) != 3:
            return False
        changed, amount = formula.parts[1:]
        if str(changed) not in ("(total-cost)", "total-cost"):
            return False
        if amount.word:
            return whole_number(amount) is not None or (value := number(amount.word)) is None or value < 0
        return amount.head not in ("+", "-", "*", "/") or (amount.head == "-" and len(amount.parts) == 2)

    def _change(self, formula: Expression, scope: Scope, action: str) -> Expression:
        """Check an effect that changes a number."""
        self.numeric = True
        self._expect(formula, 2, f"({formula.head} (FUNCTION ARGUMENT ...) NUMBER)")
        changed, amount = formula.parts[1:]
        if changed.word in self.names.functions:  # PDDL 2.1 allows a function without arguments as a word
            changed = Expression("", (changed,), changed.place)
        if not changed.parts:
            near = meant(changed.word, {*self.names.functions, "total-cost"})
            self.refuse(changed, f"action '{action}' changes '{changed}', which is no (FUNCTION ARGUMENT ...){near}")
        if changed.head == "total-cost" and formula.head != "increase":
            self.refuse(formula, f"action '{action}': costs only grow; expected (increase (total-cost) NUMBER)")
        if changed.head in ("+", "-", "*", "/"):
            self.refuse(changed, f"action '{action}' changes '{shown(changed)}'; expected (FUNCTION ARGUMENT ...)")
        both = self._function(changed, scope), self.expression(amount, scope)
        return Expression("", (formula.parts[0], *both), formula.place)

    def timed_condition(self, formula: Expression, scope: Scope, action: str) -> Expression:
        """Check the condition of a durative action. Each part of it stands in `(at start ...)` or its siblings."""
        self._headed(formula, "condition", ("at start", "over all", "at end"))
        head, parts = formula.head, formula.parts[1:]
        if self._has_time(formula, action):
            return listed(*formula.parts[:2], self.condition(formula.parts[2], scope))
        if not head:
            return listed(word("and"))
        if head in ("and", "or"):
            return listed(formula.parts[0], *(self.timed_condition(part, scope, action) for part in parts))
        if head in ("forall", "exists"):
            self._expect(formula, 2, f"({head} (?VARIABLE - TYPE ...) CONDITION)")
            variables, inner = self._quantified(parts[0], scope)
            body = self.timed_condition(parts[1], inner, action)
            return listed(formula.parts[0], variables, body) if variables.parts else body
        if head == "preference":
            self.refuse(formula, "preferences are not supported; write what must hold as a plain condition")
        self.refuse(
            formula, f"durative action '{action}': '{shown(formula)}' has no time; expected (at start CONDITION), "
            "(over all CONDITION) or (at end CONDITION)",
        )  # fmt: skip

    def timed_effect(self, formula: Expression, scope: Scope, action: str) -> Expression:
        """Check the effect of a durative action. Each part of it stands in `(at start ...)` or `(at end ...)`."""
        self._headed(formula, "effect", ("at start", "at end"))
        head, parts = formula.head, formula.parts[1:]
        if self._has_time(formula, action):
            if head == "over":
                self.refuse(formula, f"durative action '{action}': effects happen (at start ...) or (at end ...)")
            return listed(*formula.parts[:2], self._effect(formula.parts[2], scope, action, [], ""))
        if not head:
            return listed(word("and"))
        if head == "and":
            return listed(formula.parts[0], *(self.timed_effect(part, scope, action) for part in parts))
        if head == "forall":
            self._expect(formula, 2, "(forall (?VARIABLE - TYPE ...) EFFECT)")
            variables, inner = self._quantified(parts[0], scope)
            body = self.timed_effect(parts[1], inner, action)
            return listed(formula.parts[0], variables, body) if variables.parts else body
        if head == "when":
            self._expect(formula, 2, "(when CONDITION EFFECT)")
            condition = self.timed_condition(parts[0], scope, action)
            return listed(formula.parts[0], condition, self.timed_effect(parts[1], scope, action))
        if any(each.word == "#t" for each in formula.walk()):
            self.refuse(formula, "continuous effects (#t) are not supported; write the whole change (at end ...)")
        self.refuse(
            formula,
            f"durative action '{action}': '{shown(formula)}' has no time; "
            "expected (at start EFFECT) or (at end EFFECT)",
        )

    def _has_time(self, formula: Expression, action: str) -> bool:
        """Whether a formula is `(at start ...)`, `(over all ...)` or `(at end ...)`."""
        if formula.head not in TIMES or len(formula.parts) < 2:
            return False
        when, inner = formula.parts[1], formula.parts[2:]
        if when.word in TIMES[formula.head] and len(inner) == 1 and not inner[0].word:
            return True
        if formula.head in self.names.predicates and not any(each.parts for each in formula.parts[1:]):
            return False
        near = meant(when.word, TIMES[formula.head])
        self.refuse(
            formula, f"durative action '{action}': '{shown(formula)}' is no time with one formula{near}; "
            "expected (at start ...), (over all ...) or (at end ...)",
        )  # fmt: skip

    def duration(self, formula: Expression, scope: Scope, action: str) -> Expression:
        """Check a constraint on the duration, and return it in normalised form, `?duration` on the left."""
        head = formula.head
        if not formula.word and not head:
            return listed(word("and"))
        if head == "and":
            return listed(formula.parts[0], *(self.duration(part, scope, action) for part in formula.parts[1:]))
        if head == "at" and self._has_time(formula, action):
            return listed(*formula.parts[:2], self.duration(formula.parts[2], scope, action))
        if head not in ("=", "<=", ">=") or len(formula.parts) != 3 or formula.parts[1].word != DURATION:
            self.refuse(
                formula, f"durative action '{action}': '{shown(formula)}' is no duration; "
                f"expected (= {DURATION} NUMBER), or <= and >= in place of =",
            )  # fmt: skip
        amount = self.expression(formula.parts[2], scope)
        if any(each.word == DURATION for each in amount.walk()):
            self.refuse(formula, f"durative action '{action}': the duration is stated by itself")
        return Expression("", (*formula.parts[:2], amount), formula.place)

    def _cost(self, formula: Expression, scope: Scope, action: str) -> tuple[Expression, Cost]:
        parts = formula.parts[1:]
        if not parts[0].parts:
            self.refuse(formula, f"action '{action}': expected (increase (total-cost) COST)")
        amount = parts[1]
        written = self._amount(amount, scope, action)
        cost = Cost(whole_number(written), tuple(written.words), formula.place)
        return Expression("", (formula.parts[0], parts[0], written), formula.place), cost

    def limited(self, at: Expression, number: int) -> None:
        """Refuse a cost above `LARGEST_COST`."""
        if number > LARGEST_COST:
            self.refuse(at, f"a cost of {shown(at)} is too large; expected at most {LARGEST_COST}")

    def _amount(self, amount: Expression, scope: Scope, action: str) -> Expression:
        """Check the cost of an action: a whole number, or a declared function with the right number of arguments."""
        if (number := whole_number(amount)) is not None:
            self.limited(amount, number)
            return word(str(number))
        if re.fullmatch(r"-[\d.]+", amount.word) or amount.head == "-":
            self.refuse(amount, f"action '{action}' costs '{amount}'; costs may not be negative")
        if not amount.head:
            self.refuse(amount, f"action '{action}' costs '{amount}'; expected a number, or (FUNCTION ARGUMENT ...)")
        function = self.names.functions.get(amount.head)
        if amount.head == "total-cost":
            self.refuse(amount, f"action '{action}' costs '{amount}', which changes; expected another function")
        if function is None:
            near = meant(amount.head, self.names.functions)
            self.refuse(
                amount, f"action '{action}' costs '{shown(amount)}': no such function in (:functions ...){near}"
            )
        return listed(amount.parts[0], *self.arguments(amount, function, scope))


def _when(condition: Expression, effect: Expression) -> Expression:
    """Return a conditional effect in which `forall` is outside of `when`."""
    if not any(part.head == "forall" for part in effect.walk()):
        return listed(word("when"), condition, effect)
    if effect.head == "and":
        return listed(effect.parts[0], *(_when(condition, part) for part in effect.parts[1:]))
    if effect.head == "forall":
        return listed(*effect.parts[:2], _when(condition, effect.parts[2]))
    both = listed(word("and"), condition, effect.parts[1])
    return _when(both, effect.parts[2])
