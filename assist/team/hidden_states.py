"""Teams of people whose task states the robot knows in part, since it does not see every action as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.joint_belief import JointBelief, same_suggestions
from ..person.policy import Policy
from .state import Ask, TeamState, by_model


@dataclass(frozen=True)
class HiddenTeamState(TeamState):
    """The robot's knowledge of people whose task states are hidden; `x` has the most probable one of each.

    Answers about a person are expected values over the possible states (QMDP). A suggestion is one that is applicable
    in the most probable state. Where it is not applicable, it costs the same and has no effect. The belief in each
    person is that in their type, over all states.

    Attributes
    ----------
    joint : sequence of JointBelief
        The belief in each person, in the order of the flattened arrays.
    """

    joint: Sequence[JointBelief]

    @classmethod
    def of(cls, team: TeamState, joint: Sequence[JointBelief]) -> HiddenTeamState:
        """Return a team with the beliefs in its people."""
        return cls(**{field.name: getattr(team, field.name) for field in fields(TeamState)}, joint=joint)

    def of_each(self, ask: Ask) -> Floats:
        """Return the expected answers about each person, as `TeamState.of_each` does."""
        found = [
            (rows, expected_answers(ask, self.policies[group], self.x.ravel()[rows], [self.joint[n] for n in rows]))
            for group, rows in by_model(self.model.ravel(), np.flatnonzero(self.active), len(self.policies))
        ]
        values = np.full((self.x.size, max((each.shape[1] for _, each in found), default=1)), -np.inf)
        for rows, each in found:
            values[rows, : each.shape[1]] = each
        return values.reshape(*self.x.shape, -1)


def expected_answers(ask: Ask, policy: Policy, x: NDArray[np.int64], joint: Sequence[JointBelief]) -> Floats:
    """Return the expected answers about some people, shape (N, W), over the states that are possible for each.

    With R robot actions, the last R - 1 columns of an answer are those of suggestions, if it has R columns or more, and
    the one before is that of a robot that is there and says nothing. The columns of suggestions are arranged as in the
    states `x`.

    Parameters
    ----------
    ask : Ask
    policy : Policy
    x : int array, shape (N,)
        A state of each person.
    joint : sequence of JointBelief
    """
    pomdp = policy.pomdp
    person = np.repeat(np.arange(len(x)), [len(one.x) for one in joint])
    states, weight = np.concatenate([one.x for one in joint]), np.concatenate([one.probability for one in joint])
    answers = ask(policy, states, np.concatenate([one.joint for one in joint]) / weight[:, None, None])
    suggestions = pomdp.suggested.shape[1] - 1
    head = answers.shape[1] - suggestions
    if head >= 1 and suggestions:
        there = same_suggestions(pomdp, x[person], states)[:, 1:]
        silent = answers[:, head - 1, None] - pomdp.robot_costs[x[person], 1:]
        said = np.where(there > 0, np.take_along_axis(answers, head - 1 + there, axis=1), silent)
        offered = np.arange(1, suggestions + 1) < pomdp.robot_actions[x[person], None]
        answers = np.concatenate([answers[:, :head], np.where(offered, said, -np.inf)], axis=1)
    values = np.zeros((len(x), answers.shape[1]))
    np.add.at(values, person, weight[:, None] * answers)
    return values
