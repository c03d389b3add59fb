"""What of PDDL can be planned with, and faults that the readers pass over or name badly.

Classical planning with action costs is what Fast Downward's translator grounds. All that lies outside is refused here,
with its place; so are unknown and circular types and actions that share a name, which the translator accepts in
silence. `docs/planning.md` lists what is supported.
"""

from __future__ import annotations

import difflib
import re
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
    ":observe": "sensing actions",
    ":sensing": "sensing actions",
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
        _check_hyphens(file, whole)
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
    _check_types_of_arguments(instance, domain, problem)
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


def _check_hyphens(file: Path, whole: Expression) -> None:
    """Refuse a hyphen that touches a name: for some readers of PDDL it begins a type, for others it is in the name."""
    for each in whole.walk():
        word = each.word
        if len(word) > 1 and (word.endswith("-") or (word.startswith("-") and not re.fullmatch(r"-[\d.]+", word))):
            _refuse(
                file, each.line, f"'{word}': expected a blank before and after the hyphen that stands before a type"
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
    heads = [part.head for part in whole.parts[2:]]
    if ":goal" in heads and ":init" in heads[heads.index(":goal") :]:
        _refuse(file, seen[":goal"], "(:goal ...) stands before (:init ...); expected the initial state first")
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
    for name, above_it in supertypes.items():
        if name == above_it:  # a root type, as some domains write it
            supertypes[name] = ""
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
        if ":observe" in action.words:
            _refuse(file, action.line, f"action '{name}' observes (:observe): sensing actions are not supported")
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
        costs = list(action.lists("increase"))
        if len(costs) > 1:
            _refuse(
                file, costs[1].line, f"action '{name}' has two costs, on line {costs[0].line} as well; expected one"
            )
        for cost in costs:
            _check_cost(file, name, cost, functions)


def _check_cost(file: Path, action: Expression, cost: Expression, functions: Expression | None) -> None:
    """Check what an action costs: a whole number, or a declared function of as many arguments as it takes."""
    declared = {} if functions is None else {each.head: each for each in functions.parts[1:] if each.parts}
    amount = cost.parts[2] if len(cost.parts) == 3 else None
    if amount is None:
        _refuse(file, cost.line, f"action '{action}': expected (increase (total-cost) COST)")
    if re.fullmatch(r"-[\d.]+", amount.word):
        _refuse(file, cost.line, f"action '{action}' costs '{amount}'; costs may not be negative")
    if amount.word and not re.fullmatch(r"\d+(\.0*)?", amount.word):
        _refuse(
            file,
            amount.line,
            f"action '{action}' costs '{amount}'; expected a whole number, or (FUNCTION ARGUMENT ...)",
        )
    if amount.parts and amount.head in ("+", "-", "*", "/"):
        _refuse(file, amount.line, f"action '{action}' costs a sum or product, which is not supported: {amount}")
    if amount.parts and amount.head not in declared:
        offered = meant(amount.head, declared)
        _refuse(file, amount.line, f"action '{action}' costs '{amount}': no such function in (:functions ...){offered}")
    if amount.parts:
        wanted = sum(part.word.startswith("?") for part in declared[amount.head].parts)
        if len(amount.parts) - 1 != wanted:
            _refuse(file, amount.line, f"'{amount.head}' takes {wanted} arguments, not {len(amount.parts) - 1}")


def _typed_names(parts: tuple[Expression, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each name of a typed list with the types that it may have; ("object",) where none is given."""
    place = 0
    for names, kind in _typed(parts):
        kinds = tuple(part.word for part in kind.parts[1:]) if kind.head == "either" else (kind.word,)
        yield from ((name.word, kinds) for name in names)
        place += len(names) + 2
    yield from ((part.word, ("object",)) for part in parts[place:])


def _check_types_of_arguments(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Compare the types of objects in the initial state and the goal with those that predicates declare.

    The translator takes an atom of a wrong type for one that never holds. Names that are not declared, and other
    numbers of arguments, are left to the readers, which name them; so are predicates that are declared twice.
    """
    types = domain.section(":types")
    parents: dict[str, set[str]] = {}
    for name, kinds in _typed_names(types.parts[1:]) if types is not None else ():
        parents.setdefault(name, set()).update(kinds)
    objects: dict[str, tuple[str, ...]] = {}
    for whole, head in ((domain, ":constants"), (problem, ":objects")):
        section = whole.section(head)
        objects.update(_typed_names(section.parts[1:]) if section is not None else ())
    predicates = domain.section(":predicates")
    declared: dict[str, list[tuple[str, tuple[str, ...]]]] = {}
    for each in predicates.parts[1:] if predicates is not None else ():
        twice = each.head in declared
        declared[each.head] = [] if twice else list(_typed_names(each.parts[1:]))

    def above(kinds: Iterable[str]) -> set[str]:
        found, waiting = {"object"}, [*kinds]
        while waiting:
            if (kind := waiting.pop()) not in found:
                found.add(kind)
                waiting += parents.get(kind, ())
        return found

    init, goal = problem.section(":init"), problem.section(":goal")
    for atoms in (init.parts[1:] if init is not None else (), goal.walk() if goal is not None else ()):
        for atom in atoms:
            wanted = declared.get(atom.head)
            if wanted is None or len(wanted) != len(atom.parts) - 1:
                continue
            for argument, (_, kinds) in zip(atom.parts[1:], wanted, strict=True):
                own = objects.get(argument.word)
                if own is not None and not {*kinds} & above(own):
                    _refuse(
                        instance.problem, atom.line,
                        f"{atom.head} has an argument of the wrong type: '{argument}' is of type {' or '.join(own)}, "
                        f"and {' or '.join(kinds)} is expected",
                    )  # fmt: skip


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
