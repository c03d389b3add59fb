"""What unified-planning says of files and of plans.

unified-planning knows types and the whole language, and validates plans independently of all that is computed here;
nothing is expanded with it.

Not everything that it refuses is wrong: it wants names to differ that Fast Downward tells apart. A `Refusal` says
whether the fault is certain; otherwise the translator has the last word.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from . import pddl
from .expressions import tokens
from .pddl import Instance, PDDLError
from .source import Source
from .supported import meant

if TYPE_CHECKING:
    from unified_planning.model import Problem


class InvalidPlanError(AssertionError):
    """A plan that does not solve its task."""


@dataclass(frozen=True)
class Refusal:
    """Why unified-planning does not accept an instance.

    Attributes
    ----------
    file : str
        "domain" or "problem".
    line : int or None
    message : str
    certain : bool
        Whether it is a fault in any case: the translator would pass over it.
    vague : bool
        Whether the message is of the parser's or an internal error; anybody else's is better.
    """

    file: str
    line: int | None
    message: str
    certain: bool = False
    vague: bool = False

    def error(self, instance: Instance) -> PDDLError:
        """Give it as an error in the instance's files."""
        return PDDLError(getattr(instance, self.file), self.line, self.message)


class RefusedError(ValueError):
    """Carries a `Refusal`."""

    def __init__(self, refusal: Refusal) -> None:
        self.refusal = refusal
        super().__init__(refusal.message)


def read(instance: Instance) -> Problem:
    """Read and validate the files of an instance with unified-planning, in this process.

    Raises
    ------
    PDDLError
        The files are no valid PDDL, do not belong together, or use what lies outside classical planning with action
        costs, or unified-planning cannot read them.
    """
    source = Source.of(instance)
    try:
        return parsed(source.domain_text, source.problem_text)
    except RefusedError as error:
        raise error.refusal.error(instance) from None


def validate(problem: Problem, plan: Sequence[str]) -> None:
    """Check a plan, ground actions as `(name arg ...)`, with unified-planning's own validator.

    Raises
    ------
    InvalidPlanError
        The plan does not lead to the goal, or an action of it is not applicable.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from unified_planning.engines import SequentialPlanValidator, ValidationResultStatus
        from unified_planning.io import PDDLReader

        parsed = PDDLReader(problem.environment).parse_plan_string(problem, "\n".join(plan))
        validator = SequentialPlanValidator(environment=problem.environment)
        # Its list of features lacks functions without a value for some arguments, which it handles well.
        validator.skip_checks = True
        result = validator.validate(problem, parsed)
    if result.status != ValidationResultStatus.VALID:
        raise InvalidPlanError(f"unified-planning's validator rejects the plan: {result.reason}")


def parsed(domain: str, problem: str) -> Problem:
    """Read an instance's texts; a `RefusedError` tells why not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unified-planning and pyparsing warn of their own internals
        from unified_planning.io import PDDLReader

        try:
            return PDDLReader().parse_problem_string(domain, problem)
        except Exception as fault:  # noqa: BLE001  it raises whatever comes, its own internal errors included
            clear_walkers()
            try:  # which of the two files is it?
                PDDLReader().parse_problem_string(domain)
            except Exception:  # noqa: BLE001  as above
                clear_walkers()
                _refuse("domain", domain, domain, fault)
            _refuse("problem", problem, domain + problem, fault)


def clear_walkers() -> None:
    """Let the shared environment forget what an error has interrupted; its next user would be told of it."""
    from unified_planning.environment import get_environment

    for walker in vars(get_environment()).values():
        if isinstance(stack := getattr(walker, "stack", None), list):
            stack.clear()


def _refuse(file: str, text: str, names: str, fault: Exception) -> NoReturn:
    """Turn a fault of unified-planning or pyparsing into one line with a place."""
    told = str(fault)
    line: int | None = getattr(fault, "lineno", None)
    if line is None and (place := re.search(r"\bline:? (\d+)", told)):
        line = int(place[1])
    told = re.sub(
        r"\s+\(at char .*|[.\n]*\s*(Error )?(in expression )?(from|found at) line:? .*", "", told, flags=re.S | re.I
    )
    words = [token for token, _ in tokens(names) if token[0].isalpha()]
    certain = vague = False
    if match := re.match(r"Found invalid expression: (\S+)|Undefined name found: (\S+)", told):
        name = match[1] or f"?{match[2].rstrip('.')}"
        message = f"unknown name '{name}'{meant(name, words)}"
    elif match := re.match(r"Not able to handle: \(?([^\s()]+)", told):
        message = f"unknown predicate '{match[1]}'{meant(match[1], words)}"
    elif "type: [[" in told:
        message = "a quantified variable without a type"
    elif match := re.match(r"Undefined .* type: ([^\s.]+)", told):
        message = f"unknown type '{match[1]}'{meant(match[1], words)}"
    elif match := re.match(r"Name (\S+) already defined", told):
        line = _line_of(match[1], text, occurrence=2)
        message = f"'{match[1]}' is defined twice"
    elif match := re.search(r"The expression '(.*)' is not well-formed", told):
        line = line or _line_of_expression(match[1], text)
        message = f"{match[1]} has an argument of the wrong type; see the predicate's declaration in the domain"
        certain = True
    elif match := re.search(r"fluent: (\S+) has arity (\d+) but (\d+) parameters", told):
        message = f"'{match[1]}' takes {match[2]} arguments, not {match[3]}"
    elif isinstance(loc := getattr(fault, "loc", None), int) and text[loc:].strip():
        message, vague = f"'{text[loc:].split()[0]}' is not expected here", True
    elif isinstance(fault, SyntaxError) and told:
        message = " ".join(told.split())
    else:
        message, vague = f"unified-planning fails at it ({type(fault).__name__})", True
    raise RefusedError(Refusal(file, line, message, certain, vague)) from None


def _line_of(name: str, text: str, occurrence: int = 1) -> int | None:
    lines = [line for token, line in tokens(text) if token == name]
    return lines[occurrence - 1] if len(lines) >= occurrence else None


def _line_of_expression(shown: str, text: str) -> int | None:
    """Find `name(arg, ...)`, in which variables have lost their question marks."""
    wanted = re.findall(r"[^\s(),]+", shown)
    for expression in pddl.parse(Path(), text).walk():
        if [part.word.lstrip("?") for part in expression.parts] == wanted:
            return expression.line
    return None
