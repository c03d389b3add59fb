"""The tasks that come with the package, found by folder and name, such as `kitting/paper`.

The name of a folder alone, such as `blocks`, stands for all of its tasks.
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
    """A task that comes with the package; the number of its states and its cost are from the README of its folder."""

    name: str
    """Folder and file name without its ending, as commands accept it."""
    problem: Path
    about: str
    """One-sentence description: the first sentence of its file's comment, or else of its domain's."""
    states: int | None
    cost: float | None
    """Optimal cost in the file's unit; a whole number where all costs are."""


def folder() -> Path:
    """Return the folder of domains: inside the package, or next to it in a checkout."""
    package = Path(__file__).parents[1]
    return package / "domains" if (package / "domains").is_dir() else package.parent / "domains"


@cache
def problems() -> dict[str, Path]:
    """Return the problem file of each bundled task, keyed and sorted by name."""
    files = (file for file in folder().rglob("*.pddl") if file.name != DOMAIN_FILE)
    return dict(sorted((file.relative_to(folder()).with_suffix("").as_posix(), file) for file in files))


def find(name: str | Path) -> Path | None:
    """Return the problem file of the bundled task of that name; None if there is none."""
    return problems().get(Path(name).as_posix())


def files(name: str | Path) -> list[Path]:
    """Return the problem files for a task name or a folder name; an empty list for an unknown name."""
    own = Path(name).as_posix()
    return [file for task, file in problems().items() if task == own or task.startswith(f"{own}/")]


def near(name: str | Path) -> str:
    """Return the part of a message that suggests bundled tasks with a similar name; empty if there are none."""
    wanted = "/".join(Path(name).with_suffix("").parts[-2:])
    folders = {task.rpartition("/")[0] for task in problems()}
    alike = difflib.get_close_matches(wanted, [*problems(), *folders], n=3, cutoff=0.75)
    if not alike:  # the name may lack its folder
        alike = [one for one in problems() if one.endswith(f"/{Path(wanted).stem}")]
    if wanted in folders:  # the name is a folder, where a task was expected
        alike = [one for one in problems() if one.startswith(f"{wanted}/")][:3]
    return f"; with the package come {', '.join(alike)}" if alike else ""


def listed() -> list[BundledTask]:
    """Return the bundled tasks, sorted by name."""
    return [
        BundledTask(name, file, _sentence(file) or _sentence(file.parent / DOMAIN_FILE), *_known(file))
        for name, file in problems().items()
    ]


def _sentence(file: Path) -> str:
    """Return the first sentence of the comment at the beginning of a file."""
    lines = takewhile(lambda line: line.startswith(";"), file.read_text(encoding="utf-8").splitlines())
    words = " ".join(" ".join(line.lstrip(";") for line in lines).split())
    sentence = re.match(r".*?\.(?=\s|$)", words)
    return sentence[0] if sentence else words


def _known(file: Path) -> tuple[int | None, float | None]:
    """Return a task's number of states and optimal cost, from the README of its folder or of a parent folder."""
    for place in file.relative_to(folder()).parents:
        readme = folder() / place / README
        head: list[str] = []
        for line in readme.read_text(encoding="utf-8").splitlines() if readme.is_file() else ():
            cells = [cell.strip(" `") for cell in line.split("|")[1:-1]]
            if cells[:1] == ["instance"]:
                head = cells
            elif cells and (folder() / place / cells[0]) == file:
                row = dict(zip(head, cells, strict=True))
                states, cost = _number(row.get("states", "")), _number(row.get("optimal cost", ""))
                return None if states is None else int(states), cost
    return None, None


def _number(cell: str) -> float | None:
    """Return the number at the beginning of a table cell; None if there is none."""
    found = re.match(r"[\d,]+(\.\d+)?", cell)
    digits = found[0].replace(",", "") if found else ""
    return (float(digits) if "." in digits else int(digits)) if digits else None
