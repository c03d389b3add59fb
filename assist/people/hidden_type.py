"""What is hidden and fixed about a person: one axis of H types with named parts.

A person has a goal and an expertise beta, which the robot does not know and which do not change while they work on a
task. A *type* is a value of each of these parts; the types are all combinations, in the order of the parts, and the
last part changes fastest. What is hidden and moves is theta, on T cells. So a belief about a person has the shape
(H, T), and `HiddenType.marginal` returns the distribution of one part.

Everything that depends on a person's type is an array with an axis of types: the probabilities of choices are
`chosen[n, A, H]`. Arrays that depend on the goal alone have an axis of G goals (`OfGoals`), and `goal_of[H]` leads from
one to the other. A goal that is known is a prior with one goal: formulas do not ask whether it is known.

What is about goals in particular stands here, or in `type_kernels` for compiled code:

- The robot sees that a person goes on. So no goal that is reached in their state is theirs
  (`person.belief_update.without_reached`; in compiled code `leave_out_reached` and `exclude_reached`).
- A mistake is an action that is optimal for no goal that is still possible (`type_kernels.is_mistake`).
- QMDP counts the goal as known from the next step on, so that waiting seems too good. The robot therefore acts on
  sharper probabilities of goals, or on the most probable goal alone (`HiddenType.acted_on`).
- What is known for each goal is averaged over the goals (`mean_over_goals`).
- Whether there is anything to know, to ask or to show about goals is `several`, and nothing else counts them.

A further part, such as a workload, is one more entry of `HiddenType.parts`, with its effect on `expertise` and its
probabilities in `prior`: in a class of one's own, which `person.Assumptions` takes, as `docs/contributing.md` shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sized
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import frozen, outline, read_only

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

KNOWN = ""
"""The name of a goal that is known."""


def is_certain(probability: float | Floats) -> bool | Bools:
    """Return whether a sum of probabilities is 1, up to rounding."""
    return probability > 1 - 1e-9


@dataclass(frozen=True, eq=False)
class OfGoals:
    """What differs between the goals of which a person pursues one, in n states with up to A choices each.

    Attributes
    ----------
    prior : mapping of str to float
        Probability of each of the G goals at the beginning of a task, by the goal's name.
    h : float array, shape (G, n)
        Exact cost-to-go, infinite in dead ends.
    goal : bool array, shape (G, n)
        Whether the goal is reached.
    optimal : bool array, shape (n, A, G)
        Whether an optimal plan can begin with the action.
    assume_likeliest : bool
        Whether the robot acts as if the most probable goal were certain.
    sharpness : float
        Power to which the robot raises the goals' probabilities before it averages its values over the goals.
    """

    prior: Mapping[str, float]
    h: Floats
    goal: Bools
    optimal: Bools
    assume_likeliest: bool = False
    sharpness: float = 1.0

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.prior)

    def of_rows(self, rows: Ints) -> OfGoals:
        """Return the arrays of some of the states, given by their numbers."""
        return replace(self, h=self.h[:, rows], goal=self.goal[:, rows], optimal=self.optimal[rows])

    @property
    def distinguished(self) -> bool:
        """Whether there are several; see `several`."""
        return several(self.prior)

    @property
    def names(self) -> tuple[str, ...]:
        """The goals' names."""
        return tuple(self.prior)

    def shown(self, goal: int) -> str | None:
        """Return the name of a goal, by its number; None if it is known, so that people need no name for it."""
        return self.names[goal] if self.distinguished else None


def several(goals: Sized) -> bool:
    """Return whether a person's goal is one of several.

    Then the robot needs beliefs to know what is optimal for them, and may ask. Where the code for several goals does
    the same for one, it does not ask this.
    """
    return len(goals) > 1


