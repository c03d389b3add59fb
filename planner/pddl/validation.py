"""Validation of files and plans with unified-planning.

unified-planning checks types and the whole language. It validates plans independently of all that is computed here. It
is not used to expand states.

It also refuses some valid files: it requires distinct names where Fast Downward does not. The translator therefore
decides.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unified_planning.model import Problem


class InvalidPlanError(AssertionError):
    """A plan does not solve its task."""


class InstanceRefusedError(ValueError):
    """unified-planning refuses an instance; the message is its reason."""


def validate(problem: Problem, plan: Sequence[str]) -> None:
    """Check a plan, a sequence of ground actions `(name arg ...)`, with unified-planning's own validator.

    If it does not lead to the goal, or an action of it is not applicable, this raises an `InvalidPlanError`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from unified_planning.engines import SequentialPlanValidator, ValidationResultStatus
        from unified_planning.io import PDDLReader

        parsed = PDDLReader(problem.environment).parse_plan_string(problem, "\n".join(plan))
        validator = SequentialPlanValidator(environment=problem.environment)
        # It supports functions without a value for some arguments, although its list of features does not say so.
        validator.skip_checks = True
        result = validator.validate(problem, parsed)
    if result.status != ValidationResultStatus.VALID:
        raise InvalidPlanError(f"unified-planning's validator rejects the plan: {result.reason}")


def parsed(domain: str, problem: str) -> Problem:
    """Parse an instance's texts with unified-planning; raise `InstanceRefusedError` if it refuses them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unified-planning and pyparsing warn of their own internals
        from unified_planning.io import PDDLReader

        try:
            return PDDLReader().parse_problem_string(domain, problem)
        except Exception as fault:  # noqa: BLE001  it raises any exception, internal errors included
            clear_walkers()
            # Further lines give places in the rewritten text.
            reason = str(fault).partition("\n")[0] or f"it fails at it ({type(fault).__name__})"
            raise InstanceRefusedError(reason) from None


def clear_walkers() -> None:
    """Reset the walkers of the shared environment after an error, which would otherwise affect their next use."""
    from unified_planning.environment import get_environment

    for walker in vars(get_environment()).values():
        if isinstance(stack := getattr(walker, "stack", None), list):
            stack.clear()
