"""Grounding of a compiled instance by Fast Downward's translator, compared with this project's own reading.

The translator's SAS text (file format version 3) is read. Each ground action must instantiate an action of the domain,
with objects of the right types, and have the cost that the files state. Each fact must instantiate a predicate with the
right number of arguments. The facts that hold initially must be the stated ones. The two readings are independent
programs. A difference is an error, reported with its place.

A compiled instance then gets the names and numbers of its file. Parameters that the compilation added are left out of
the actions. An action whose cost depends on the state then occurs several times in `Task.actions`, once for each cost.
No two of these are applicable in the same state, since the state determines the cost.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from ..pddl.compilation import Compilation
from ..pddl.declarations import Typed, refuse
from ..pddl.expressions import Number
from ..pddl.instances import Expression, Instance
from ..pddl.reader import Action, Reading
from ..system.limits import NO_LIMITS, Limits
from . import fast_downward
from .task import Effect, Fact, Operator, Task, Variable

T = TypeVar("T")

TRANSLATOR = "Fast Downward's translator"


def ground(compilation: Compilation, limits: Limits = NO_LIMITS) -> Task:
    """Ground a compiled instance, and compare the result with what was read."""
    reading = compilation.reading
    sas = fast_downward.translate(reading, limits)
    task = from_sas(sas, reading.instance, "; ".join((*reading.notes, *compilation.notes)) or None)
    check(reading, task)
    if compilation.numbers:
        task = with_plain_assignments(task)
    task = in_the_files_terms(task, compilation)
    left_out = _left_out(compilation)
    if not left_out:
        return task
    said = f"actions without an effect on states are left out: {', '.join(left_out)}"
    return replace(task, note="; ".join(filter(None, (task.note, said))))


def _left_out(compilation: Compilation) -> list[str]:
    """Return the file's actions without effects in the compilation, which the translator drops."""
    found: dict[str, bool] = {}
    for name, action in compilation.reading.domain.actions.items():
        own = compilation.actions.get(name, (name, 0))[0]
        found[own] = found.get(own, False) or _changes_facts(action.effect)
    return [name for name, changes in found.items() if not changes]


def _changes_facts(effect: Expression) -> bool:
    """Return whether an effect changes facts, and not costs alone."""
    if effect.head in ("and", "when", "forall"):
        own = effect.parts[1:] if effect.head == "and" else effect.parts[2:]
        return any(map(_changes_facts, own))
    return bool(effect.parts) and effect.head != "increase"


def from_sas(sas: str, instance: Instance, note: str | None = None) -> Task:
    """Return the task of a SAS text; `note` becomes the note of the task."""
    text = _Sas(sas)
    text.expect("begin_version", "3", "end_version", "begin_metric")
    has_costs = text.number() == 1
    text.expect("end_metric")
    variables = text.each("variable", text.variable)
    mutexes = text.each("mutex_group", text.facts)
    text.expect("begin_state")
    initial = tuple(text.number() for _ in variables)
    text.expect("end_state", "begin_goal")
    goal = text.facts()
    text.expect("end_goal")
    grounded = text.each("operator", text.operator)
    axioms = text.each("rule", text.axiom)
    priced = [(action, cost if has_costs else 1) for action, _, _, cost in grounded]
    actions = sorted(set(priced))  # one for each cost that an action may have
    index = {action: number for number, action in enumerate(actions)}
    return Task(
        instance=instance,
        variables=variables,
        actions=tuple(action for action, _ in actions),
        costs=tuple(cost for _, cost in actions),
        operators=tuple(
            Operator(index[action], preconditions, effects)
            for action, (_, preconditions, effects, _) in zip(priced, grounded, strict=True)
        ),
        axioms=axioms,
        initial=initial,
        goal=goal,
        mutexes=mutexes,
        note=note,
    )


