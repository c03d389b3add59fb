"""Reader for states in files: the facts that hold, in PDDL or as a JSON list."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

from planner.grounding.task import derived
from planner.pddl.instances import Expression, PDDLError, nested
from planner.system.errors import InputFileError

from .subject import Atom, Subject, atom, is_number


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
    InputFileError
        A fact is not of the task, two facts exclude each other, or a variable has no value.
    """
    file = Path(file)
    try:
        text = file.read_text(encoding="utf-8-sig").lower()
    except UnicodeDecodeError:
        raise InputFileError(f"{file}: not a text file in UTF-8") from None
    given: dict[Atom, int] = {}
    known = subject.constant | subject.changing
    numbers: dict[Atom, list[str]] = {}
    for one in subject.changing:
        if is_number(one):
            numbers.setdefault(one[:-1], []).append(one[-1].removeprefix("= "))
    for line, fact in _facts(file, text):
        if is_number(fact):
            if fact[:-1] not in numbers:
                continue  # values of functions that do not change do not matter
            shown_as = _among(fact[-1].removeprefix("= "), numbers[fact[:-1]])
            if shown_as is None:
                values_are = _listed_values(numbers[fact[:-1]])
                raise InputFileError(f"{file}:{line}: {_shown(fact)} is no fact of the task; expected {values_are}")
            fact = (*fact[:-1], f"= {shown_as}")
        if fact not in known:
            shown = {_shown(one): one for one in known}
            near = difflib.get_close_matches(_shown(fact), shown, n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            raise InputFileError(f"{file}:{line}: {_shown(fact)} is no fact of the task{meant}")
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
            raise InputFileError(f"{file}:{given[second or ()]}: {excluded} on line {given[first or ()]}")
        if not held:  # a number that is not given has no value, where the task has such states
            held = [value for value, one in enumerate(atoms) if one is None or one[-1] == "= undefined"][:1]
        if not held and all(one and is_number(one) for one in atoms):
            missing = f"(= {_shown((atoms[0] or ())[:-1])} N)"
            shown_as = _listed_values([(one or ())[-1].removeprefix("= ") for one in atoms])
            raise InputFileError(f"{file}: too few facts; expected {missing}, where N is {shown_as}")
        if not held:
            one_of = ", ".join(_shown(one) for one in atoms)
            raise InputFileError(f"{file}: too few facts; expected one of {one_of}")
        values[number] = held[0]
    return derived(subject.task, values)


def _shown(fact: Atom | None) -> str:
    if fact and is_number(fact):
        return f"(= {_shown(fact[:-1])} {fact[-1].removeprefix('= ')})"
    return f"({' '.join(fact or ())})"


ABOVE_AND_BELOW = (("more than", " or more"), ("less than", " or less"))
"""Words of values that stand for all above, or all below, a number."""


def _among(given: str, shown: Sequence[str]) -> str | None:
    """Return which of the values of a number a text means: 2.50 is "2.5", and 7 is "3 or more"; None for none."""
    if given in shown:
        return given
    value = _number(given)
    if value is None:
        return None
    for one in shown:
        found = re.fullmatch(r"(more than|less than|) ?(\S+?)( or more| or less|)", one)
        limit = _number(found[2]) if found else None
        if found is None or limit is None:
            continue
        above, below = (f"{found[1]}{found[3]}" in words for words in ABOVE_AND_BELOW)
        if (value == limit and not found[1]) or (above and value > limit) or (below and value < limit):
            return one
    return None


def _number(text: str) -> Fraction | None:
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError):
        return None


def _listed_values(shown: Sequence[str]) -> str:
    """Return the values of a number as a short list, in their order."""
    words = sorted(shown, key=lambda one: (_number(re.sub(r"[a-z ]", "", one)) or 0, one))
    return ", ".join(words if len(words) <= 8 else [*words[:3], "...", words[-1]])


def _facts(file: Path, text: str) -> Iterator[tuple[int, Atom]]:
    """Yield the facts of a text, each with its line number."""
    if text.lstrip().startswith("["):
        yield from _listed(file, text)
        return
    try:
        whole = re.match(r"(\s|;[^\n]*(\n|$))*\(\s*define\b", text) is not None
        found = nested(file, text if whole else f"({text}\n)")
    except PDDLError as error:
        raise InputFileError(f"{file}:{error.line}: {error.message.replace('(define ...)', 'a fact')}") from None
    inner = found.section(":init")
    if whole and inner is None:
        raise InputFileError(f"{file}: there is no (:init ...)")
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
            raise InputFileError(f"{file}:{part.place.line}: {part}; expected a fact, (predicate argument ...)")
        else:
            words = _words([*([] if name is None else [name]), *part.parts])
            if name is not None and len(waiting) > 1 and waiting[0].word == "=" and waiting[1].word:
                told = [one.word or "" for one in waiting[1:4]]
                whole = told[0] in ("more", "less") or told[1:] in (["or", "more"], ["or", "less"])
                words = (*words, f"= {' '.join(told if whole else told[:1])}".strip(","))
                del waiting[: 4 if whole else 2]
            yield part.place.line, words
            name = None
    if name is not None:
        raise InputFileError(f"{file}:{name.place.line}: {name}; expected a fact, (predicate argument ...)")


def _words(parts: Sequence[Expression]) -> Atom:
    return tuple(word for word in ((part.word or "").strip(",") for part in parts) if word)


def _listed(file: Path, text: str) -> Iterator[tuple[int, Atom]]:
    """Yield the facts of a JSON list, each with its line number."""
    try:
        facts = json.loads(text)
    except ValueError as error:
        raise InputFileError(f"{file}:{getattr(error, 'lineno', 1)}: not JSON; expected a list of facts") from None
    at = 0
    for fact in facts:
        if not isinstance(fact, str):
            raise InputFileError(f'{file}: {json.dumps(fact)}; expected a fact as text, "(predicate argument ...)"')
        at = max(at, text.find(json.dumps(fact, ensure_ascii=False), at))
        line = text.count("\n", 0, at) + 1
        try:
            parts = nested(file, f"({fact})").parts
        except PDDLError:
            raise InputFileError(f"{file}:{line}: {fact}; expected a fact, (predicate argument ...)") from None
        yield from ((line, one) for _, one in _atoms(file, parts))
