"""A person's recorded choices with their costs: how much worse than the best each choice is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo
from planner.system.arrays import read_only
from planner.system.results import ByContent, Result

from ..people.decision import NOTHING, Floats
from ..people.hidden_type import KNOWN
from ..people.same_costs import same_cost
from ..people.sights import Sights
from .replay import Recording

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class Chances(ByContent):
    """The probability of each choice at each step, without suggestions and lapses; N steps of up to A choices.

    Attributes
    ----------
    beta : float array, shape (G,)
        Ascending values.
    chance : float array, shape (N, A, G)
    """

    beta: Floats
    chance: Floats

    def __post_init__(self) -> None:
        read_only(self)

    def at(self, beta: float) -> Floats:
        """Return the probabilities for one beta, shape (N, A)."""
        low = int(np.clip(np.searchsorted(self.beta, beta) - 1, 0, len(self.beta) - 2))
        share = np.clip((beta - self.beta[low]) / (self.beta[low + 1] - self.beta[low]), 0.0, 1.0)
        return (1 - share) * self.chance[:, :, low] + share * self.chance[:, :, low + 1]


@dataclass(frozen=True, eq=False, repr=False)
class UnknownGoals(ByContent):
    """A person's choices of N steps with each of G goals, one of which they pursue in each episode.

    Attributes
    ----------
    names : tuple of str
    prior : float array, shape (G,)
        Probability of each goal in an episode.
    each : tuple of Observations
        The same choices with each goal.
    reached : bool array, shape (G, N)
        Whether each goal holds before each choice, so that the choice is a lapse.
    """

    names: tuple[str, ...]
    prior: Floats
    each: tuple[Observations, ...]
    reached: NDArray[np.bool_]

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def distinguished(self) -> bool:
        """Whether goals are summed within each episode; for a goal that is known, all episodes are added at once."""
        return KNOWN not in self.names


@dataclass(frozen=True, eq=False, repr=False)
class EvaluatedStates(ByContent):
    """Cost-to-go and plan lengths of n states to which choices lead.

    Attributes
    ----------
    h : float array, shape (n,)
        h*, infinite in dead ends; NaN if unknown.
    lengths : float array, shape (n,), or None
        Number of actions of the shortest optimal plan (`CostToGo.plan_lengths`); infinite if unknown. None if no action
        is free.
    """

    h: Floats
    lengths: Floats | None

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(cls, costs: CostToGo, states: Ints, h: Floats, at: Ints, size: int) -> EvaluatedStates:
        """Return the data of `size` states, of which some have been evaluated.

        These have the numbers `states` in the task, their h* (NaN if unknown), and the positions `at`, each of shape
        (N,).
        """
        known = ~np.isnan(h)
        own, lengths = np.full(size, np.nan), None
        own[at] = h
        if 0 in costs.task.costs:
            lengths = np.full(size, np.inf)
            lengths[at[known]] = costs.plan_lengths(states[known])
        return cls(own, lengths)


@dataclass(frozen=True, eq=False, repr=False)
class Observations(Result):
    """One person's recorded choices; N steps of up to A choices.

    Attributes
    ----------
    person : str
    episodes : tuple of str
        The names of their episodes.
    excess : float array, shape (N, A)
        Q(x, a) - min over a' of Q(x, a'), in cost units, with h* in place of h. Infinite for an avoidable action into a
        dead end, 0 if all actions lead to one.
    optimal : bool array, shape (N, A)
        Whether an optimal plan begins with the choice (`planner.optimal_choices`); if actions are free, an optimal plan
        with the fewest actions.
    applicable : bool array, shape (N, A)
    targets : int array, shape (N, A)
        Successor of each choice.
    ahead : float array, shape (N, A)
        h* of the successors.
    chosen, suggested : int arrays, shape (N,)
        Slots; `NOTHING` without a suggestion.
    gain : float array, shape (N,)
        V(x_r) - V(x) of the suggested action, in cost units; 0 without a suggestion.
    begins : bool array, shape (N,)
        Whether an episode begins at each step.
    state : int array, shape (N,)
    cost_to_go : float array, shape (N,)
        h* of the state.
    goal : bool array, shape (N, A)
        Whether each successor is a goal state.
    terms : tuple of str
        Names of the terms.
    features : float array, shape (N, A, terms)
        Value of each term for each choice.
    own : Chances, optional
        Choice probabilities of a user's choice model; None if people choose by cost-to-go.
    unknown_goal : UnknownGoals, optional
        The choices with each possible goal; None if the goal is known: whoever reads `goals` has one or several in the
        same form. What depends on the goal in other fields then belongs to one goal for each episode.
    seen : Sights
        What the person saw of suggestions to neighbours (`neighbours_in_logs.with_neighbours`).
    simulated : bool
        Whether the log is that of a simulation, in which each episode begins with theta_0 (`Log.simulated`).
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
    unknown_goal: UnknownGoals | None = None
    seen: Sights = field(default_factory=Sights.of)
    simulated: bool = False

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.chosen)

    @property
    def goals(self) -> UnknownGoals:
        """The choices with each goal; a goal that is known is the only one."""
        if self.unknown_goal is not None:
            return self.unknown_goal
        return UnknownGoals((KNOWN,), np.ones(1), (self,), np.zeros((1, len(self)), dtype=bool))

    def by_goal(self, name: str) -> NDArray[Any]:
        """Return an attribute with each goal, with a first axis of length G."""
        return np.stack([getattr(each, name) for each in self.goals.each])

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each action: its episode, state and h*, its excess cost, and whether it was advised."""
        number, told = self.begins.cumsum() - 1, self.suggested != NOTHING
        return [
            {
                "person": self.person, "episode": self.episodes[episode], "state": state, "cost_to_go": h,
                "excess": excess, "mistake": mistake, "suggested": heard, "followed": followed if heard else None,
            }
            for episode, state, h, excess, mistake, heard, followed in zip(
                number.tolist(), self.state.tolist(), self.cost_to_go.tolist(), self.regret.tolist(),
                self.mistake.tolist(), told.tolist(), (self.chosen == self.suggested).tolist(), strict=True,
            )
        ]  # fmt: skip

    @property
    def regret(self) -> Floats:
        """The excess cost of each action over the best one, shape (N,)."""
        return self.excess[np.arange(len(self)), self.chosen]

    @property
    def mistake(self) -> NDArray[np.bool_]:
        """Whether each action was not an optimal choice, shape (N,)."""
        return ~self.optimal[np.arange(len(self)), self.chosen]

    @property
    def mistakes_by_goal(self) -> NDArray[np.bool_]:
        """Whether each action was a mistake with each goal, shape (G, N): not an optimal choice, or after the goal."""
        return self.goals.reached | ~self.by_goal("optimal")[:, np.arange(len(self)), self.chosen]

    @property
    def suboptimal(self) -> int:
        """The number of actions that were not optimal choices."""
        return int(self.mistake.sum())


def observe(
    recording: Recording,
    known: EvaluatedStates,
    goal: NDArray[np.bool_],
    terms: tuple[str, ...] = (),
    features: Floats | None = None,
) -> list[Observations]:
    """Return each person's observations, in the order of `recording.people`.

    Parameters
    ----------
    recording : Recording
    known : EvaluatedStates
        Data of the states that `recording.wanted()` returns; others are not read.
    goal : bool array, shape (states,)
        Whether each state is a goal state.
    terms : tuple of str
        Names of the terms.
    features : float array, shape (N, A, terms), optional
        Value of each term for each choice.
    """
    r = recording
    features = np.zeros((*r.applicable.shape, 0)) if features is None else features
    ahead = np.where(r.applicable, known.h[r.targets], np.inf)
    q = np.where(r.applicable, r.costs + ahead, np.inf)
    best = q.min(axis=1, initial=np.inf)
    with np.errstate(invalid="ignore"):
        excess = np.where(np.isinf(best)[:, None], 0.0, q - best[:, None])
    excess = np.where(r.applicable, excess, np.inf)
    optimal = same_cost(q, best[:, None])
    if known.lengths is not None:
        length = np.where(optimal, known.lengths[r.targets], np.inf)
        optimal &= length == length.min(axis=1, keepdims=True)
    rows = np.arange(len(r))
    told = r.suggested != NOTHING
    # V = -h*, because the exact cost-to-go equals the smallest Q.
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
