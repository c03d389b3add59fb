"""The PDDL files of an instance: finding them, their text, and the nested lists of words in it, with their places.

A faulty file raises a `PDDLError`, whose one-line message states the fault, the file and the line. Words are not
interpreted here.
"""

from __future__ import annotations

import codecs
import difflib
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

from ..system.errors import InputFileError
from ..system.files import no_such


class PDDLError(ValueError):
    """A PDDL file is invalid or not supported.

    Attributes
    ----------
    file : Path
        The file at fault.
    line : int or None
        Line of the fault, counted from 1, if it is known.
    message : str
        The fault, and what is expected.
    column : int or None
        Column of the fault, counted from 1, if it is known.
    """

    def __init__(self, file: Path, line: int | None, message: str, column: int | None = None) -> None:
        self.file = file
        self.line = line
        self.message = message
        self.column = column
        super().__init__(f"{file}:{line}: {message}" if line else f"{file}: {message}")

    def __reduce__(self) -> tuple[type[PDDLError], tuple[Path, int | None, str, int | None]]:
        """Keep all fields when the error crosses a process boundary."""
        return type(self), (self.file, self.line, self.message, self.column)


@dataclass(frozen=True, order=True)
class Instance:
    """The two files of a planning instance.

    Attributes
    ----------
    problem, domain : Path
    """

    problem: Path
    domain: Path

    def __post_init__(self) -> None:
        for name in ("problem", "domain"):
            object.__setattr__(self, name, Path(getattr(self, name)))

    def __str__(self) -> str:
        return str(self.problem)


MARKS = {  # the longer ones first
    "UTF-32": (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE),
    "UTF-16": (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE),
}
"""Byte order marks of encodings other than UTF-8."""

STRANGE = re.compile(r"[^\t\v\f -~]")
"""Characters that may occur in comments only."""


def text(file: Path, kind: str) -> str:
    """Return the text of a PDDL file in lower case, since PDDL ignores case and unified-planning does not.

    A file that does not exist, is empty, or is not ASCII text outside of its comments raises a `PDDLError`.
    """
    try:
        raw = file.read_bytes()
    except FileNotFoundError:
        raise PDDLError(file, None, no_such(file, f"no such {kind} file")) from None
    except OSError as error:
        raise PDDLError(file, None, f"cannot be read: {error.strerror}") from None
    for name, marks in MARKS.items():
        if raw.startswith(marks):
            raise PDDLError(file, 1, f"this is {name}; save it as UTF-8")
    try:
        content = raw.decode("utf-8-sig")
        encoding = "UTF-8"
    except UnicodeDecodeError:
        content = raw.decode("latin-1")  # old files have comments in this encoding
        encoding = "unknown encoding"
    content = content.replace("\r\n", "\n").replace("\r", "\n")
    for number, line in enumerate(content.split("\n"), start=1):
        if "\0" in line:
            raise PDDLError(file, number, "not a text file (it has NUL bytes)")
        words = line.partition(";")[0]
        if (found := STRANGE.search(words)) is not None:
            if encoding != "UTF-8":
                raise PDDLError(file, number, "not a text file in UTF-8")
            strange = found[0]
            shown = (
                f"'{strange}'" if strange.isprintable() else unicodedata.name(strange, "a control character").lower()
            )
            what = "no PDDL" if strange.isascii() else "not ASCII"
            where = f"(U+{ord(strange):04X}, column {found.start() + 1})"
            raise PDDLError(file, number, f"{shown} is {what} {where}; only comments may have such characters")
    if not re.sub(r";[^\n]*", "", content).strip():
        raise PDDLError(file, None, f"the file is empty; expected (define ({kind} ...) ...)")
    return content.lower()


SECTIONS = {
    ":requirements", ":types", ":constants", ":predicates", ":functions", ":action", ":durative-action", ":derived",
    ":domain", ":objects", ":init", ":goal", ":metric",
}  # fmt: skip


class Place(NamedTuple):
    """Position at which something begins in a file; both are counted from 1."""

    line: int
    column: int


