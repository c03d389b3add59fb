"""Traces: a record for each action of each person in a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Trace = list[dict[str, Any]]
"""A list with one dictionary for each action of each person."""


def robot_is_at(row: Mapping[str, Any], place: int) -> bool:
    """Whether a row of a trace says that a robot was at a person's place: its only robot, or one of several."""
    return place in row.get("robot_places", [row.get("robot_place")])
