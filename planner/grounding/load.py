"""Loading an instance: it is read, validated, and grounded by Fast Downward."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from ..pddl import built_problems, bundled, instance_finder, instances
from ..pddl.source import Source
from ..pddl.validation import Refusal
from ..pddl.validation_process import PATIENCE, ValidationProcess
from ..system.files import atomic
from ..system.limits import NO_LIMITS, Limits
from . import cross_check, fast_downward
from .task import Effect, Fact, Operator, Task, Variable

if TYPE_CHECKING:
    from unified_planning.model import Problem


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
    source = Source.of(instance)
    with ValidationProcess(source, limits) as checker:
        task = ground(source, checker, limits)
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


def ground(source: Source, checker: ValidationProcess, limits: Limits = NO_LIMITS) -> Task:
    """Ground an instance while unified-planning reads it.

    If unified-planning refuses an instance that Fast Downward's translator accepts, the task's note says so. The files
    have passed this project's own checks before.

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
    """Return the grounded task, after checking that it agrees with the project's own reading of its files."""
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
        except instances.PDDLError as error:  # the user does not know the temporary files
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
