"""The errors that more than one module raises."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from pathlib import Path


def expected(name: str, known: Iterable[str], more: str = "") -> str:
    """Return what a name should have been: the nearest known one, or all of them where none is near.

    Parameters
    ----------
    name : str
    known : iterable of str
    more : str
        What else is possible, to be said after the known ones.
    """
    words = list(known)
    lower = {word.lower(): word for word in words}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    if near:
        return f"did you mean '{lower[near[0]]}'?"
    return f"expected one of {', '.join(words)}{more}"


class MissingExtraError(ImportError):
    """A package that only an extra of this project installs; the message says how.

    Parameters
    ----------
    what : str
        What cannot be done without it.
    package, extra : str
        What is missing, and the extra that has it.
    """

    def __init__(self, what: str, package: str, extra: str) -> None:
        checkout = Path(__file__).parents[2]
        if (checkout / "pyproject.toml").is_file():
            source = f"-c '{checkout / 'constraints.txt'}' -e '{checkout}[{extra}]'"
        else:
            source = f"'kitassist[{extra}]'"
        super().__init__(f"{what} {package}: {sys.executable} -m pip install {source}")


class ResultsExistError(ValueError):
    """An output folder that holds results already."""


class MismatchError(AssertionError):
    """A cost-to-go that differs from Fast Downward's."""


class DamagedFileError(ValueError):
    """A file of results that was cut off, changed, or made by something else.

    Attributes
    ----------
    file : Path
    line : int or None
        Counted from 1.
    message : str
    """

    def __init__(self, file: Path, line: int | None, message: str) -> None:
        super().__init__(file, line, message)
        self.file, self.line, self.message = file, line, message

    def __str__(self) -> str:
        return f"{self.file}{'' if self.line is None else f':{self.line}'}: {self.message}"


class InputFileError(ValueError):
    """An input file that cannot be used: what is wrong, in which line, and what would be right."""
