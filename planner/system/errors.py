"""Error classes that several modules raise, and the words and signs of messages.

Signs that a reader does not see are named in messages, left out of names, and never sent to a terminal.
"""

from __future__ import annotations

import difflib
import importlib.util
import re
import sys
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any


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


UNSEEN = re.compile(
    "[\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u202a-\u202e\u2060-\u206f\u3164\ufe00-\ufe0f"
    "\ufeff\uffa0\ufff0-\ufff8\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e0fff]"
)
"""Signs that show nothing (Unicode's property Default_Ignorable_Code_Point)."""

JOINERS = "\u200c\u200d"
"""Signs between two letters or pictures that change how these look; after ASCII they show nothing."""

CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Signs that move a terminal's cursor, change its colours, or reverse what is read. Tabs and line feeds are allowed."""


def visible(text: str) -> str:
    r"""Return a text whose control characters are written out, such as `\x1b`; tabs and line feeds stay."""
    return text if text.isprintable() else CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)


def named(sign: str) -> str:
    """Return a sign as messages name it, such as `U+200B (zero width space)`."""
    return f"U+{ord(sign):04X} ({unicodedata.name(sign, 'a control character').lower()})"


def plain(text: str) -> str:
    """Return a text with composed letters (NFC), without unseen signs, and with single spaces between its words.

    Two names that look the same are then equal, unless their letters only resemble each other.
    """
    if not text.isascii():
        text = unicodedata.normalize("NFC", UNSEEN.sub(_kept, text))
    return " ".join(text.split())


def changed(text: str) -> list[str]:
    """Return what `plain` takes the unseen signs of a text for, such as `U+200B (zero width space) as nothing`."""
    if text.isascii():
        return []
    unseen = dict.fromkeys(found[0] for found in UNSEEN.finditer(text) if not _kept(found))
    spaces = dict.fromkeys(sign for sign in text if sign.isspace() and not sign.isascii())
    decomposed = not unicodedata.is_normalized("NFC", UNSEEN.sub(_kept, text))
    return [
        *(f"{named(sign)} as nothing" for sign in unseen),
        *(f"{named(sign)} as a space" for sign in spaces),
        *["decomposed letters as composed ones"] * decomposed,
    ]


def _kept(found: re.Match[str]) -> str:
    """Return an unseen sign if it joins two signs that are not ASCII, else nothing."""
    before, after = found.string[found.start() - 1 : found.start()], found.string[found.end() : found.end() + 1]
    joins = found[0] in JOINERS and before and after and not before.isascii() and not after.isascii()
    return found[0] if joins else ""


class VisibleText:
    """A text stream that writes control characters out (`visible`), whatever a message contains.

    Rich, which styles its output by such characters, writes to the stream beneath.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text; return its number of characters."""
        self._stream.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after another."""
        for line in lines:
            self.write(line)

    @property
    def rich_proxied_file(self) -> IO[str]:
        """The stream to which Rich writes."""
        under: Any = self._stream
        while (found := getattr(under, "rich_proxied_file", None)) is not None:
            under = found
        return under

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
