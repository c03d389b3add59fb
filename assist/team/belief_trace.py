"""The robot's beliefs during an episode, next to the true parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np

from ..people.arguments import Seed
from ..people.decision import Floats
from ..people.spread import Spread
from ..person.policy import Policy
from .episodes import Episode
from .pool import Pool
from .requested import Conditions
from .simulate import simulate
from .state import TeamAction, TeamPolicy, TeamState
from .trace import Trace, robot_is_at


def belief_of(team: TeamState) -> Floats:
    """Return the beliefs about the people of one team, shape (K, H, T)."""
    assert team.belief is not None
    return team.belief[0].copy()  # the simulation reuses the array


@dataclass(frozen=True)
class Watched:
    """A policy for one team of which something is kept in each step in which it chooses.

    Attributes
    ----------
    policy : TeamPolicy
        The policy that chooses.
    look : callable
        Returns what is kept: the beliefs unless given.
    seen : dict
        What was kept, by step.
    """

    policy: TeamPolicy
    look: Callable[[TeamState], Floats] = belief_of
    seen: dict[int, Floats] = field(default_factory=dict)
    uses_belief = True  # even if the policy itself does not use beliefs

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        if hasattr(self.policy, "prepare"):
            self.policy.prepare(policy)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Look at the team, and return the policy's choice."""
        self.seen[team.step] = self.look(team)
        return self.policy(team)


def beliefs_of_episode(
    pool: Pool,
    policy: TeamPolicy,
    *,
    humans: int | Sequence[int],
    episode: int,
    seed: Seed,
    **conditions: Unpack[Conditions],
) -> tuple[Episode, list[dict[str, Any]]]:
    """Simulate one episode; return it with the robot's belief about each person before each of their actions.

    Parameters
    ----------
    pool, policy, humans, seed, **conditions
        As in `simulate`. With the same arguments the episode is the same.
    episode : int
        Number of the episode.

    Returns
    -------
    Episode
    list of dict
        For each person and step: `place` and `step`; mean and interval (`Spread`) of beta and theta, as `beta_mean`,
        `beta_low`, `beta_high` and so on; `beta_true` and the present `theta_true`; `suggestion`, whether one was made
        to this person; and `robot_here`. Beliefs are NaN while the robot is on its way, since the policy does not
        choose then.
    """
    watched, trace = Watched(policy), Trace()
    named: Conditions = {"name": "policy", **conditions}
    episodes = simulate(pool, watched, humans=humans, episodes=[episode], seed=seed, trace=trace, **named)
    found, models = episodes[0], pool.model[episodes.people[0]]
    pomdps = [pool.policies[model].pomdp for model in models]
    rows = []
    for action in trace:
        place, step = action["place"], action["step"]
        pomdp = pomdps[place]
        belief = watched.seen[step][place] if step in watched.seen else np.full(pomdp.prior.shape, np.nan)
        beta, theta = pomdp.grid.spreads(belief, pomdp.hidden)
        rows.append(
            {
                "place": place,
                "step": step,
                **_described("beta", beta),
                **_described("theta", theta),
                "beta_true": found.beta[place],
                "theta_true": action["theta"],
                "suggestion": action["suggestion"] is not None,
                "robot_here": robot_is_at(action, place),
            }
        )
    return found, rows


def _described(name: str, spread: Spread) -> dict[str, float]:
    return {f"{name}_mean": spread.mean, f"{name}_low": spread.low, f"{name}_high": spread.high}
