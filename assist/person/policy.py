"""Policies for one person's problem, whatever the size of the task.

Most policies are for problems whose states are enumerated, and their rows are the states of the task. A policy for a
task that is too large for that (`large_tasks.truncated_policy`) keeps values of some states only. Users of a policy do
not need to distinguish them: they ask for the policy of the next step in some states (`Policy.local`), and for the rows
of these states there.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo

from ..people.choices import Choices
from ..people.decision import Floats
from .pomdp import AssistPOMDP

Ints = NDArray[np.int64]


class VisitingRobot(Protocol):
    """The robot of a team from one person's view: it comes to the person and leaves. Team policies provide it.

    Attributes
    ----------
    entry : float
        Cost of coming, in cost units.
    entry_steps, longest : int
        Mean and largest number of steps of coming.
    """

    @property
    def entry(self) -> float: ...  # noqa: D102
    @property
    def entry_steps(self) -> int: ...  # noqa: D102
    @property
    def longest(self) -> int: ...  # noqa: D102

    @property
    def price(self) -> Floats:
        """The price of each step of attention, in cost units; the last applies to all later steps."""
        ...

    def solved(self, policy: Policy, /) -> Any:
        """Return the solved problem of a person with this robot, given the person's policy on an enumerated task."""
        ...


class Policy:
    """A policy for one person's problem. Its methods take N people at a time.

    A subclass has the attribute `pomdp` and the method `q_values`. Everything else holds for enumerated tasks.

    Attributes
    ----------
    pomdp : AssistPOMDP
        The problem.
    states : int array, shape (n,), or None
        Task state of each row of the problem; None if rows and states are the same.
    """

    if TYPE_CHECKING:

        @property
        def pomdp(self) -> AssistPOMDP:
            """The problem."""

    @property
    def states(self) -> Ints | None:
        """The task state of each row of the problem, shape (n,); None if rows and states are the same."""
        return None

    def q_values(self, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of all robot actions, shape (N, R); minus infinity in padding.

        Parameters
        ----------
        x : int array, shape (N,)
        belief : float array, shape (N, B, T)
        """
        raise NotImplementedError

    def value(self, x: Ints, belief: Floats) -> Floats:
        """Return the value of each person's problem, shape (N,), in cost units; arguments as in `q_values`."""
        return np.asarray(self.q_values(x, belief).max(axis=1))

    def choose(self, x: Ints, belief: Floats) -> Ints:
        """Return the best robot action for each person, shape (N,). Ties favour 0, doing nothing."""
        return np.asarray(self.q_values(x, belief).argmax(axis=1))

    def prepare(self) -> Any:
        """Solve now what would otherwise be solved on first use."""
        return self

    @property
    def task(self) -> Choices | CostToGo:
        """The whole task: the choices in all of its states, or its cost-to-go."""
        return self.pomdp.model.choices

    @property
    def size(self) -> float:
        """The number of states whose values are kept; infinite if they are not those of the whole task."""
        return len(self.pomdp.robot_actions)

    @property
    def searches(self) -> bool:
        """Whether a state that was not visited before takes a slow search."""
        return False

    @property
    def cheapest(self) -> float:
        """The cost of the cheapest action, in cost units."""
        choices = self.pomdp.model.choices
        return float(choices.costs[choices.applicable].min())

    def require_enumerated(self, what: str) -> None:
        """Check that the values of all states are kept. If not, the `ValueError` says that `what` needs them."""

    def local(self, states: Ints, *, deep: bool = True) -> Policy:
        """Return a policy for the next step of people in some states.

        Parameters
        ----------
        states : int array, shape (N,)
            States of the task. `rows` returns their rows in the problem of the local policy.
        deep : bool
            Whether the effect of every suggestion on trust is needed. If not, `after_suggestions` adds the effects of
            those that are made.
        """
        del states, deep
        return self

    def rows(self, states: Ints, *, deep: bool = True) -> Ints | None:
        """Return the row of each state, shape (N,); None if the policy does not cover all of them as in `local`."""
        del deep
        return states

    def after_suggestions(self, x: Ints, robot: Ints) -> Policy:
        """Return the policy with the effects on trust of robot actions in some rows, both of shape (N,)."""
        del x, robot
        return self

    def with_robot(self, robot: VisitingRobot) -> Any:
        """Return the person's solved problem with a robot that comes and goes (`VisitingRobot.solved`)."""
        return robot.solved(self)

    def bounded(self, entry: float, **limits: Any) -> Any:
        """Return the problem whose upper bound holds for the whole task; None if that is `pomdp` itself.

        The arguments are those of `large_tasks.truncated_bound.bounded`.
        """
        del entry, limits


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
        return {name: value for name, value in vars(self).items() if name != "_lock"}

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
