"""What of PDDL can be planned with, and faults that the readers pass over or name badly.

Classical planning with action costs is what Fast Downward's translator grounds. All that lies outside is refused here,
with its place; so are unknown and circular types and actions that share a name, which the translator accepts in
silence. `docs/planning.md` lists what is supported.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NoReturn

from .expressions import Expression
from .pddl import Instance, PDDLError

REQUIREMENTS = (
    ":strips", ":adl", ":typing", ":negation", ":equality", ":negative-preconditions", ":disjunctive-preconditions",
    ":existential-preconditions", ":universal-preconditions", ":quantified-preconditions", ":conditional-effects",
    ":derived-predicates", ":action-costs",
)  # fmt: skip
"""The requirements that Fast Downward's translator knows."""

NUMERIC = "numeric fluents; for action costs write :action-costs"
OUTSIDE = {
    ":durative-action": "durative actions",
    ":constraints": "trajectory constraints",
    ":process": "processes",
    ":event": "events",
    ":task": "hierarchical tasks",
    ":method": "hierarchical tasks",
    ":htn": "hierarchical tasks",
    ":fluents": NUMERIC,
    ":numeric-fluents": NUMERIC,
    ":object-fluents": "object fluents",
    ":durative-actions": "durative actions",
    ":duration-inequalities": "durative actions",
    ":continuous-effects": "continuous effects",
    ":timed-initial-literals": "timed initial literals",
    ":timed-effects": "timed effects",
    ":preferences": "preferences",
    ":goal-utilities": "preferences",
    ":contingent": "contingent planning",
    ":probabilistic-effects": "probabilistic effects",
    ":rewards": "rewards",
    ":time": "processes and events",
    ":hierarchy": "hierarchical tasks",
    ":method-preconditions": "hierarchical tasks",
    ":multi-agent": "several agents",
}
"""What else there is in PDDL's family: sections and requirements that are not supported."""