class Expression(NamedTuple):
    """A word, or a list in parentheses, with the place where it begins.

    `word` is empty for a list, and `parts`, the elements of the list, for a word.
    """

    word: str
    parts: tuple[Expression, ...] = ()
    place: Place = Place(0, 1)

    def __str__(self) -> str:
        return self.word or f"({' '.join(map(str, self.parts))})"

    @property
    def head(self) -> str:
        """First element of a list if that is a word, else an empty text."""
        return self.parts[0].word if self.parts else ""

    @property
    def words(self) -> list[str]:
        """All words in the expression, in the order of the text."""
        return [each.word for each in self.walk() if each.word]

    def walk(self) -> Iterator[Expression]:
        """Yield the expression and all its subexpressions, in the order of the text."""
        waiting = [self]
        while waiting:
            expression = waiting.pop()
            yield expression
            waiting.extend(reversed(expression.parts))

    def section(self, head: str) -> Expression | None:
        """Return the first element that is a list beginning with the word; None if there is none."""
        return next((part for part in self.parts if part.head == head), None)


_TOKEN = re.compile(r"[()]|\?[^()\s?]*|[^()\s?]+")


def tokens(text: str) -> Iterator[tuple[str, Place]]:
    """Yield parentheses and words with their positions, without comments. A question mark begins a new word."""
    for line, content in enumerate(text.split("\n"), start=1):
        for match in _TOKEN.finditer(content.partition(";")[0]):
            yield match[0], Place(line, match.start() + 1)


def nested(file: Path, text: str) -> Expression:
    """Return the only list of a file's text.

    If parentheses do not match, or are nested too deep, the `PDDLError` has the line where this probably began, not the
    end of the file.
    """
    deepest = 200  # largest depth of nested lists. Recursive readers would otherwise exceed Python's recursion limit
    opened: list[tuple[Place, list[Expression]]] = []
    whole: Expression | None = None
    section, previous = 1, ""
    for token, place in tokens(text):
        line = place.line
        if token == "(":
            opened.append((place, []))
            if len(opened) > deepest:
                raise PDDLError(file, line, f"more than {deepest} parentheses are open here; expected fewer")
        elif token == ")":
            if not opened:
                raise PDDLError(file, line, "')' without a '(' that it closes")
            begin, parts = opened.pop()
            closed = Expression("", tuple(parts), begin)
            if opened:
                opened[-1][1].append(closed)
            elif whole is None:
                whole = closed
            else:
                raise PDDLError(file, begin.line, "nothing is expected after the end of (define ...)")
        else:
            if previous == "(" and token in SECTIONS:
                if len(opened) > 2:
                    raise PDDLError(file, opened[-2][0].line, f"'(' is not closed before ({token} on line {line}")
                section = line
            if not opened:
                raise PDDLError(file, line, f"'{token}' is not within (define ...)")
            opened[-1][1].append(Expression(token, (), place))
        previous = token
    if opened:
        raise PDDLError(file, section, "')' is missing between here and the end of the file")
    return whole or Expression("", (), Place(1, 1))


DOMAIN_FILE = "domain.pddl"
README = "README.md"


@dataclass(frozen=True)
class BundledTask:
    """A task that comes with the package; the number of its states and its cost are from the README of its folder."""

    name: str
    """Folder and file name without its ending, as commands accept it."""
    problem: Path
    about: str
    """One-sentence description: the first sentence of its file's comment, or else of its domain's."""
    states: int | None
    cost: float | None
    """Optimal cost in the file's unit; a whole number where all costs are."""


def bundled_folder() -> Path:
    """Return the folder of domains: inside the package, or next to it in a checkout."""
    package = Path(__file__).parents[1]
    return package / "domains" if (package / "domains").is_dir() else package.parent / "domains"


@cache
def bundled_problems() -> dict[str, Path]:
    """Return the problem file of each bundled task, keyed and sorted by name."""
    files = (file for file in bundled_folder().rglob("*.pddl") if file.name != DOMAIN_FILE)
    return dict(sorted((file.relative_to(bundled_folder()).with_suffix("").as_posix(), file) for file in files))


def bundled_problem(name: str | Path) -> Path | None:
    """Return the problem file of the bundled task of that name; None if there is none."""
    return bundled_problems().get(Path(name).as_posix())


