"""Texts of pages, questionnaires, refusals, explanations and reports of studies: one TOML file for each language.

A language is a file in this folder. A file elsewhere can be given by its path; its name is the language's tag, such as
`fr.toml`. Each file has the same texts, and each text has placeholders only of those that the English one has.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from pathlib import Path
from typing import Any

from planner.system.errors import in_words

from . import tables

FOLDER = Path(__file__).parent
FIRST = "en"
TAG = re.compile(r"[A-Za-z]{2,3}(-[A-Za-z0-9]{2,8})*")
"""Tags of languages, as in the attribute `lang` of a page."""


def languages() -> tuple[str, ...]:
    """Return the names of the languages that come with the package, the default first."""
    return tuple(sorted((file.stem for file in FOLDER.glob("*.toml")), key=lambda name: (name != FIRST, name)))


@dataclass(frozen=True)
class Catalogue:
    """The texts of a language.

    Attributes
    ----------
    file : Path
    texts : mapping of str to str
        Texts by their dotted keys.
    """

    file: Path
    texts: Mapping[str, str]

    def __call__(self, key: str, **values: object) -> str:
        """Return a text with its placeholders replaced; its first letter is a capital."""
        text = self.phrase(key, **values)
        return text[:1].upper() + text[1:]

    def phrase(self, key: str, **values: object) -> str:
        """Return a text with its placeholders replaced, as a part of a sentence or a cell of a table."""
        return self.texts[key].format(**values)

    def decimal(self, value: float, digits: int) -> str:
        """Return a number with a fixed number of decimals."""
        return f"{value:.{digits}f}".replace(".", self.texts["decimal"])

    @property
    def tag(self) -> str:
        """The tag of the language, as in the attribute `lang` of a page."""
        return self.file.stem

    def section(self, name: str) -> dict[str, str]:
        """Return the texts of a section, by their keys within it."""
        return {key.removeprefix(f"{name}."): text for key, text in self.texts.items() if key.startswith(f"{name}.")}

    def refusal(self, key: str, **values: Any) -> str:
        """Return the text of a refusal, given the key of its text; days are dates."""
        given = {name: self.day(value) if isinstance(value, date) else value for name, value in values.items()}
        return self.texts[f"refusals.{key}"].format(**given)

    def day(self, day: date) -> str:
        """Return a day as it is written in this language."""
        year, month, number = day.isoformat().split("-")
        return self.texts["date"].format(year=year, month=month, day=number)

    def action(self, pddl: str, words: str | None) -> str:
        """Return an action as a part of a sentence; `words` is the domain's wording, if there is one."""
        if words is None:
            return self.texts["actions.unworded"].format(pddl=pddl)
        return self.texts["actions.worded"].format(words=words, inner=words[:1].lower() + words[1:])

    def percent(self, share: float) -> str:
        """Return a probability in percent; only 0 and 1 themselves are given as 0 and 100."""
        n = round(100 * share)
        n = min(max(n, 1), 99) if 0 < share < 1 else n
        return self.texts["percent"].format(n=n)

    def number(self, value: float) -> str:
        """Return a number with two significant digits, or all digits before the decimal sign."""
        text = f"{value:.0f}" if abs(value) >= 10 else f"{float(f'{value:.2g}'):g}"
        return text.replace(".", self.texts["decimal"])

    def about(self, value: float, smallest: float = 0.01) -> str:
        """Return a positive expectation, in cost units; below `smallest`, only that it is less."""
        if value < smallest:
            return self.texts["less_than"].format(n=self.number(smallest))
        return self.texts["about"].format(n=self.number(value))

    def below(self, value: float) -> str:
        """Return a positive limit with two significant digits, rounded down so that it is not overstated."""
        unit = 10.0 ** (math.floor(math.log10(value)) - 1)
        return self.number(math.floor(value / unit * (1 + 1e-12)) * unit)


def catalogue(language: str = FIRST) -> Catalogue:
    """Return the texts of a language.

    Parameters
    ----------
    language : str
        One of `languages()`, or the path of a TOML file.

    Raises
    ------
    ValueError
        There is no such language, or the file lacks a text or has an unknown one; the message names the text.
    """
    own = language.endswith(".toml")
    if not own and language not in languages():
        raise ValueError(f"language {language[:40]!r}: expected one of {', '.join(languages())}, or a .toml file")
    file = Path(language) if own else FOLDER / f"{language}.toml"
    if not TAG.fullmatch(file.stem):
        raise ValueError(f"{file}: expected a file that is named after its language, such as fr.toml")
    try:
        return _read(file, file.stat().st_mtime_ns, own)
    except OSError as error:
        raise ValueError(in_words(error)) from None


@lru_cache(maxsize=16)
def _read(file: Path, _changed: int, own: bool) -> Catalogue:
    """Return the texts in a file, which is read again after it has changed."""
    texts = dict(_texts(tables.load(file)))
    if own or file.stem != FIRST:
        _check(file, texts, catalogue(FIRST).texts)
    return Catalogue(file, texts)


def _texts(tree: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _texts(value, f"{before}{name}.")
        else:
            yield before + name, str(value)


def _check(file: Path, texts: Mapping[str, str], first: Mapping[str, str]) -> None:
    for key in [*first, *texts]:
        if key not in texts or key not in first:
            raise tables.fault(
                file, key, "is missing; expected a text" if key in first else "unknown; expected no text"
            )
        # English begins actions with a small letter; a language may take the words as they are.
        allowed = _placeholders(first[key]) | ({"words", "inner"} if key == "actions.worded" else set())
        if wrong := _placeholders(texts[key]) - allowed:
            raise tables.fault(file, key, f"{{{min(wrong)}}}; expected {', '.join(sorted(allowed)) or 'no name'}")


def _placeholders(text: str) -> set[str]:
    return set(re.findall(r"\{(\w*)\}", text))
