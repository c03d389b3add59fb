"""Traces: a record for each action of each person in a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from .state import TeamPolicy, TeamState

Trace = list[dict[str, Any]]
"""A list with one dictionary for each action of each person."""


class Link(NamedTuple):
    """Something between two people at a step: from the one at `place` to the one at `to`, with a weight from 0 to 1."""

    step: int
    place: int
    to: int
    weight: float


class Reasons(Protocol):
    """Returns why a robot suggests what it does; `assist.live.TraceReasons` is one."""

    def __call__(
        self, team: TeamState, row: int, place: int, action: int, *, robot: int, names: Sequence[str], rule: str,
        policy: TeamPolicy,
    ) -> dict[str, Any]:  # fmt: skip
        """Return the reason for a robot action towards one person of a team, as plain data."""
        ...


def robot_is_at(row: Mapping[str, Any], place: int) -> bool:
    """Whether a row of a trace says that a robot was at a person's place."""
    return place in row["robot_places"]
