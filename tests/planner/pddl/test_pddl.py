"""Invalid PDDL: one line with the fault, the file and the line number."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import KITTING, invoke, kitassist, understood, write_instance

from planner import Instance, MismatchError, PDDLError, load
from planner.pddl.validation import validate

DOMAIN = (KITTING / "domain.pddl").read_text()
PROBLEM = (KITTING / "tiny.pddl").read_text()


def line_of(text: str, part: str) -> int:
    assert text.count(part) == 1, part
    return text[: text.index(part)].count("\n") + 1


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


COSTS = changed(DOMAIN, "(:predicates", "(:functions (total-cost) - number)\n  (:predicates")
FETCH = "(:action fetch"

CHANGED = {
    "a missing parenthesis": ("(platform-free)  ", "(platform-free  ", "(:predicates", "not closed before (:action"),
    "a problem without a name": ("(problem tiny)", "(problem)", "(problem)", "NAME"),
    "two names": ("(domain kitting)", "(domain kitting x)", "(domain kitting x)", "NAME"),
    "another domain": ("(:domain kitting)", "(:domain cooking)", "(:domain cooking)", "'cooking'"),
    "a mistyped section": ("(:goal", "(:gaol", "(:gaol", "(:gaol"),
    "a mistyped section of the domain": (FETCH, "(:actoin fetch", "(:actoin", "did you mean ':action'"),
    "an unknown requirement": (
        "(:requirements :strips", "(:requirements :strips\n  :type-checks", ":type-checks",
        "unknown requirement ':type-checks'",
    ),
    "a requirement outside": (
        "(:requirements :strips", "(:requirements :strips\n  :goal-utilities", ":goal-utilities",
        ":goal-utilities is not supported",
    ),
    "an action without effect": (
        FETCH, "(:action wait :parameters ()\n :precondition (platform-free))\n  (:action fetch", "(:action wait",
        "'wait' has no :effect",
    ),
    "an action twice": (
        "(:action return", FETCH,
        "\n  (:action fetch\n    :parameters (?c - container)\n    :precondition (on-platform",
        "'fetch' is defined twice, on line 21 as well",
    ),
    "no name of a domain": ("(define (domain kitting)", "(define (kitting)", None, "not a PDDL domain: (domain NAME)"),
    "no domain": ("(:domain kitting)", "", None, "not a PDDL problem: (:domain NAME) is missing"),
    "no facts": (
        PROBLEM[PROBLEM.index("(:init") : PROBLEM.index("(:goal")], "", None, "the problem has no (:init ...)",
    ),
    "a word among facts": (
        "(platform-free)\n    (con", "platform-free\n    (con", None, "a fact stands in parentheses",
    ),
    "a word before all": ("(define (domain", "kitting (define (domain", None, "'kitting' is not within (define ...)"),
    "a broken predicate": ("(platform-free)        ", "(platform-free ?a -)", "(platform-free ?a -)", "expected"),
    "a conjunction in init": (
        "(platform-free)\n    (con", "(and (platform-free))\n    (con", "(and (platform-free))", "one by one",
    ),
    "maximising": ("(:goal", "(:metric maximize (total-cost))\n  (:goal", "(:metric", "maximize is not supported"),
    "a metric without a direction": ("(:goal", "(:metric)\n  (:goal", "(:metric)", "(:metric minimize"),
    "a mistyped direction": ("(:goal", "(:metric minimise (total-cost))\n  (:goal", "(:metric", "mean 'minimize'"),
    "parameters without parentheses": (
        "fetch\n    :parameters (?c - container)", "fetch\n    :parameters ?c", ":parameters ?c", "'fetch'",
    ),
    "two initial states": (
        "(:goal", "(:init (platform-free) )\n  (:goal", "(:init (platform-free) )", "a second (:init ...); the first",
    ),
}  # fmt: skip
"""A part of either file, what stands there instead, a part on the reported line, and words of the message."""

WHOLE = {
    "a missing parenthesis at the end": (DOMAIN, PROBLEM.rstrip()[:-1], "problem", "(:goal", "')' is missing"),
    "one parenthesis too many": (DOMAIN, PROBLEM.rstrip() + "\n)", "problem", "\n)", "without a '('"),
    "no goal": (DOMAIN, PROBLEM[: PROBLEM.index("(:goal")] + ")", "problem", None, "(:goal"),
    "an empty problem": (DOMAIN, "", "problem", None, "empty"),
    "an empty domain": ("; nothing but a comment\n", PROBLEM, "domain", None, "empty"),
    "swapped files": (PROBLEM, DOMAIN, "domain", None, "swap"),
    "a cost that is multiplied": (
        changed(COSTS, "(not (in-storage ?c)) (not", "(scale-up (total-cost) 2) (not"), PROBLEM, "domain", "(scale-up",
        "costs only grow",
    ),
    "something after the end": (
        DOMAIN, PROBLEM.rstrip() + "\n(:metric minimize (total-cost))", "problem", "\n(:metric", "after the end",
    ),
    "a fault beside what only the translator reads": (
        changed(DOMAIN, "(platform-free)  ", "(platform-free) (fetch)"),
        changed(PROBLEM, "(contains box-a hammer)", "(contains box-a hamer)"), "problem", "hamer)", "hamer",
    ),
}  # fmt: skip
"""Two files, which of them is at fault, the part, None if no line is reported, and the words.

