"""The supported fragment of PDDL: the sections and requirements that the two files may have.

Fast Downward's translator grounds classical planning with action costs, to which `compilation` reduces numbers and
durations. Everything else is refused here, with its place. `docs/planning.md` lists what is supported.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from .declarations import meant, refuse
from .instances import Instance
from .s_expressions import Expression

REQUIREMENTS = (
    ":strips", ":adl", ":typing", ":negation", ":equality", ":negative-preconditions", ":disjunctive-preconditions",
    ":existential-preconditions", ":universal-preconditions", ":quantified-preconditions", ":conditional-effects",
    ":derived-predicates", ":action-costs",
)  # fmt: skip
"""Requirements that Fast Downward's translator accepts."""

NUMERIC = (":fluents", ":numeric-fluents", ":durative-actions", ":duration-inequalities")
"""Requirements for numbers and durations, which are compiled away."""

AT_THEIR_PLACE = (
    ":timed-initial-literals", ":continuous-effects", ":object-fluents", ":preferences", ":constraints",
)  # fmt: skip
"""Requirements of which only the use is refused, with its place: files declare them without using them."""

OUTSIDE = {
    ":constraints": "trajectory constraints",
    ":process": "processes",
    ":event": "events",
    ":task": "hierarchical tasks",
    ":method": "hierarchical tasks",
    ":htn": "hierarchical tasks",
    ":object-fluents": "object fluents",
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
"""Sections and requirements of other PDDL dialects, which are not supported, with the name of the feature."""

CLASSICAL = "write actions with conditions and effects"
INSTEAD = {
    "processes": "write a durative action with the whole change at its end",
    "events": "write their effects into the actions that cause them",
    "trajectory constraints": "write them as conditions of actions, or as goals",
}
"""What to write instead of some of these features."""


def check(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Check both files of an instance: that their names match, and that their sections and requirements are supported.

    A fault raises a `PDDLError` with its place.
    """
    _check_names(instance, domain, problem)
    counts = Counter(each.word for whole in (domain, problem) for each in whole.walk() if each.word.endswith("-"))
    of_domains = (
        ":requirements",
        ":types",
        ":constants",
        ":predicates",
        ":functions",
        ":derived",
        ":action",
        ":durative-action",
    )
    of_problems = (":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
    for file, whole, sections in ((instance.domain, domain, of_domains), (instance.problem, problem, of_problems)):
        _check_hyphens(file, whole, counts)
        _check_sections(file, whole, sections)
        _check_requirements(file, whole)


def _check_names(instance: Instance, domain: Expression, problem: Expression) -> None:
    """Compare the domain's name in the two files, which unified-planning does not do."""

    def named(whole: Expression, head: str) -> Expression | None:
        part = whole.section(head)
        return part.parts[1] if part is not None and len(part.parts) > 1 and part.parts[1].word else None

    defined, wanted = named(domain, "domain"), named(problem, ":domain")
    if defined is None and named(domain, "problem") and named(problem, "domain"):
        refuse(instance.domain, domain, "this is a problem, and the other file its domain: swap them")
    if defined is None:
        refuse(instance.domain, domain, "not a PDDL domain: (domain NAME) is missing")
    if wanted is None:
        refuse(instance.problem, problem, "not a PDDL problem: (:domain NAME) is missing")
    for file, whole, head in ((instance.domain, domain, "domain"), (instance.problem, problem, "problem")):
        title = whole.section(head)
        if title is None or len(title.parts) != 2 or not title.parts[1].word:
            refuse(file, whole if title is None else title, f"expected ({head} NAME), and one word for NAME")
        if whole.head != "define" or whole.parts[1] is not title:
            refuse(file, whole, f"expected (define ({head} {title.parts[1]}) ...)")
    if defined.word != wanted.word:
        refuse(
            instance.problem,
            wanted,
            f"the problem is written for domain '{wanted.word}', but {instance.domain} defines '{defined.word}'",
        )


def _check_hyphens(file: Path, whole: Expression, counts: Mapping[str, int]) -> None:
    """Refuse a hyphen that touches a name: PDDL readers differ on whether it belongs to the name.

    A name may end in a hyphen. A word that ends in one and occurs only once is taken for a mistake.
    """
    for each in whole.walk():
        word = each.word
        if len(word) < 2 or word[0] != "-" != word[-1]:
            continue
        if counts[word] == 1 if word[0] != "-" else not re.fullmatch(r"-[\d.]+", word):
            refuse(file, each, f"'{word}': expected a blank before and after the hyphen that stands before a type")


def _check_sections(file: Path, whole: Expression, sections: tuple[str, ...]) -> None:
    seen: dict[str, int] = {}
    for part in whole.parts[2:]:
        if part.head in OUTSIDE:
            refuse(
                file,
                part,
                f"{OUTSIDE[part.head]} ({part.head}) are not supported; {INSTEAD.get(OUTSIDE[part.head], CLASSICAL)}",
            )
        if part.head not in sections:
            shown = part.word or f"({part.head}"
            refuse(file, part, f"'{shown}' is not expected here{meant(part.head, sections)}")
        if part.head in seen and part.head not in (":action", ":durative-action", ":derived"):
            refuse(file, part, f"a second ({part.head}; the first is on line {seen[part.head]}")
        seen[part.head] = part.place.line


def _check_requirements(file: Path, whole: Expression) -> None:
    wanted = whole.section(":requirements")
    for requirement in () if wanted is None else wanted.parts[1:]:
        if requirement.word in AT_THEIR_PLACE:
            continue
        if requirement.word in OUTSIDE:
            refuse(file, requirement, f"{requirement} is not supported: {OUTSIDE[requirement.word]}")
        if requirement.word not in REQUIREMENTS and requirement.word not in NUMERIC:
            near = meant(requirement.word, REQUIREMENTS + NUMERIC)
            refuse(file, requirement, f"unknown requirement '{requirement}'{near}")
