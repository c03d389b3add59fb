"""Reading and checking PDDL.

unified-planning reads and validates the two files of an instance; this module finds the files, gives
every fault one line that says what is wrong, in which file and on which line, and hands on the
validated `unified_planning.model.Problem`. What is grounded and searched later comes from Fast
Downward's translator: nothing is expanded with the object returned here.
"""

from __future__ import annotations

import difflib
import itertools
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from unified_planning.model import Problem

DOMAIN_FILE = "domain.pddl"


class PDDLError(ValueError):
    """A PDDL file that cannot be used.

    Attributes
    ----------
    file : Path
        The file at fault.
    line : int or None
        Its line, counted from 1, where one can be named.
    message : str
        What is wrong, and what would be right.
    """

    def __init__(self, file: Path, line: int | None, message: str) -> None:
        self.file = file
        self.line = line
        self.message = message
        super().__init__(f"{file}:{line}: {message}" if line else f"{file}: {message}")

    def __reduce__(self) -> tuple[type[PDDLError], tuple[Path, int | None, str]]:
        """Keep the three fields when the error crosses a process boundary."""
        return type(self), (self.file, self.line, self.message)


class InstanceError(ValueError):
    """A name on the command line that stands for no instance."""


@dataclass(frozen=True, order=True)
class Instance:
    """The two files of a planning instance."""

    problem: Path
    domain: Path

    def __str__(self) -> str:
        return str(self.problem)


def instance(problem: str | Path, domain: str | Path | None = None) -> Instance:
    """Name an instance by its problem file; the domain is `domain.pddl` beside it unless given."""
    problem = Path(problem)
    return Instance(problem, Path(domain) if domain is not None else problem.parent / DOMAIN_FILE)


def find_instances(names: Iterable[str | Path], domain: str | Path | None = None) -> list[Instance]:
    """Find the instances that problem files, folders and globs stand for.

    A folder stands for every `*.pddl` file in it and below that is no domain, in sorted order. No
    instance is listed twice.

    Raises
    ------
    InstanceError
        A file that is not there, a folder or a glob without problems.
    """
    if domain is not None and not Path(domain).is_file():
        raise InstanceError(f"{domain}: no such domain file")
    found: dict[Instance, None] = {}
    for name in names:
        path = Path(name)
        if path.is_file():
            files = [path]
        elif path.is_dir():
            files = sorted(f for f in path.rglob("*.pddl") if not _is_domain(f, domain))
            if not files:
                raise InstanceError(f"{name}: no problem file (*.pddl other than {DOMAIN_FILE}) in this folder")
        else:
            parts = path.parts
            start = Path(path.anchor) if path.anchor else Path()
            pattern = str(Path(*parts[1:])) if path.anchor else str(path)
            files = []
            if any(mark in pattern for mark in "*?["):
                files = sorted(f for f in start.glob(pattern) if f.is_file() and not _is_domain(f, domain))
                if not files:
                    raise InstanceError(f"{name}: no problem file matches")
            else:
                raise InstanceError(f"{name}: no such file or folder")
        found.update((instance(file, domain), None) for file in files)
    return list(found)


def _is_domain(file: Path, domain: str | Path | None) -> bool:
    return file.name == DOMAIN_FILE or (domain is not None and file.resolve() == Path(domain).resolve())


def read(instance: Instance) -> Problem:
    """Read and validate the files of an instance with unified-planning.

    Raises
    ------
    PDDLError
        The files cannot be read, are no valid PDDL, do not belong together, or use what lies outside
        classical planning with action costs.
    """
    domain_text = _text(instance.domain, "domain")
    problem_text = _text(instance.problem, "problem")
    _check_sections(instance.domain, domain_text)
    _check_sections(instance.problem, problem_text)
    _check_domain_name(instance, domain_text, problem_text)

    from unified_planning.exceptions import UPException, UPValueError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unified-planning and pyparsing warn of their own internals
        from pyparsing import ParseBaseException
        from unified_planning.io import PDDLReader

        faults = (ParseBaseException, SyntaxError, UPException, UPValueError, KeyError, ValueError, AssertionError)
        try:
            problem = PDDLReader().parse_problem_string(domain_text, problem_text)
        except faults as fault:
            try:  # which of the two files is it?
                PDDLReader().parse_problem_string(domain_text)
            except faults:
                _reject(instance.domain, domain_text, domain_text, fault)
            _reject(instance.problem, problem_text, domain_text + problem_text, fault)
    _check_classical(instance, domain_text, problem)
    return problem


class InvalidPlanError(AssertionError):
    """A plan that unified-planning's validator rejects."""


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


def _text(file: Path, kind: str) -> str:
    """The text of a PDDL file in lower case: PDDL does not distinguish case, unified-planning does."""
    try:
        raw = file.read_bytes()
    except FileNotFoundError:
        raise PDDLError(file, None, f"no such {kind} file") from None
    except OSError as error:
        raise PDDLError(file, None, f"cannot be read: {error.strerror}") from None
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise PDDLError(file, line, "not a text file in UTF-8") from None
    if "\0" in text:
        raise PDDLError(file, text[: text.index("\0")].count("\n") + 1, "not a text file (it has NUL bytes)")
    if not re.sub(r";[^\n]*", "", text).strip():
        raise PDDLError(file, None, f"the file is empty; expected (define ({kind} ...) ...)")
    return text.lower()


SECTIONS = {
    ":requirements", ":types", ":constants", ":predicates", ":functions", ":action",
    ":domain", ":objects", ":init", ":goal", ":metric",
}  # fmt: skip
OUTSIDE = {
    ":durative-action": "durative actions",
    ":derived": "derived predicates",
    ":constraints": "trajectory constraints",
    ":process": "processes",
    ":event": "events",
    ":task": "hierarchical tasks",
    ":method": "hierarchical tasks",
    ":htn": "hierarchical tasks",
}


