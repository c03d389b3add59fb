"""The interface between the searches and the indices of states.

The searches (`forward_search`, `backward_search`) know states by *keys*, in blocks. A `SearchSpace` expands and relaxes
such blocks. There are four, each with its own `StateIndex`:

- `SortedSpace` is for small tasks. It uses numpy alone, since compiling takes longer than to search them.
- `RankedSpace` is the fastest of the compiled ones. Keys are ranks, the reachable ones are a bitmap, and the backward
  search applies inverse operators, so that no transitions are stored.
- `RegistrySpace` works for every task. Keys are the numbers of packed states, in the order of their discovery until
  `finish` sorts each layer, and the transitions are stored.
- A `RegistrySpace` with a function that replaces each state by the canonical state of its orbit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from ..grounding.task import Fact
from ..system.arrays import Ints
from ..system.limits import Budget
from .state_space import StateIndex


class SearchSpace(Protocol):
    """The states of a task for a search: first all methods of the forward search are called, then the others."""

    transitions: int
    """Number of transitions of the states that have been expanded."""

    @property
    def index(self) -> StateIndex:
        """The numbering of the reachable states, complete after `finish`."""

    @property
    def initial(self) -> int:
        """Number of the initial state, known after `finish`."""

    @property
    def costs(self) -> Ints:
        """The distinct costs of the operators, ascending; a *kind* is a position in this array."""

    @property
    def nbytes(self) -> float:
        """Bytes in use."""

    def __len__(self) -> int:
        """Return the number of states found so far."""

    def start(self) -> list[Any]:
        """Return the first layer: the key of the initial state. A layer is a list of arrays, or of ranges, of keys."""

    def blocks(self, layer: list[Any], threads: int) -> deque[Any]:
        """Return the keys of a layer in blocks of suitable size; the given list is emptied."""

    def expand(self, block: Any) -> Any:
        """Expand the states of a block; several threads may call this at once."""

    def add(self, expanded: Any) -> list[Any]:
        """Record what `expand` returned, in the order of the blocks; return the keys of the new states."""

    def finish(self) -> None:
        """End the forward search."""

    def begin(self, goal: Sequence[Fact], distance: NDArray[Any]) -> list[Ints]:
        """Begin the backward search: set the distance of the goal states to 0, and return their keys."""

    def settle(self, block: Ints, d: int, distance: NDArray[Any], costs: NDArray[Any]) -> list[tuple[int, Ints]]:
        """Relax the transitions into the states of a block at distance `d`; several threads may call this at once.

        Return the states whose distance has decreased, as pairs of the kind of the cost and keys.
        """


def check(space: SearchSpace, budget: Budget, more: float = 0) -> None:
    """Check all limits of a search; `more` is the number of bytes that it uses besides its space."""
    budget.check_states(len(space))
    budget.check_time(len(space))
    budget.check_memory(space.nbytes + more)
