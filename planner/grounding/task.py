"""The grounded finite-domain task.

`load` takes the PDDL files to a frozen `Task`: variables with finitely many values, ground actions with
their costs, operators as preconditions and (conditional) effects, axioms, the initial state and the
goal, all numbers. It is what Fast Downward's translator writes (SAS+, Bäckström and Nebel 1995; Helmert,
"Concise finite-domain representations for PDDL planning tasks", 2009), read once and never changed. The text that Fast
Downward's search reads is made from these fields, so that a task in which some are replaced is the same to everything.
"""

from __future__ import annotations

import hashlib
import math
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from ..pddl import built_problems, instance_finder, instances
from ..pddl import bundled as shipped
from ..pddl.source import Source
from ..pddl.validation import Refusal
from ..pddl.validation_process import PATIENCE, Checker
from ..system.arrays import outline
from ..system.files import atomic
from . import cross_check, fast_downward
from .fast_downward import NO_LIMITS, Limits

if TYPE_CHECKING:
    from unified_planning.model import Problem

Fact = tuple[int, int]
"""A variable and one of its values."""


@dataclass(frozen=True)
class Variable:
    """A finite-domain variable; `facts[v]` says what its value `v` means, as the translator writes it.

    That is `Atom on(a, b)`, `NegatedAtom on(a, b)`, or `<none of those>`.

    A derived variable has an axiom layer of 0 or more, a primary one -1.

    Attributes
    ----------
    name : str
    facts : tuple of str
    axiom_layer : int
    """

    name: str
    facts: tuple[str, ...]
    axiom_layer: int


@dataclass(frozen=True)
class Effect:
    """`variable := value` where all conditions hold in the state before.

    Attributes
    ----------
    conditions : tuple of Fact
    variable, value : int
    """

    conditions: tuple[Fact, ...]
    variable: int
    value: int


