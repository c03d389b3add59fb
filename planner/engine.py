"""An engine of unified-planning that finds optimal plans for problems that were built in Python.

It is registered by one line,

    unified_planning.environment.get_environment().factory.add_engine("kitassist", "planner.engine", "Engine")

or by two lines of a file `up.ini`, which unified-planning reads from the working folder, its parent folders, and the
user's home:

    [engine kitassist]
    module_name: planner.engine
    class_name: Engine

Then `OneshotPlanner(name="kitassist")` finds plans that are proven to be optimal: of least cost if the problem
minimises costs, else with the fewest actions. Numbers may change as long as they have finitely many values, by their
types (`IntType(0, 9)`) or by what bounds them in the problem.

Where actions have durations, a plan is a `TimeTriggeredPlan` of one action after the other, with the least cost or
makespan of all such plans. Other plans may overlap: these may be better, or the only ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from math import inf, isfinite
from typing import IO, TYPE_CHECKING, Any
from warnings import warn

from unified_planning import engines
from unified_planning.engines import Credits, OptimalityGuarantee, PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.engines.results import LogLevel, LogMessage
from unified_planning.model import ProblemKind
from unified_planning.plans import ActionInstance, Plan, SequentialPlan, TimeTriggeredPlan

from .costtogo.astar import astar
from .costtogo.load import load
from .costtogo.table import sweep
from .grounding.fast_downward import FastDownwardError
from .grounding.task import Task
from .pddl.built_problems import SUPPORTED, Written, is_temporal, written
from .pddl.compilation import NO_SEQUENTIAL_PLAN
from .pddl.instances import PDDLError
from .pddl.plan_execution import execute
from .system.errors import MismatchError
from .system.limits import CostLimitError, LimitError, Limits, MemoryLimitError

if TYPE_CHECKING:
    from unified_planning.model import Problem

GAP = Fraction(1, 1000)
"""Time between two actions of a temporal plan, unless the problem has an epsilon; unified-planning requires some."""


class Engine(engines.Engine, OneshotPlannerMixin):
    """A one-shot planner for optimal plans.

    The results `SOLVED_OPTIMALLY` and `UNSOLVABLE_PROVEN` are proven. With `TIMEOUT` and `MEMOUT` nothing is known.
    Temporal problems end with `SOLVED_SATISFICING`, or with `UNSOLVABLE_INCOMPLETELY` if there is no plan of one action
    after the other. `UNSUPPORTED_PROBLEM` comes with a message that says what is not supported.
    """

    def __init__(self, **options: Any) -> None:
        engines.Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)
        if options:
            raise TypeError(f"{', '.join(options)}: this engine has no such options")

    @property
    def name(self) -> str:
        """Identifier under which the engine is registered."""
        return "kitassist"

    @staticmethod
    def supported_kind() -> ProblemKind:
        """Return the supported features."""
        kind = ProblemKind(version=2)
        for what, features in SUPPORTED.items():
            for feature in features:
                getattr(kind, f"set_{what}")(feature)
        return kind

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Return whether all features of a problem are supported: for instance, at most one metric.

        Features do not tell values. A problem of a supported kind is refused by `solve` if a number has no bound, a
        duration or cost is negative, an interval of durations is open on the left, or a number is no decimal.
        """
        metrics = problem_kind.features & set(SUPPORTED["quality_metrics"])
        return bool(problem_kind <= Engine.supported_kind()) and len(metrics) < 2

    @staticmethod
    def satisfies(optimality_guarantee: OptimalityGuarantee) -> bool:  # noqa: ARG004  every guarantee holds
        """Return whether plans have the given guarantee: always, as plans without durations are optimal.

        unified-planning asks before it knows the problem. For temporal problems, the result's status says what holds.
        """
        return True

    @staticmethod
    def get_credits(**_: Any) -> Credits:
        """Return the authors and the licence."""
        what = "Optimal plans, and the exact cost-to-go of every state, for assistance in task planning."
        return Credits(
            "kitassist", "the authors of kitassist", "", "", "Apache-2.0", what, f"{what} Runs Fast Downward."
        )

    def _solve(
        self,
        problem: Problem,
        heuristic: Callable[[Any], float | None] | None = None,
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
    ) -> PlanGenerationResult:
        for name, value in (("heuristic", heuristic), ("output_stream", output_stream)):
            if value is not None:
                warn(f"kitassist does not use the {name} that it was given", stacklevel=3)
        start = time.monotonic()

        def left() -> Limits:
            if timeout is None or timeout == inf:
                return Limits()
            return Limits(seconds=max(0.01, timeout - (time.monotonic() - start)))

        try:
            with written(problem) as files:
                temporal = is_temporal(problem)
                task = load(files.instance, limits=left())
                words = _cheapest_plan(task, left)
                durations = execute(files.instance, words).durations if temporal and words is not None else ()
        except MemoryLimitError as error:
            return self._without(Status.MEMOUT, error)
        except PDDLError as error:
            return self._without(Status.UNSUPPORTED_PROBLEM, error)
        except LimitError as error:
            return self._without(Status.TIMEOUT, error)
        except (FastDownwardError, MismatchError, OSError) as error:
            return self._without(Status.INTERNAL_ERROR, error)
        notes = [task.note] if task.note else []
        if words is None:
            status = Status.UNSOLVABLE_INCOMPLETELY if temporal else Status.UNSOLVABLE_PROVEN
            return self._with(status, None, [*notes, NO_SEQUENTIAL_PLAN] if temporal else notes)
        steps = [_step(problem, files, word) for word in words]
        if temporal:
            return self._with(Status.SOLVED_SATISFICING, _in_sequence(problem, steps, durations), notes)
        return self._with(Status.SOLVED_OPTIMALLY, SequentialPlan(steps, problem.environment), notes)

    def _with(self, status: Status, plan: Plan | None, notes: list[str]) -> PlanGenerationResult:
        messages = [LogMessage(LogLevel.INFO, note) for note in notes]
        return PlanGenerationResult(status, plan, self.name, log_messages=messages)

    def _without(self, status: Status, error: Exception) -> PlanGenerationResult:
        message = LogMessage(LogLevel.ERROR, str(error))
        return PlanGenerationResult(status, None, self.name, log_messages=[message])


def _cheapest_plan(task: Task, left: Callable[[], Limits]) -> list[str] | None:
    """Return an optimal plan; None if there is no plan.

    A task whose costs are too large for Fast Downward is swept. `left` returns the limits with the remaining time.
    """
    try:
        return astar(task, limits=left())[1]
    except CostLimitError:
        seconds = left().seconds
        table = sweep(task, time_limit=seconds)
        return table.optimal_plan() if isfinite(table[table.initial]) else None


def _step(problem: Problem, files: Written, action: str) -> ActionInstance:
    """Return a ground action of the files, `(name argument ...)`, as an action of the problem."""
    name, *arguments = action[1:-1].split()
    make = problem.environment.expression_manager
    objects = [make.ObjectExp(problem.object(files.items[word].name)) for word in arguments]
    return ActionInstance(problem.action(files.items[name].name), tuple(objects))


def _in_sequence(
    problem: Problem, steps: Sequence[ActionInstance], durations: Sequence[Fraction | None]
) -> TimeTriggeredPlan:
    """Return a plan in which each action begins after the one before it has ended."""
    time, timed = Fraction(0), []
    for step, duration in zip(steps, durations, strict=True):
        timed.append((time, step, duration))
        time += (duration or 0) + (problem.epsilon or GAP)
    return TimeTriggeredPlan(timed, problem.environment)
