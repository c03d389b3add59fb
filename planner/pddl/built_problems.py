"""Problems that were built in Python: a unified-planning `Problem` is written as the files that all other code reads.

unified-planning allows names that PDDL does not (capitals, dots), and writes others in their place. `written` returns
what these name, and `restore_names` undoes the renaming in the grounded task.
"""

from __future__ import annotations

import re
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import built_actions
from .instances import Instance, PDDLError
from .validation import clear_walkers

if TYPE_CHECKING:
    from unified_planning.model import Problem

SUPPORTED = {
    "problem_class": ("ACTION_BASED",),
    "problem_type": ("SIMPLE_NUMERIC_PLANNING", "GENERAL_NUMERIC_PLANNING"),
    "time": ("CONTINUOUS_TIME", "DURATION_INEQUALITIES", "SELF_OVERLAPPING"),
    "expression_duration": (
        "STATIC_FLUENTS_IN_DURATIONS", "FLUENTS_IN_DURATIONS", "INT_TYPE_DURATIONS", "REAL_TYPE_DURATIONS",
    ),
    "numbers": ("BOUNDED_TYPES",),
    "fluents_type": ("INT_FLUENTS", "REAL_FLUENTS"),
    "typing": ("FLAT_TYPING", "HIERARCHICAL_TYPING"),
    "conditions_kind": (
        "NEGATIVE_CONDITIONS", "DISJUNCTIVE_CONDITIONS", "EQUALITIES", "EXISTENTIAL_CONDITIONS", "UNIVERSAL_CONDITIONS",
    ),
    "effects_kind": (
        "CONDITIONAL_EFFECTS", "FORALL_EFFECTS", "INCREASE_EFFECTS", "DECREASE_EFFECTS",
        "STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS", "FLUENTS_IN_BOOLEAN_ASSIGNMENTS",
        "STATIC_FLUENTS_IN_NUMERIC_ASSIGNMENTS", "FLUENTS_IN_NUMERIC_ASSIGNMENTS",
    ),
    "quality_metrics": ("ACTIONS_COST", "PLAN_LENGTH", "MAKESPAN"),
    "actions_cost_kind": (
        "STATIC_FLUENTS_IN_ACTIONS_COST", "FLUENTS_IN_ACTIONS_COST", "INT_NUMBERS_IN_ACTIONS_COST",
        "REAL_NUMBERS_IN_ACTIONS_COST",
    ),
    "initial_state": ("UNDEFINED_INITIAL_NUMERIC",),
}  # fmt: skip
"""Features of unified-planning problems that are supported, by kind: planning for one person who acts in sequence."""

SOMETIMES = frozenset({"FINAL_VALUE"})
"""Features that are supported in part: the least final value of numbers that only grow."""


@dataclass(frozen=True)
class Written:
    """The files of a problem, and what of it the names in them stand for."""

    instance: Instance
    items: Mapping[str, Any]

    @property
    def own_names(self) -> dict[str, str]:
        """The problem's own names by those in the files from which they differ.

        Names with spaces, commas or parentheses are left out, since they cannot stand in a ground action.
        """
        renamed = {name: item.name for name, item in self.items.items() if name != item.name}
        return {name: own for name, own in renamed.items() if own and not re.search(r"[\s(),]", own)}


def named(problem: Problem) -> Instance:
    """Return an instance without files, named after its problem."""
    name = problem.name or "problem"
    return Instance(Path(name), Path(f"{name} (domain)"))


@contextmanager
def written(problem: Problem) -> Iterator[Written]:
    """Write a problem as PDDL, into files that last as long as the context.

    A problem that is not supported raises a `PDDLError`. One that is raised within the context is about the problem
    too, since its user does not know the files.
    """
    with tempfile.TemporaryDirectory(prefix="kitassist-") as folder:
        try:
            yield _write(problem, Path(folder))
        except PDDLError as error:
            raise PDDLError(named(problem).problem, None, error.message) from None


