"""Recordings of real people at the Tower of London as logs of `domains/tower`, and generated ones in the same format.

Each file is one person's session, a table with a row for each click. Rows with `task` tol_tohand (a ball is taken) and
tol_toboard (it is put down), up to tol_feedback, are used; one of each is a move. Practice (tol_practice), problems
that do not end at their target (aborted), and sessions without a problem are omitted. A ball that is put back where it
was taken from is not a move. The result contains no names; people are numbers.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

CAPACITY = {"left": 3, "middle": 2, "right": 1}
BALLS = ("red", "green", "blue")

Board = tuple[tuple[int, ...], ...]
"""The balls on each peg, 1 to 3, from bottom to top."""


@dataclass(frozen=True)
class Solved:
    """One person's solution of one problem."""

    person: int
    problem: int
    order: int  # among this person's problems
    initial: Board
    target: Board
    boards: tuple[Board, ...]  # after each move
    seconds: tuple[float, ...]  # from putting one ball down to taking the next


def board_of(text: str) -> Board:
    return tuple(tuple(ball for ball in peg if ball) for peg in json.loads(text))


def read_all(folder: Path) -> list[Solved]:
    """Read a folder of sessions."""
    files = sorted(file for file in folder.iterdir() if file.suffix == ".csv")
    sessions = [one for one in (list(_session(file)) for file in files) if one]
    return [Solved(person, *rest) for person, session in enumerate(sessions) for rest in session]


def _session(file: Path) -> Iterator[tuple[int, int, Board, Board, tuple[Board, ...], tuple[float, ...]]]:
    with file.open(encoding="utf-8", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["task"] in ("tol_tohand", "tol_toboard", "tol_feedback")]
    order, clicks = 0, []
    for row in rows:
        if row["task"] != "tol_feedback":
            clicks.append(row)
            continue
        if clicks:
            order += 1
            boards = [board_of(click["current_position"]) for click in clicks[1::2]]
            target = board_of(clicks[0]["tol_target"])
            initial = _before(board_of(clicks[0]["current_position"]), int(clicks[0]["mouse_click"][-1]) - 1)
            moved = [now != before for now, before in zip(boards, [initial, *boards], strict=False)]
            seconds = [float(click["rt"]) / 1000 for click in clicks[::2]]
            if boards and boards[-1] == target:
                kept = [i for i, real in enumerate(moved) if real]
                yield (
                    int(clicks[0]["tol_problem_id"]), order, initial, target, tuple(boards[i] for i in kept),
                    tuple(seconds[i] for i in kept),
                )  # fmt: skip
        clicks = []


def _before(board: Board, peg: int) -> Board:
    """Return the board with the ball in the hand put back on the peg that it was taken from."""
    (ball,) = {1, 2, 3} - {ball for held in board for ball in held}
    return tuple((*held, ball) if place == peg else held for place, held in enumerate(board))


def problem_text(name: str, initial: Board, target: Board) -> str:
    """Return a problem of `domains/tower` as text."""
    pegs = list(CAPACITY.items())
    places = [f"{peg}-{n}" for peg, size in pegs for n in range(1, size + 1)]
    columns = [["board", *(f"{peg}-{n}" for n in range(1, size + 1)), "air"] for peg, size in pegs]
    held = {f"{pegs[p][0]}-{n + 1}": ball for p, balls in enumerate(initial) for n, ball in enumerate(balls)}
    facts = [f"(at {BALLS[ball - 1]} {place}) (taken {place})" for place, ball in held.items()]
    facts += [f"(free {place})" for place in places if place not in held]
    facts += [f"(above {high} {low})" for column in columns for low, high in pairwise(column)]
    goal = [f"(at {BALLS[b - 1]} {pegs[p][0]}-{n + 1})" for p, balls in enumerate(target) for n, b in enumerate(balls)]
    return (
        f"(define (problem {name}) (:domain tower)\n"
        f"  (:objects {' '.join(BALLS)} - ball {' '.join(places)} - place board air - level)\n"
        f"  (:init (taken board) (free air) {' '.join(facts)})\n  (:goal (and {' '.join(goal)})))\n"
    )


def moves_of(solved: Solved) -> list[str]:
    """Return the moves as actions of `domains/tower`."""
    actions, before = [], solved.initial
    for after in solved.boards:
        (source,) = [p for p in range(3) if len(after[p]) < len(before[p])]
        (goal,) = [p for p in range(3) if len(after[p]) > len(before[p])]
        pegs = list(CAPACITY)
        ball, start, end = (
            before[source][-1],
            f"{pegs[source]}-{len(before[source])}",
            f"{pegs[goal]}-{len(after[goal])}",
        )
        actions.append(f"(move {BALLS[ball - 1]} {start} {end})")
        before = after
    return actions


def make_up(folder: Path, people: int, problems: int, rng: np.random.Generator) -> None:
    """Write generated sessions in the format of the recordings: random moves, never of the same ball twice in a row."""
    folder.mkdir(parents=True, exist_ok=True)
    columns = ["task", "current_position", "tol_target", "tol_problem_id", "mouse_click", "rt"]
    boards = [((1, 2, 3), (), ())]
    for board in boards:
        boards += [after for _, _, after in _reach(board) if after not in boards]
    pairs = [rng.choice(len(boards), 2, replace=False) for _ in range(problems)]
    for person in range(people):
        rows = [["tol_practice", "[[1,2,0],[0,0],[3]]", "[[1,2,0],[0,0],[3]]", "practice", "tol_peg_3", "900"]]
        for problem, (first, last) in enumerate(pairs):
            board, moved = boards[first], 0
            while board != boards[last]:
                options = [one for one in _reach(board) if one[0][1] != moved] or _reach(board)
                (source, ball), goal, after = options[int(rng.integers(len(options)))]
                lifted = tuple(held[:-1] if p == source else held for p, held in enumerate(board))
                wanted, number = _text(boards[last]), str(problem)
                rows.append(["tol_tohand", _text(lifted), wanted, number, f"tol_peg_{source + 1}", "800"])
                rows.append(["tol_toboard", _text(after), wanted, number, f"tol_peg_{goal + 1}", "500"])
                board, moved = after, ball
            rows.append(["tol_feedback", "", "", "", "none", "-1"])
        with (folder / f"{person:03d}.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, quoting=csv.QUOTE_ALL).writerows([columns, *rows])


def _reach(board: Board) -> list[tuple[tuple[int, int], int, Board]]:
    """Return all moves: source peg and ball, target peg, and the board afterwards."""
    found = []
    for source, held in enumerate(board):
        for goal, size in enumerate(CAPACITY.values()):
            if held and goal != source and len(board[goal]) < size:
                changed = {source: held[:-1], goal: (*board[goal], held[-1])}
                found.append(((source, held[-1]), goal, tuple(changed.get(p, b) for p, b in enumerate(board))))
    return found


def _text(board: Board) -> str:
    return json.dumps([[*held, *[0] * (size - len(held))] for held, size in zip(board, CAPACITY.values(), strict=True)])
