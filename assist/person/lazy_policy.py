"""Policies that are solved on first use."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from ..people.decision import Floats, Ints
from .policy import Policy
from .pomdp import AssistPOMDP


class LazyPolicy(Policy):
    """A policy that is solved on first use.

    The problem is available without solving. Any attribute that a `Policy` does not have is that of the solved policy.
    All methods are thread-safe.

    Parameters
    ----------
    pomdp : AssistPOMDP
    solver : callable
        Returns the policy for a problem.
    """

    def __init__(self, pomdp: AssistPOMDP, solver: Callable[[AssistPOMDP], Policy]) -> None:
        self.pomdp, self.solver = pomdp, solver  # type: ignore[misc]
        self._lock, self._solved = threading.Lock(), list[Policy]()

    def __repr__(self) -> str:
        return f"LazyPolicy({self._solved[0] if self._solved else self.pomdp!r})"

    def prepare(self) -> Policy:
        """Return the solved policy; the solver is called once."""
        with self._lock:
            if not self._solved:
                self._solved.append(self.solver(self.pomdp))
            return self._solved[0]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _lock=threading.Lock())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.prepare(), name)

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding."""
        return self.prepare().q_values(x, belief)

    def value(self, x: Ints, belief: Floats) -> Floats:
        """Return the value of each person's problem, shape (N,)."""
        return self.prepare().value(x, belief)

    def choose(self, x: Ints, belief: Floats) -> Ints:
        """Return the best robot action for each person, shape (N,)."""
        return self.prepare().choose(x, belief)