DOMAIN_SECTIONS = (":requirements", ":types", ":constants", ":predicates", ":functions", ":derived", ":action")
PROBLEM_SECTIONS = (":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
NUMERIC_EFFECTS = ("increase", "decrease", "assign", "scale-up", "scale-down")


def check(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Check both files of an instance.

    Raises
    ------
    PDDLError
        With the place.
    """
    _check_names(instance, domain, problem)
    predicates = domain.section(":predicates")
    declared = {predicate.head for predicate in predicates.parts[1:]} if predicates is not None else set()
    for file, whole, sections in (
        (instance.domain, domain, DOMAIN_SECTIONS),
        (instance.problem, problem, PROBLEM_SECTIONS),
    ):
        _check_sections(file, whole, sections)
        _check_requirements(file, whole)
        for preference in whole.lists("preference"):
            if "preference" not in declared:
                _refuse(file, preference.line, "preferences are not supported")
    supertypes = _check_types(instance.domain, domain)
    _check_typed(instance.domain, domain, supertypes)
    _check_typed(instance.problem, problem, supertypes)
    _check_actions(instance.domain, domain)
    _check_init(instance.problem, problem)
    metric = problem.section(":metric")
    if metric is not None and str(metric) != "(:metric minimize (total-cost))":
        _refuse(instance.problem, metric.line, "of metrics only (:metric minimize (total-cost)) is supported")


def meant(name: str, words: Iterable[str]) -> str:
    """Offer the nearest of some other words."""
    near = difflib.get_close_matches(name.lstrip("?"), sorted(set(words) - {name}), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""


def _refuse(file: Path, line: int | None, message: str) -> NoReturn:
    raise PDDLError(file, line, message)


def _check_names(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Compare the domain's names in the two files; unified-planning accepts any."""

    def named(whole: Expression, head: str) -> Expression | None:
        part = whole.section(head)
        return part.parts[1] if part is not None and len(part.parts) > 1 and part.parts[1].word else None

    defined, wanted = named(domain, "domain"), named(problem, ":domain")
    if defined is None and named(domain, "problem") and named(problem, "domain"):
        _refuse(instance.domain, 1, "this is a problem, and the other file its domain: swap them")
    if defined is None:
        _refuse(instance.domain, 1, "not a PDDL domain: (domain NAME) is missing")
    if wanted is None:
        _refuse(instance.problem, 1, "not a PDDL problem: (:domain NAME) is missing")
    for file, whole, head in ((instance.domain, domain, "domain"), (instance.problem, problem, "problem")):
        title = whole.section(head)
        if title is None or len(title.parts) != 2 or not title.parts[1].word:
            _refuse(file, 1 if title is None else title.line, f"expected ({head} NAME), and one word for NAME")
    if defined.word != wanted.word:
        _refuse(
            instance.problem,
            wanted.line,
            f"the problem is written for domain '{wanted.word}', but {instance.domain} defines '{defined.word}'",
        )


def _check_sections(file: Path, whole: Expression, sections: tuple[str, ...]) -> None:
    seen: dict[str, int] = {}
    for part in whole.parts[2:]:
        if part.head in OUTSIDE:
            _refuse(file, part.line, f"{OUTSIDE[part.head]} ({part.head}) are not supported; write classical PDDL")
        if part.head not in sections:
            shown = part.word or f"({part.head}"
            _refuse(file, part.line, f"'{shown}' is not expected here{meant(part.head, sections)}")
        if part.head in seen and part.head not in (":action", ":derived"):
            _refuse(file, part.line, f"a second ({part.head}; the first is on line {seen[part.head]}")
        seen[part.head] = part.line
    if ":domain" in sections and ":goal" not in seen:
        _refuse(file, None, "the problem has no (:goal ...)")


def _check_requirements(file: Path, whole: Expression) -> None:
    for wanted in whole.lists(":requirements"):
        for requirement in wanted.parts[1:]:
            if requirement.word in OUTSIDE:
                _refuse(file, requirement.line, f"{requirement} is not supported: {OUTSIDE[requirement.word]}")
            if requirement.word not in REQUIREMENTS:
                _refuse(
                    file,
                    requirement.line,
                    f"unknown requirement '{requirement}'{meant(requirement.word, REQUIREMENTS)}",
                )


def _typed(parts: tuple[Expression, ...]) -> Iterator[tuple[list[Expression], Expression]]:
    """Give the names of a typed list in groups, each with its type; names without a type are left out."""
    begin = 0
    for at in range(1, len(parts) - 1):
        if parts[at].word == "-" and at > begin:
            yield list(parts[begin:at]), parts[at + 1]
            begin = at + 2


def _check_types(file: Path, domain: Expression) -> dict[str, str]:
    """Give the supertype of each declared type, empty where there is none; no type is its own ancestor."""
    supertypes = {"object": "", "number": ""}
    section = domain.section(":types")
    if section is None:
        return supertypes
    supertypes.update((part.word, "") for part in section.parts[1:] if part.word not in ("-", "object"))
    lines = {part.word: part.line for part in section.parts[1:]}
    for names, supertype in _typed(section.parts[1:]):
        supertypes.update((name.word, supertype.word) for name in names if name.word != "object")
    for name in supertypes:
        above = [name]
        while supertypes.get(above[-1]):
            above.append(supertypes[above[-1]])
            if above[-1] == name and len(above) > 1:
                _refuse(file, lines[name], f"circular types: {' - '.join(above)}")
            if len(above) > len(supertypes):
                break  # it leads into another's circle
    return supertypes


def _check_typed(file: Path, whole: Expression, types: Iterable[str]) -> None:
    """Look for types that are not declared: the translator takes them for types without objects."""
    known = set(types)
    for expression in whole.walk():
        if expression.head == ":types":
            continue
        for _, kind in _typed(expression.parts[1:] if expression.head.startswith(":") else expression.parts):
            for name in kind.parts[1:] if kind.head == "either" else [kind]:
                if name.word and name.word not in known:
                    _refuse(file, name.line, f"unknown type '{name}'{meant(name.word, known)}")


def _check_actions(file: Path, domain: Expression) -> None:
    functions = domain.section(":functions")
    seen: dict[str, int] = {}
    for action in domain.lists(":action"):
        name = action.parts[1] if len(action.parts) > 1 else action
        if name.word in seen:
            _refuse(file, name.line, f"'{name}' is defined twice, on line {seen[name.word]} as well")
        seen[name.word] = name.line
        if ":effect" not in action.words:
            _refuse(file, action.line, f"action '{name}' has no :effect")
        for conditional in action.lists("when"):
            for cost in conditional.lists("increase"):
                _refuse(file, cost.line, f"action '{name}' has a conditional cost; costs depend on arguments only")
        for head in NUMERIC_EFFECTS:
            for effect in action.lists(head):
                changed = effect.parts[1].head or str(effect.parts[1]) if len(effect.parts) > 1 else "nothing"
                if head != "increase" or changed != "total-cost":
                    _refuse(
                        file,
                        functions.line if functions is not None else effect.line,
                        f"numeric fluents are not supported: action '{name}' changes '{changed}' ({head}, on line "
                        f"{effect.line}); only (increase (total-cost) ...) may be used",
                    )


def _check_init(file: Path, problem: Expression) -> None:
    init = problem.section(":init")
    if init is None:
        _refuse(file, None, "the problem has no (:init ...)")
    for fact in init.parts[1:]:
        if fact.head in ("and", "or", "forall", "exists", "when", "imply"):
            _refuse(file, fact.line, f"({fact.head} ...) is not expected in (:init ...): list the facts one by one")
        if fact.head == "at" and len(fact.parts) == 3 and fact.parts[2].parts:
            _refuse(file, fact.line, f"timed initial literals are not supported: {fact}")
        if fact.word:
            _refuse(file, fact.line, f"'{fact}' is not expected in (:init ...): a fact stands in parentheses")
