"""The files that belong together: the problems that a name stands for, and the domain of each problem.

A domain file is known by what it defines, `(define (domain NAME) ...)`, whatever it is called. A problem names its
domain in `(:domain NAME)`. Files are read as far as that stands in them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from . import bundled
from . import bundled as shipped
from .bundled import DOMAIN_FILE
from .instances import Instance, PDDLError

BEGIN = 1 << 14
"""Bytes of a file that are read first; more only where a long comment comes before everything else."""

FOLDERS = ("", "domains")
"""Where domains are sought in a problem's folder, and then in the folder above it."""

SHOWN = 5
"""Files that a message lists."""

OPTION = "--domain (in Python: domain=)"


class InstanceError(ValueError):
    """A name on the command line that stands for no instance."""


@dataclass(frozen=True)
class Head:
    """What the beginning of a file says of it.

    Attributes
    ----------
    domain : str
        The domain that it defines, or that it is a problem of, in lower case; empty where it does not say.
    is_domain : bool
    line : int or None
        Where the domain's name stands.
    """

    domain: str = ""
    is_domain: bool = False
    line: int | None = None


class Heads:
    """The beginnings of files and the domains in folders, each read once."""

    def __init__(self) -> None:
        self._heads: dict[Path, Head] = {}
        self._defined: dict[tuple[Path, str], dict[str, list[Path]]] = {}

    def __getitem__(self, file: Path) -> Head:
        """Return what a file's beginning says; nothing of one that cannot be read."""
        if file not in self._heads:
            self._heads[file] = _head(file)
        return self._heads[file]

    def defined(self, folder: Path, suffix: str) -> dict[str, list[Path]]:
        """Return the domain files of a folder, by the name that they define."""
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
    text = ""
    with suppress(OSError), file.open("rb") as stream:
        for size in (BEGIN, -1):
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
    """Yield the domains that lie where a problem's may lie, the nearest first."""
    beside = problem.parent
    above = beside.parent if beside.name not in ("", "..") else beside / ".."
    for folder in (beside, above):
        for within in FOLDERS:
            yield heads.defined(folder / within, problem.suffix.lower())


def _words(file: Path) -> list[str]:
    """Split a file's name into words and numbers, without those that only say what kind of file it is."""
    name = re.sub("domain|problem|instance|task", " ", file.stem.lower())
    words = [word.lstrip("0") or "0" for word in re.findall(r"[^\W\d_]+|\d+", name)]
    return [word for word in words if word not in ("p", "prob", "pfile")]


def _nearest(problem: Path, found: list[Path]) -> list[Path]:
    """Choose the files whose names are most of the problem's name; all, where no name is.

    So are found `p01-domain.pddl` for `p01.pddl`, `domain-1.pddl` for `instance-1.pddl`, and `packing_domain.pddl` for
    `packing_problem.pddl`.
    """
    own = _words(problem)
    fitting = [file for file in found if own[: len(_words(file))] == _words(file)]
    longest = max((len(_words(file)) for file in fitting), default=0)
    return [file for file in fitting if len(_words(file)) == longest] or found


def _fitting(problem: Path, heads: Heads) -> list[Path]:
    """Find the domain file of a problem: several, where it cannot be told which of them it is."""
    wanted, default = heads[problem].domain, problem.with_name(DOMAIN_FILE)
    if not wanted or (heads[default].is_domain and heads[default].domain == wanted):
        return [default]
    for defined in _places(problem, heads):
        if wanted in defined:
            return _nearest(problem, defined[wanted])
    return []


def instance(problem: str | Path, domain: str | Path | None = None) -> Instance:
    """Name an instance by its problem file; its domain file is found beside it unless given.

    Parameters
    ----------
    problem : path
        Or the name of a task that comes with the package, such as `kitting/paper`; a file of that name comes first.
    domain : path, optional
        Unless given: `domain.pddl` beside the problem if it defines the problem's domain, or else the file that does,
        in the same folder, or else in the folder above, or in a folder `domains` of these. Of several the one is taken
        whose name has the problem's, as `p01-domain.pddl` has that of `p01.pddl`. Where there is none, or it cannot be
        told which of several, it is `domain.pddl` beside the problem, and reading the instance says what is missing.
    """
    problem = Path(problem)
    if not problem.exists():
        problem = bundled.find(problem) or problem
    return _instance(problem, domain, Heads())


