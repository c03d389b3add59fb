"""Grounding of a compiled instance by Fast Downward's translator, compared with this project's own reading.

Each ground action must instantiate an action of the domain, with objects of the right types, and have the cost that the
files state. Each fact must instantiate a predicate with the right number of arguments. The facts that hold initially
must be the stated ones. The two readings are independent programs. A difference is an error, reported with its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..pddl.compilation import Compilation
from ..pddl.declarations import Typed, refuse
from ..pddl.numeric_expressions import Number
from ..pddl.reader import Action, Reading
from ..system.limits import NO_LIMITS, Limits
from . import fast_downward
from .plain_assignments import with_plain_assignments
from .sas_reader import from_sas
from .shown_names import in_the_files_terms
from .task import Task

TRANSLATOR = "Fast Downward's translator"


def check(reading: Reading, task: Task) -> None:
    """Compare a grounded task with the reading of its files; raise a `PDDLError` where they differ."""
    objects = {**reading.domain.constants, **reading.problem.objects}
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


def ground(compilation: Compilation, limits: Limits = NO_LIMITS) -> Task:
    """Ground a compiled instance, and compare the result with what was read."""
    reading = compilation.reading
    sas = fast_downward.translate(reading, limits)
    task = from_sas(sas, reading.instance, "; ".join((*reading.notes, *compilation.notes)) or None)
    check(reading, task)
    if compilation.numbers:
        task = with_plain_assignments(task)
    return in_the_files_terms(task, compilation)