def _write(problem: Problem, folder: Path) -> Written:
    from unified_planning.exceptions import UPException
    from unified_planning.io import PDDLWriter

    name = named(problem).problem
    instance = Instance(folder / "problem.pddl", folder / "domain.pddl")
    try:
        _require_supported(problem)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "The PDDL printer cannot exactly represent")
            writer = PDDLWriter(plain(problem))
            for file, text in ((instance.domain, writer.get_domain()), (instance.problem, writer.get_problem())):
                file.write_text(_without_powers(text), encoding="utf-8")
    except PDDLError:
        raise
    except UserWarning as warning:
        number = str(warning).split("'")[1]
        message = f"the number {number} has no decimal of at most ten digits, as PDDL needs; expected one, such as 0.5"
        raise PDDLError(name, None, message) from None
    except Exception as error:  # noqa: BLE001  it raises any exception, internal errors included
        clear_walkers()
        reason = " ".join(str(error).split()) if isinstance(error, UPException) else "unified-planning fails at it"
        raise PDDLError(name, None, f"cannot be written as PDDL: {reason}") from None
    return Written(instance, dict(writer.nto_renamings))


def _without_powers(text: str) -> str:
    """Return a text whose numbers have no exponents: 0.0000001 for 1e-07."""
    return re.sub(r"(?<=[\s(])-?\d[\d.]*e[-+]\d+(?=[\s)])", lambda found: format(Decimal(found[0]), "f"), text)


def _require_supported(problem: Problem) -> None:
    """Refuse what PDDL, or this project, does not have."""
    name = named(problem).problem
    known = SOMETIMES.union(*SUPPORTED.values())
    if more := sorted(problem.kind.features - known):
        said = ", ".join(each.lower().replace("_", " ") for each in more)
        raise PDDLError(name, None, f"{said}: not supported")
    for action in filter(built_actions.lasts, problem.actions):
        times: list[tuple[Any, ...]] = [(timing,) for timing, _ in built_actions.effects(action)]
        times += [(interval.lower, interval.upper) for interval in action.conditions]
        if any(each.is_global() for several in times for each in several) or any(
            each[0].is_from_end() and each[-1].is_from_start() for each in times
        ):
            raise PDDLError(name, None, f"action '{action.name}' has a time that is not within it; expected its start, "
                            "its end, or all between them")  # fmt: skip
        if action.duration.is_left_open():
            raise PDDLError(name, None, f"action '{action.name}' has no least duration, since its interval is open on "
                            "the left; expected a closed one")  # fmt: skip


def plain(problem: Problem) -> Problem:
    """Return a problem with the same plans, in the constructs that PDDL has and Fast Downward reads."""
    found = problem.clone()
    built_actions.add_bounds(found, named(problem).problem)
    _close_durations(found)
    built_actions.simplify(found)
    metric = problem.quality_metrics[0] if len(problem.quality_metrics) == 1 else None
    if metric is not None and metric.is_minimize_action_costs():
        zero = problem.environment.expression_manager.Int(0)
        costs = {action: metric.get_action_cost(problem.action(action.name)) for action in found.actions}
        found.clear_quality_metrics()
        found.add_quality_metric(type(metric)({one: zero if cost is None else cost for one, cost in costs.items()}))
    return found


def _close_durations(problem: Problem) -> None:
    """Close the intervals of durations: below an open end there has to be a duration."""
    from unified_planning.model import ClosedDurationInterval, StartTiming

    make = problem.environment.expression_manager
    for action in filter(built_actions.lasts, problem.actions):
        if action.duration.is_right_open():
            low, high = action.duration.lower, action.duration.upper
            action.add_condition(StartTiming(), make.LT(low, high))
            action.set_duration_constraint(ClosedDurationInterval(low, high))


def restore_names(sas: str, names: Mapping[str, str]) -> str:
    """Return the SAS text with the problem's own names in its facts and operators."""
    if not names:
        return sas

    def restored(match: re.Match[str]) -> str:
        return re.sub(r"[^\s(),]+", lambda word: names.get(word[0], word[0]), match[0])

    sas = re.sub(r"(?<=^Atom ).*", restored, sas, flags=re.M)
    sas = re.sub(r"(?<=^NegatedAtom ).*", restored, sas, flags=re.M)
    return re.sub(r"(?<=^begin_operator\n).*", restored, sas, flags=re.M)