def _instance(problem: Path, domain: str | Path | None, heads: Heads) -> Instance:
    found = [Path(domain)] if domain is not None else _fitting(problem, heads)
    return Instance(problem, found[0] if len(found) == 1 else problem.with_name(DOMAIN_FILE))


def missing(instance: Instance) -> PDDLError | None:
    """Return why an instance has no domain file, or no problem file; None where it has both."""
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
        told = f"{len(found)} files define the domain '{problem.domain}': {_shown(found)}; choose one with {OPTION}"
        return PDDLError(instance.problem, problem.line, told)
    if found or instance.domain.exists():
        return None
    others = [file for defined in _places(instance.problem, heads) for files in defined.values() for file in files]
    defining = [f"{file} ('{heads[file].domain}')" for file in others]
    told = f"no file beside it or in the folder above defines the domain '{problem.domain}'; give it with {OPTION}"
    if defining:
        told += f"; other domains are there: {_shown(defining)}"
    return PDDLError(instance.problem, problem.line, told)


def _shown(files: Sequence[object]) -> str:
    more = [f"{len(files) - SHOWN} more"] if len(files) > SHOWN else []
    return ", ".join([*map(str, files[:SHOWN]), *more])


def find_instances(names: Iterable[str | Path], domain: str | Path | None = None) -> list[Instance]:
    """Find the instances that problem files, folders, globs and names of shipped tasks stand for.

    A folder stands for every `*.pddl` file in it and below that defines no domain, in sorted order. No instance is
    listed twice, and no domain file that is named beside its problems, as a shell writes `*.pddl`.

    Parameters
    ----------
    names : iterable of path
        Problem files, folders and globs. Where there is no file or folder of a name: a task that comes with the
        package, such as `kitting/paper`, or all tasks of a folder of the package, such as `kitting`.
    domain : path, optional
        Of all of them; found beside each as `instance` finds it unless given.

    Raises
    ------
    InstanceError
        A file that is not there, a folder or a glob without problems.
    """
    if domain is not None and not Path(domain).is_file():
        raise InstanceError(f"{domain}: no such domain file")
    heads = Heads()
    given = None if domain is None else Path(domain).resolve()

    def is_problem(file: Path) -> bool:
        known = file.name == DOMAIN_FILE or heads[file].is_domain or (given is not None and file.resolve() == given)
        return file.is_file() and not known

    found: dict[Instance, None] = {}
    for name in names:
        path = Path(name)
        if path.is_file():
            files = [path]
        elif path.is_dir():
            files = sorted(filter(is_problem, path.rglob("*.pddl")))
            if not files:
                raise InstanceError(f"{name}: no problem file (*.pddl that defines no domain) in this folder")
        else:
            files = sorted(filter(is_problem, _matching(path)))
            if not files and any(mark in str(path) for mark in "*?["):
                raise InstanceError(f"{name}: no problem file matches")
            if not files and not (files := bundled.files(path)):
                raise InstanceError(f"{name}: no such file or folder{shipped.near(path)}")
        found.update((_instance(file, domain, heads), None) for file in files)
    domains = {one.domain.resolve() for one in found if not heads[one.problem].is_domain}
    return [one for one in found if one.problem.resolve() not in domains]


def _matching(path: Path) -> Iterator[Path]:
    """Yield the files that a glob stands for; none where it is no glob."""
    if any(mark in str(path) for mark in "*?["):
        start = Path(path.anchor) if path.anchor else Path()
        yield from start.glob(str(path.relative_to(path.anchor) if path.anchor else path))