class _Sas:
    """A SAS text that is read line by line."""

    def __init__(self, sas: str) -> None:
        self._lines = iter(sas.split("\n"))

    def expect(self, *words: str) -> None:
        for word in words:
            if (line := next(self._lines)) != word:
                raise ValueError(f"SAS text: expected '{word}', found '{line}'")

    def number(self) -> int:
        return int(next(self._lines))

    def numbers(self) -> list[int]:
        return [int(word) for word in next(self._lines).split()]

    def facts(self) -> tuple[Fact, ...]:
        pairs = (next(self._lines).split() for _ in range(self.number()))
        return tuple((int(variable), int(value)) for variable, value in pairs)

    def each(self, section: str, one: Callable[[], T]) -> tuple[T, ...]:
        """Read a number of sections, each between a line that begins it and one that ends it."""
        found = []
        for _ in range(self.number()):
            self.expect(f"begin_{section}")
            found.append(one())
            self.expect(f"end_{section}")
        return tuple(found)

    def variable(self) -> Variable:
        name, layer = next(self._lines), self.number()
        return Variable(name, tuple(next(self._lines) for _ in range(self.number())), layer)

    def operator(self) -> tuple[str, tuple[Fact, ...], tuple[Effect, ...], int]:
        """Read an action with its preconditions, effects and cost."""
        action = f"({next(self._lines).strip()})"
        preconditions, effects = list(self.facts()), []
        for _ in range(self.number()):
            words = self.numbers()
            variable, before, after = words[-3:]
            if before != -1:
                preconditions.append((variable, before))
            effects.append(Effect(tuple(zip(words[1:-3:2], words[2:-3:2], strict=True)), variable, after))
        # each effect repeats the precondition of its variable
        return action, tuple(dict.fromkeys(preconditions)), tuple(effects), self.number()

    def axiom(self) -> Effect:
        conditions = self.facts()
        variable, _, after = self.numbers()
        return Effect(conditions, variable, after)


def with_plain_assignments(task: Task) -> Task:
    """Return a task with the same transitions, in which each assignment is one effect.

    The translator has no assignment. `(assign (load) 0)` is compiled to "for each value: if it is the old one, replace
    it". Of this it makes conditional effects: as many as the variable has other values, all with the same new one.
    Together they are the effect without a condition on the old value, since one of the values is always the old one.
    Fast Downward has more heuristics for operators without conditional effects, and the sweep has fewer moves.
    """
    sizes = task.sizes
    return replace(task, operators=tuple(_plain(operator, sizes) for operator in task.operators))


def _plain(operator: Operator, sizes: list[int]) -> Operator:
    if not any(effect.conditions for effect in operator.effects):
        return operator
    of: dict[int, list[Effect]] = {}
    for effect in operator.effects:
        of.setdefault(effect.variable, []).append(effect)
    effects: list[Effect] = []
    for variable, own in of.items():
        effects += _joined(variable, own, sizes[variable])
    return replace(operator, effects=tuple(effects))


def _joined(variable: int, effects: list[Effect], size: int) -> list[Effect]:
    """Return the effects on a variable; those that differ in its old value only, and have all, are one."""
    values = {effect.value for effect in effects}
    if len(values) > 1:  # which of them counts may depend on their order
        return effects
    (value,) = values
    others: dict[tuple[Fact, ...], set[int]] = {}
    for effect in effects:
        rest = tuple(fact for fact in effect.conditions if fact[0] != variable)
        own = {fact[1] for fact in effect.conditions if fact[0] == variable}
        others.setdefault(rest, set()).update(own or range(size))
    if any(len(old | {value}) < size for old in others.values()):
        return effects
    return [Effect(rest, variable, value) for rest in others]


def in_the_files_terms(task: Task, compilation: Compilation) -> Task:
    """Return a task that was grounded from a compilation with the names, numbers and unit of cost of the file."""
    if not compilation.actions and not compilation.numbers:
        return task if task.unit == compilation.unit else replace(task, unit=compilation.unit)
    named = [_action(action, compilation) for action in task.actions]
    priced = list(zip(named, task.costs, strict=True))
    kept = sorted(set(priced))
    number = {action: place for place, action in enumerate(kept)}
    return replace(
        task,
        variables=tuple(
            replace(variable, facts=tuple(_fact(fact, compilation) for fact in variable.facts))
            for variable in task.variables
        ),
        actions=tuple(name for name, _ in kept),
        costs=tuple(cost for _, cost in kept),
        operators=tuple(replace(one, action=number[priced[one.action]]) for one in task.operators),
        unit=compilation.unit,
    )


