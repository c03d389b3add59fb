"""Constructs that PDDL readers interpret differently or accept silently are refused with their line, or read
correctly.
"""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import write_instance

from planner import PDDLError, instance, load, sweep
from planner.pddl.reader import read
from planner.pddl.validation import LATE, SecondReader
from planner.system.errors import MismatchError

DOMAIN = """(define (domain sorting)
  (:requirements :strips :typing :action-costs)
  (:types part tray - object)
  (:predicates (on ?p - part ?t - tray) (held ?p - part) (free) (at ?t - tray))
  (:functions (total-cost) - number (way ?a ?b - tray) - number)
  (:action go :parameters (?a ?b - tray) :precondition (at ?a)
    :effect (and (not (at ?a)) (at ?b)
      (increase (total-cost) (way ?a ?b))))
  (:action take :parameters (?p - part ?t - tray) :precondition (and (at ?t) (on ?p ?t) (free))
    :effect (and (held ?p) (not (on ?p ?t)) (not (free))
      (increase (total-cost) 1)))
  (:action lay :parameters (?p - part ?t - tray) :precondition (and (at ?t) (held ?p))
    :effect (and (on ?p ?t) (free) (not (held ?p))
      (increase (total-cost) 2))))
"""
PROBLEM = """(define (problem one) (:domain sorting)
  (:objects nut - part
    red blue - tray)
  (:init (free) (at red) (on nut red) (= (total-cost) 0)
    (= (way red blue) 4) (= (way blue red) 4) (= (way red red) 0) (= (way blue blue) 0))
  (:goal (and
    (on nut blue)))
  (:metric minimize (total-cost)))
"""


def cost(folder: Path, domain: str, problem: str) -> float:
    table = sweep(load(write_instance(folder, domain, problem)))
    return float(table[table.initial])


