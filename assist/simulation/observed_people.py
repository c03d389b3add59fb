"""What the robot sees of people in a simulation in which it misses actions, or takes one for another."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from ..people.belief import ImpossibleObservationError
from ..people.choices import Choices
from ..people.decision import NOTHING, Floats
from ..person.dynamics import PeopleArrays
from ..person.joint_belief import JointBelief, said_in, same_suggestions
from ..person.observation_model import Evidence, ObservationModel
from ..person.policy import Policy
from ..team.hidden_states import HiddenTeamState
from ..team.state import TeamState, by_model
from .common_random_numbers import CommonRandomNumbers
from .model_group import ModelGroup
from .pool import Pool
from .task_view import StepView

Ints = NDArray[np.int64]


class ObservedPeople:
    """The joint beliefs in the people of N teams, as flat lists; the robot sees who has finished.

    Parameters
    ----------
    model : ObservationModel
    x : int array, shape (N, K)
        State of each person, which the robot knows at first.
    belief : float array, shape (N, K, B, T)
        Belief in each of them.
    """

    def __init__(self, model: ObservationModel, x: Ints, belief: Floats) -> None:
        self.model, self.shape = model, x.shape
        each = zip(x.ravel().tolist(), belief.reshape(-1, *belief.shape[2:]), strict=True)
        self.joint = [JointBelief.at(state, one) for state, one in each]
        self.x = x.copy()

    @classmethod
    def of(cls, pool: Pool, model: Ints, x: Ints, belief: Floats | None) -> ObservedPeople:
        """Return the people of some models in states that the robot knows, shape (N, K); by default with the prior.

        Raises
        ------
        ValueError
            Their task is not enumerated.
        """
        assert pool.setting.observation is not None
        for policy in pool.policies:
            policy.require_enumerated("observation")
        if belief is None:
            belief = np.array([policy.pomdp.prior for policy in pool.policies])[model]
        return cls(pool.setting.observation, x, belief)

    @property
    def pruned(self) -> Floats:
        """The probability of states that were left out, summed over the steps of each person, shape (N, K)."""
        return np.array([one.pruned for one in self.joint]).reshape(self.shape)

    @property
    def beliefs(self) -> Floats:
        """The beliefs in people's types, shape (N, K, B, T)."""
        each = np.array([one.belief for one in self.joint])
        return each.reshape(*self.shape, *each.shape[1:])

    def as_known(self, team: TeamState, teams: Ints) -> TeamState:
        """Return some of the teams, given by their numbers, as the robot knows them."""
        people = (teams[:, None] * self.shape[1] + np.arange(self.shape[1])).ravel().tolist()
        return HiddenTeamState.of(team, [self.joint[n] for n in people])

    def heard(self, robot: Ints, x: Ints, model: Ints, policies: Sequence[Policy]) -> tuple[Ints, Ints]:
        """Return what is said to people: as robot actions in the states `x`, and as ground actions, both (N, K).

        Parameters
        ----------
        robot : int array, shape (N, K)
            What is said, as a robot action in the most probable state.
        x, model : int arrays, shape (N, K)
            State of each person, and the index of their policy.
        policies : sequence of Policy
        """
        there, said = np.zeros(x.size, dtype=np.int64), np.full(x.size, NOTHING)
        for number, rows in by_model(model.ravel(), np.flatnonzero(robot), len(policies)):
            pomdp, own, chosen = policies[number].pomdp, self.x.ravel()[rows], robot.ravel()[rows, None]
            there[rows] = np.take_along_axis(same_suggestions(pomdp, own, x.ravel()[rows]), chosen, axis=1)[:, 0]
            said[rows] = np.take_along_axis(said_in(pomdp, own), chosen, axis=1)[:, 0]
        return there.reshape(x.shape), said.reshape(x.shape)

    def observe(
        self, view: StepView, before: Ints, people: PeopleArrays, said: Ints, running: Ints,
        finished: NDArray[np.bool_], erred: NDArray[np.bool_], random_numbers: CommonRandomNumbers,
    ) -> None:  # fmt: skip
        """Update the beliefs in people who have acted and have not reached their goal.

        Parameters
        ----------
        view : StepView
            The step in which they acted.
        before, said : int arrays, shape (N, K)
            State before the action, and the ground action that was suggested.
        people : PeopleArrays
            What they did.
        running : int array
            The teams in which a person is at work.
        finished : bool array, shape (N, K)
        erred : bool array, shape (N, K)
            Receives whether the action was probably no optimal choice.
        random_numbers : CommonRandomNumbers
        """
        uniform = np.zeros((*self.shape, 2))
        for kind in (5, 6):
            uniform[running, :, kind - 5] = random_numbers.draw(kind, running)
        before, said, uniform, erred = before.reshape(-1), said.reshape(-1), uniform.reshape(-1, 2), erred.reshape(-1)
        acted = np.flatnonzero((people.slot >= 0) & ~finished.reshape(-1))
        for number, rows in by_model(view.model.reshape(-1), acted, len(view.policies)):
            choices, group = view.policies[number].pomdp.model.choices, view.groups[number]
            for n in rows.tolist():
                seen = self.model.draw(choices, int(before[n]), int(people.slot[n]), uniform[n])
                self.joint[n] = self._after(self.joint[n], seen, int(said[n]), choices, group)
                self.x.reshape(-1)[n], erred[n] = self.joint[n].likeliest, self.joint[n].erred > 1 / 2

    def _after(
        self, joint: JointBelief, seen: int | None, said: int, choices: Choices, group: ModelGroup
    ) -> JointBelief:
        try:
            return joint.after(self.model.evidence(choices, seen), said, choices, group.arrays, works=True)
        except ImpossibleObservationError:  # the true state was left out; the observation is not used
            with suppress(ImpossibleObservationError):
                return joint.after(Evidence.none(choices), said, choices, group.arrays, works=True)
            return joint