Faults of types, names, conditions and effects are in `test_reading`, those of numbers in `test_numbers_refused`.
"""


def broken(what: str) -> tuple[str, str, str, str | None, str]:
    if what in WHOLE:
        return WHOLE[what]
    old, new, place, words = CHANGED[what]
    texts = (changed(DOMAIN, old, new), PROBLEM) if old in DOMAIN else (DOMAIN, changed(PROBLEM, old, new))
    return *texts, "domain" if old in DOMAIN else "problem", place, words


@pytest.mark.parametrize("what", [*CHANGED, *WHOLE])
def test_broken_pddl_names_the_place(tmp_path: Path, what: str) -> None:
    domain, problem, at_fault, place, words = broken(what)
    instance = write_instance(tmp_path, domain, problem)
    with pytest.raises(PDDLError) as error:
        load(instance)
    assert error.value.file == getattr(instance, at_fault)
    if place is not None:
        text = domain if at_fault == "domain" else problem
        assert error.value.line == line_of(text, place) + (place[0] == "\n")
    assert words in error.value.message
    assert "\n" not in str(error.value)


def test_pddl_does_not_distinguish_case(tmp_path: Path) -> None:
    task = load(write_instance(tmp_path, DOMAIN, PROBLEM.upper()))
    assert task.actions == load(KITTING / "tiny.pddl").actions


ONE_LINE: dict[str, tuple[Callable[[Instance], object], Callable[[Instance], list[object]], int]] = {
    "broken": (lambda of: of.problem.write_text(PROBLEM.replace("-free)", "-fre)")), lambda of: [of.problem], 1),
    "binary": (lambda of: of.problem.write_bytes(b"\x00\xff" * 100), lambda of: [of.problem], 1),
    "no domain": (lambda of: of.domain.unlink(), lambda of: [of.problem], 1),
    "missing": (lambda of: of.problem.unlink(), lambda of: [of.problem], 2),
    "no problems": (lambda of: of.problem.unlink(), lambda of: [of.problem.parent], 2),
    "no match": (lambda _: None, lambda of: [of.problem.with_name("x*.pddl")], 2),
    "no such domain": (lambda _: None, lambda of: [of.problem, "--domain", of.domain.with_name("absent.pddl")], 2),
}
"""What is done to the files, the words of a command, and its exit code."""


@pytest.mark.parametrize("case", ONE_LINE)
def test_the_command_says_it_in_one_line(tmp_path: Path, case: str) -> None:
    change, words, code = ONE_LINE[case]
    instance = write_instance(tmp_path, DOMAIN, PROBLEM)
    change(instance)
    results = [invoke(*command, *words(instance)) for command in (("solve",), ("simulate", "--humans", 2))]
    found = [(one.exit_code, one.stdout, one.stderr) for one in results]
    if case == "broken":
        done = kitassist("solve", instance.problem)  # as a user starts it
        found.append((done.returncode, done.stdout, done.stderr))
    for exit_code, printed, said in found:
        assert (exit_code, printed, len(said.splitlines())) == (code, "", 1)
        assert str(tmp_path) in said


def test_an_invalid_plan_is_rejected(tmp_path: Path) -> None:
    problem = understood(write_instance(tmp_path, DOMAIN, PROBLEM))
    with pytest.raises(MismatchError):
        validate(problem, ["(fetch box-a)", "(return box-a)"])
