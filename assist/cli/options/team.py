"""The options that describe a team, and the people and distances that are built from them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import click

from planner import Instance, LimitError

from ...declare.options import Given, setting_options
from ...person.settings import Setting
from ..terminal.console import ExitCode, fail
from .common import domain_option, humans_option, instance_argument, seed_option, together
from .goals import goals_option, several_goals
from .policies import policy_option
from .population import chosen_setting
from .settings import REGION_STATES, TeamSetting
from .task import costs_of, one_instance
from .travel import travel_of

if TYPE_CHECKING:
    from planner import CostToGo

    from ...people.goals import Goals
    from ...people.ranges import Population
    from ...person.travel import Travel
    from ...team.pool import Pool
    from ...team.state import TeamPolicy


class TeamOptions(NamedTuple):
    """The task, the policies, and the values of the options that describe a team, with its setting."""

    instance: str
    policy: tuple[str, ...]
    humans: int
    seed: int
    domain: str | None
    problems: tuple[str, ...]
    setting: TeamSetting
    given: Given[TeamSetting]

    def goals(self) -> Goals | None:
        """Return the goals of the task and of further problems; None if there is one only."""
        prior, most = self.setting.goal_prior, self.setting.max_states
        return several_goals(self.instance, self.problems, prior, domain=self.domain, max_states=most)


team_options = together(
    "team", TeamOptions,
    (
        instance_argument, policy_option(several=True), humans_option(required=True), seed_option, domain_option,
        goals_option, setting_options(TeamSetting),
    ),
)  # fmt: skip


class TeamSetup(NamedTuple):
    """The task, the pool of people from which teams are drawn, and the distances between their stations."""

    instance: Instance
    known: CostToGo | Goals
    population: Population
    pool: Pool
    travel: Travel

    def prepared(self, policy: str | TeamPolicy) -> TeamPolicy:
        """Return the team policy of this name; a policy object is returned unchanged."""
        if not isinstance(policy, str):
            return policy
        try:
            return self.pool.policy(policy, self.travel)
        except ValueError as error:  # the policy needs a robot that sees all actions
            fail(f"{self.instance}: {error}", ExitCode.FAILED)


def team_of(team: TeamOptions, size: int, goals: Goals | None = None) -> TeamSetup:
    """Draw a pool of `size` people, of whom each pursues one of some goals if there are several.

    Expected errors end the command in one line.
    """
    from ...team.pool import Pool

    setting = team.setting
    if team.humans > size:
        raise click.UsageError(f"--humans {team.humans} is more than --pool {size}")
    found = one_instance(team.instance, team.domain)
    chosen = chosen_setting(Setting, setting, team.given, rate=True)
    if not chosen.fleet.executes:
        team.given.refuse(["c_execute"], "without execute")
    known = goals or costs_of(found, max_states=setting.max_states, memory_limit_mb=None)
    try:
        chosen.neighbourhood(team.humans)
        travel = travel_of(chosen, team.humans, setting.distances, team.given)
        pool = Pool.sample(
            known, size, seed=team.seed, setting=chosen, population=setting.population, prior=setting.prior,
            memory_limit_mb=setting.memory_limit, states=setting.region_states or REGION_STATES,
            region=setting.region_states,
        )  # fmt: skip
    except LimitError as error:
        fail(f"{found}: {error} (--set memory_limit)", ExitCode.FAILED)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    return TeamSetup(found, known, setting.population, pool, travel)