def bundled_files(name: str | Path) -> list[Path]:
    """Return the problem files for a task name or a folder name; an empty list for an unknown name."""
    own = Path(name).as_posix()
    return [file for task, file in bundled_problems().items() if task == own or task.startswith(f"{own}/")]


def bundled_near(name: str | Path) -> str:
    """Return the part of a message that suggests bundled tasks with a similar name; empty if there are none."""
    wanted = "/".join(Path(name).with_suffix("").parts[-2:])
    folders = {task.rpartition("/")[0] for task in bundled_problems()}
    alike = difflib.get_close_matches(wanted, [*bundled_problems(), *folders], n=3, cutoff=0.75)
    if not alike:  # the name may lack its folder
        alike = [one for one in bundled_problems() if one.endswith(f"/{Path(wanted).stem}")]
    if wanted in folders:  # the name is a folder, where a task was expected
        alike = [one for one in bundled_problems() if one.startswith(f"{wanted}/")][:3]
    return f"; with the package come {', '.join(alike)}" if alike else ""


def not_there(path: Path, what: str) -> str:
    """Return what is said of a path that is neither a user's nor bundled, with the names that were perhaps meant."""
    found = f"{what}{bundled_near(path)}"
    found = no_such(path, what) if found == what else found
    return f"{what}; `kitassist domains` lists the tasks that come with the package" if found == what else found


def bundled_tasks() -> list[BundledTask]:
    """Return the bundled tasks, sorted by name."""
    return [
        BundledTask(name, file, _sentence(file) or _sentence(file.parent / DOMAIN_FILE), *_known(file))
        for name, file in bundled_problems().items()
    ]


def _sentence(file: Path) -> str:
    """Return the first sentence of the comment at the beginning of a file."""
    lines = takewhile(lambda line: line.startswith(";"), file.read_text(encoding="utf-8").splitlines())
    words = " ".join(" ".join(line.lstrip(";") for line in lines).split())
    sentence = re.match(r".*?\.(?=\s|$)", words)
    return sentence[0] if sentence else words


def _known(file: Path) -> tuple[int | None, float | None]:
    """Return a task's number of states and optimal cost, from the README of its folder or of a parent folder."""
    for place in file.relative_to(bundled_folder()).parents:
        readme = bundled_folder() / place / README
        head: list[str] = []
        for line in readme.read_text(encoding="utf-8").splitlines() if readme.is_file() else ():
            cells = [cell.strip(" `") for cell in line.split("|")[1:-1]]
            if cells[:1] == ["instance"]:
                head = cells
            elif cells and (bundled_folder() / place / cells[0]) == file:
                row = dict(zip(head, cells, strict=True))
                states, cost = _number(row.get("states", "")), _number(row.get("optimal cost", ""))
                return None if states is None else int(states), cost
    return None, None


def _number(cell: str) -> float | None:
    """Return the number at the beginning of a table cell; None if there is none."""
    found = re.match(r"[\d,]+(\.\d+)?", cell)
    digits = found[0].replace(",", "") if found else ""
    return (float(digits) if "." in digits else int(digits)) if digits else None


OPTION = "--domain (in Python: domain=)"


@dataclass(frozen=True)
class Head:
    """Information from the beginning of a file."""

    domain: str = ""
    """Name of the domain that the file defines, or of the problem's domain, in lower case; empty if there is none."""
    is_domain: bool = False
    line: int | None = None
    """Line of the domain's name."""


class Heads:
    """Cache of the beginnings of files, and of the domains in folders."""

    def __init__(self) -> None:
        self._heads: dict[Path, Head] = {}
        self._defined: dict[tuple[Path, str], dict[str, list[Path]]] = {}

    def __getitem__(self, file: Path) -> Head:
        """Return the `Head` of a file; an empty one if the file cannot be read."""
        if file not in self._heads:
            self._heads[file] = _head(file)
        return self._heads[file]

    def defined(self, folder: Path, suffix: str) -> dict[str, list[Path]]:
        """Return the domain files of a folder by the domain that they define."""
        if (folder, suffix) not in self._defined:
            found: dict[str, list[Path]] = {}
            for file in sorted(_files(folder)):
                if file.suffix.lower() in (".pddl", suffix) and self[file].is_domain:
                    found.setdefault(self[file].domain, []).append(file)
            self._defined[folder, suffix] = found
        return self._defined[folder, suffix]


