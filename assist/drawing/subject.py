"""What there is to draw of a task: its objects and their types, which facts hold in a state, and what is wanted.

A fact is a tuple of words, the predicate first. Types and parameters come from the PDDL files; where these are gone, or
the problem was built in Python, the grounded task says what it can.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from planner import Packing, Successors, Task
from planner.grounding.semantics import derived
from planner.pddl.instances import PDDLError
from planner.pddl.s_expressions import Expression
from planner.pddl.source import Source

from ..people.action_names import Matcher, words_of
from ..people.choices import STAND_STILL

Atom = tuple[str, ...]
"""A predicate and its arguments."""

CONNECTIVES = ("and", "or", "not", "imply", "exists", "forall")


@dataclass(frozen=True)
class Wanted:
    """A part of the goal.

    Attributes
    ----------
    atom : tuple of str, or None
        None where it is more than one fact; then it holds where `variable` has `value`.
    negated : bool
    text : str
        In PDDL.
    variable, value : int
    """

    atom: Atom | None
    negated: bool
    text: str
    variable: int = -1
    value: int = -1

    def names(self, name: str) -> bool:
        """Tell whether it names an object."""
        words = self.text.replace("(", " ").replace(")", " ").split() if self.atom is None else self.atom[1:]
        return name in words


@dataclass(frozen=True)
class Subject:
    """What there is to draw of a task.

    Attributes
    ----------
    task : Task
    objects : dict of str to str
        The type of each object, in the order of the files.
    supertypes : dict of str to str
    parameters : dict of str to tuple of str
        Of each action, with their question marks.
    constant : frozenset of Atom
        What holds in all states.
    changing : frozenset of Atom
        What may hold and may not.
    numbers : dict of Atom to str
        Values of functions.
    goal : tuple of Wanted
    """

    task: Task
    objects: dict[str, str]
    supertypes: dict[str, str]
    parameters: dict[str, tuple[str, ...]]
    constant: frozenset[Atom]
    changing: frozenset[Atom]
    numbers: dict[Atom, str]
    goal: tuple[Wanted, ...]

    @classmethod
    def of(cls, task: Task) -> Subject:
        """Read what there is to draw."""
        files = [task.instance.domain, task.instance.problem]
        try:
            source = Source.of(task.instance) if all(file.is_file() for file in files) else None
        except PDDLError:  # the files have changed since
            source = None
        changing = {a for v in task.variables if "dummy(" not in "".join(v.facts) for f in v.facts if (a := atom(f))}
        parts = () if source is None else _part(source.problem, ":init")
        stated = {tuple(map(str, part.parts)) for part in parts if part.head != "="}
        constant = frozenset(stated - changing)
        equal = (part.parts[1:] for part in parts if part.head == "=")
        numbers = {tuple(map(str, what.parts)): str(value) for what, value in equal}
        if source is None:
            objects = dict.fromkeys(_named(task, changing), "object")
            return cls(task, objects, {}, {}, constant, frozenset(changing), numbers, _grounded_goal(task))
        typed = [*_typed(_part(source.domain, ":constants")), *_typed(_part(source.problem, ":objects"))]
        objects = {name: kind if kind != "object" else _kind(name, constant) for name, kind in typed}
        return cls(
            task=task,
            objects=objects,
            supertypes=dict(_typed(_part(source.domain, ":types"))),
            parameters={str(action.parts[1]): _parameters(action) for action in source.domain.lists(":action")},
            constant=constant,
            changing=frozenset(changing),
            numbers=numbers,
            goal=_goal(source.problem, task),
        )

    @property
    def initial(self) -> list[int]:
        """The values of the initial state."""
        return derived(self.task, self.task.initial)

    def facts(self, values: Sequence[int]) -> frozenset[Atom]:
        """Give all that holds in a state, the constant facts included."""
        found = (atom(variable.facts[value]) for variable, value in zip(self.task.variables, values, strict=True))
        return self.constant | {one for one in found if one and one in self.changing}

    def holds(self, wanted: Wanted, facts: frozenset[Atom], values: Sequence[int]) -> bool:
        """Tell whether a part of the goal is reached."""
        if wanted.atom is None:
            return values[wanted.variable] == wanted.value
        return (wanted.atom in facts) != wanted.negated

    def types(self, name: str) -> Iterator[str]:
        """Give an object's type and those above it, the closest first."""
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
            It is unknown, or not applicable there.
        """
        packing, successors, matcher = self._moves
        state = packing.pack([list(values)])
        _, actions, after = successors.choices(state)
        slot = matcher.slot(words_of(action), actions)
        if not len(actions):
            return STAND_STILL, list(values)
        return self.task.actions[actions[slot]], packing.unpack(after[[slot]])[0].tolist()

    def follow(self, plan: Sequence[str], values: Sequence[int] | None = None) -> list[list[int]]:
        """Return the values of the states that a plan passes through, the first one included.

        Raises
        ------
        ValueError
            An action that is unknown, or not applicable where its turn comes.
        """
        states = [list(self.initial if values is None else values)]
        for step, action in enumerate(plan):
            try:
                states.append(self.meant(action, states[-1])[1])
            except ValueError as error:
                raise ValueError(f"step {step}: {error}") from None
        return states

    @cached_property
    def _moves(self) -> tuple[Packing, Successors, Matcher]:
        packing = Packing.of(self.task)
        return packing, Successors(self.task, packing), Matcher(self.task.actions)


def atom(fact: str) -> Atom | None:
    """Read a fact of a grounded task; None where it is that something does not hold, or one of the translator's own."""
    found = re.fullmatch(r"Atom (?!new-axiom@)([^(]+)\((.*)\)", fact)
    return (found[1], *(found[2].split(", ") if found[2] else ())) if found else None