def test_the_task_that_is_changed_below_can_be_read(tmp_path: Path) -> None:
    assert cost(tmp_path, DOMAIN, PROBLEM) == 7


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("(:types part tray - object)", "(:types part - part tray)"),
        ("(:types part tray - object)", "(:types tray - tray nut-part - part part - part)"),
        ("(way ?a ?b))))", "( way   ?a\t?b ))))"),
        ("(:types part tray - object)", "(:types thing box - object part tray - thing tray - box)"),
        ("(at ?t - tray))", "(at ?t - tray) (seen ?x))"),
    ],
)
def test_ways_to_write_types_that_mean_the_same(tmp_path: Path, old: str, new: str) -> None:
    """An object belongs to its type and all supertypes, of which there may be several."""
    assert old in DOMAIN
    general = DOMAIN.replace(old, new).replace("(on ?p - part ?t - tray)", "(on ?p - part ?t - (either tray box))")
    assert cost(tmp_path, general if "box" in new else DOMAIN.replace(old, new), PROBLEM) == 7


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_may_end_as_any_system_writes_them(tmp_path: Path, end: str) -> None:
    """A comment ends with its line, whatever that is."""
    commented = DOMAIN.replace("(:types", "; what there is\n  (:types")
    instance = write_instance(tmp_path, "", "")
    instance.domain.write_bytes(commented.replace("\n", end).encode())
    instance.problem.write_bytes(PROBLEM.replace("\n", end).encode())
    table = sweep(load(instance))
    assert table[table.initial] == 7
    instance.domain.write_bytes(commented.replace("1)))", "one)))").replace("\n", end).encode())
    with pytest.raises(PDDLError, match=r":12: action 'take' costs 'one'"):
        load(instance)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("(?p - part ?t - tray) :precondition", "(?p -part ?t - tray) :precondition", 9, "'-part'"),
        ("(held ?p - part)", "(held ?p -part)", 4, "'-part': expected a blank before and after the hyphen"),
        ("(:types part tray - object)", "(:types part tray -object)", 3, "'-object'"),
        ("(:types part tray - object)", "(:types part tray- object)", 3, "'tray-'"),
        ("(total-cost) 1)", "(total-cost) one)", 11, "action 'take' costs 'one'; expected a number"),
        ("(total-cost) 1)", "(total-cost) 1,5)", 11, "costs '1,5'"),
        ("(total-cost) 1)", "(total-cost) 1e1)", 11, "costs '1e1'"),
        ("(total-cost) 1)", "(total-cost) -1)", 11, "may not be negative"),
        ("(total-cost) 1)", "(total-cost))", 11, "'increase' expects exactly two arguments"),
        ("(total-cost) 1)", "(total-cost) 1) (increase (total-cost) 5)", 11, "action 'take' has two costs"),
        ("(way ?a ?b))))", "(wya ?a ?b))))", 8, "no such function .*did you mean 'way'"),
        ("(way ?a ?b))))", "(way ?a))))", 8, "'way' takes 2 arguments, not 1"),
        (":precondition (at ?a)\n", ":precondition (at ?a) :observe (at ?b)\n", 6, "sensing actions are not supported"),
    ],
)  # fmt: skip
def test_faults_of_a_domain_that_would_change_the_answer(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in DOMAIN
    with pytest.raises(PDDLError, match=words) as error:
        load(write_instance(tmp_path, DOMAIN.replace(old, new, 1), PROBLEM))
    assert (error.value.file.name, error.value.line) == ("domain.pddl", line)


DERIVED = DOMAIN.replace(":action-costs)", ":action-costs :derived-predicates)").replace(
    "(at ?t - tray))", "(at ?t - tray) (idle))"
).replace("  (:action go", "  (:derived (idle) (free))\n  (:action go")  # fmt: skip
"""The same with an axiom, which unified-planning does not read: it names no wrong types here."""


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("(on nut red)", "(on red nut)", 4, "on has an argument of the wrong type: 'red' is of type tray, and part is"),
        ("(at red)", "(at nut)", 4, "'nut' is of type part, and tray is expected"),
        ("(on nut blue)", "(on nut nut)", 7, "'nut' is of type part, and tray is expected"),
        ("red blue - tray)", "red blue -tray)", 3, "'-tray'"),
        ("(at red)", "(at\u200b red)", 4, r"zero width space is not ASCII \(U\+200B, column 20\)"),
        ("(at red)", "(at\u00a0red)", 4, r"U\+00A0, column 20"),
        ("(at red)", "(at\x1cred)", 4, r"a control character is no PDDL \(U\+001C, column 20\)"),
        ("(at red)", "(at red)\x7f", 4, r"U\+007F, column 25"),
        ("(at red)", "(at r\u2028ed)", 4, r"line separator is not ASCII \(U\+2028, column 22\)"),
        ("(on nut blue)", "(and " * 200 + "(on nut blue)" + ")" * 200, 7, "more than 200 parentheses are open here"),
        ("(at red)", "(at réd)", 4, r"'é' is not ASCII \(U\+00E9, column 22\)"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("domain", [DOMAIN, DERIVED], ids=["plain", "derived"])
def test_faults_of_a_problem_that_would_change_the_answer(
    tmp_path: Path, domain: str, old: str, new: str, line: int, words: str
) -> None:
    assert old in PROBLEM
    with pytest.raises(PDDLError, match=words) as error:
        load(write_instance(tmp_path, domain, PROBLEM.replace(old, new, 1)))
    assert (error.value.file.name, error.value.line) == ("problem.pddl", line)


def process_of(second: SecondReader) -> int:
    assert second._process is not None
    return second._process.popen.pid


def test_a_second_reader_that_dies_or_hangs_gives_a_reason() -> None:
    reading = read(instance("kitting/tiny"))
    for number, seconds, reason in ((signal.SIGKILL, 60.0, "its process died"), (signal.SIGSTOP, 0.2, LATE)):
        with SecondReader(reading) as second:
            os.kill(process_of(second), number)
            second.ask(["(fetch box-a)"])
            assert second.answer(seconds) == reason
    with SecondReader(reading) as second:
        second.ask([])
        with pytest.raises(MismatchError):
            second.answer(60.0)


def test_a_second_reader_serves_one_instance_after_another() -> None:
    processes = set()
    for name in ("kitting/tiny", "kitting/paper"):
        with SecondReader(read(instance(name))) as second:
            processes.add(process_of(second))
            assert second.answer(60.0) is None
    assert len(processes) == 1


def test_asking_the_second_reader_takes_no_time() -> None:
    """Neither a long text nor a long plan waits for a process that reads nothing."""
    reading = read(instance("kitting/tiny"))
    long = replace(reading, problem=replace(reading.problem, name="p" * 10_000_000))
    with SecondReader(long) as second:
        os.kill(process_of(second), signal.SIGSTOP)
        second.ask(["(fetch box-a)"] * 100_000)
        assert second.answer(0.0) == LATE
