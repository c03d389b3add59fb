"""What a suggestion is worth beside its person: the expected effect on those who see it.

A suggestion r to person k has answers a with probabilities P(a | b_k, r) under the belief in k. Each of them moves the
belief in a neighbour j who sees it, to b_j' (`people.neighbourhood`). One step ahead, the suggestion is worth for them

    gamma sum_a P(a | b_k, r) sum_j (V_j(x_j, b_j') - V_j(x_j, b_j)),

with V_j the largest Q-value of j's own problem in their present state. `AttentionWithOutlook` adds it to the score of
Algorithm 1, and `Priority` to the value of presence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..people.neighbourhood import each_once
from ..person.policy import Policy
from .attention import AttentionSwitching
from .seen import gained
from .state import TeamState

Ints = NDArray[np.int64]

Value = Callable[[Policy, Ints, Floats], Floats]
"""Returns the values of people of a policy in some rows, shape (m,), under beliefs, shape (m, H, T)."""

AT_A_TIME = 50_000
"""Number of moved beliefs that are in memory together."""


def outlook(team: TeamState, actions: int, value: Value) -> Floats:
    """Return what the first R robot actions towards each person are worth for those who see it, shape (N, K, R).

    Where nobody sees anybody, the shape is (1, 1, R).

    Parameters
    ----------
    team : TeamState
    actions : int
        R, the number of robot actions.
    value : callable
        Values of people.
    """
    (n, people), seen = team.x.shape, team.beliefs.neighbours.believed
    if not seen.watched.any():
        return np.zeros((1, 1, actions))
    found, shown = np.zeros((n * people, actions)), np.zeros((n, people), dtype=bool)
    shown[:, : len(seen.watched)] = seen.watched
    for group, every in team.by_policy():
        flat = every[shown.reshape(-1)[every]]
        policy, (x, belief) = team.policies[group], team.known_of(flat)
        chance, gain = _answers(policy, x, belief, actions)
        which, slot, follows = np.nonzero(chance.any(axis=1))
        told = flat[which]
        at, onlooker, sees = seen.onlookers(told % people, team.active[told // people])
        effect = _effects(
            team, told[at] // people * people + onlooker, gain[which[at], slot[at]], follows[at] == 1, sees, value
        )
        each = np.bincount(at, effect, minlength=len(told))
        by_answer = np.zeros((len(flat), *chance.shape[2:]))
        by_answer[which, slot, follows] = each
        found[flat] = policy.pomdp.gamma * np.einsum("nraf,naf->nr", chance, by_answer)
    return found.reshape(n, people, actions)


def _answers(policy: Policy, x: Ints, belief: Floats, actions: int) -> tuple[Floats, Floats]:
    """Return how likely people's answers to suggestions are, shape (m, R, A, 2), and what comes of them, shape (m, A).

    The last axis says whether the suggestion is followed. Robot actions that suggest nothing have zeros.
    """
    pomdp = policy.pomdp
    applicable, targets = pomdp.model.choices.applicable[x], pomdp.model.choices.targets[x]
    suggested = pomdp.suggested[x, :actions]
    chance = np.zeros((len(x), actions, applicable.shape[1], 2))
    for action in range(1, suggested.shape[1]):
        row, slot = np.nonzero(applicable & (suggested[:, action, None] != NOTHING))
        p = pomdp.likelihood(x[row], np.full(len(row), action), slot)
        follows = (slot == suggested[row, action]).astype(np.int64)
        chance[row, action, slot, follows] = np.einsum("nht,nht->n", p, belief[row])
    gain, (row, slot) = np.zeros(applicable.shape), np.nonzero(applicable & (chance.any(axis=(1, 3))))
    gain[row, slot] = gained(policy, x[row], targets[row, slot])
    return chance, gain


def _effects(
    team: TeamState, flat: Ints, gain: Floats, followed: NDArray[np.bool_], sees: Floats, value: Value
) -> Floats:
    """Return by how much the values of people change who see suggestions to neighbours, all arrays of shape (m,).

    People are given as indices of the flattened arrays. What is the same for a person is computed once.
    """
    flat, event, inverse = each_once(flat, gain, followed, sees)
    effect, model = np.zeros(len(flat)), team.model.reshape(-1)[flat]
    for group in np.unique(model).tolist():
        policy, mine = team.policies[group], np.flatnonzero(model == group)
        for part in np.split(mine, range(AT_A_TIME, len(mine), AT_A_TIME)):
            seen, (x, belief) = event.of(part), team.known_of(flat[part])
            after = team.beliefs.neighbours.after(belief, policy.pomdp.grid, seen)
            effect[part] = value(policy, x, after) - value(policy, x, belief)
    return effect[inverse]


@dataclass(frozen=True)
class AttentionWithOutlook(AttentionSwitching):
    """Algorithm 1 with the expected effect on those who see a suggestion as a part of its score.

    Without neighbours who see each other it is Algorithm 1.
    """

    def values(self, team: TeamState, q: Floats) -> Floats:
        """Return the Q-values and what those who see it gain, in the shape of `q`."""
        return q + self.beside(team, q.shape[3])[:, None]

    def beside(self, team: TeamState, actions: int) -> Floats:
        """Return what the first R robot actions are worth beside each person, as in `outlook`."""
        return outlook(team, actions, Policy.value)
