"""Trust rules other than equation (7), by which people's own theta moves in a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..people.perceived_suggestions import PerceivedSuggestions, moved
from ..people.trust_rules import TrustRule, may_move
from ..person.dynamics import act
from ..person.people_arrays import Minds, PeopleArrays
from ..person.problem_arrays import ProblemArrays


@dataclass(frozen=True)
class TrustOfPeople:
    """The trust rule of some people.

    Attributes
    ----------
    rule : TrustRule
    perceived : float array, shape (m, n, A)
        Perceived costs of each row of `Minds`.
    optimal : bool array, shape (n, A, G)
        Whether each choice is optimal for each goal.
    """

    rule: TrustRule
    perceived: Floats
    optimal: NDArray[np.bool_]

    def act(self, flat: NDArray[np.int64], them: PeopleArrays, minds: Minds, arrays: ProblemArrays) -> None:
        """Let some people, all of one model, act once; theta moves by the rule.

        Parameters
        ----------
        flat : int array
            Their indices in the arrays.
        them : PeopleArrays
        minds : Minds
            Their choices, with a rate of 0 for equation (7).
        arrays : ProblemArrays
            Their problem.
        """
        before, theta, outcomes = them.x[flat], them.theta[flat], them.outcomes[flat]
        act(flat, them, minds, arrays)
        who, heard = them.who[flat], them.heard[flat]
        suggested, value = arrays.suggested[before, heard], minds.value
        moving = np.flatnonzero(may_move(self.rule, suggested != NOTHING) & (them.slot[flat] != NOTHING))
        who, x, suggested = who[moving], before[moving], suggested[moving]
        slot = np.maximum(suggested, 0)
        perceived = PerceivedSuggestions.of(
            self.perceived[who, x, slot], self.perceived[who, x].min(axis=1), value[who, x],
            value[who, arrays.targets[x, slot]], self.optimal[x, slot, minds.goal[who]],
        )  # fmt: skip
        flat = flat[moving]
        event = perceived.event(them.slot[flat] == suggested, self.rule.feedback, suggested != NOTHING)
        them.theta[flat], them.outcomes[flat] = moved(self.rule, theta[moving], outcomes[moving], event)
