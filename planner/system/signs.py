"""Signs that a reader does not see: they are named in messages, left out of names, and never sent to a terminal."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from typing import IO, Any

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
