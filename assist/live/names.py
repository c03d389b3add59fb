"""Names of people, in any script, and labels that stand for those whose records were erased."""

from __future__ import annotations

import unicodedata

LONGEST_REASON = 200
"""Number of characters of a reason for an erasure, a withdrawal or an exclusion; more would invite personal data."""

LONGEST_NAME = 64
"""Number of characters of a name, which is part of addresses of pages."""

BETWEEN_LETTERS = frozenset(" .-_'\u2019\u05f3\u00b7")
"""Signs of names besides letters, marks and digits: among others apostrophes, also typographic and Hebrew ones."""

JOINERS = frozenset("\u200c\u200d")
"""Invisible signs that some scripts need within words: behind a mark, as in Sinhala, or an Arabic letter."""


def name_of(text: str) -> str:
    """Return a name without blanks around it and in its composed form (NFC), so that it is the same for all."""
    return unicodedata.normalize("NFC", text).strip()


def is_name(text: str) -> bool:
    """Whether this is a valid name, in any script, as `name_of` returns it."""
    if not 0 < len(text) <= LONGEST_NAME or text.strip(" .") != text:
        return False
    for before, sign in zip(f" {text}", text, strict=False):
        if sign in JOINERS:
            if unicodedata.category(before) != "Mn" and unicodedata.bidirectional(before) != "AL":
                return False
        elif unicodedata.category(sign)[0] not in "LMN" and sign not in BETWEEN_LETTERS:
            return False
    return any(unicodedata.category(sign)[0] in "LN" for sign in text)
