"""What the files of studies name: tasks, policies, populations, conditions. A fault has its place in the file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from planner import Instance, find_instances
from planner.pddl.instances import bundled_files
from planner.system.errors import InputFileError
from planner.system.errors import expected as meant
from planner.system.files import no_such, read_json

from ..declare.declared import shown
from ..declare.tables import convert, fault
from ..learning import distribution as populations
from ..people.ranges import OF_ADVICE_TAKERS, Population, advice_takers
from ..people.terms import TERMS
from ..people.user_code import parse
from ..team.policy_names import POLICIES


def among(file: Path, place: str, names: Iterable[str], known: Iterable[str]) -> tuple[str, ...]:
    """Return names without duplicates.

    Raises
    ------
    InputFileError
        One of them is unknown; so do the other functions of this file for what is at fault.
    """
    known = tuple(known)
    for name in names:
        if name not in known:
            raise fault(file, place, f"'{name}'; {meant(name, known)}")
    return tuple(dict.fromkeys(names))


def different(file: Path, table: str, names: Sequence[str]) -> None:
    """Check that the tables of a list have different names, and that there is one."""
    if not names:
        raise fault(file, table, "[]; expected one table or more")
    for number, name in enumerate(names):
        if name in names[:number]:
            message = f"there are two {table} '{name}'; expected different names"
            raise fault(file, f"{table}[{number + 1}].name", message)


def tasks(file: Path, place: str, name: str) -> list[Instance]:
    """Return the tasks of a path from the file's folder, or of a shipped name."""
    path = file.parent / name
    try:
        return find_instances(([] if path.exists() else bundled_files(name)) or [path])
    except InputFileError as error:
        raise fault(file, place, str(error)) from None


def own_policy(file: Path, place: str, name: str, *, must_exist: bool = True) -> tuple[Path, str] | None:
    """Return the file and the function of a policy FILE.py:FUNCTION; None for one of the package."""
    own = parse(name, file.parent)
    if own is None and name not in POLICIES:
        raise fault(file, place, f"'{name}'; {meant(name, POLICIES, ', or FILE.py:FUNCTION')}")
    if own is not None and must_exist and not own[0].is_file():
        raise fault(file, place, f"{own[0]}: {no_such(own[0])}")
    return own


def population(file: Path, place: str, content: dict[str, Any]) -> Population:
    """Return a population: ranges, real people's influence, or a file written by `kitassist fit`."""
    for key, others in (("file", ()), ("advice_takers", OF_ADVICE_TAKERS)):
        if key in content and (more := set(content) - {key, *others}):
            raise fault(file, place, f"{key} also sets {' and '.join(sorted(more))}; expected one of them")
    if "file" in content:
        found = _fitted(file, f"{place}.file", content["file"])
    else:
        found = convert(
            {name: one for name, one in content.items() if name != "advice_takers"}, Population, file, place
        )
    if "advice_takers" in content:
        if content["advice_takers"] is not True:
            raise fault(file, f"{place}.advice_takers", f"{shown(content['advice_takers'])}; expected true")
        return advice_takers(found.beta, found.sigma, chooses=found.chooses)
    among(file, f"{place}.weights", found.weights, TERMS)
    return found


def _fitted(file: Path, place: str, name: Any) -> Population:
    try:
        return populations.mixture(read_json(file.parent / name))
    except TypeError:
        raise fault(file, place, f"{shown(name)}; expected a text") from None
    except ValueError as error:
        raise fault(file, place, str(error)) from None