@dataclass(frozen=True)
class Operator:
    """One way in which a ground action can be applied (disjunctions give an action several).

    Attributes
    ----------
    action : int
        Its number in the task.
    preconditions : tuple of Fact
    effects : tuple of Effect
    """

    action: int
    preconditions: tuple[Fact, ...]
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Task:
    """A planning task, grounded.

    Attributes
    ----------
    instance : Instance
        The files that it was read from; of a problem that was built in Python, names of files that do not exist.
    variables : tuple of Variable
    actions : tuple of str
        Ground actions as `(name arg ...)`, each once, sorted.
    costs : tuple of int
        The cost of each action: its PDDL cost, or 1 where the problem has no metric.
    operators, axioms : tuple
        The head of an axiom is its only effect.
    initial : tuple of int
        Value of each variable; a derived variable has the value that it takes when no axiom applies.
    goal : tuple of Fact
    mutexes : tuple of tuple of Fact
        Groups of facts of which the operators let at most one hold, if not more hold before. Only searches use them,
        to be faster.
    note : str or None
        What a user has to know of how it was read: that unified-planning has not checked the files, and why.
    """

    instance: instances.Instance
    variables: tuple[Variable, ...]
    actions: tuple[str, ...]
    costs: tuple[int, ...]
    operators: tuple[Operator, ...]
    axioms: tuple[Effect, ...]
    initial: tuple[int, ...]
    goal: tuple[Fact, ...]
    mutexes: tuple[tuple[Fact, ...], ...] = ()
    note: str | None = None

    __repr__ = outline

    @property
    def name(self) -> str:
        """The problem file's name without its ending."""
        return Path(self.instance.problem).stem

    @property
    def decided_by_translator(self) -> bool:
        """Whether the translator settled the task by itself and dropped its states.

        It does so where the goal cannot be reached even if nothing is ever deleted, and where it consists of
        facts that always hold. What remains is a dummy task of one state; `astar` says which case it is.
        """
        return not self.operators and any("dummy(" in fact for v in self.variables for fact in v.facts)

    @cached_property
    def sas(self) -> str:
        """The task as SAS text (file format version 3), which Fast Downward's search reads and `from_sas` too."""
        return _rendered(self)

    @cached_property
    def reduced(self) -> Task:
        """The same task with costs divided by their greatest common divisor."""
        divisor = math.gcd(*self.costs)
        return self if divisor <= 1 else replace(self, costs=tuple(cost // divisor for cost in self.costs))

    @cached_property
    def action_index(self) -> dict[str, int]:
        """The number of each ground action."""
        return {action: index for index, action in enumerate(self.actions)}

    def facts(self, values: Sequence[int]) -> list[str]:
        """Describe a state by its values: the PDDL atoms that hold in it, of those that can change."""
        facts = (variable.facts[value] for variable, value in zip(self.variables, values, strict=True))
        return sorted(fact.removeprefix("Atom ") for fact in facts if fact.startswith("Atom "))

    def plan_cost(self, plan: Sequence[str]) -> int:
        """Add up the costs of a plan's actions."""
        return sum(self.costs[self.action_index[action]] for action in plan)


def pddl_fact(fact: str) -> str:
    """Return what a value of a variable means in PDDL; `<none of those>` stays as it is."""
    match = re.fullmatch(r"(Negated)?Atom ([^()]+)\((.*)\)", fact)
    if match is None:
        return fact
    atom = f"({' '.join([match[2], *(match[3].split(', ') if match[3] else [])])})"
    return f"(not {atom})" if match[1] else atom


def load(
    problem: str | Path | instances.Instance | Problem,
    domain: str | Path | None = None,
    *,
    limits: Limits = NO_LIMITS,
    cache: str | Path | None = None,
) -> Task:
    """Read, validate and ground a PDDL instance.

    Parameters
    ----------
    problem : path, Instance, or Problem of unified-planning
        The problem file, the name of a task that comes with the package (`kitting/paper`), or a problem that was built
        in Python. The latter's names stand in the task as they are.
    domain : path, optional
        The domain file; found beside the problem unless given, as `instance` does.
    limits : Limits
        Time and memory of the grounding.
    cache : path, optional
        A folder in which the result is kept, addressed by the files' contents: files that have been read and
        grounded before are neither validated nor grounded again.

    Raises
    ------
    PDDLError
        The files are not valid, with file and line.
    LimitError
        Grounding ran out of time or memory.
    """
    if isinstance(problem, str | Path):
        problem = instance_finder.instance(problem, domain)
        if not problem.problem.exists():
            raise instances.PDDLError(problem.problem, None, f"no such problem file{shipped.near(problem.problem)}")
    if not isinstance(problem, instances.Instance):
        return _load_built(problem, limits)
    instance, stored = problem, None
    if cache is not None and instance.domain.is_file() and instance.problem.is_file():
        stored = Path(cache) / f"{fast_downward.digest(instance)}.sas"
        if (kept := _kept(stored)) is not None:
            return from_sas(kept[1], instance, kept[0])
    source = Source.of(instance)
    with Checker(source, limits) as checker:
        task = ground(source, checker, limits)
    # The files may have been changed since their digest was made.
    if stored is not None and stored.stem == fast_downward.digest(instance):
        content = f"{task.note or ''}\n{task.sas}"
        with atomic(stored) as path:
            path.write_text(f"{_digest(content)}\n{content}", encoding="utf-8")
    return task


def _kept(file: Path) -> tuple[str | None, str] | None:
    """Return the note and the SAS text of a file of the cache; None if there is none, or it is not whole."""
    try:
        digest, _, content = file.read_text(encoding="utf-8").partition("\n")
    except (FileNotFoundError, UnicodeDecodeError):
        return None
    note, _, sas = content.partition("\n")
    return (note or None, sas) if digest == _digest(content) else None


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def ground(source: Source, checker: Checker, limits: Limits = NO_LIMITS) -> Task:
    """Ground an instance that unified-planning is reading meanwhile.

    Where unified-planning refuses what Fast Downward's translator reads, the task's note says so: the files have been
    checked before.

    Raises
    ------
    PDDLError
        The files are not valid, with file and line.
    LimitError
        Out of time or memory.
    """
    sas = fast_downward.translate(source, limits)
    refusal = checker.refusal(PATIENCE if limits.seconds is None else limits.seconds)
    note = None
    if refusal is not None:
        if rules := source.reading.domain.rules:
            refusal = Refusal("domain", rules[0].head.place.line, "it knows no derived predicates")
        # Without the file's path, since a cached task may be that of a copy.
        place = "" if refusal.line is None else f" (line {refusal.line} of the {refusal.file})"
        note = f"read by Fast Downward's translator, not checked by unified-planning: {refusal.message}{place}"
    return _agreed(from_sas(sas, source.instance, note), source)


def _agreed(task: Task, source: Source) -> Task:
    """Give back a grounded task that agrees with what was read."""
    primary = [at for at, variable in enumerate(task.variables) if variable.axiom_layer < 0]
    facts = [task.variables[at].facts for at in primary]
    cross_check.check(source.reading, task.actions, task.costs, facts, [task.initial[at] for at in primary])
    return task


def _load_built(problem: Problem, limits: Limits) -> Task:
    named = built_problems.named(problem)
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        instance, names = built_problems.write(problem, Path(folder))
        try:
            source = Source.of(instance)
            sas = fast_downward.translate(source, limits)
            _agreed(from_sas(sas, instance), source)
        except instances.PDDLError as error:  # the places are those of files that nobody has seen
            raise instances.PDDLError(named.problem, None, error.message) from None
    return from_sas(built_problems.restore_names(sas, names), named)


def from_sas(sas: str, instance: instances.Instance, note: str | None = None) -> Task:
    """Read the SAS text of Fast Downward's translator (file format version 3)."""
    lines = iter(sas.split("\n"))

    def expect(word: str) -> None:
        if (line := next(lines)) != word:
            raise ValueError(f"SAS text: expected '{word}', found '{line}'")

    def number() -> int:
        return int(next(lines))

    def facts() -> tuple[Fact, ...]:
        pairs = (next(lines).split() for _ in range(number()))
        return tuple((int(variable), int(value)) for variable, value in pairs)

    expect("begin_version")
    expect("3")
    expect("end_version")
    expect("begin_metric")
    has_costs = number() == 1
    expect("end_metric")

    variables = []
    for _ in range(number()):
        expect("begin_variable")
        name, layer = next(lines), number()
        variables.append(Variable(name, tuple(next(lines) for _ in range(number())), layer))
        expect("end_variable")

    mutexes = []
    for _ in range(number()):
        expect("begin_mutex_group")
        mutexes.append(facts())
        expect("end_mutex_group")

    expect("begin_state")
    initial = tuple(number() for _ in variables)
    expect("end_state")
    expect("begin_goal")
    goal = facts()
    expect("end_goal")

    grounded: list[tuple[str, int, tuple[Fact, ...], tuple[Effect, ...]]] = []
    for _ in range(number()):
        expect("begin_operator")
        action = f"({next(lines).strip()})"
        preconditions, effects = list(facts()), []
        for _ in range(number()):
            words = [int(word) for word in next(lines).split()]
            conditions = tuple(zip(words[1:-3:2], words[2:-3:2], strict=True))
            variable, before, after = words[-3:]
            if before != -1:
                preconditions.append((variable, before))
            effects.append(Effect(conditions, variable, after))
        cost = number()
        expect("end_operator")
        conditions = tuple(dict.fromkeys(preconditions))  # each effect repeats that of its variable
        grounded.append((action, cost if has_costs else 1, conditions, tuple(effects)))

    axioms = []
    for _ in range(number()):
        expect("begin_rule")
        conditions = facts()
        variable, _, after = (int(word) for word in next(lines).split())
        axioms.append(Effect(conditions, variable, after))
        expect("end_rule")

    costs = {action: cost for action, cost, _, _ in grounded}
    actions = tuple(sorted(costs))
    index = {action: number for number, action in enumerate(actions)}
    return Task(
        instance=instance,
        variables=tuple(variables),
        actions=actions,
        costs=tuple(costs[action] for action in actions),
        operators=tuple(Operator(index[a], preconditions, effects) for a, _, preconditions, effects in grounded),
        axioms=tuple(axioms),
        initial=initial,
        goal=goal,
        mutexes=tuple(mutexes),
        note=note,
    )


def _rendered(task: Task) -> str:
    """Write a task as the SAS text that `from_sas` reads."""

    def listed(facts: Sequence[Fact]) -> list[str]:
        return [str(len(facts)), *(f"{variable} {value}" for variable, value in facts)]

    has_costs = any(cost != 1 for cost in task.costs)
    lines = ["begin_version", "3", "end_version", "begin_metric", str(int(has_costs)), "end_metric"]
    lines.append(str(len(task.variables)))
    for variable in task.variables:
        lines += ["begin_variable", variable.name, str(variable.axiom_layer), str(len(variable.facts))]
        lines += [*variable.facts, "end_variable"]
    # What a group says is true only where it is true of the initial state.
    initial = set(enumerate(task.initial))
    groups = [group for group in task.mutexes if len(initial.intersection(group)) <= 1]
    lines.append(str(len(groups)))
    for group in groups:
        lines += ["begin_mutex_group", *listed(group), "end_mutex_group"]
    lines += ["begin_state", *map(str, task.initial), "end_state", "begin_goal"]
    lines += [*listed(tuple(dict.fromkeys(task.goal))), "end_goal"]
    lines.append(str(len(task.operators)))
    for operator in task.operators:
        # The value before of a variable that changes stands beside its effects, the other conditions by themselves.
        changed, before = {effect.variable for effect in operator.effects}, dict(operator.preconditions)
        lines += ["begin_operator", _name_in_sas(task.actions[operator.action])]
        lines += listed([(v, x) for v, x in operator.preconditions if v not in changed or x != before[v]])
        lines.append(str(len(operator.effects)))
        for effect in operator.effects:
            conditions = "".join(f" {variable} {value}" for variable, value in effect.conditions)
            change = f"{effect.variable} {before.get(effect.variable, -1)} {effect.value}"
            lines.append(f"{len(effect.conditions)}{conditions} {change}")
        lines += [str(task.costs[operator.action]), "end_operator"]
    lines.append(str(len(task.axioms)))
    for axiom in task.axioms:
        lines += ["begin_rule", *listed(axiom.conditions)]
        lines += [f"{axiom.variable} {task.initial[axiom.variable]} {axiom.value}", "end_rule"]
    return "\n".join([*lines, ""])


def _name_in_sas(action: str) -> str:
    """Write an action as the translator does: a space comes after the name, also where no argument does."""
    name = action[1:-1]
    return name if " " in name else f"{name} "
