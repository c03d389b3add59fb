"""Codes that people copy by hand, and the identifiers by which other systems know participants."""

from __future__ import annotations

import secrets
import unicodedata

LETTERS = "23456789BCDFGHJKLMNPQRSTVWXYZ"
"""Characters of codes: no vowels, and none that resembles another."""


def spelled(number: int, length: int) -> str:
    """Return a code of this length for a number; the same for the same number."""
    signs = ""
    for _ in range(length):
        number, place = divmod(number, len(LETTERS))
        signs += LETTERS[place]
    return signs


def identifier(text: str) -> str:
    """Return an identifier of another system without what a copy may change; empty if nothing is left.

    Blanks around it and invisible signs are left out, and signs have their usual form (NFKC).
    """
    composed = unicodedata.normalize("NFKC", text)
    seen = "".join(sign for sign in composed if sign.isspace() or unicodedata.category(sign)[0] != "C")
    return " ".join(seen.split())


def drawn(length: int) -> str:
    """Return a random code."""
    return "".join(secrets.choice(LETTERS) for _ in range(length))
