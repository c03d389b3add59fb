"""One person's problem on a task of any size: on all states, or on a truncated task."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeGuard, overload

import numpy as np

from planner import CostToGo, Table
from planner.system.arrays import outline

from ..people.arguments import whole
from ..people.choices import Choices
from ..people.decision import Ints
from ..people.goals import Goals, each_of, first_of, known_task
from ..people.human import Human
from ..people.memory import choices_of
from ..people.memory_on_demand import memory_of, on_demand
from ..people.misconception import Misconception
from ..people.ranges import Population, require_populations
from .assumptions import Assumptions
from .closed_problem import closed_problem
from .lazy_policy import LazyPolicy
from .memory_needed import depth_within, first_bounds_bytes
from .policy import Policy
from .pomdp import AssistPOMDP
from .qmdp import qmdp
from .settings import Setting, require_setting
from .shared_task import SharedTask
from .truncated_policy import TruncatedPolicy
from .truncated_task import TruncatedTask

if TYPE_CHECKING:
    from planner import AnyTask

WHOLE = 20_000
"""Number of states of a table up to which a problem enumerates all of them; also the default size of a truncated task.

A solver keeps vectors and beliefs for each state, so that its time and memory limit their number.
"""


def rows_within(states: int) -> int:
    """Return how many pairs of a goal and a state are enumerated if so many states are."""
    return 10 * states


@overload
def is_whole(known: CostToGo, states: int | None = None) -> TypeGuard[Table]: ...


@overload
def is_whole(known: CostToGo | Goals, states: int | None = None) -> TypeGuard[Table | Goals]: ...


def is_whole(known: CostToGo | Goals, states: int | None = None) -> TypeGuard[Table | Goals]:
    """Return whether a person's problem enumerates the whole task, or is restricted to a `TruncatedTask`.

    It enumerates the task if every cost-to-go is known and the number of states is small enough. Then the problem has
    no frontier, and its value is that of the task. A task whose states are solved on demand is always truncated,
    because its number of states is unknown. With several goals, there may be ten times as many pairs of a goal and a
    state as there may be states.

    Parameters
    ----------
    known : CostToGo or Goals
    states : int, optional
        Largest number of states to enumerate; `WHOLE` by default.
    """
    first, most = first_of(known), WHOLE if states is None else states
    return isinstance(first, Table) and len(first) <= most and len(known) <= rows_within(most)


def policy_on(known: CostToGo | Goals, assumed: Assumptions) -> Policy:
    """Return a person's policy by QMDP: solved now on all states if they are enumerated, as `is_whole` decides.

    Parameters
    ----------
    known : CostToGo or Goals
    assumed : Assumptions
        What the robot assumes of the person.
    """
    weights = assumed.population.weights
    if is_whole(known):
        return qmdp(assumed.problem(choices_of(known, tuple(weights))))
    return next(policies_on(SharedTask(on_demand(known, weights)), [assumed]))


def policies_on(
    task: Choices | SharedTask, each: Sequence[Assumptions], solver: Callable[[AssistPOMDP], Policy] = qmdp,
    advance: Callable[[int], None] = lambda _: None,
) -> Iterator[Policy]:  # fmt: skip
    """Yield the policy for each of some people at a task, which is solved on first use.

    Parameters
    ----------
    task : Choices or SharedTask
        The choices in all states, or a task that is too large to enumerate them.
    each : sequence of Assumptions
        What the robot assumes of each person.
    solver : callable
        Solves a person's problem.
    advance : callable
        Called with the number of people whose problems have been built in all states, also before the first one.
    """
    if isinstance(task, Choices):
        advance(0)
        for number, assumed in enumerate(each, start=1):
            yield LazyPolicy(replace(assumed.problem(task), alike=len(each)), solver)
            advance(number)
        return
    # Another class, since it has other values: estimates for each goal, on a task of its own, from which a row gets its
    # Q-values when somebody is there. A whole task has one table of Q-values for all goals and rows.
    own, typical = None if solver == qmdp else solver, TruncatedPolicy(task, replace(each[0], human=None))
    for assumed in each:
        yield TruncatedPolicy(task, assumed, None if assumed.human is None else typical, own)


@dataclass(frozen=True)
class PersonProblem:
    """The problem of assisting one person, and the numbers of its states in the task.

    Attributes
    ----------
    known : CostToGo or Goals
        Cost-to-go of the task, or of each goal.
    pomdp : AssistPOMDP
        Its `frontier` is None if it covers the whole task.
    states : int array, shape (n,)
        Number of each state in the task; -1 for what follows an executed action at the frontier of a truncated one.
    """

    known: CostToGo | Goals
    pomdp: AssistPOMDP
    states: Ints

    __repr__ = outline

    @classmethod
    def of(
        cls,
        known: CostToGo | Goals | AnyTask,
        *,
        setting: Setting | None = None,
        population: Population | None = None,
        states: int | None = None,
        misconception: Misconception | None = None,
        time_limit: float | None = None,
        memory_limit_mb: float = np.inf,
        progress: Callable[[int], None] | None = None,
    ) -> PersonProblem:
        """Build the problem on all states or on a truncated task, as `is_whole` decides.

        Parameters
        ----------
        known : CostToGo or Goals, or whatever `planner.load` takes
        setting : Setting, optional
            What it says of one person and of the best of the robots.
        population : Population, optional
            Prior distribution of the person.
        states : int, optional
            Largest number of states; by default 20,000 for a table, divided by the number of goals if the task is
            truncated, and 200 if states are solved on demand. An on-demand query takes up to seconds.
        misconception : Misconception, optional
            The person's misconception, if the robot knows it.
        time_limit : float, optional
            Seconds for collecting the states of a truncated task.
        memory_limit_mb : float
            Memory of a solver in MB. The number of states of a truncated task is halved until its first bounds take
            at most 0.8 times as much, but not below 20.
        progress : callable, optional
            Called with the number of states that were expanded since the last call.

        Raises
        ------
        ValueError
            A parameter is out of its range, or several goals are combined with terms.
        """
        require_setting(setting)
        require_populations(population)
        setting, states = setting or Setting(), None if states is None else whole("states", states, 1)
        known = known_task(known)
        people, human = population or Population(), None
        if misconception is not None:
            human = Human(1.0, 0.5, misconception.sigma, misconception)
        assumed = Assumptions.of(setting, human, people)
        if is_whole(known, states):
            choices = choices_of(known, people.weights)
            return cls(known, assumed.problem(choices), choices.of_task(np.arange(choices.task_states)))
        if states is None:
            states = 200 if first_of(known).searches else max(1, WHOLE // len(each_of(known)))
        task = on_demand(known, people.weights)
        of = partial(TruncatedTask.of, task, population=people, human=human, time_limit=time_limit)
        robot = assumed.robot
        problem = closed_problem(region := of(states=states, progress=progress).for_robot(robot), assumed)
        while (states := states // 2) >= 20:
            needed = first_bounds_bytes(problem, depth_within(problem, memory_limit_mb))
            if needed <= 0.8e6 * memory_limit_mb:
                break
            problem = closed_problem(region := of(states=states).for_robot(robot), assumed)
        return cls(known, problem, memory_of(task).state_of(region.states))
