"""The paper's Algorithm 1 in the reading whose reference is the value of never helping a person again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from ..people.decision import Floats
from ..person.policy import OfRows, Policy
from .attention import AttentionSwitching
from .by_policy import ByPolicy
from .state import TeamState


@dataclass(frozen=True)
class AttentionAgainstNever(AttentionSwitching):
    """Algorithm 1 with the value of never helping a person again as the reference of their score.

    Attributes
    ----------
    never : ByPolicy of functions
        This value in rows, for known type and theta.
    """

    never: ByPolicy[OfRows]

    @classmethod
    def of(cls, policies: Sequence[Policy]) -> AttentionAgainstNever:
        """Return the team policy for people with the given policies."""
        return cls(ByPolicy(policies, attrgetter("unhelped")))

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        policy.prepare()
        self.never[policy]

    def reference(self, team: TeamState, _q: Floats) -> Floats:
        """Return the value of never helping each person, shape (N, 1, K)."""
        return team.of_each(self._if_never)[:, None, :, 0]

    def _if_never(self, policy: Policy, x: NDArray[np.int64], belief: Floats) -> Floats:
        weighed = policy.pomdp.hidden.acted_on(belief)
        return np.einsum("nht,nht->n", self.never[policy](x), weighed)[:, None]
