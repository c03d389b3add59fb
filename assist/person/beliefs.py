"""What a robot knows of people's tasks and types, and how it learns from what they do and say.

There is one interface with two storages. `KnownStates` is for people whose task states are known: dense arrays, which
change by `belief_update.update_readable`. `UncertainStates` is for people whose actions may be missed or confused: it
adds a distribution over task states for each person whose state is uncertain. In both, the type is uncertain, and with
it a goal that is unknown. `team.goal_knowledge` and live teams choose a storage when they begin. Who holds beliefs
later does not ask which of the two they are:

- `observe` updates them by a step of a simulation, `update` by actions that were seen as they are;
- `answered` updates them by an answer, whose likelihood under each type is known;
- `expected` answers a question about people, as an expected value over what is uncertain;
- `x` has the most probable state of each person, `belief` the belief in their type, and `erred` whether their last
  action was probably a mistake; `finished` is the probability that they have reached their goal.

People have numbers from 0 to P - 1, in the order of the arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

from ..people.choices import Choices
from ..people.decision import Bools, Floats, Ints
from ..people.neighbourhood import Neighbourhood
from .joint_belief import JointBelief
from .policy import Policy
from .pomdp import AssistPOMDP
from .problem_arrays import Acts, ProblemArrays, read_only

Ask = Callable[[Policy, Ints, Floats], Floats]
"""A function of a policy, states, shape (m,), and beliefs, shape (m, H, T), that returns numbers, shape (m, W)."""


@dataclass(frozen=True, eq=False)
class PersonModel:
    """The robot's model of a person, in which beliefs about them are updated.

    Attributes
    ----------
    policy : Policy
        Their policy, whose problem on all rows so far is that of the other attributes.
    pomdp : AssistPOMDP
    arrays : ProblemArrays
        The problem, as compiled code reads it.
    optimal : bool array, shape (n, A, G)
        Whether each choice is optimal for each goal.
    possible : float array, shape (H, 1)
        Probability of each type at the beginning: what a robot without beliefs knows.
    """

    policy: Policy
    pomdp: AssistPOMDP
    arrays: ProblemArrays
    optimal: Bools
    possible: Floats

    @classmethod
    def of(cls, policy: Policy) -> PersonModel:
        """Return the model of a policy's person."""
        pomdp, arrays = policy.pomdp, policy.arrays
        possible = read_only(pomdp.prior.sum(axis=1, keepdims=True))
        return cls(policy, pomdp, arrays, read_only(pomdp.model.choices.goals.optimal), possible)

    @property
    def choices(self) -> Choices:
        """The choices in each state."""
        return self.pomdp.model.choices


Groups = Iterable[tuple[PersonModel, Ints]]
"""Models, with the numbers of the people who have each."""


class Beliefs(Protocol):
    """What a robot knows of P people; see the module's docstring.

    `neighbours` is what the people of each team see of each other, whether or not the robot knows of it. Its `believe`
    moves theta in `belief` by that.
    """

    x: Ints
    belief: Floats
    erred: Bools
    neighbours: Neighbourhood

    def observe(self, acts: Acts, said: Ints, groups: Groups, draw: Callable[[int], Floats]) -> None:
        """Update the beliefs in people who have acted, given by their models and numbers.

        Parameters
        ----------
        acts : Acts
            What all P people did.
        said : int array, shape (P,)
            What the robot meant to say: a robot action in the most probable state.
        groups : iterable of pairs of PersonModel and int array
        draw : callable
            Returns uniform numbers, shape (P,), of a `Stream`.
        """
        ...

    def update(self, people: Ints, acts: Acts, model: PersonModel) -> None:
        """Update the beliefs in some people of one model, shape (m,), by actions that were seen as they are."""
        ...

    def answered(self, person: int, likelihood: Floats, policy: Policy) -> None:
        """Update the belief in a person with a policy by an answer.

        Parameters
        ----------
        person : int
        likelihood : float array
            Likelihood of the answer, in a shape that broadcasts with (S, H, T), for S states.
        policy : Policy

        Raises
        ------
        ImpossibleObservationError
            The answer has probability 0. Nothing has changed.
        """
        ...

    def expected(self, ask: Ask, policy: Policy, people: Ints) -> Floats:
        """Return the answers about some people of one policy, shape (m, W), expected over what is uncertain.

        Parameters
        ----------
        ask : Ask
        policy : Policy
        people : int array, shape (m,)
            Their numbers, ascending.
        """
        ...

    def finished(self, person: int, policy: Policy) -> float:
        """Return the probability that a person with a policy has reached their goal."""
        ...

    def heard(self, said: Ints, x: Ints, groups: Iterable[tuple[AssistPOMDP, Ints]]) -> Ints:
        """Return what people hear: robot actions in their states `x`, shape (P,), of those in the most probable one."""
        ...

    def joint(self, person: int, policy: Policy) -> JointBelief:
        """Return the belief in a person with a policy, over situations and types together."""
        ...

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out, summed over the updates of each person, shape (P,)."""
        ...

    def of(self, people: Ints) -> Beliefs:
        """Return the beliefs in some people, given by their numbers; changes of these do not show there."""
        ...

    @property
    def sees_states(self) -> bool:
        """Whether all actions are seen as they are, so that task states are known."""
        ...
