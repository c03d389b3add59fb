"""Loading an instance: it is read, validated, and grounded by Fast Downward."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from ..pddl import built_problems, bundled, instance_finder, instances
from ..pddl.reader import Reading, read
from ..pddl.validation_process import PATIENCE, ValidationProcess
from ..system.files import atomic
from ..system.limits import NO_LIMITS, Limits
from . import cross_check, fast_downward
from .task import Effect, Fact, Operator, Task, Variable

if TYPE_CHECKING:
    from unified_planning.model import Problem

T = TypeVar("T")


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
        Problem file, name of a bundled task (`kitting/paper`), or a problem that was built in Python. The task keeps
        the names of the latter.
    domain : path, optional
        Domain file; by default `instance_finder.instance` searches for it.
    limits : Limits
        Time and memory of the grounding.
    cache : path, optional
        Folder in which results are cached by the contents of the files. Files that were grounded before are neither
        validated nor grounded again.

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
            raise instances.PDDLError(problem.problem, None, f"no such problem file{bundled.near(problem.problem)}")
    if not isinstance(problem, instances.Instance):
        return _load_built(problem, limits)
    instance, stored = problem, None
    if cache is not None and instance.domain.is_file() and instance.problem.is_file():
        stored = Path(cache) / f"{fast_downward.digest(instance)}.sas"
        if (kept := _kept(stored)) is not None:
            return from_sas(kept[1], instance, kept[0])
    reading = read(instance)
    with ValidationProcess(reading, limits) as checker:
        task = ground(reading, checker, limits)
    # The files may have been changed since their digest was made.
    if stored is not None and stored.stem == fast_downward.digest(instance):
        content = f"{task.note or ''}\n{task.sas}"
        with atomic(stored) as path:
            path.write_text(f"{_digest(content)}\n{content}", encoding="utf-8")
    return task


def _kept(file: Path) -> tuple[str | None, str] | None:
    """Return the note and the SAS text of a cache file; None if there is none, or it is damaged."""
    try:
        digest, _, content = file.read_text(encoding="utf-8").partition("\n")
    except (FileNotFoundError, UnicodeDecodeError):
        return None
    note, _, sas = content.partition("\n")
    return (note or None, sas) if digest == _digest(content) else None


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def ground(reading: Reading, checker: ValidationProcess, limits: Limits = NO_LIMITS) -> Task:
    """Ground an instance while unified-planning reads it.

    If unified-planning refuses an instance that Fast Downward's translator accepts, the task's note says so. The files
    have passed this project's own checks before.
    """
    sas = fast_downward.translate(reading, limits)
    refusal = checker.refusal(PATIENCE if limits.seconds is None else limits.seconds)
    note = None
    if refusal is not None:
        if rules := reading.domain.rules:  # without the file's path, since a cached task may be that of a copy
            refusal = f"it knows no derived predicates (line {rules[0].head.place.line} of the domain)"
        note = f"read by Fast Downward's translator, not checked by unified-planning: {refusal}"
    return _agreed(from_sas(sas, reading.instance, note), reading)


def _agreed(task: Task, reading: Reading) -> Task:
    """Return the grounded task, after checking that it agrees with the project's own reading of its files."""
    primary = [at for at, variable in enumerate(task.variables) if variable.axiom_layer < 0]
    facts = [task.variables[at].facts for at in primary]
    cross_check.check(reading, task.actions, task.costs, facts, [task.initial[at] for at in primary])
    return task


def _load_built(problem: Problem, limits: Limits) -> Task:
    named = built_problems.named(problem)
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        instance, names = built_problems.write(problem, Path(folder))
        try:
            reading = read(instance)
            sas = fast_downward.translate(reading, limits)
            _agreed(from_sas(sas, instance), reading)
        except instances.PDDLError as error:  # the user does not know the temporary files
            raise instances.PDDLError(named.problem, None, error.message) from None
    return from_sas(built_problems.restore_names(sas, names), named)


def from_sas(sas: str, instance: instances.Instance, note: str | None = None) -> Task:
    """Read the SAS text of Fast Downward's translator (file format version 3)."""
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
    costs = {action: cost if has_costs else 1 for action, _, _, cost in grounded}
    actions = tuple(sorted(costs))
    index = {action: number for number, action in enumerate(actions)}
    return Task(
        instance=instance,
        variables=variables,
        actions=actions,
        costs=tuple(costs[action] for action in actions),
        operators=tuple(Operator(index[a], preconditions, effects) for a, preconditions, effects, _ in grounded),
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
