"""The parts of a task that drawings show: objects, types, the facts of a state, and the goal.

A fact is a tuple of words with the predicate first; that of a number that changes ends in its value, "= 3". Types and
parameters are read from the PDDL files. If there are no files, or they have changed, only the information of the
grounded task is available.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from planner import Task, task_of
from planner.grounding.task import derived, successors
from planner.pddl.expressions import as_shown
from planner.pddl.instances import Expression, PDDLError
from planner.pddl.reader import Domain, Rule, read

from ..people.action_names import Matcher, words_of
from ..people.choices import STAND_STILL

if TYPE_CHECKING:
    from planner import AnyTask

Atom = tuple[str, ...]
"""A predicate and its arguments."""


@dataclass(frozen=True)
class Wanted:
    """A part of the goal: one fact, or a condition of several.

    Attributes
    ----------
    atom : tuple of str, or None
        The fact; None for a condition of several facts, which holds if `variable` has `value`.
    negated : bool
        Whether the fact must not hold.
    text : str
        The part in PDDL.
    variable, value : int
    """

    atom: Atom | None
    negated: bool
    text: str
    variable: int = -1
    value: int = -1

    def names(self, name: str) -> bool:
        """Return whether it names an object."""
        words = self.text.replace("(", " ").replace(")", " ").split() if self.atom is None else self.atom[1:]
        return name in words


@dataclass(frozen=True)
class Subject:
    """The parts of a task that drawings show.

    Attributes
    ----------
    task : Task
    objects : dict of str to str
        The type of each object, in the order of the files.
    supertypes : dict of str to str
    parameters : dict of str to tuple of str
        The parameters of each action, with question marks.
    constant : frozenset of Atom
        Facts that hold in all states.
    changing : frozenset of Atom
        Facts that hold in some states only.
    numbers : dict of Atom to str
        The values of functions in the initial state, as they are shown.
    goal : tuple of Wanted
    domain : Domain or None
        The domain's names, if its file is present and unchanged.
    """

    task: Task
    objects: dict[str, str]
    supertypes: dict[str, str]
    parameters: dict[str, tuple[str, ...]]
    constant: frozenset[Atom]
    changing: frozenset[Atom]
    numbers: dict[Atom, str]
    goal: tuple[Wanted, ...]
    domain: Domain | None = None

    @classmethod
    def of(cls, task: AnyTask) -> Subject:
        """Return the subject of a task, from its PDDL files if they are present and unchanged."""
        task = task_of(task)
        files = [task.instance.domain, task.instance.problem]
        try:
            reading = read(task.instance) if all(file.is_file() for file in files) else None
        except PDDLError:  # the files have changed since the task was loaded
            reading = None
        variables = () if task.decided_by_translator else task.variables
        changing = {a for v in variables for f in v.facts if (a := atom(f))}
        if reading is None:
            objects = dict.fromkeys(_named(task, changing), "object")
            return cls(task, objects, {}, {}, frozenset(), frozenset(changing), {}, _grounded_goal(task))
        constant = frozenset(reading.problem.facts) - changing
        typed = {**reading.domain.constants, **reading.problem.objects}
        kinds = {name: each.kinds[0] for name, each in typed.items()}
        return cls(
            task=task,
            objects={name: kind if kind != "object" else _kind(name, constant) for name, kind in kinds.items()},
            supertypes={kind: above[-1] for kind, above in reading.domain.types.parents.items() if above},
            parameters={
                action.name: tuple(each.name for each in action.parameters)
                for action in reading.domain.entries
                if not isinstance(action, Rule)
            },
            constant=constant,
            changing=frozenset(changing),
            numbers={of: as_shown(value) for of, value in reading.problem.values.items()},
            goal=_goal(reading.problem.goal, task),
            domain=reading.domain,
        )

    @property
    def initial(self) -> list[int]:
        """The values of the initial state."""
        return derived(self.task, self.task.initial)

    def facts(self, values: Sequence[int]) -> frozenset[Atom]:
        """Return all facts that hold in a state, constant facts included."""
        found = (atom(variable.facts[value]) for variable, value in zip(self.task.variables, values, strict=True))
        return self.constant | {one for one in found if one and one in self.changing}

    def holds(self, wanted: Wanted, facts: frozenset[Atom], values: Sequence[int]) -> bool:
        """Return whether a part of the goal holds."""
        if wanted.atom is None:
            return values[wanted.variable] == wanted.value
        return (wanted.atom in facts) != wanted.negated

    def types(self, name: str) -> Iterator[str]:
        """Yield the type of an object and its supertypes, the most specific first."""
        kind, seen = self.objects.get(name, "object"), set[str]()
        while kind and kind not in seen:
            yield kind
            seen.add(kind)
            kind = self.supertypes.get(kind, "")

    def meant(self, action: str, values: Sequence[int]) -> tuple[str, list[int]]:
        """Return the ground action that a text stands for in a state, and the values of the state after it.

        Raises
        ------
        ValueError
            The action is unknown, or not applicable in the state.
        """
        after = successors(self.task, values)
        slot = self._matcher.slot(words_of(action), np.array(list(after), dtype=np.int64))
        if not after:
            return STAND_STILL, list(values)
        number = list(after)[slot]
        return self.task.actions[number], after[number]

    def follow(self, plan: Sequence[str], values: Sequence[int] | None = None) -> list[list[int]]:
        """Return the values of the states along a plan, the first state included.

        Raises
        ------
        ValueError
            An action is unknown, or not applicable in its state.
        """
        states = [list(self.initial if values is None else values)]
        for step, action in enumerate(plan):
            try:
                states.append(self.meant(action, states[-1])[1])
            except ValueError as error:
                raise ValueError(f"step {step}: {error}") from None
        return states

    @cached_property
    def _matcher(self) -> Matcher:
        return Matcher(self.task.actions)


def atom(fact: str) -> Atom | None:
    """Return a fact of a grounded task as an atom; None for negated facts and the translator's auxiliary atoms."""
    found = re.fullmatch(r"Atom (?!new-axiom@)([^(]+)\(([^()]*)\)(?: (= .+))?", fact)
    return (found[1], *(found[2].split(", ") if found[2] else ()), *filter(None, [found[3]])) if found else None