def _files(folder: Path) -> list[Path]:
    with suppress(OSError):
        return [file for file in folder.iterdir() if file.is_file()]
    return []


def _head(file: Path) -> Head:
    """Read the beginning of a file until its domain name is found."""
    begin = 1 << 14  # bytes of a file that are read first. The rest is read only after a long comment at the beginning
    text = ""
    with suppress(OSError), file.open("rb") as stream:
        for size in (begin, -1):
            text += stream.read(size).decode("latin-1").lower()
            words = re.sub(r";[^\r\n]*", lambda comment: " " * len(comment[0]), text)
            what = re.search(r"\(\s*define\s*\(\s*(domain|problem)\b\s*([^\s()]*)", words)
            is_domain = what is not None and what[1] == "domain"
            named = what if is_domain else re.search(r"\(\s*(:domain)\b\s*([^\s()]*)", words)
            if named is not None and named.end() < len(words):
                before = text[: named.end()].replace("\r\n", "\n").replace("\r", "\n")
                return Head(named[2], is_domain, before.count("\n") + 1)
    return Head()


def _places(problem: Path, heads: Heads) -> Iterator[dict[str, list[Path]]]:
    """Yield the domains of each folder that may hold the problem's domain, the nearest folder first."""
    beside = problem.parent
    above = beside.parent if beside.name not in ("", "..") else beside / ".."
    for folder in (beside, above):
        for within in ("", "domains"):
            yield heads.defined(folder / within, problem.suffix.lower())


def _words(file: Path) -> list[str]:
    """Split a file name into words and numbers, without words that denote the kind of file."""
    name = re.sub("domain|problem|instance|task", " ", file.stem.lower())
    words = [word.lstrip("0") or "0" for word in re.findall(r"[^\W\d_]+|\d+", name)]
    return [word for word in words if word not in ("p", "prob", "pfile")]


def _nearest(problem: Path, found: list[Path]) -> list[Path]:
    """Return the files whose name agrees with the longest beginning of the problem's name; all of them if none does.

    This matches `p01-domain.pddl` with `p01.pddl`, `domain-1.pddl` with `instance-1.pddl`, and `packing_domain.pddl`
    with `packing_problem.pddl`.
    """
    own = _words(problem)
    fitting = [file for file in found if own[: len(_words(file))] == _words(file)]
    longest = max((len(_words(file)) for file in fitting), default=0)
    return [file for file in fitting if len(_words(file)) == longest] or found


def _fitting(problem: Path, heads: Heads) -> list[Path]:
    """Return the domain file of a problem; several files where the choice is ambiguous."""
    wanted, default = heads[problem].domain, problem.parent / DOMAIN_FILE
    if not wanted or (heads[default].is_domain and heads[default].domain == wanted):
        return [default]
    for defined in _places(problem, heads):
        if wanted in defined:
            return _nearest(problem, defined[wanted])
    return []


def instance(problem: str | Path, domain: str | Path | None = None) -> Instance:
    """Return the instance of a problem file. Its domain file is searched for unless it is given.

    Parameters
    ----------
    problem : path
        A problem file, or else the name of a bundled task, such as `kitting/paper`.
    domain : path, optional
        Default: `domain.pddl` in the problem's folder if it defines the problem's domain. Otherwise the file that
        defines it is searched for in the problem's folder, its subfolder `domains`, the parent folder, and the
        parent's subfolder `domains`. Of several files, the one with the matching name is chosen (`p01-domain.pddl`
        for `p01.pddl`). If there is none, or the choice is ambiguous, it is `domain.pddl` in the problem's folder,
        and reading the instance reports what is missing.
    """
    problem = Path(problem)
    if not problem.exists():
        problem = bundled_problem(problem) or problem
    return _instance(problem, domain, Heads())


def _instance(problem: Path, domain: str | Path | None, heads: Heads) -> Instance:
    found = [Path(domain)] if domain is not None else _fitting(problem, heads)
    return Instance(problem, found[0] if len(found) == 1 else problem.parent / DOMAIN_FILE)


