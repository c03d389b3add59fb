"""The PDDL files of instances: found, and read as text.

A fault of a file is a `PDDLError`: one line that says what is wrong, in which file and on which line.
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from . import expressions, shipped
from .expressions import Expression, UnbalancedError
from .shipped import DOMAIN_FILE


class PDDLError(ValueError):
    """A PDDL file that cannot be used.

    Attributes
    ----------
    file : Path
        The file at fault.
    line : int or None
        Its line, counted from 1, where one can be named.
    message : str
        What is wrong, and what would be right.
    """

    def __init__(self, file: Path, line: int | None, message: str) -> None:
        self.file = file
        self.line = line
        self.message = message
        super().__init__(f"{file}:{line}: {message}" if line else f"{file}: {message}")

    def __reduce__(self) -> tuple[type[PDDLError], tuple[Path, int | None, str]]:
        """Keep the three fields when the error crosses a process boundary."""
        return type(self), (self.file, self.line, self.message)


class InstanceError(ValueError):
    """A name on the command line that stands for no instance."""


@dataclass(frozen=True, order=True)
class Instance:
    """The two files of a planning instance.

    Attributes
    ----------
    problem, domain : Path
    """

    problem: Path
    domain: Path

    def __str__(self) -> str:
        return str(self.problem)


def instance(problem: str | Path, domain: str | Path | None = None) -> Instance:
    """Name an instance by its problem file; the domain is `domain.pddl` beside it unless given.

    Parameters
    ----------
    problem : path
        Or the name of a task that comes with the package, such as `kitting/paper`; a file of that name comes first.
    domain : path, optional
        `domain.pddl` beside the problem unless given.
    """
    problem = Path(problem)
    if not problem.exists():
        problem = shipped.find(problem) or problem
    return Instance(problem, Path(domain) if domain is not None else problem.parent / DOMAIN_FILE)


def find_instances(names: Iterable[str | Path], domain: str | Path | None = None) -> list[Instance]:
    """Find the instances that problem files, folders, globs and names of shipped tasks stand for.

    A folder stands for every `*.pddl` file in it and below that is no domain, in sorted order. No
    instance is listed twice.

    Parameters
    ----------
    names : iterable of path
        Problem files, folders and globs. Where there is no file or folder of a name: a task that comes with the
        package, such as `kitting/paper`, or all tasks of a folder of the package, such as `kitting`.
    domain : path, optional
        Of all of them; `domain.pddl` beside each unless given.

    Raises
    ------
    InstanceError
        A file that is not there, a folder or a glob without problems.
    """
    if domain is not None and not Path(domain).is_file():
        raise InstanceError(f"{domain}: no such domain file")
    found: dict[Instance, None] = {}
    for name in names:
        path = Path(name)
        if path.is_file():
            files = [path]
        elif path.is_dir():
            files = sorted(f for f in path.rglob("*.pddl") if not _is_domain(f, domain))
            if not files:
                raise InstanceError(f"{name}: no problem file (*.pddl other than {DOMAIN_FILE}) in this folder")
        else:
            parts = path.parts
            start = Path(path.anchor) if path.anchor else Path()
            pattern = str(Path(*parts[1:])) if path.anchor else str(path)
            files = []
            if any(mark in pattern for mark in "*?["):
                files = sorted(f for f in start.glob(pattern) if f.is_file() and not _is_domain(f, domain))
                if not files:
                    raise InstanceError(f"{name}: no problem file matches")
            elif not (files := shipped.files(path)):
                raise InstanceError(f"{name}: no such file or folder{shipped.near(path)}")
        found.update((instance(file, domain), None) for file in files)
    return list(found)


def _is_domain(file: Path, domain: str | Path | None) -> bool:
    return file.name == DOMAIN_FILE or (domain is not None and file.resolve() == Path(domain).resolve())


def text(file: Path, kind: str) -> str:
    """Give the text of a PDDL file in lower case: PDDL does not distinguish case, unified-planning does.

    Raises
    ------
    PDDLError
        There is no such file, or it is no PDDL text: letters outside ASCII may stand in comments only.
    """
    try:
        raw = file.read_bytes()
    except FileNotFoundError:
        raise PDDLError(file, None, f"no such {kind} file") from None
    except OSError as error:
        raise PDDLError(file, None, f"cannot be read: {error.strerror}") from None
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise PDDLError(file, 1, "this is UTF-16; save it as UTF-8")
    try:
        content = raw.decode("utf-8-sig")
        encoding = "UTF-8"
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # as old files have it, in comments
        encoding = "unknown encoding"
    content = content.replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(content.split("\n"), start=1):
        if "\0" in line:
            raise PDDLError(file, number, "not a text file (it has NUL bytes)")
        words = line.partition(";")[0]
        if not words.isascii():
            if encoding != "UTF-8":
                raise PDDLError(file, number, "not a text file in UTF-8")
            column, strange = next((place, letter) for place, letter in enumerate(words, 1) if not letter.isascii())
            shown = f"'{strange}'" if strange.isprintable() else unicodedata.name(strange, "a character").lower()
            where = f"(U+{ord(strange):04X}, column {column})"
            raise PDDLError(file, number, f"{shown} is not ASCII {where}; only comments may have such characters")
    if not re.sub(r";[^\n]*", "", content).strip():
        raise PDDLError(file, None, f"the file is empty; expected (define ({kind} ...) ...)")
    return content.lower()


def parse(file: Path, content: str) -> Expression:
    """Read a file's text as nested lists.

    Raises
    ------
    PDDLError
        A parenthesis is missing or too many; with its line, which a parser would see only at the end.
    """
    try:
        return expressions.parse(content)
    except UnbalancedError as error:
        raise PDDLError(file, error.line, str(error)) from None