def _tokens(text: str) -> Iterator[tuple[str, int]]:
    """Parentheses and words with their lines, comments left out."""
    for line, content in enumerate(text.split("\n"), start=1):
        for match in re.finditer(r"[()]|[^()\s]+", content.partition(";")[0]):
            yield match[0], line


def _check_sections(file: Path, text: str) -> None:
    """Name the line of an unbalanced parenthesis (a parser sees it only at the end) and what is unsupported."""
    opened: list[int] = []
    section = 1
    previous = ""
    for token, line in _tokens(text):
        if token == "(":
            opened.append(line)
        elif token == ")":
            if not opened:
                raise PDDLError(file, line, "')' without a '(' that it closes")
            opened.pop()
        elif previous == "(" and token in OUTSIDE:
            raise PDDLError(file, line, f"{OUTSIDE[token]} ({token}) are not supported; write classical PDDL")
        elif previous == "(" and token in SECTIONS:
            if len(opened) > 2:
                raise PDDLError(file, opened[-2], f"'(' is not closed before ({token} on line {line}")
            section = line
        previous = token
    if opened:
        raise PDDLError(file, section, "')' is missing between here and the end of the file")


def _check_domain_name(instance: Instance, domain_text: str, problem_text: str) -> None:
    """Compare the names in the two files; unified-planning accepts any."""

    def named(text: str, keyword: str) -> tuple[str, int] | None:
        tokens = list(_tokens(text))
        for (word, _), (name, line) in itertools.pairwise(tokens):
            if word == keyword and name not in "()":
                return name, line
        return None

    defined, wanted = named(domain_text, "domain"), named(problem_text, ":domain")
    if defined is None or wanted is None:
        if named(domain_text, "problem") and named(problem_text, "domain"):
            raise PDDLError(instance.domain, 1, "this is a problem, and the other file its domain: swap them")
        file, what = (instance.domain, "(domain NAME)") if defined is None else (instance.problem, "(:domain NAME)")
        raise PDDLError(file, 1, f"not a PDDL {'domain' if defined is None else 'problem'}: {what} is missing")
    if defined[0] != wanted[0]:
        raise PDDLError(
            instance.problem,
            wanted[1],
            f"the problem is written for domain '{wanted[0]}', but {instance.domain} defines '{defined[0]}'",
        )


def _check_classical(instance: Instance, domain_text: str, problem: Problem) -> None:
    """Refuse numeric state: Fast Downward plans with truth values and action costs."""
    line = next((line for token, line in _tokens(domain_text) if token == ":functions"), None)
    for action in problem.actions:
        for effect in action.effects:
            fluent: Any = effect.fluent.fluent()
            if not fluent.type.is_bool_type() and fluent.name != "total-cost":
                raise PDDLError(
                    instance.domain,
                    line,
                    f"numeric fluents are not supported: action '{action.name}' changes '{fluent.name}'; "
                    "only (total-cost) may change",
                )


def _reject(file: Path, text: str, names: str, fault: BaseException) -> NoReturn:
    """Turn a fault of unified-planning or pyparsing into one line with a place."""
    told = str(fault)
    line: int | None = getattr(fault, "lineno", None)
    if line is None and (place := re.search(r"\bline:? (\d+)", told)):
        line = int(place[1])
    told = re.sub(
        r"\s+\(at char .*|[.\n]*\s*(Error )?(in expression )?(from|found at) line:? .*", "", told, flags=re.S | re.I
    )

    if match := re.match(r"Found invalid expression: (\S+)|Undefined name found: (\S+)", told):
        name = match[1] or f"?{match[2].rstrip('.')}"
        message = f"unknown name '{name}'{_meant(name, names)}"
    elif match := re.match(r"Not able to handle: \(?([^\s()]+)", told):
        message = f"unknown predicate '{match[1]}'{_meant(match[1], names)}"
    elif match := re.match(r"Undefined .* type: ([^\s.]+)", told):
        message = f"unknown type '{match[1]}'{_meant(match[1], names)}"
    elif isinstance(fault, KeyError):
        name = str(fault.args[0])
        line = _line_of(name, text)
        message = f"unknown type '{name}'{_meant(name, names)}"
    elif match := re.match(r"Name (\S+) already defined", told):
        line = _line_of(match[1], text, occurrence=2)
        message = f"'{match[1]}' is defined twice"
    elif match := re.search(r"The expression '(.*)' is not well-formed", told):
        message = f"{match[1]} has an argument of the wrong type; see the predicate's declaration in the domain"
    elif match := re.search(r"fluent: (\S+) has arity (\d+) but (\d+) parameters", told):
        message = f"'{match[1]}' takes {match[2]} arguments, not {match[3]}"
    elif match := re.match(r"Missing goal section", told):
        message = "the problem has no (:goal ...)"
    elif isinstance(loc := getattr(fault, "loc", None), int) and text[loc:].strip():
        message = f"'{text[loc:].split()[0]}' is not expected here"
    else:
        message = " ".join(told.split()) or type(fault).__name__
    raise PDDLError(file, line, message) from None


def _line_of(name: str, text: str, occurrence: int = 1) -> int | None:
    lines = [line for token, line in _tokens(text) if token == name]
    return lines[occurrence - 1] if len(lines) >= occurrence else None


def _meant(name: str, text: str) -> str:
    """Offer the nearest other word of the files."""
    words = {token for token, _ in _tokens(text) if token[0].isalpha()} - {name}
    near = difflib.get_close_matches(name.lstrip("?"), sorted(words), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""
