"""Error classes that several modules raise."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from pathlib import Path


def expected(name: str, known: Iterable[str], more: str = "") -> str:
    """Return the hint of a message about an unknown name: the most similar known name, or else all of them.

    The list of known names ends with `more`.
    """
    words = list(known)
    lower = {word.lower(): word for word in words}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    if near:
        return f"did you mean '{lower[near[0]]}'?"
    return f"expected one of {', '.join(words)}{more}"


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message contains the pip command that installs it.

    The message begins with `what`, the feature that needs the package; `extra` is that of this project.
    """

    def __init__(self, what: str, package: str, extra: str) -> None:
        checkout = Path(__file__).parents[2]
        if (checkout / "pyproject.toml").is_file():
            source = f"-c '{checkout / 'constraints.txt'}' -e '{checkout}[{extra}]'"
        else:
            source = f"'kitassist[{extra}]'"
        super().__init__(f"{what} {package}: {sys.executable} -m pip install {source}")


class ResultsExistError(ValueError):
    """An output folder already contains results."""


class MismatchError(AssertionError):
    """Two computations of a cost disagree."""


class DamagedFileError(ValueError):
    """A results file was truncated or changed, or another program wrote it; lines are counted from 1."""

    def __init__(self, file: Path, line: int | None, message: str) -> None:
        super().__init__(file, line, message)
        self.file, self.line, self.message = file, line, message

    def __str__(self) -> str:
        return f"{self.file}{'' if self.line is None else f':{self.line}'}: {self.message}"


class InputFileError(ValueError):
    """An input file is invalid; the message states the fault, its place and what is expected."""