def is_number(fact: Atom) -> bool:
    """Return whether a fact is the value of a number that changes."""
    return fact[-1].startswith("= ")


def words_for(fact: Atom, without: str | None = None) -> str:
    """Return a fact in words, as a mark on one of its objects (`without`) leaves out this object."""
    words = list(fact[1:])
    if without is not None:
        words.remove(without)
    return " ".join([fact[0], *words])


def _kind(name: str, constant: frozenset[Atom]) -> str:
    """Return the type of an object in a domain without types: the first unary predicate that is constant for it."""
    return min((fact[0] for fact in constant if fact[1:] == (name,)), default="object")


def _named(task: Task, changing: set[Atom]) -> list[str]:
    words = {word for fact in changing for word in (fact[1:-1] if is_number(fact) else fact[1:])}
    return sorted(words | {word for action in task.actions for word in action.strip("()").split()[1:]})


def _goal(goal: Expression, task: Task) -> tuple[Wanted, ...]:
    """Return the goal as in the file if it is a conjunction of literals, and as in the grounded task otherwise."""
    waiting, found = [goal], []
    while waiting:
        part = waiting.pop(0)
        if part.head == "and":
            waiting[:0] = part.parts[1:]
            continue
        inner = part.parts[1] if part.head == "not" and len(part.parts) > 1 else part
        if inner.head in ("and", "or", "not", "imply", "exists", "forall", "=", "<", "<=", ">", ">="):
            return _grounded_goal(task, str(goal))
        if inner.parts:
            found.append(Wanted(tuple(map(str, inner.parts)), part.head == "not", str(part)))
    return tuple(found)


def _grounded_goal(task: Task, whole: str = "the goal") -> tuple[Wanted, ...]:
    """Return the goal of the grounded task; conditions that were compiled to a fact of their own are named `whole`."""
    found, held = [], {fact for variable in task.variables if variable.axiom_layer < 0 for fact in variable.facts}
    for variable, value in task.goal:
        fact = task.variables[variable].facts[value]
        one = atom(fact.removeprefix("Negated"))
        if one is None or (whole.startswith("(") and fact not in held and f"({one[0]}" not in whole):
            found.append(Wanted(None, False, whole, variable, value))
        else:
            negated = fact.startswith("Negated")
            text = f"({' '.join(one)})"
            found.append(Wanted(one, negated, f"(not {text})" if negated else text))
    return tuple(found)
