"""The options that describe one person's POMDP, and the problem that is built from them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING, NamedTuple

from planner import Instance
from planner.system.progress import adding, stages

from ...declare.options import Given, setting_options
from ...person.settings import Setting
from ..terminal.console import usage_errors
from .common import domain_option, instance_argument, seed_option, together
from .population import RATES, chosen_setting
from .settings import PersonSetting
from .task import one_instance

OF_TEAMS = (
    "c_move", "travel_time", "robots", "knowledge", "max_steps", "observation", "c_ask", "ask_error", "neighbours",
    "population.noise", "population.sigma",
)  # fmt: skip
"""Fields of a setting that the problem of one person does not have."""

if TYPE_CHECKING:
    from planner import CostToGo

    from ...people.goals import Goals
    from ...person.person_problem import PersonProblem


class PersonOptions(NamedTuple):
    """The task, and the values of the options that describe one person's problem, with its setting."""

    instance: str
    seed: int
    domain: str | None
    setting: PersonSetting
    given: Given[PersonSetting]


person_options = together(
    "person", PersonOptions,
    (instance_argument, seed_option, domain_option, setting_options(PersonSetting, without=("c_move", "robots"))),
)  # fmt: skip


def person_problem(
    person: PersonOptions, known_of: Callable[[Instance], CostToGo | Goals], *, states: int | None,
    time_limit: float | None = None,
) -> tuple[Instance, PersonProblem]:  # fmt: skip
    """Build one person's problem. Invalid options raise usage errors.

    Parameters
    ----------
    person : PersonOptions
    known_of : callable
        Reads and solves the task, or the tasks of several goals.
    states : int or None
        Largest number of states in the problem; a larger task is truncated to it. None: all states of the task.
    time_limit : float, optional
        Seconds for choosing the states of a truncated problem.
    """
    from numpy.random import default_rng

    from ...people.goals import each_of
    from ...people.misconception import Misconception
    from ...person.person_problem import PersonProblem, is_whole

    setting, given = person.setting, person.given
    given.refuse(OF_TEAMS, "on the problem of one person")
    if setting.believed_trust is not None:
        given.refuse(["trust"], "on the problem of one person beside believed_trust")
    if setting.believed_trust not in (None, "paper"):
        given.refuse(RATES, "on the problem of one person with this believed_trust")
    if not setting.execute:
        given.refuse(["c_execute"], "without execute")
    found = one_instance(person.instance, person.domain)
    chosen = chosen_setting(Setting, setting, given, rate=True)
    known = known_of(found)
    if states is None:
        states = len(known)
    whole, memory_limit = is_whole(known, states), float("inf")
    # A number that nobody gave is a limit of a truncated task alone: its states take memory for each goal.
    if not whole and setting.region_states is None:
        states, memory_limit = max(1, states // len(each_of(known))), setting.memory_limit
    drawn = Misconception.drawn(setting.sigma, default_rng(person.seed))
    known_to_robot = drawn if setting.sigma else None
    with usage_errors(), nullcontext() if whole else stages() as show:
        advance = None if show is None else adding(show, "collecting states", states)
        problem = PersonProblem.of(
            known, setting=chosen, population=setting.population, states=states, misconception=known_to_robot,
            time_limit=time_limit, memory_limit_mb=memory_limit, progress=advance,
        )  # fmt: skip
    return found, problem
