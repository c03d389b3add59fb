"""What people of a team see of each other's suggestions, as a map on theta of arrays.

The same map moves people's own theta and, at the grid's values, what a robot believes of it.

Assumptions. The prior is a product over people. The robot sees all states, what was suggested (u), the actions of each
step (a), who goes on, and answers. Each answer, and who goes on, depends on one person's type alone. People's theta is
on the grid at the beginning of each step.

Claim. Beliefs about people stay independent of each other, so that a filter for each of them is exact.

Proof. Let b_k be the belief about person k.

1. Before the step the belief is a product, b = prod_k b_k, over types h_k and theta_k. At first that is the prior.
2. P(a | h, theta, u) = prod_k P(a_k | h_k, theta_k, u_k), as each chooses by their own type and theta alone.
3. After the step theta_k' = f(theta_k; u_k, a_k), then g(theta_k'; e_1, ..., e_n), with the events e of the neighbours.
4. Each e is a function of states, u and a, which are known; so given (u, a), theta_k' depends on theta_k alone.
5. A theta between grid points is divided between both: the person is at one of them by a chance that is their own.
6. An answer of person k, and that they go on, have a likelihood P(. | h_k), which changes b_k alone.
7. Hence b' = prod_k b_k', where b_k' is the person's own posterior, moved by g: a product again.

Goals of people that depend on each other are no product. A filter for each person then leaves out what others' actions
tell of their goal. Theta that is not on the grid, as that of simulated people who are not of the model, is divided in
beliefs only, which are no longer exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planner.system.arrays import frozen

from .belief import Grid, moved
from .decision import Bools, Floats, Ints
from .hidden_type import mean_over_goals
from .human import HumanModel
from .neighbours import Neighbours, SeenEvent, SeenNothing, SeenRule, moves_theta


class Helped(NamedTuple):
    """What came of E suggestions to people of N teams in a step, in the order of teams and people.

    Attributes
    ----------
    team, person : int arrays, shape (E,)
    gain : float array, shape (E,)
    followed : bool array, shape (E,)
        As in `SeenEvent`.
    """

    team: Ints
    person: Ints
    gain: Floats
    followed: Bools


def seen_value(model: HumanModel, x: Ints) -> Floats:
    """Return the value of states as neighbours see it, shape (N,): minus the cost-to-go that the person perceives.

    With several goals it is the mean under their probabilities at the beginning, which do not depend on actions.

    Parameters
    ----------
    model : HumanModel
        The robot's model of the person.
    x : int array, shape (N,)
        States whose choices are known.
    """
    goals = model.choices.goals
    value = np.where(goals.goal[:, x].T, 0.0, -model.q[x].min(axis=1))
    return mean_over_goals(value, np.array(list(goals.prior.values())))


def seen_gain(model: HumanModel, before: Ints, after: Ints) -> Floats:
    """Return what came of steps from some states to others, shape (N,), in cost units, as neighbours see it.

    Parameters
    ----------
    model : HumanModel
        As in `seen_value`.
    before, after : int arrays, shape (N,)
        States whose choices are known.
    """
    was, now = seen_value(model, before), seen_value(model, after)
    return np.subtract(now, was, out=np.zeros(len(was)), where=now != was)


def each_once(who: Ints, gain: Floats, followed: Bools, weight: Floats) -> tuple[Ints, SeenEvent, Ints]:
    """Return who sees what, without repetitions; the arguments have the shape (m,).

    Returns
    -------
    who : int array, shape (d,)
    event : SeenEvent
        Arrays of shape (d, 1).
    place : int array, shape (m,)
        Number, among these d, of each that was given.
    """
    gains, of_gain = np.unique(gain, return_inverse=True)
    weights, of_weight = np.unique(weight, return_inverse=True)
    count = len(gains) * 2 * len(weights)
    key, inverse = np.unique(who * count + (of_gain * 2 + followed) * len(weights) + of_weight, return_inverse=True)
    who, which = np.divmod(key, count)
    event, of_weight = np.divmod(which, len(weights))
    each = SeenEvent(gains[event // 2][:, None], (event % 2 == 1)[:, None], weights[of_weight][:, None])
    return who, each, inverse.reshape(-1)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """What people at the first K places of a team see of each other, and how their theta moves by it.

    People at later places see nobody, and nobody sees them. Where no theta moves by what is seen, K is 0: then all
    that follows from it is empty, so that nobody needs to ask whether there is a graph.

    Attributes
    ----------
    rule : SeenRule
    sees : float array, shape (K, K)
        Weight with which each person (a row) sees each other one.
    known : bool
        Whether the robots know of it.
    """

    rule: SeenRule
    sees: Floats
    known: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "sees", frozen(np.asarray(self.sees, dtype=float)))

    @classmethod
    def of(cls, declared: Neighbours | None, places: int) -> Neighbourhood:
        """Return what a team of `places` people see of each other: `NOBODY_SEES` if theta does not move by it.

        Raises
        ------
        ValueError
            As in `Neighbours.weights`.
        """
        if not moves_theta(declared):
            return NOBODY_SEES
        assert declared is not None
        return cls(declared.rule, declared.weights(places), declared.known)

    @cached_property
    def believed(self) -> Neighbourhood:
        """What the robots know of it."""
        return self if self.known else NOBODY_SEES

    @cached_property
    def watched(self) -> Bools:
        """Whether anybody sees each person, shape (K,)."""
        return frozen(np.any(self.sees > 0, axis=0))

    def first(self, places: int) -> Neighbourhood:
        """Return what people at the first places see of each other."""
        return replace(self, sees=self.sees[:places, :places])

    @property
    def needs_all_seen(self) -> bool:
        """Whether robots must see all actions as they are, to know what people saw."""
        return len(self.sees) > 0

    def told(self, heard: Ints) -> Bools:
        """Return to whom robots said something, where others can see it, shape (N, K).

        Parameters
        ----------
        heard : int array, shape (N, K'), with K' >= K
            The robot action that each person heard; 0 for none.
        """
        return np.logical_and(heard[:, : len(self.sees)] > 0, self.watched)

    def seen_from(self, place: int) -> dict[int, float]:
        """Return whom the person at a place sees, with the weight of each."""
        row = self.sees[place : place + 1].reshape(-1)
        return {other: float(row[other]) for other in np.flatnonzero(row).tolist()}

    def onlookers(self, person: Ints, there: Bools) -> tuple[Ints, Ints, Floats]:
        """Return who sees each of some people.

        Parameters
        ----------
        person : int array, shape (E,)
            Their places.
        there : bool array, shape (E, K'), with K' >= K
            Who of the person's team can see something.

        Returns
        -------
        which, who : int arrays, shape (m,)
            Number of the person who is seen, ascending, and the place of one who sees them.
        weight : float array, shape (m,)
        """
        size = len(self.sees)
        inside = np.flatnonzero(person < size)
        inside = inside[self.watched[person[inside]]]
        sees = self.sees[:, person[inside]].T
        which, who = np.nonzero((sees > 0) & there[inside, :size])
        return inside[which], who, sees[which, who]

    def moved(self, theta: Floats, helped: Helped, there: Bools) -> tuple[Ints, Floats]:
        """Return who of the people of N teams has seen something, and their theta after it.

        Parameters
        ----------
        theta : float array, shape (N * K, T)
            One or more values of theta of each person.
        helped : Helped
        there : bool array, shape (N, K)
            Who can see something: the people at work.

        Returns
        -------
        rows : int array, shape (m,)
            These people, as ascending indices of the flattened array.
        theta : float array, shape (m, T)
        """
        each = list(self._in_order(helped, there))
        rows = np.unique(np.concatenate([rows for rows, _ in each])) if each else np.zeros(0, dtype=np.int64)
        found = theta[rows]
        for who, event in each:
            at = np.searchsorted(rows, who)
            found[at] = self.rule.update(found[at], event)
        return rows, found

    def after(self, belief: Floats, grid: Grid, event: SeenEvent) -> Floats:
        """Return the beliefs in m people, shape (m, H, T), after each has seen an event, arrays of shape (m, 1)."""
        theta = self.rule.update(np.broadcast_to(grid.theta, (len(belief), len(grid.theta))), event)
        return moved(belief, *grid.shares(theta, grid.count))

    def believe(self, belief: Floats, grid: Grid, helped: Helped, there: Bools) -> None:
        """Move theta in the beliefs about those who have seen something.

        Parameters
        ----------
        belief : float array, shape (N * K, H, T)
            It changes in place; without rows nothing does.
        grid : Grid
        helped, there
            As in `moved`.
        """
        if len(belief):
            rows, theta = self.moved(np.broadcast_to(grid.theta, (len(belief), len(grid.theta))), helped, there)
            belief[rows] = moved(belief[rows], *grid.shares(theta, grid.count))

    def _in_order(self, helped: Helped, there: Bools) -> Iterator[tuple[Ints, SeenEvent]]:
        """Yield who sees the first suggestion in each team, with the events as they see them, then the second, ..."""
        if not len(helped.team):
            return
        begins = np.flatnonzero(np.diff(helped.team, prepend=-1))
        rank = np.arange(len(helped.team)) - np.repeat(begins, np.diff([*begins, len(helped.team)]))
        for number in range(int(rank.max()) + 1):
            those = np.flatnonzero(rank == number)
            which, who, weight = self.onlookers(helped.person[those], there[helped.team[those]])
            of = those[which]
            yield (
                helped.team[of] * there.shape[1] + who,
                SeenEvent(helped.gain[of, None], helped.followed[of, None], weight[:, None]),
            )


NOBODY_SEES = Neighbourhood(SeenNothing(), np.zeros((0, 0)))
"""Nobody sees anybody."""
