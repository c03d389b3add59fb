"""What a person could choose from and what they chose, in costs: how much worse than the best each choice is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.arrays import outline, read_only

from ..people.decision import NOTHING, Floats
from .replay import Recording

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Chances:
    """The chance of each choice at each step, without suggestions and lapses; N steps of up to A choices.

    Attributes
    ----------
    beta : float array, shape (G,)
        Ascending.
    chance : float array, shape (N, A, G)
    """

    beta: Floats
    chance: Floats

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def at(self, beta: float) -> Floats:
        """Return the chances for one beta, shape (N, A)."""
        low = int(np.clip(np.searchsorted(self.beta, beta) - 1, 0, len(self.beta) - 2))
        share = np.clip((beta - self.beta[low]) / (self.beta[low + 1] - self.beta[low]), 0.0, 1.0)
        return (1 - share) * self.chance[:, :, low] + share * self.chance[:, :, low + 1]


@dataclass(frozen=True)
class EvaluatedStates:
    """What is known of the states that choices lead to; n states.

    Attributes
    ----------
    h : float array, shape (n,)
        h*, infinite at dead ends; NaN where it is not known.
    lengths : float array, shape (n,), or None
        How many actions the shortest of the cheapest plans has, as `CostToGo.plan_lengths` counts; infinite where that
        is not known, None where no action is free.
    """

    h: Floats
    lengths: Floats | None

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, costs: CostToGo, states: Ints, h: Floats, at: Ints, size: int) -> EvaluatedStates:
        """Take in h* of some states, shape (N,), NaN where it is not known; `at` are their places among all."""
        known = ~np.isnan(h)
        own, lengths = np.full(size, np.nan), None
        own[at] = h
        if 0 in costs.task.costs:
            lengths = np.full(size, np.inf)
            lengths[at[known]] = costs.plan_lengths(states[known])
        return cls(own, lengths)


@dataclass(frozen=True)
class Observations:
    """What one person could choose from and what they chose; N steps of up to A choices.

    Attributes
    ----------
    person : str
    episodes : tuple of str
        The names of their episodes.
    excess : float array, shape (N, A)
        Q(x, a) - min over a' of Q(x, a'), in cost units, for h* in place of h: how much an action costs more than
        the best. Infinite for a needless action into a dead end, 0 where all actions lead to one.
    optimal : bool array, shape (N, A)
        Whether a cheapest way to the goal begins with the choice, as `planner.optimal_choices` has it: where actions
        are free, one with the fewest actions.
    applicable : bool array, shape (N, A)
    targets : int array, shape (N, A)
        The state after each choice.
    ahead : float array, shape (N, A)
        h* of the targets.
    chosen, suggested : int arrays, shape (N,)
        Slots; `NOTHING` where nothing was suggested.
    gain : float array, shape (N,)
        V(x_r) - V(x) of the suggested action, in cost units; 0 where nothing was suggested.
    begins : bool array, shape (N,)
        Where an episode begins.
    state : int array, shape (N,)
    cost_to_go : float array, shape (N,)
        h* of the state.
    goal : bool array, shape (N, A)
        Which targets are goal states.
    terms : tuple of str
        What besides cost may speak for a choice.
    features : float array, shape (N, A, terms)
        How much of it each choice has.
    own : Chances, optional
        The chance of each choice under a choice model of one's own; None: they choose by cost-to-go.
    """

    person: str
    episodes: tuple[str, ...]
    excess: Floats
    optimal: NDArray[np.bool_]
    applicable: NDArray[np.bool_]
    targets: Ints
    ahead: Floats
    chosen: Ints
    suggested: Ints
    gain: Floats
    begins: NDArray[np.bool_]
    state: Ints
    cost_to_go: Floats
    goal: NDArray[np.bool_]
    terms: tuple[str, ...]
    features: Floats
    own: Chances | None = None

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.chosen)

    @property
    def regret(self) -> Floats:
        """What each action cost more than the best one, shape (N,)."""
        return self.excess[np.arange(len(self)), self.chosen]

    @property
    def mistake(self) -> NDArray[np.bool_]:
        """Whether each action was not an optimal choice, shape (N,)."""
        return ~self.optimal[np.arange(len(self)), self.chosen]

    @property
    def suboptimal(self) -> int:
        """How many actions were not optimal choices."""
        return int(self.mistake.sum())


def observe(
    recording: Recording,
    known: EvaluatedStates,
    goal: NDArray[np.bool_],
    terms: tuple[str, ...] = (),
    features: Floats | None = None,
) -> list[Observations]:
    """Give each person's observations, in the order of `recording.people`.

    Parameters
    ----------
    recording : Recording
    known : EvaluatedStates
        Of the states that `recording.wanted()` names; others are not read.
    goal : bool array, shape (states,)
        Which of them are goal states.
    terms : tuple of str
        The names of what besides cost may speak for a choice.
    features : float array, shape (N, A, terms), optional
        How much of it each choice has.
    """
    r = recording
    features = np.zeros((*r.applicable.shape, 0)) if features is None else features
    ahead = np.where(r.applicable, known.h[r.targets], np.inf)
    q = np.where(r.applicable, r.costs + ahead, np.inf)
    best = q.min(axis=1, initial=np.inf)
    with np.errstate(invalid="ignore"):
        excess = np.where(np.isinf(best)[:, None], 0.0, q - best[:, None])
    excess = np.where(r.applicable, excess, np.inf)
    optimal = np.isfinite(q) & (q == best[:, None])
    if known.lengths is not None:
        length = np.where(optimal, known.lengths[r.targets], np.inf)
        optimal &= length == length.min(axis=1, keepdims=True)
    rows = np.arange(len(r))
    told = r.suggested != NOTHING
    # V = -h*: the cost-to-go is exact, so that it equals the smallest Q.
    expected = np.where(told, ahead[rows, np.maximum(r.suggested, 0)], best)
    with np.errstate(invalid="ignore"):
        gain = np.where(expected == best, 0.0, best - expected)
    begins = np.ones(len(r), dtype=bool)
    begins[1:] = r.episode[1:] != r.episode[:-1]
    result = []
    for number, person in enumerate(r.people):
        own = r.person == number
        names = tuple(r.episodes[e] for e in r.episode[own & begins])
        result.append(
            Observations(
                person, names, excess[own], optimal[own], r.applicable[own], r.targets[own], ahead[own], r.chosen[own],
                r.suggested[own], gain[own], begins[own], r.state[own], best[own],
                goal[r.targets[own]] & r.applicable[own], terms, features[own],
            )
        )  # fmt: skip
    return result
