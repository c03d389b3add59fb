"""Values of problems that were solved before, for studies in which robots solve equal problems again and again.

The value of a person's problem does not depend on the prior, on the true trust rule, or on the population from which
the person was drawn. So cells of a study that differ in these alone share the values.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict

import numpy as np

from ..people.decision import Floats
from .mdp_values import initial_upper_bounds, sweep_order
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays
from .qmdp import QMDP, look_ahead, qmdp
from .sparse_iteration import is_small


class SolutionCache:
    """A solver that keeps the values of the problems that it solved last. It is thread-safe.

    Parameters
    ----------
    limit_mb : float
        Memory of all values that are kept, in MB.
    """

    def __init__(self, limit_mb: float = 256.0) -> None:
        self.limit = limit_mb * 1e6
        self._values: OrderedDict[bytes, Floats] = OrderedDict()
        self._bytes, self._lock = 0, threading.Lock()

    def qmdp(self, pomdp: AssistPOMDP, *, tolerance: float = 1e-6) -> QMDP:
        """Return what `qmdp` returns, to the bit.

        Parameters
        ----------
        pomdp : AssistPOMDP
        tolerance : float
            Largest error of any value, in cost units.
        """
        key = _key(pomdp, tolerance)
        with self._lock:
            if (value := self._values.get(key)) is not None:
                self._values.move_to_end(key)
        if value is not None:
            return look_ahead(pomdp, value)
        solved = qmdp(pomdp, tolerance=tolerance)
        with self._lock:
            if key not in self._values:
                self._values[key] = solved.value_mdp
                self._bytes += solved.value_mdp.nbytes
            while self._bytes > self.limit:
                self._bytes -= self._values.popitem(last=False)[1].nbytes
        return solved


def _key(pomdp: AssistPOMDP, tolerance: float) -> bytes:
    """Return a digest of all that the values depend on."""
    digest = hashlib.sha256(f"{tolerance} {is_small(pomdp)}".encode())
    orders = (sweep_order(pomdp, goal) for goal in range(len(pomdp.final)))
    for part in (*ProblemArrays.of(pomdp), initial_upper_bounds(pomdp), *orders):
        array = np.ascontiguousarray(part)
        digest.update(f"{array.shape} {array.dtype}".encode())
        digest.update(array.data)
    return digest.digest()
