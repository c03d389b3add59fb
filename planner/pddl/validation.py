"""Validation of files and plans with unified-planning.

unified-planning checks types and the whole language. It validates plans independently of all that is computed here. It
is not used to expand states.

It also refuses some valid files: it requires distinct names where Fast Downward does not. The translator therefore
decides.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

from .s_expressions import tokens
from .source import Source

if TYPE_CHECKING:
    from unified_planning.model import Problem


class InvalidPlanError(AssertionError):
    """A plan does not solve its task."""


@dataclass(frozen=True)
class Refusal:
    """The reason why unified-planning does not accept an instance, with the line of the text that it has read.

    The file is "domain" or "problem".
    """

    file: str
    line: int | None
    message: str

    def placed(self, source: Source) -> Refusal:
        """Return the refusal with the line of the instance's own file."""
        rendered = source.typed_domain if self.file == "domain" else source.rendered_problem
        return Refusal(self.file, rendered.line(self.line), self.message)


class InstanceRefusedError(ValueError):
    """unified-planning refuses an instance; `refusal` holds the reason."""

    def __init__(self, refusal: Refusal) -> None:
        self.refusal = refusal
        super().__init__(refusal.message)


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
            try:  # which of the two files is it?
                PDDLReader().parse_problem_string(domain)
            except Exception:  # noqa: BLE001  as above
                clear_walkers()
                _refuse("domain", domain, fault)
            _refuse("problem", problem, fault)


def clear_walkers() -> None:
    """Reset the walkers of the shared environment after an error, which would otherwise affect their next use."""
    from unified_planning.environment import get_environment

    for walker in vars(get_environment()).values():
        if isinstance(stack := getattr(walker, "stack", None), list):
            stack.clear()


def _refuse(file: str, text: str, fault: Exception) -> NoReturn:
    """Raise `InstanceRefusedError` with a one-line reason for what unified-planning or pyparsing does not accept."""
    told = str(fault)
    line: int | None = getattr(fault, "lineno", None)
    if line is None and (place := re.search(r"\bline:? (\d+)", told)):
        line = int(place[1])
    if match := re.match(r"Name (\S+) already defined", told):
        lines = [place.line for token, place in tokens(text) if token == match[1]]
        line = line or (lines[1] if len(lines) > 1 else None)
        message = f"'{match[1]}' may name one thing only"
    elif match := re.search(r"The expression '(.*)' is not well-formed", told):
        message = f"it does not accept the types of the arguments of {match[1]}"
    elif match := re.match(r"Type (\S+) is declared more than once", told):
        message = f"type '{match[1]}' may be under one type only"
    else:
        message = f"it fails at it ({type(fault).__name__})" if line is None else "it does not accept what is written"
    raise InstanceRefusedError(Refusal(file, line, message)) from None
