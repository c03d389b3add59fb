"""Invalid PDDL: one line with the fault, the file and the line number."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import KITTING, kitassist, understood, write_instance

from assist.cli import main
from planner import InstanceError, PDDLError, find_instances, load
from planner.pddl.validation import InvalidPlanError, validate

DOMAIN = (KITTING / "domain.pddl").read_text()
PROBLEM = (KITTING / "tiny.pddl").read_text()


def line_of(text: str, part: str) -> int:
    assert text.count(part) == 1, part
    return text[: text.index(part)].count("\n") + 1


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


COSTS = changed(DOMAIN, "(:predicates", "(:functions (total-cost) - number)\n  (:predicates")

# The fault, the two files, the file at fault, a part of that file on the reported line (None if there is no line), and
# words of the message.
BROKEN = [
    (
        "missing parenthesis in a section",
        changed(DOMAIN, "(platform-free)  ", "(platform-free  "),
        PROBLEM,
        "domain",
        "(:predicates",
        ["not closed before (:action"],
    ),
    ("missing parenthesis at the end", DOMAIN, PROBLEM.rstrip()[:-1], "problem", "(:goal", ["')' is missing"]),
    (
        "a problem without a name",
        DOMAIN,
        changed(PROBLEM, "(problem tiny)", "(problem)"),
        "problem",
        "(problem)",
        ["NAME"],
    ),
    (
        "two names",
        changed(DOMAIN, "(domain kitting)", "(domain kitting x)"),
        PROBLEM,
        "domain",
        "(domain kitting x)",
        ["NAME"],
    ),
    ("one parenthesis too many", DOMAIN, PROBLEM.rstrip() + "\n)", "problem", "\n)", ["without a '('"]),
    (
        "unknown predicate in the goal",
        DOMAIN,
        changed(PROBLEM, "(in-slot wrench slot-2)", "(in-slt wrench slot-2)"),
        "problem",
        "(in-slt",
        ["in-slt", "did you mean 'in-slot'"],
    ),
    (
        "unknown predicate in init",
        DOMAIN,
        changed(PROBLEM, "(platform-free)", "(platform-fre)"),
        "problem",
        "(platform-fre)",
        ["platform-fre'", "platform-free"],
    ),
    (
        "unknown predicate in an action",
        changed(DOMAIN, "(and (contains ?c ?i) (slot", "(and (holds ?c ?i) (slot"),
        PROBLEM,
        "domain",
        "(holds ?c",
        ["holds"],
    ),
    (
        "unknown object",
        DOMAIN,
        changed(PROBLEM, "(contains box-a hammer)", "(contains box-a hamer)"),
        "problem",
        "hamer)",
        ["'hamer'", "did you mean 'hammer'"],
    ),
    (
        "unknown variable",
        changed(DOMAIN, "(contains ?c ?i)\n", "(contains ?c ?z)\n"),
        PROBLEM,
        "domain",
        "(contains ?c ?z)",
        ["'?z'"],
    ),
    (
        "wrong type in init",
        DOMAIN,
        changed(PROBLEM, "(contains box-a hammer)", "(contains hammer hammer)"),
        "problem",
        "(contains hammer hammer)",
        ["wrong type"],
    ),
    (
        "wrong type in an action",
        changed(DOMAIN, "(and (on-platform ?c) (contains", "(and (on-platform ?i) (contains"),
        PROBLEM,
        "domain",
        "(on-platform ?i)",
        ["wrong type"],
    ),
    (
        "unknown type",
        DOMAIN,
        changed(PROBLEM, "- container", "- contaner"),
        "problem",
        "- contaner",
        ["unknown type 'contaner'", "did you mean 'container'"],
    ),
    (
        "wrong number of arguments",
        DOMAIN,
        changed(PROBLEM, "(contains box-a hammer)", "(contains box-a)"),
        "problem",
        "(contains box-a)",
        ["takes 2 arguments, not 1"],
    ),
    (
        "wrong domain name",
        DOMAIN,
        changed(PROBLEM, "(:domain kitting)", "(:domain cooking)"),
        "problem",
        "(:domain cooking)",
        ["'cooking'", "'kitting'"],
    ),
    (
        "object defined twice",
        DOMAIN,
        changed(PROBLEM, "hammer wrench - item", "hammer\n    hammer wrench - item"),
        "problem",
        "\n    hammer wrench - item",
        ["'hammer' is defined twice"],
    ),
    (
        "durative actions",
        changed(DOMAIN, "(:action fetch", "(:durative-action fetch"),
        PROBLEM,
        "domain",
        ":precondition (and (in-storage ?c)",
        ["':precondition' is not expected in action 'fetch'"],
    ),
    ("no goal", DOMAIN, PROBLEM[: PROBLEM.index("(:goal")] + ")", "problem", None, ["(:goal"]),
    ("mistyped section", DOMAIN, changed(PROBLEM, "(:goal", "(:gaol"), "problem", "(:gaol", ["(:gaol"]),
    ("empty problem", DOMAIN, "", "problem", None, ["empty"]),
    ("empty domain", "; nothing but a comment\n", PROBLEM, "domain", None, ["empty"]),
    ("files swapped", PROBLEM, DOMAIN, "domain", None, ["swap"]),
    (
        "unknown requirement",
        changed(DOMAIN, "(:requirements :strips", "(:requirements :strips\n  :type-checks"),
        PROBLEM,
        "domain",
        ":type-checks",
        ["unknown requirement ':type-checks'"],
    ),
    (
        "requirement outside",
        changed(DOMAIN, "(:requirements :strips", "(:requirements :strips\n  :goal-utilities"),
        PROBLEM,
        "domain",
        ":goal-utilities",
        [":goal-utilities is not supported"],
    ),
    (
        "action without effect",
        changed(
            DOMAIN, "(:action fetch", "(:action wait :parameters ()\n :precondition (platform-free))\n  (:action fetch"
        ),
        PROBLEM,
        "domain",
        "(:action wait",
        ["'wait' has no :effect"],
    ),
    (
        "timed initial literals",
        DOMAIN,
        changed(PROBLEM, "(platform-free)", "(at 5 (platform-free))"),
        "problem",
        "(at 5",
        ["timed initial literals"],
    ),
    (
        "a conjunction in init",
        DOMAIN,
        changed(PROBLEM, "(platform-free)", "(and (platform-free))"),
        "problem",
        "(and (platform-free))",
        ["(and ...)", "one by one"],
    ),
    (
        "object of the wrong type, seen in the goal",
        DOMAIN,
        changed(PROBLEM, "(in-slot wrench slot-2)", "(in-slot slot-2 wrench)"),
        "problem",
        "(in-slot slot-2 wrench)",
        ["wrong type"],
    ),
    (
        "circular types",
        changed(DOMAIN, "(:types container", "(:types\n thing - part part - thing container"),
        PROBLEM,
        "domain",
        " thing - part",
        ["circular types: thing - part - thing"],
    ),
    (
        "action defined twice",
        changed(DOMAIN, "(:action return", "(:action fetch"),
        PROBLEM,
        "domain",
        "\n  (:action fetch\n    :parameters (?c - container)\n    :precondition (on-platform ?c)",
        ["'fetch' is defined twice, on line 21 as well"],
    ),
    (
        "scale-up",
        changed(
            COSTS,
            "(not (in-storage ?c)) (not",
            "(scale-up (total-cost) 2) (not",
        ),
        PROBLEM,
        "domain",
        "(scale-up",
        ["costs only grow"],
    ),
    (
        "negative cost",
        changed(
            COSTS,
            "(not (in-storage ?c)) (not",
            "(increase (total-cost) -2) (not",
        ),
        PROBLEM,
        "domain",
        "(increase",
        ["may not be negative", "-2"],
    ),
    (
        "maximising",
        DOMAIN,
        changed(PROBLEM, "(:goal", "(:metric maximize (total-cost))\n  (:goal"),
        "problem",
        "(:metric",
        ["maximize is not supported"],
    ),
    (
        "a preference",
        DOMAIN,
        changed(PROBLEM, "(in-slot wrench slot-2)", "(preference tidy (in-slot wrench slot-2))"),
        "problem",
        "(preference",
        ["preferences"],
    ),
    (
        "a variable in the goal",
        DOMAIN,
        changed(PROBLEM, "(in-slot wrench slot-2)", "(in-slot wrench ?s)"),
        "problem",
        "(in-slot wrench ?s)",
        ["?s"],
    ),
    (
        "not of two",
        changed(DOMAIN, "(not (in-storage ?c)) (not", "(not (in-storage ?c) (on-platform ?c)) (not"),
        PROBLEM,
        "domain",
        "(not (in-storage ?c) (on",
        ["exactly one"],
    ),
    (
        "imply of one",
        changed(DOMAIN, "(and (in-storage ?c) (platform-free))", "(and (in-storage ?c)\n (imply (platform-free)))"),
        PROBLEM,
        "domain",
        "(imply",
        ["'imply'", "two"],
    ),
    (
        "parameters without parentheses",
        changed(DOMAIN, ":action fetch\n    :parameters (?c - container)", ":action fetch\n    :parameters ?c"),
        PROBLEM,
        "domain",
        ":parameters ?c",
        ["parameters", "'fetch'"],
    ),
    (
        "a letter outside ASCII",
        DOMAIN,
        changed(PROBLEM, "hammer wrench - item", "hammer wrench clé - item"),
        "problem",
        "clé",
        ["'é' is not ASCII"],
    ),
    (
        "two initial states",
        DOMAIN,
        changed(PROBLEM, "(:goal", "(:init (platform-free) )\n  (:goal"),
        "problem",
        "(:init (platform-free) )",
        ["a second (:init"],
    ),
    (
        "mistyped section of the domain",
        changed(DOMAIN, "(:action fetch", "(:actoin fetch"),
        PROBLEM,
        "domain",
        "(:actoin",
        ["did you mean ':action'"],
    ),
    (
        "something after the end",
        DOMAIN,
        PROBLEM.rstrip() + "\n(:metric minimize (total-cost))",
        "problem",
        "\n(:metric",
        ["after the end"],
    ),
    (
        "a fault beside what only the translator reads",
        changed(DOMAIN, "(platform-free)  ", "(platform-free) (fetch)"),
        changed(PROBLEM, "(contains box-a hammer)", "(contains box-a hamer)"),
        "problem",
        "hamer)",
        ["hamer"],
    ),
]


@pytest.mark.parametrize(
    ("domain", "problem", "at_fault", "place", "words"), [b[1:] for b in BROKEN], ids=[b[0] for b in BROKEN]
)
def test_broken_pddl_names_the_place(
    tmp_path: Path, domain: str, problem: str, at_fault: str, place: str | None, words: list[str]
) -> None:
    instance = write_instance(tmp_path, domain, problem)
    with pytest.raises(PDDLError) as error:
        load(instance)
    assert error.value.file == getattr(instance, at_fault)
    if place is not None:
        text = domain if at_fault == "domain" else problem
        assert error.value.line == line_of(text, place) + (place[0] == "\n")
    assert all(word in error.value.message for word in words), error.value.message
    assert "\n" not in str(error.value)


def test_binary_file(tmp_path: Path) -> None:
    instance = write_instance(tmp_path, DOMAIN, "")
    instance.problem.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(PDDLError, match="not a text file"):
        load(instance)


def test_pddl_does_not_distinguish_case(tmp_path: Path) -> None:
    task = load(write_instance(tmp_path, DOMAIN, PROBLEM.upper()))
    assert task.actions == load(KITTING / "tiny.pddl").actions


@pytest.mark.parametrize(
    ("case", "code"),
    [
        ("broken", 1),
        ("binary", 1),
        ("no domain", 1),
        ("missing", 2),
        ("no problems", 2),
        ("no match", 2),
        ("no such domain", 2),
    ],
)
def test_the_command_says_it_in_one_line(tmp_path: Path, case: str, code: int) -> None:
    instance = write_instance(tmp_path, DOMAIN, PROBLEM)
    arguments: list[object] = [instance.problem]
    if case == "broken":
        instance.problem.write_text(PROBLEM.replace("(platform-free)", "(platform-fre)"))
    elif case == "binary":
        instance.problem.write_bytes(b"\x00\xff" * 100)
    elif case == "no domain":
        instance.domain.unlink()
    elif case == "missing":
        arguments = [tmp_path / "absent.pddl"]
    elif case == "no problems":
        instance.problem.unlink()
        arguments = [tmp_path]
    elif case == "no match":
        arguments = [f"{tmp_path}/x*.pddl"]
    else:
        arguments = [instance.problem, "--domain", tmp_path / "absent.pddl"]
    # A second interpreter where that is what a user starts, and else none: both read in the same way.
    for command, options in (("solve", []), ("simulate", ["--humans", "2"])):
        if command == "solve" and case == "broken":
            done = kitassist("solve", *arguments)
            assert (done.returncode, done.stdout) == (code, "")
            said = done.stderr
        else:
            result = CliRunner().invoke(main, [command, *map(str, arguments), *options])
            assert result.exit_code == code
            assert result.stdout == ""
            said = result.stderr
        assert len(said.splitlines()) == 1
        assert str(tmp_path) in said


def test_find_instances(tmp_path: Path) -> None:
    first = write_instance(tmp_path / "a", DOMAIN, PROBLEM)
    second = write_instance(tmp_path / "b" / "c", DOMAIN, PROBLEM)
    assert find_instances([tmp_path]) == [first, second]
    assert find_instances([first.problem, tmp_path / "a"]) == [first]
    assert find_instances([f"{tmp_path}/*/p*.pddl"]) == [first]
    assert find_instances([f"{tmp_path}/**/*.pddl"]) == [first, second]
    assert find_instances([first.problem], second.domain)[0].domain == second.domain
    with pytest.raises(InstanceError, match="no such file"):
        find_instances([tmp_path / "absent"])


def test_an_invalid_plan_is_rejected(tmp_path: Path) -> None:
    problem = understood(write_instance(tmp_path, DOMAIN, PROBLEM))
    with pytest.raises(InvalidPlanError):
        validate(problem, ["(fetch box-a)", "(return box-a)"])
