"""States and beliefs that people of a team visit, recorded in a simulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.attention_subproblem import AttentionSubproblem
from ..person.time_expansion import AWAY, HERE
from ..team.state import BASE, TeamAction, TeamPolicy, TeamState


class BeliefRecorder:
    """A team policy that acts like another one and records the states and beliefs of people at each place.

    Attributes
    ----------
    visited : list of lists of (int, int array, int array, float array)
        For each place: a step, and for all teams with an active person there the task state, the position of a robot
        (`person.time_expansion`), and the belief, shape (n, B, T). A robot under way counts as away.
    """

    uses_belief = True

    def __init__(self, policy: TeamPolicy, places: int, steps: int) -> None:
        self.policy, self.steps = policy, steps
        self.visited: list[list[tuple[int, NDArray[np.int64], NDArray[np.int64], Floats]]] = [[] for _ in range(places)]

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Record the states and beliefs of the teams, and return the other policy's action."""
        if team.step < self.steps:
            assert team.belief is not None
            location = np.where(team.ready, team.location, BASE)
            for k, visited in enumerate(self.visited):
                at = np.flatnonzero(team.active[:, k])
                here = np.where((location[at] == k).any(axis=1), HERE, AWAY)
                visited.append((team.step, team.x[at, k], here, team.belief[at, k]))
        return self.policy(team)

    def of(self, places: tuple[int, ...], visits: AttentionSubproblem) -> tuple[NDArray[np.int64], Floats]:
        """Return the subproblem's states and visited beliefs of the people at some places, the latest steps first.

        Beliefs that differ by less than 1/200 in each entry count as equal.
        """
        found = [one for place in places for one in self.visited[place] if len(one[1])]
        if not found:
            return np.empty(0, dtype=np.int64), np.empty((0, *visits.pomdp.prior.shape))
        states = np.concatenate([visits.layout.number(step, here, x) for step, x, here, _ in found])
        steps = np.concatenate([np.full(len(x), step) for step, x, _, _ in found])
        beliefs = np.concatenate([belief for *_, belief in found])
        rounded = np.column_stack([states, np.rint(beliefs.reshape(len(states), -1) / (1 / 200))])
        first = np.unique(rounded.astype(np.int32), axis=0, return_index=True)[1]
        first = first[(states[first] >= 0) & ~visits.pomdp.ends[states[first]]]
        first = first[np.argsort(-steps[first], kind="stable")]
        return states[first], beliefs[first]
