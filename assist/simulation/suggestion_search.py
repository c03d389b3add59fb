"""The search for the cost of suggestions at which a team policy that made none would make one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.system.progress import Progress

from ..person.lazy_policy import LazyPolicy
from ..person.qmdp import qmdp
from ..person.suggestion_threshold import SEARCHED_STATES, priced, search_threshold
from ..team.attention import NoAssistance
from ..team.state import TeamAction, TeamPolicy, TeamState
from ..team.travel import Travel
from .common_random_numbers import BLOCK
from .episodes import Episodes
from .pool import Pool


def with_threshold(
    found: Episodes, pool: Pool, policy: TeamPolicy, travel: Travel, again: Callable[..., Episodes], progress: Progress
) -> Episodes:
    """Return episodes without a suggestion, with the cost of suggestions at which the policy would make one.

    `again` simulates a policy in the same setting. Policies that weigh costs have a method `with_policies`.
    """
    with_policies = getattr(policy, "with_policies", None)
    if with_policies is None or pool.setting.differ:  # then there is no single cost
        return found
    few = _few(pool, found)

    def suggests(c_suggest: float) -> bool:
        progress(f"trying c_suggest {c_suggest:g}", 0, None)
        other = priced_pool(pool, c_suggest)
        until_first = _UntilFirstSuggestion(with_policies(other.policies, travel))
        again(other, until_first, humans=found.people[:few], episodes=found.episode[:few], explain=False)
        return until_first.suggested

    return replace(found, suggestion_threshold=search_threshold(pool.setting.c_suggest, suggests if few else None))


def priced_pool(pool: Pool, c_suggest: float) -> Pool:
    """Return the same people with another cost of a suggestion; the task must be enumerated, and robots alike."""
    if pool.setting.differ:
        raise ValueError("robots: they differ; expected robots that are alike, which have one cost of a suggestion")
    for policy in pool.policies:
        policy.require_enumerated("priced")
    policies = tuple(
        LazyPolicy(priced(policy.pomdp, c_suggest), getattr(policy, "solver", qmdp)) for policy in pool.policies
    )
    return replace(pool, setting=replace(pool.setting, c_suggest=c_suggest), policies=policies)


class _UntilFirstSuggestion:
    """A policy that makes no suggestion after its first one, and records whether it has made one."""

    def __init__(self, policy: TeamPolicy) -> None:
        self._policy, self.suggested = policy, False

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the policy's action, or none after the first suggestion."""
        action = NoAssistance()(team) if self.suggested else self._policy(team)
        self.suggested = self.suggested or bool(action.robot.any())
        return action


def _few(pool: Pool, episodes: Episodes) -> int:
    """Return how many episodes, from the first on, involve problems of at most `SEARCHED_STATES` states in total."""
    count = min(len(episodes), BLOCK)

    def states() -> float:
        return sum(pool.policies[model].size for model in np.unique(pool.model[episodes.people[:count]]).tolist())

    while count and states() > SEARCHED_STATES:
        count //= 2
    return count
