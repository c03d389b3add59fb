"""What sees the steps of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .engine import Engine, StepTaken
from .questions import Asked
from .state import TeamAction, TeamState

Ints = NDArray[np.int64]


class Watcher(Protocol):
    """Sees what happens in the episodes of a chunk, for instance to write it down."""

    def asked(self, engine: Engine, asked: Sequence[tuple[Asked, bool]]) -> None:
        """See questions that were asked, and their answers."""
        ...

    def decided(self, engine: Engine, team: TeamState, action: TeamAction, teams: Ints) -> None:
        """See what the robots of some teams, given by their numbers, do in a step, before it is carried out."""
        ...

    def took(self, engine: Engine, taken: StepTaken) -> None:
        """See a step that has been taken."""
        ...
