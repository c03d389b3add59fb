"""The tasks that come with the package: found by folder and name, such as `kitting/paper`, wherever it is installed.

A folder's name alone, such as `blocks`, stands for all of its tasks.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path

DOMAIN_FILE = "domain.pddl"
README = "README.md"


@dataclass(frozen=True)
class BundledTask:
    """A task that comes with the package.

    Attributes
    ----------
    name : str
        Its folder and its own name, as every command takes it.
    problem : Path
    about : str
        What it is, in a sentence: the first of its file, or else of its domain.
    states, cost : int or None
        How many states it has and what its cheapest plan costs, as its folder's README has them; None where that does
        not say.
    """

    name: str
    problem: Path
    about: str
    states: int | None
    cost: int | None


def folder() -> Path:
    """Give the folder of domains: within the package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    return package / "domains" if (package / "domains").is_dir() else package.parent / "domains"


@cache
def problems() -> dict[str, Path]:
    """Give the problem file of each task by its name, in the order of the names."""
    files = (file for file in folder().rglob("*.pddl") if file.name != DOMAIN_FILE)
    return dict(sorted((file.relative_to(folder()).with_suffix("").as_posix(), file) for file in files))


def find(name: str | Path) -> Path | None:
    """Give the problem file of a task by its name; None if there is none of that name."""
    return problems().get(Path(name).as_posix())


def files(name: str | Path) -> list[Path]:
    """Return the problem files that a name stands for: one of a task, all of a folder; none of an unknown name."""
    own = Path(name).as_posix()
    return [file for task, file in problems().items() if task == own or task.startswith(f"{own}/")]


def near(name: str | Path) -> str:
    """Return a remark on a name that stands for nothing: similar names of tasks and folders; empty without such."""
    wanted = "/".join(Path(name).with_suffix("").parts[-2:])
    folders = {task.rpartition("/")[0] for task in problems()}
    alike = difflib.get_close_matches(wanted, [*problems(), *folders], n=3, cutoff=0.75)
    if not alike:  # perhaps without its folder
        alike = [one for one in problems() if one.endswith(f"/{Path(wanted).stem}")]
    if wanted in folders:  # a task was expected
        alike = [one for one in problems() if one.startswith(f"{wanted}/")][:3]
    return f"; with the package come {', '.join(alike)}" if alike else ""


def listed() -> list[BundledTask]:
    """Give the tasks that come with the package, in the order of their names."""
    return [
        BundledTask(name, file, _sentence(file) or _sentence(file.parent / DOMAIN_FILE), *_known(file))
        for name, file in problems().items()
    ]


def _sentence(file: Path) -> str:
    """Give the first sentence of the comment with which a file begins."""
    lines = takewhile(lambda line: line.startswith(";"), file.read_text(encoding="utf-8").splitlines())
    words = " ".join(" ".join(line.lstrip(";") for line in lines).split())
    sentence = re.match(r".*?\.(?=\s|$)", words)
    return sentence[0] if sentence else words


def _known(file: Path) -> tuple[int | None, int | None]:
    """Give states and cost of a task from the tables in the README of its folder, or of one above."""
    for place in file.relative_to(folder()).parents:
        readme = folder() / place / README
        head: list[str] = []
        for line in readme.read_text(encoding="utf-8").splitlines() if readme.is_file() else ():
            cells = [cell.strip(" `") for cell in line.split("|")[1:-1]]
            if cells[:1] == ["instance"]:
                head = cells
            elif cells and (folder() / place / cells[0]) == file:
                row = dict(zip(head, cells, strict=True))
                return _number(row.get("states", "")), _number(row.get("optimal cost", ""))
    return None, None


def _number(cell: str) -> int | None:
    digits = re.match(r"[\d,]+", cell)
    return int(digits[0].replace(",", "")) if digits else None
