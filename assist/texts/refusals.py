"""Refusals: errors whose sentence each reader gets in their own language.

A refusal has a key, and values for the placeholders of the texts of that key. The section `refusals` of a catalogue has
these texts. The class of a refusal says what a caller can do about it; it also fixes the status of an answer over HTTP.
The text of the key `other` is the English reason itself: what only programs and operators meet has no text of its own.
"""

from __future__ import annotations

from typing import Any, ClassVar

from .catalogue import catalogue


class Refusal(ValueError):  # noqa: N818 the family; its members are errors
    """What was asked for is refused, and nothing has changed. As a string, it is its English sentence.

    Attributes
    ----------
    key : str
        Key of the text in the section `refusals`.
    values : dict
        Values of the text's placeholders; days are dates.
    status : int
        Status of an answer over HTTP.
    """

    status: ClassVar[int]

    def __init__(self, key: str, **values: Any) -> None:
        super().__init__(catalogue().refusal(key, **values))
        self.key, self.values = key, values

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.key, self.values)


class ForbiddenError(Refusal):
    """Whoever asks may not have this."""

    status = 403


class AbsentError(Refusal):
    """There is no such person, robot or page."""

    status = 404


class InapplicableError(Refusal):
    """An action or event is not possible now; the message says which actions are."""

    status = 409


class FullError(InapplicableError):
    """There is no place for a further person."""


class InvalidError(Refusal):
    """An argument is unknown or malformed."""

    status = 422


class ThrottledError(Refusal):
    """Too much was asked for in a short time; the value `n`, if there is one, is the seconds until it is possible."""

    status = 429


class BusyError(Refusal):
    """Too much is being done at present."""

    status = 503


def _again(kind: type[Refusal], key: str, values: dict[str, Any]) -> Refusal:
    return kind(key, **values)
