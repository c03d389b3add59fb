"""Reader for states in files: the facts that hold, in PDDL or as a JSON list."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from planner.grounding.semantics import derived
from planner.pddl.s_expressions import Expression, UnbalancedError, parse

from .subject import Atom, Subject, atom, is_number


class StateError(ValueError):
    """A file does not describe a state of the task; the message has the file and the line."""


def read_state(file: str | Path, subject: Subject) -> list[int]:
    """Return the values of the state in which exactly the facts of a file hold, besides constant facts.

    Parameters
    ----------
    file : path
        Facts as `(contains box-a hammer)` or `contains(box-a, hammer)`, numbers as `(= (stock bin-1) 3)` or
        `stock(bin-1) = 3`: a plain list, an `(:init ...)`, a complete
        problem file, or a JSON list of texts. Constant facts may be omitted.
    subject : Subject

    Raises
    ------
    StateError
        A fact is not of the task, two facts exclude each other, or a variable has no value.
    """
    file = Path(file)
    try:
        text = file.read_text(encoding="utf-8-sig").lower()
    except UnicodeDecodeError:
        raise StateError(f"{file}: not a text file in UTF-8") from None
    given: dict[Atom, int] = {}
    known = subject.constant | subject.changing
    changing = {fact[:-1] for fact in subject.changing if is_number(fact)}
    for line, fact in _facts(file, text):
        if is_number(fact) and fact[:-1] not in changing:
            continue  # values of functions that do not change do not matter
        if fact not in known:
            shown = {_shown(one): one for one in known}
            near = difflib.get_close_matches(_shown(fact), shown, n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            raise StateError(f"{file}:{line}: {_shown(fact)} is no fact of the task{meant}")
        given.setdefault(fact, line)
    values = list(subject.task.initial)
    for number, variable in enumerate(subject.task.variables):
        if variable.axiom_layer >= 0:
            continue
        atoms = [atom(fact) for fact in variable.facts]
        held = [value for value, one in enumerate(atoms) if one in given]
        if len(held) > 1:
            first, second = sorted((atoms[value] for value in held[:2]), key=lambda one: given[one or ()])
            excluded = f"{_shown(second)} cannot hold together with {_shown(first)}"
            raise StateError(f"{file}:{given[second or ()]}: {excluded} on line {given[first or ()]}")
        if not held:
            held = [value for value, one in enumerate(atoms) if one is None][:1]
        if not held:
            one_of = ", ".join(_shown(one) for one in atoms)
            raise StateError(f"{file}: too few facts; expected one of {one_of}")
        values[number] = held[0]
    return derived(subject.task, values)


def _shown(fact: Atom | None) -> str:
    return f"({' '.join(fact or ())})"


def _facts(file: Path, text: str) -> Iterator[tuple[int, Atom]]:
    """Yield the facts of a text, each with its line number."""
    if text.lstrip().startswith("["):
        yield from _listed(file, text)
        return
    try:
        whole = re.match(r"(\s|;[^\n]*(\n|$))*\(\s*define\b", text) is not None
        found = parse(text) if whole else parse(f"({text}\n)")
    except UnbalancedError as error:
        raise StateError(f"{file}:{error.line}: {str(error).replace('(define ...)', 'a fact')}") from None
    inner = found.section(":init")
    if whole and inner is None:
        raise StateError(f"{file}: there is no (:init ...)")
    yield from _atoms(file, found.parts if inner is None else inner.parts[1:])


def _atoms(file: Path, parts: tuple[Expression, ...]) -> Iterator[tuple[int, Atom]]:
    name: Expression | None = None  # the predicate of a fact in the form name(argument, ...)
    waiting = list(parts)
    while waiting:
        part = waiting.pop(0)
        if part.head == "and":
            yield from _atoms(file, part.parts[1:])
        elif part.head == "=" and name is None and len(part.parts) == 3 and part.parts[1].parts and part.parts[2].word:
            yield part.place.line, (*_words(part.parts[1].parts), f"= {part.parts[2].word}")
        elif part.head in ("=", "not") and name is None:
            continue  # negated facts do not matter
        elif name is None and part.word:
            name = part
        elif part.word or not all(one.word for one in part.parts) or (name is None and not part.parts):
            raise StateError(f"{file}:{part.place.line}: {part}; expected a fact, (predicate argument ...)")
        else:
            words = _words([*([] if name is None else [name]), *part.parts])
            if name is not None and len(waiting) > 1 and waiting[0].word == "=" and waiting[1].word:
                words = (*words, f"= {waiting[1].word}".strip(","))
                del waiting[:2]
            yield part.place.line, words
            name = None
    if name is not None:
        raise StateError(f"{file}:{name.place.line}: {name}; expected a fact, (predicate argument ...)")


def _words(parts: Sequence[Expression]) -> Atom:
    return tuple(word for word in ((part.word or "").strip(",") for part in parts) if word)


def _listed(file: Path, text: str) -> Iterator[tuple[int, Atom]]:
    """Yield the facts of a JSON list, each with its line number."""
    try:
        facts = json.loads(text)
    except ValueError as error:
        raise StateError(f"{file}:{getattr(error, 'lineno', 1)}: not JSON; expected a list of facts") from None
    at = 0
    for fact in facts:
        if not isinstance(fact, str):
            raise StateError(f'{file}: {json.dumps(fact)}; expected a fact as text, "(predicate argument ...)"')
        at = max(at, text.find(json.dumps(fact, ensure_ascii=False), at))
        line = text.count("\n", 0, at) + 1
        try:
            parts = parse(f"({fact})").parts
        except UnbalancedError:
            raise StateError(f"{file}:{line}: {fact}; expected a fact, (predicate argument ...)") from None
        yield from ((line, one) for _, one in _atoms(file, parts))
