"""Error classes that several modules raise."""

from __future__ import annotations

import difflib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the most similar known name; None if none is similar."""
    lower = {word.lower(): word for word in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    return lower[near[0]] if near else None


def expected(name: str, known: Iterable[str], more: str = "") -> str:
    """Return the hint of a message about an unknown name: the most similar known name, or else all of them.

    The list of known names ends with `more`.
    """
    words = list(known)
    near = nearest(name, words)
    if near is not None:
        return f"did you mean '{near}'?"
    return f"expected one of {', '.join(words)}{more}"


def require_kind(value: Any, kind: type, example: str) -> None:
    """Check that a value, unless it is None, is an object of a class.

    Raises
    ------
    TypeError
        It is something else, such as a dictionary; the message has the example.
    """
    if value is not None and not isinstance(value, kind):
        raise TypeError(f"a {type(value).__name__} where a {kind.__name__} was expected, such as {example}")


def in_words(error: OSError) -> str:
    """Return a system error as one line; some libraries raise it without its fields."""
    what = error.strerror or " ".join(str(error).split()) or type(error).__name__
    return what if error.filename is None else f"{error.filename}: {what}"


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


def require_package(what: str, package: str, extra: str, module: str | None = None) -> None:
    """Check that an optional dependency is installed, whose module has its name unless given.

    Raises
    ------
    MissingExtraError
        It is not.
    """
    if importlib.util.find_spec(module or package) is None:
        raise MissingExtraError(what, package, extra)


class MismatchError(AssertionError):
    """Two computations disagree: two costs, or a plan and the task that it should solve."""


class UnsuitedError(Exception):
    """A method is not for this task, as it would take too much. Its caller takes another one, or says what is large."""


class InputFileError(ValueError):
    """A file cannot be used: there is none, it is invalid or damaged, or it has results that would be overwritten.

    The message states the fault, its place and what is expected.
    """

    @classmethod
    def of(cls, file: str | Path, line: int | None, message: str) -> InputFileError:
        """Return the error of a file, or of one of its lines, which are counted from 1."""
        return cls(f"{file}{'' if line is None else f':{line}'}: {message}")
