"""Codes that people copy by hand: of participants, of completed studies, and for withdrawals."""

from __future__ import annotations

import secrets

LETTERS = "23456789BCDFGHJKLMNPQRSTVWXYZ"
"""Characters of codes: no vowels, and none that resembles another."""


def spelled(number: int, length: int) -> str:
    """Return a code of this length for a number; the same for the same number."""
    signs = ""
    for _ in range(length):
        number, place = divmod(number, len(LETTERS))
        signs += LETTERS[place]
    return signs


def drawn(length: int) -> str:
    """Return a random code."""
    return "".join(secrets.choice(LETTERS) for _ in range(length))