def _action(action: str, compilation: Compilation) -> str:
    name, *arguments = action[1:-1].split()
    if name not in compilation.actions:
        return action
    own, parameters = compilation.actions[name]
    return f"({' '.join([own, *arguments[:parameters]])})"


def _fact(fact: str, compilation: Compilation) -> str:
    """Return a fact in the translator's notation; that of a function is `Atom stock(bin-1) = 3`."""
    found = re.fullmatch(r"(Negated)?Atom ([^()]+)\((.*)\)", fact)
    if found is None or found[2] not in compilation.numbers:
        return fact
    function, shown = compilation.numbers[found[2]]
    *arguments, value = found[3].split(", ")
    return f"{found[1] or ''}Atom {function}({', '.join(arguments)}) = {shown[value]}"


def check(reading: Reading, task: Task) -> None:
    """Compare a grounded task with the reading of its files; raise a `PDDLError` where they differ."""
    objects = reading.objects
    known = reading.domain.actions
    for ground, cost in zip(task.actions, task.costs, strict=True):
        name, *arguments = ground[1:-1].split()
        action = known.get(name)
        if action is None:
            refuse(reading.instance.domain, None, f"{TRANSLATOR} has an action {ground}, which is not in the files")
        _check_arguments(reading, action, ground, arguments, objects)
        if (stated := _cost(reading, action, arguments)) != cost:
            refuse(reading.instance.domain, action.place, f"{ground} costs {stated}, and {cost} for {TRANSLATOR}")
    if task.decided_by_translator:  # its only facts are those of a dummy
        return
    for variable, initial in zip(task.variables, task.initial, strict=True):
        for number, fact in enumerate(variable.facts):
            if variable.axiom_layer < 0 and fact.startswith("Atom "):
                _check_fact(reading, fact.removeprefix("Atom "), number == initial, objects)


def _check_arguments(
    reading: Reading, action: Action, ground: str, arguments: Sequence[str], objects: Mapping[str, Typed]
) -> None:
    types = reading.domain.types
    wrong = len(arguments) != len(action.parameters)
    for argument, parameter in zip(arguments, action.parameters, strict=False):
        known = objects.get(argument)
        wrong = wrong or known is None or not types.fits(known.kinds[0], parameter.kinds)
    if wrong:
        refuse(reading.instance.domain, action.place, f"{TRANSLATOR} has {ground}, with other arguments than declared")


def _cost(reading: Reading, action: Action, arguments: Sequence[str]) -> Number | None:
    if reading.problem.metric is None:
        return 1
    if action.cost is None:
        return 0
    bound = dict(zip((each.name for each in action.parameters), arguments, strict=True))
    return action.cost.of(bound, reading.problem.values)


def _check_fact(reading: Reading, fact: str, holds: bool, objects: Mapping[str, Typed]) -> None:
    name, _, inner = fact.removesuffix(")").partition("(")
    if "@" in name:  # a fact that the translator introduced
        return
    atom = (name, *(inner.split(", ") if inner else ()))
    symbol = reading.domain.predicates.get(name)
    if symbol is None or len(symbol.parameters) != len(atom) - 1 or not objects.keys() >= set(atom[1:]):
        refuse(reading.instance.problem, None, f"{TRANSLATOR} has a fact {fact}, which is not in the files")
    if holds != (atom in reading.problem.facts):
        at = reading.problem.facts.get(atom, reading.problem.init)
        other = "holds" if holds else "does not hold"
        refuse(reading.instance.problem, at, f"({' '.join(atom)}) {other} initially for {TRANSLATOR}")