def _part(whole: Expression, head: str) -> tuple[Expression, ...]:
    section = whole.section(head)
    return () if section is None else section.parts[1:]


def _typed(parts: tuple[Expression, ...]) -> Iterator[tuple[str, str]]:
    """Give the names of a typed list, each with its type."""
    names: list[str] = []
    words = iter(parts)
    for part in words:
        if part.word != "-":
            names.append(str(part))
            continue
        kind = next(words, None)
        shown = "object" if kind is None else kind.word or next(iter(kind.words[1:]), "object")
        yield from ((name, shown) for name in names)
        names = []
    yield from ((name, "object") for name in names)


def _kind(name: str, constant: frozenset[Atom]) -> str:
    """Give the type of an object where there are no types: what is said of it for all time."""
    return min((fact[0] for fact in constant if fact[1:] == (name,)), default="object")


def _parameters(action: Expression) -> tuple[str, ...]:
    found = {str(a): b for a, b in zip(action.parts, action.parts[1:], strict=False)}.get(":parameters")
    return () if found is None else tuple(name for name, _ in _typed(found.parts))


def _named(task: Task, changing: set[Atom]) -> list[str]:
    words = {word for fact in changing for word in fact[1:]}
    return sorted(words | {word for action in task.actions for word in action.strip("()").split()[1:]})


def _goal(problem: Expression, task: Task) -> tuple[Wanted, ...]:
    """Read the goal from the file where it is a list of facts, and from the grounded task elsewhere."""
    section = _part(problem, ":goal")
    waiting, found = list(section), []
    while waiting:
        part = waiting.pop(0)
        if part.head == "and":
            waiting[:0] = part.parts[1:]
            continue
        inner = part.parts[1] if part.head == "not" and len(part.parts) > 1 else part
        if inner.head in (*CONNECTIVES, "="):
            return _grounded_goal(task, " ".join(map(str, section)))
        if inner.parts:
            found.append(Wanted(tuple(map(str, inner.parts)), part.head == "not", str(part)))
    return tuple(found)


def _grounded_goal(task: Task, whole: str = "the goal") -> tuple[Wanted, ...]:
    found = []
    for variable, value in task.goal:
        fact = task.variables[variable].facts[value]
        one = atom(fact.removeprefix("Negated"))
        if one is None:
            found.append(Wanted(None, False, whole, variable, value))
        else:
            negated = fact.startswith("Negated")
            text = f"({' '.join(one)})"
            found.append(Wanted(one, negated, f"(not {text})" if negated else text))
    return tuple(found)