def missing(instance: Instance) -> PDDLError | None:
    """Return the error for an instance without a domain file or a problem file; None if it has both."""
    if instance.problem.is_dir():
        return PDDLError(instance.problem, None, "is a folder; expected the file of a problem")
    heads = Heads()
    problem, domain = heads[instance.problem], heads[instance.domain]
    if problem.is_domain and (domain.is_domain or not instance.domain.exists()):
        return PDDLError(
            instance.problem, problem.line, f"this file defines the domain '{problem.domain}'; expected a problem"
        )
    if not problem.domain or instance.domain != instance.problem.with_name(DOMAIN_FILE):
        return None
    found = _fitting(instance.problem, heads)
    if len(found) > 1:
        message = f"{len(found)} files define the domain '{problem.domain}': {_shown(found)}; choose one with {OPTION}"
        return PDDLError(instance.problem, problem.line, message)
    if found or instance.domain.exists():
        return None
    others = [file for defined in _places(instance.problem, heads) for files in defined.values() for file in files]
    defining = [f"{file} ('{heads[file].domain}')" for file in others]
    message = f"no file beside it or in the folder above defines the domain '{problem.domain}'; give it with {OPTION}"
    if defining:
        message += f"; other domains are there: {_shown(defining)}"
    return PDDLError(instance.problem, problem.line, message)


def _shown(files: Sequence[object]) -> str:
    shown = 5  # largest number of files that a message lists, to keep it readable
    more = [f"{len(files) - shown} more"] if len(files) > shown else []
    return ", ".join([*map(str, files[:shown]), *more])


def find_instances(
    names: str | Path | Iterable[str | Path], domain: str | Path | None = None
) -> list[Instance]:  # fmt: skip
    """Return the instances that problem files, folders, globs and names of bundled tasks stand for.

    A folder stands for every `*.pddl` file in it and its subfolders that does not define a domain, in sorted order. No
    instance is listed twice. A domain file that is listed with its problems, as a shell expands `*.pddl`, is left out.

    Parameters
    ----------
    names : path, or iterable of path
        Problem files, folders and globs. A name without such a file or folder is a bundled task, such as
        `kitting/paper`, or a folder of bundled tasks, such as `kitting`.
    domain : path, optional
        Domain file of all problems; by default, `instance` searches for that of each problem.

    Raises
    ------
    InputFileError
        A file does not exist, or a folder or a glob contains no problem.
    """
    if domain is not None and not Path(domain).is_file():
        raise InputFileError(f"{domain}: no such domain file")
    heads = Heads()
    given = None if domain is None else Path(domain).resolve()

    def is_problem(file: Path) -> bool:
        is_domain = file.name == DOMAIN_FILE or heads[file].is_domain or (given is not None and file.resolve() == given)
        return file.is_file() and not is_domain

    found: dict[Instance, None] = {}
    for name in [names] if isinstance(names, str | Path) else names:
        path = Path(name)
        if path.is_file():
            files = [path]
        elif path.is_dir():
            files = sorted(filter(is_problem, path.rglob("*.pddl")))
            if not files:
                raise InputFileError(f"{name}: no problem file (*.pddl that defines no domain) in this folder")
        else:
            files = sorted(filter(is_problem, _matching(path)))
            if not files and any(mark in str(path) for mark in "*?["):
                raise InputFileError(f"{name}: no problem file matches")
            if not files and not (files := bundled_files(path)):
                raise InputFileError(f"{name}: {not_there(path, 'no such file or folder')}")
        found.update((_instance(file, domain, heads), None) for file in files)
    domains = {one.domain.resolve() for one in found if not heads[one.problem].is_domain}
    return [one for one in found if one.problem.resolve() not in domains]


def _matching(path: Path) -> Iterator[Path]:
    """Yield the files that match a glob; nothing if the path is not a glob."""
    if any(mark in str(path) for mark in "*?["):
        start = Path(path.anchor) if path.anchor else Path()
        yield from start.glob(str(path.relative_to(path.anchor) if path.anchor else path))
