"""An engine of unified-planning that finds optimal plans for problems that were built in Python.

It is registered by one line,

    unified_planning.environment.get_environment().factory.add_engine("kitassist", "planner.engine", "Engine")

or by two lines of a file `up.ini`, which unified-planning reads from the working folder, its parent folders, and the
user's home:

    [engine kitassist]
    module_name: planner.engine
    class_name: Engine

Then `OneshotPlanner(name="kitassist")` finds plans that are proven to be optimal: of least cost if the problem
minimises costs, else with the fewest actions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from math import inf, isfinite
from typing import IO, TYPE_CHECKING, Any
from warnings import warn

from unified_planning import engines
from unified_planning.engines import Credits, OptimalityGuarantee, PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.io import PDDLWriter
from unified_planning.model import ProblemKind
from unified_planning.plans import ActionInstance, SequentialPlan

from .costtogo.astar import astar
from .costtogo.sweep import sweep
from .grounding.fast_downward import FastDownwardError
from .grounding.load import load
from .grounding.task import Task
from .pddl.built_problems import plain
from .pddl.instances import PDDLError
from .system.limits import CostLimitError, LimitError, Limits, MemoryLimitError

if TYPE_CHECKING:
    from unified_planning.model import Problem

KIND = {
    "problem_class": ("ACTION_BASED",),
    "typing": ("FLAT_TYPING", "HIERARCHICAL_TYPING"),
    "conditions_kind": (
        "NEGATIVE_CONDITIONS", "DISJUNCTIVE_CONDITIONS", "EQUALITIES", "EXISTENTIAL_CONDITIONS", "UNIVERSAL_CONDITIONS",
    ),
    "effects_kind": (
        "CONDITIONAL_EFFECTS", "FORALL_EFFECTS", "STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS",
        "FLUENTS_IN_BOOLEAN_ASSIGNMENTS",
    ),
    "quality_metrics": ("ACTIONS_COST", "PLAN_LENGTH"),
    "actions_cost_kind": ("STATIC_FLUENTS_IN_ACTIONS_COST", "INT_NUMBERS_IN_ACTIONS_COST"),
}  # fmt: skip
"""Supported features of unified-planning problems, by kind: classical planning with action costs."""


class Engine(engines.Engine, OneshotPlannerMixin):
    """A one-shot planner for optimal plans.

    The results `SOLVED_OPTIMALLY` and `UNSOLVABLE_PROVEN` are proven. With `TIMEOUT` and `MEMOUT` nothing is known.
    `UNSUPPORTED_PROBLEM` means that the problem cannot be written in PDDL, or not be read by Fast Downward.
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
        for what, features in KIND.items():
            for feature in features:
                getattr(kind, f"set_{what}")(feature)
        return kind

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Return whether all features of a problem are supported: at most one metric, and integer costs."""
        metrics = problem_kind.features & set(KIND["quality_metrics"])
        return bool(problem_kind <= Engine.supported_kind()) and len(metrics) < 2

    @staticmethod
    def satisfies(optimality_guarantee: OptimalityGuarantee) -> bool:  # noqa: ARG004  every guarantee holds
        """Return whether plans have the given guarantee: always, since they are optimal."""
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
            task = load(problem, limits=left())
            plan = _cheapest_plan(task, left)
        except MemoryLimitError as error:
            return self._without(Status.MEMOUT, error)
        except PDDLError as error:
            return self._without(Status.UNSUPPORTED_PROBLEM, error)
        except LimitError as error:
            return self._without(Status.TIMEOUT, error)
        except (FastDownwardError, OSError) as error:
            return self._without(Status.INTERNAL_ERROR, error)
        if plan is None:
            return PlanGenerationResult(Status.UNSOLVABLE_PROVEN, None, self.name)
        return PlanGenerationResult(Status.SOLVED_OPTIMALLY, _read_plan(problem, plan), self.name)

    def _without(self, status: Status, error: Exception) -> PlanGenerationResult:
        message = engines.results.LogMessage(engines.results.LogLevel.ERROR, str(error))
        return PlanGenerationResult(status, None, self.name, log_messages=[message])


def _cheapest_plan(task: Task, left: Callable[[], Limits]) -> list[str] | None:
    """Return an optimal plan; None if there is no plan.

    A task whose costs are too large for Fast Downward is swept. `left` returns the limits with the remaining time.
    """
    try:
        return astar(task, limits=left())[1]
    except CostLimitError:
        seconds = left().seconds
        table = sweep(task, deadline=None if seconds is None else time.monotonic() + seconds)
        return table.optimal_plan() if isfinite(table[table.initial]) else None


def _read_plan(problem: Problem, plan: list[str]) -> SequentialPlan:
    """Return a plan, ground actions as `(name argument ...)`, as a plan of unified-planning.

    The actions have the problem's own names, or else the names in its PDDL files.
    """
    own_actions = {action.name: action for action in problem.actions}  # an object may have the name of an action
    own_objects = {each.name: each for each in problem.all_objects}
    written: dict[str, Any] = {}

    def find(word: str, own: Mapping[str, Any]) -> Any:
        if word in own:
            return own[word]
        if not written:
            writer = PDDLWriter(plain(problem))
            writer.get_domain()
            writer.get_problem()
            written.update(writer.nto_renamings)
        return own[written[word].name]

    steps = []
    for action in plan:
        name, *arguments = action[1:-1].split()
        variables = problem.environment.expression_manager
        objects = [variables.ObjectExp(find(word, own_objects)) for word in arguments]
        steps.append(ActionInstance(find(name, own_actions), tuple(objects)))
    return SequentialPlan(steps, problem.environment)
