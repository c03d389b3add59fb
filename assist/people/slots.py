"""The choices in n states as arrays with a slot for each choice, from transitions in compressed rows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Transitions

WAIT = -1
"""Action number of waiting, the only choice in a state without applicable actions."""


class Slots(NamedTuple):
    """The choices in n states, padded to the largest number; attributes as in `Choices`."""

    applicable: NDArray[np.bool_]
    actions: NDArray[np.int64]
    targets: NDArray[np.int64]
    costs: NDArray[np.float64]
    optimal: NDArray[np.bool_]


def padded(known: CostToGo, rows: Transitions, optimal: NDArray[np.bool_], may_wait: NDArray[np.bool_]) -> Slots:
    """Return choices from compressed rows, with waiting as the only choice where no action is applicable.

    Parameters
    ----------
    known : CostToGo
        A cost-to-go of the task, which has the actions' names and costs.
    rows : Transitions
        The m choices of all n states, with ground actions.
    optimal : bool array, shape (m,)
    may_wait : bool array, shape (n,)
        Whether people wait in a state without a choice: not at the goal, nor where choices are not known.
    """
    task, counts = known.task, np.diff(rows.offsets)
    source = np.repeat(np.arange(len(counts)), counts)
    slot = np.arange(len(source)) - rows.offsets[source]
    shape = (len(counts), max(1, int(counts.max(initial=0))))
    found = Slots(
        np.zeros(shape, dtype=bool), np.full(shape, WAIT, dtype=np.int64),
        np.repeat(np.arange(len(counts))[:, None], shape[1], axis=1), np.zeros(shape), np.zeros(shape, dtype=bool),
    )  # fmt: skip
    every: tuple[Any, ...] = (
        True,
        task.first_of_name[rows.actions],
        rows.targets,
        task.action_costs[rows.actions],
        optimal,
    )
    for array, values in zip(found, every, strict=True):
        array[source, slot] = values
    stuck = (counts == 0) & may_wait
    found.applicable[stuck, 0] = True
    found.costs[stuck, 0] = 1.0
    return found