@dataclass(frozen=True, eq=False)
class HiddenType:
    """The types of a person; see the module's docstring.

    Attributes
    ----------
    goals : mapping of str to float
        Prior probability of each goal.
    beta : float array, shape (B,)
        The values of beta that are distinguished.
    assume_likeliest, sharpness
        As in `OfGoals`.
    """

    goals: Mapping[str, float]
    beta: Floats
    assume_likeliest: bool = False
    sharpness: float = 1.0

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @cached_property
    def parts(self) -> Mapping[str, int]:
        """The number of values of each part, in the order of the parts."""
        return {"goal": len(self.goals), "beta": len(self.beta)}

    def __len__(self) -> int:
        return math.prod(self.parts.values())

    @property
    def distinguishes_goals(self) -> bool:
        """Whether types differ by their goals; see `several`."""
        return several(self.goals)

    def part(self, name: str) -> Ints:
        """Return the number of the value that each type has of a part, shape (H,)."""
        number = list(self.parts).index(name)
        return frozen(np.unravel_index(np.arange(len(self)), tuple(self.parts.values()))[number])

    @cached_property
    def goal_of(self) -> Ints:
        """The number of each type's goal, shape (H,)."""
        return self.part("goal")

    @cached_property
    def expertise(self) -> Floats:
        """The expertise with which a person of each type chooses, shape (H,): the argument of a choice model."""
        return frozen(self.beta[self.part("beta")])

    def prior(self, person: Floats) -> Floats:
        """Return the belief at first, shape (H, T), in a person with a belief in beta and theta, shape (B, T)."""
        return self.with_goals(person)

    def with_theta(self, belief: Floats, part: str) -> Floats:
        """Return the beliefs in a part and theta, shape (..., V, T), under beliefs, shape (..., H, T)."""
        sizes, at = list(self.parts.values()), list(self.parts).index(part)
        split = belief.reshape(*belief.shape[:-2], math.prod(sizes[:at]), sizes[at], -1, belief.shape[-1])
        return np.asarray(split.sum(axis=(-4, -2)))

    def marginal(self, belief: Floats, part: str) -> Floats:
        """Return the distribution of a part, shape (..., V), under beliefs, shape (..., H, T)."""
        return np.asarray(self.with_theta(belief, part).sum(axis=-1))

    def share_of_goals(self, belief: Callable[[], Floats]) -> Floats:
        """Return the probability of each goal, shape (..., G), under beliefs; (1,) without these for a known goal."""
        return self.marginal(belief(), "goal") if self.distinguishes_goals else np.ones(1)

    def goals_shown(self, belief: Floats) -> dict[str, float]:
        """Return the probability of each goal under a belief, shape (H, T); nothing if the goal is known."""
        if not self.distinguishes_goals:
            return {}
        return dict(zip(self.goals, self.shown_goals(belief).tolist(), strict=True))

    def shown_goals(self, belief: Floats) -> Floats:
        """Return the probability of each goal, shape (G,), as people are shown it: what is certain is 1 exactly."""
        share = self.marginal(belief, "goal")
        return np.where(is_certain(share), 1.0, share)

    def of_people(self, belief: Floats) -> Floats:
        """Return the belief in what a person keeps in their next task: all parts but the goal, shape (H / G, T)."""
        return np.asarray(belief.reshape(len(self.goals), -1, belief.shape[-1]).sum(axis=0))

    def with_goals(self, person: Floats) -> Floats:
        """Return the belief, shape (H, T), at the beginning of a task, from one in the person, shape (H / G, T)."""
        return np.concatenate([share * person for share in self.goals.values()])

    def given_goal(self, belief: Floats, likelihood: Floats) -> Floats:
        """Return beliefs, shape (..., H, T), times the likelihood of each goal, shape (..., G); not normalised."""
        return np.asarray(belief * likelihood[..., self.goal_of, None])

    def acted_on(self, belief: Floats) -> Floats:
        """Return the beliefs, shape (..., H, T), on which the robot acts; for one goal they are the same."""
        return self.given_likeliest(belief) if self.assume_likeliest else self.sharpened(belief)

    def given_likeliest(self, belief: Floats) -> Floats:
        """Return each belief conditioned on its most probable goal; ties favour the first goal."""
        if not self.distinguishes_goals:
            return belief
        share = self.marginal(belief, "goal")
        best = np.arange(share.shape[-1]) == share.argmax(axis=-1)[..., None]
        return self.given_goal(belief, np.where(best, 1 / np.where(best, share, 1.0), 0.0))

    def sharpened(self, belief: Floats) -> Floats:
        """Return beliefs with the probability of each goal raised to the power `sharpness`."""
        if self.sharpness == 1 or not self.distinguishes_goals:
            return belief
        share = self.marginal(belief, "goal")
        weight = (share / share.max(axis=-1, keepdims=True)) ** self.sharpness
        return self.given_goal(belief, weight / weight.sum(axis=-1, keepdims=True) / np.where(share > 0, share, 1.0))


def mean_over_goals(values: Floats, share: Floats) -> Floats:
    """Return the mean of values of each goal, shape (..., G), weighted by the goals' probabilities."""
    return np.asarray(np.where(share > 0, share * np.where(share > 0, values, 0.0), 0.0).sum(axis=-1))
