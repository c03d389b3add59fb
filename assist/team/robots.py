"""Robots that differ in what they can do and in what it costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.system.errors import expected

from ..people.decision import Floats


@dataclass(frozen=True)
class Robot:
    """One robot of a team whose robots differ. Where a field is None, the robot has the value of the setting.

    Attributes
    ----------
    execute : bool, optional
        Whether the robot can also execute an action itself.
    c_suggest, c_execute, c_move : float, optional
        Costs of a suggestion, of an action that the robot executes, and of moving by a distance of 1, in cost units.
    travel_time : float, optional
        Steps for moving by a distance of 1.
    """

    execute: bool | None = None
    c_suggest: float | None = None
    c_execute: float | None = None
    c_move: float | None = None
    travel_time: float | None = None

    @classmethod
    def of(cls, plain: Robot | Mapping[str, Any]) -> Robot:
        """Return the robot that `as_dict` converted to plain data; a robot is returned unchanged.

        Raises
        ------
        ValueError
            It has unknown fields, or is no robot.
        """
        if isinstance(plain, Robot):
            return plain
        if not isinstance(plain, Mapping):
            raise ValueError(f"{plain!r}; expected a Robot")  # noqa: TRY004
        known = [one.name for one in fields(cls)]
        for name in plain:
            if name not in known:
                raise ValueError(f"{name!r} is unknown; {expected(str(name), known)}")
        return cls(**plain)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields that are given, as plain data."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class ExtraCosts:
    """How much more an action of each of M different robots costs than with the lowest cost of any, in cost units.

    Attributes
    ----------
    suggesting : float array, shape (M,)
        For a suggestion.
    executing : float array, shape (M,)
        For the execution of an action; infinite for a robot that executes none.
    """

    suggesting: Floats
    executing: Floats

    def __post_init__(self) -> None:
        self.suggesting.flags.writeable = self.executing.flags.writeable = False

    def of(self, robot: NDArray[np.int64], executes: NDArray[np.bool_]) -> Floats:
        """Return the extra costs of actions of robots, given by their numbers from 0; other actions are suggestions."""
        return np.where(executes, self.executing[robot], self.suggesting[robot])
