"""Compilation of an instance into classical planning with action costs, which Fast Downward's translator grounds.

What the translator does not read is finite for one person who acts in sequence, and is compiled away
(`numeric_compiler`, `recursion`). A `Compilation` says how the compiled names and numbers are shown, so that users only
meet those of their files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from .conditions import TRUE
from .declarations import Symbol
from .formulas import listed, word
from .reader import Action, Reading, Rule

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


def with_derived_goal(reading: Reading) -> Reading:
    """Return a reading whose goal is a derived predicate, so that it changes nothing else in the grounded task."""
    domain, place = reading.domain, reading.problem.init
    head = Symbol("new-axiom@goal", (), place)  # its facts are not shown, as those of the translator
    goal = Rule(head, reading.problem.goal)
    return replace(
        reading,
        domain=replace(
            domain,
            constants=reading.objects,  # which the rule names
            predicates={**domain.predicates, head.name: head},
            entries=(*domain.entries, goal),
        ),
        problem=replace(reading.problem, objects={}, goal=listed(word(head.name))),
    )
