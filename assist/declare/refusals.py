"""Refusals: errors whose sentence each reader gets in their own language.

A refusal has a key, and values for the placeholders of the texts of that key. The section `refusals` of a catalogue has
these texts. The key also fixes the status of an answer over HTTP. The text of the key `other` is the English reason
itself: what only programs and operators meet has no text of its own.
"""

from __future__ import annotations

from typing import Any, ClassVar

from .catalogue import catalogue

STATUS = {
    403: (
        "another",
        "own_links",
        "operator_only",
        "rehearsed",
        "signature",
        "unsigned",
        "visitors",
        "visitors_withdraw",
    ),
    429: ("crowded", "guesses", "joins", "many"),
    503: ("busy", "ended"),
}  # fmt: skip
"""Keys of refusals by their status over HTTP: not for whoever asks, too much at once, and not now."""


class Refusal(ValueError):  # noqa: N818 the family; its members are errors
    """What was asked for is refused, and nothing has changed. As a string, it is its English sentence.

    Attributes
    ----------
    key : str
        Key of the text in the section `refusals`.
    values : dict
        Values of the text's placeholders; days are dates. `n` of a refusal of status 429 is the seconds until it is
        possible.
    status : int
        Status of an answer over HTTP; 422, for an unknown or malformed argument, unless key or class have another one.
    """

    usual: ClassVar[int] = 422

    def __init__(self, key: str, **values: Any) -> None:
        super().__init__(catalogue().refusal(key, **values))
        self.key, self.values = key, values
        self.status = next((status for status, keys in STATUS.items() if key in keys), self.usual)

    @classmethod
    def answered(cls, status: int, why: str) -> Refusal:
        """Return the refusal that a service answered, from its status and its sentence."""
        found = {kind.usual: kind for kind in cls.__subclasses__()}.get(status, cls)("other", why=why)
        found.status = status
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.key, self.values, self.status)


class AbsentError(Refusal):
    """There is no such person, robot or page."""

    usual = 404


class InapplicableError(Refusal):
    """An action or event is not possible now; the message says which actions are, or that there is no place."""

    usual = 409


def _again(kind: type[Refusal], key: str, values: dict[str, Any], status: int) -> Refusal:
    found = kind(key, **values)
    found.status = status
    return found
