"""The problems of people at a task, each solved on first use: whole tasks, or truncated ones of large tasks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias, TypedDict, Unpack

import numpy as np

from planner import CostToGo
from planner.system.limits import Deadline
from planner.system.progress import Progress

from ..people.arguments import require_goal, require_options, whole
from ..people.choices import Choices
from ..people.goals import Goals, costs_to_go, each_of, first_of
from ..people.human import Human
from ..people.memory_on_demand import on_demand
from ..people.ranges import Population
from ..person.assumptions import Assumptions
from ..person.memory_needed import MEMORY_LIMIT_MB, states_within
from ..person.person_problem import WHOLE, is_whole, policies_on
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import qmdp
from ..person.settings import Setting
from ..person.shared_task import SharedTask, default_size
from .affordable import affordable_choices, require_room_for_people
from .drawn import Drawn

if TYPE_CHECKING:
    from planner import AnyTask

AnyTable: TypeAlias = "CostToGo | Choices | Goals | AnyTask"
"""A cost-to-go, choices, several goals, or whatever `planner.load` takes."""

MAX_ENUMERATED = 200_000
"""Largest number of states of a task that is enumerated because a requested option requires it."""


class Solving(TypedDict, total=False):
    """How the problems of a pool's people are solved, and what that may take. Each entry has a default.

    Attributes
    ----------
    solver : callable
        Returns the policy for one person's problem; `qmdp` by default. On a truncated task, that problem has proven
        bounds at its frontier (`LeafBounds`). The policy acts in its states; elsewhere the robot looks one step ahead.
    memory_limit_mb : float
        Memory of all QMDP policies in MB; it is estimated before anything is allocated.
    states : int
        Largest number of states of a table that is enumerated. It is `MAX_ENUMERATED` if people have a memory, if
        another solver is given, or if people are asked for their goals. A table is truncated in any case if the
        policies would exceed the memory limit.
    region : int or None
        Number of states of a policy's truncated task, for each goal; by default
        `assist.person.shared_task.default_size`, or fewer for many people or goals, by the memory limit.
    time_limit : float or None
        Seconds after which no further POMDP is built, and a `LimitError` says for how many people it was; none by
        default.
    """

    solver: Callable[[AssistPOMDP], Policy]
    memory_limit_mb: float
    states: int
    region: int | None
    time_limit: float | None


def solved_on_demand(
    table: CostToGo | Choices | Goals, them: Drawn, setting: Setting, prior: Population, tell: Progress,
    **solving: Unpack[Solving],
) -> tuple[Sequence[Human], list[Policy]]:  # fmt: skip
    """Return people at a task and the policy for each; one for all if the robots know nobody's misconceptions.

    Raises
    ------
    ValueError, LimitError
        As in `Pool.sample`.
    TypeError
        There is no such option.
    """
    require_options(solving, Solving.__annotations__)
    solver, limit = solving.get("solver", qmdp), solving.get("memory_limit_mb", MEMORY_LIMIT_MB)
    ends, terms = Deadline.after(solving.get("time_limit")), (*them.terms, *prior.weights)
    states = whole("states", solving.get("states", WHOLE))
    if (region := solving.get("region")) is not None:
        whole("region", region, 1)
    asks = setting.c_ask is not None  # worth of answers: exact where it is affordable
    most = MAX_ENUMERATED if asks or solver != qmdp or terms else states
    # Whether all states are enumerated is decided here: the memory of the policies of all people together limits it.
    choices: Choices | None = None
    if isinstance(table, Choices) or is_whole(table, most):
        choices = affordable_choices(table, setting, terms, them.size, limit)
    task: Choices | SharedTask
    if choices is None:
        assert not isinstance(table, Choices)
        require_goal(float(costs_to_go(table, np.array([first_of(table).initial])).min()))
        require_room_for_people(them.size, 0, limit)
        models = them.size if setting.knowledge == "own" else 1
        size = region or min(default_size(table), states_within(limit, each_of(table), models))
        task = SharedTask(on_demand(table, dict.fromkeys(terms)), size, models)
    else:
        task = choices
    people = them.at(choices)
    known: Sequence[Human | None] = people if setting.knowledge == "own" else [None]

    def advance(done: int) -> None:
        if done < len(known):
            ends.check(f"setting up {done} of {len(known)} people's POMDPs; expected fewer people, or more time")
        tell("setting up people's POMDPs", done, len(known))

    return people, list(policies_on(task, [Assumptions.of(setting, one, prior) for one in known], solver, advance))
