"""Compilation of an instance into classical planning with action costs, which Fast Downward's translator grounds.

What the translator does not read is finite for one person who acts in sequence, and is compiled away. A `Compilation`
says how the compiled names and numbers are shown, so that users only meet those of their files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from . import numeric_compiler
from .conditions import COMPLEMENT, TRUE
from .declarations import Symbol
from .formulas import TIMES, listed, word
from .instances import Expression
from .numeric_expressions import terms_of
from .reader import Action, DurativeAction, Reading, Rule
from .recursion import without_recursive_quantifiers
from .value_sets import Trial

MOST_VALUES = 1_000
"""Largest number of values of one number, unless stated otherwise."""

NO_SEQUENTIAL_PLAN = "no plan for one person who acts in sequence"
"""Note where files with durations have no plan here: they may need two actions at once."""


@dataclass(frozen=True)
class Compilation:
    """An instance as a classical one, and what its names and numbers mean in the file.

    Attributes
    ----------
    reading : Reading
        A classical instance; its costs are whole numbers.
    unit : Fraction
        Cost in the file's unit of one unit of whole-number cost.
    actions : mapping of str to (str, int)
        By compiled action: its name in the file, and how many of its first parameters are those of the file. Actions
        that are not listed are unchanged.
    numbers : mapping of str to (str, mapping of str to str)
        By compiled predicate of a function: the function's name, and the number that each value object stands for, as
        it is shown: "3", "2.5", "more than 3", "undefined". The value is the predicate's last argument.
    compiled : mapping of str to int
        What was compiled away: "durations" counts durative actions, "numbers" functions that change.
    notes : tuple of str
        What the user should know, such as the cost that was assumed.
    """

    reading: Reading
    unit: Fraction = Fraction(1)
    actions: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    numbers: Mapping[str, tuple[str, Mapping[str, str]]] = field(default_factory=dict)
    compiled: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def with_open_goal(self) -> Compilation:
        """Return an instance with the same states, each with and without a further fact, which is the goal.

        A free action makes it true, so that the translator grounds all actions whatever the goal of the file is.
        """
        domain, problem = self.reading.domain, self.reading.problem
        name = "open-goal"
        while name in domain.predicates or name in domain.actions:
            name += "x"
        fact, place = listed(word(name)), problem.init
        action = Action(name, (), TRUE, fact, None, place)
        predicates = {**domain.predicates, name: Symbol(name, (), place)}
        wider = replace(domain, predicates=predicates, entries=(*domain.entries, action))
        return replace(self, reading=replace(self.reading, domain=wider, problem=replace(problem, goal=fact)))


class Compiler:
    """The compilation of one instance, for which values of numbers without a proven bound may be tried.

    A fluent may have `most_values` values. What cannot be compiled raises a `PDDLError`, which says why.
    """

    def __init__(self, reading: Reading, most_values: int = MOST_VALUES) -> None:
        self.reading = reading = without_recursive_quantifiers(reading)
        self._numeric = numeric_compiler.Compiler(reading, most_values) if reading.numeric else None

    def compilation(self, trial: Trial | None = None) -> Compilation:
        """Return the compilation; a classical instance is its own.

        Where a function has no proven bound, or too many values, this raises an `UnprovenError`, unless there is a
        `trial`.
        """
        if self._numeric is None:
            return Compilation(self.reading)
        found = self._numeric.result(trial)
        notes = (*found.notes, *without_value(self.reading), *self._numeric.forgotten())
        return Compilation(found.reading, found.unit, found.actions, found.numbers, found.compiled, notes)


def condition_of(action: Action | DurativeAction) -> Expression:
    """Return all that an action requires."""
    return action.precondition if isinstance(action, Action) else action.condition


def without_value(reading: Reading) -> Iterator[str]:
    """Yield a sentence on each function that conditions of actions read, and that never has a value."""
    actions = [each for each in reading.domain.entries if not isinstance(each, Rule)]
    known = {term[0] for term in reading.problem.values}
    assigned = {
        part.parts[1].head: each.name
        for each in actions
        for part in each.effect.walk()
        if part.head == "assign" and part.parts[1].head not in _compared(condition_of(each)) - known
    }
    known |= assigned.keys()
    for name in reading.domain.functions:
        readers = [each.name for each in actions if any(part.head == name for part in condition_of(each).walk())]
        if readers and name not in known and name != "total-cost":
            of = f"condition of {readers[0]}" if len(readers) == 1 else f"conditions of {', '.join(readers)}"
            yield f"({name}) has no value at the beginning, so that no comparison with it holds, as in the {of}"


def _compared(condition: Expression) -> set[str]:
    """Return the functions without whose value a condition does not hold: those of comparisons that it surely makes."""
    if condition.head in ("and", *TIMES):
        return {name for part in condition.parts[1:] for name in _compared(part)}
    if condition.head in COMPLEMENT:
        return {term.head for side in condition.parts[1:] for term in terms_of(side)}
    return set()


def with_derived_goal(reading: Reading) -> Reading:
    """Return a reading whose goal is a derived predicate, so that it changes nothing else in the grounded task."""
    domain, place = reading.domain, reading.problem.init
    head = Symbol("new-axiom@goal", (), place)  # its facts are not shown, as those of the translator
    goal = Rule(head, reading.problem.goal)
    return replace(
        reading,
        domain=replace(
            domain,
            constants={**domain.constants, **reading.problem.objects},  # which the rule names
            predicates={**domain.predicates, head.name: head},
            entries=(*domain.entries, goal),
        ),
        problem=replace(reading.problem, objects={}, goal=listed(word(head.name))),
    )


def compiled(reading: Reading, *, most_values: int = MOST_VALUES) -> Compilation:
    """Return the compilation of an instance whose numbers have proven bounds; a classical instance is its own."""
    return Compiler(reading, most_values).compilation()
