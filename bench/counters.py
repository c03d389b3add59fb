"""Tasks with numbers beside the same tasks by hand in STRIPS, where a number is an object and `next` says what follows.

    python bench/counters.py [NAME...] [--pairs 7] [--record FILE]

The pairs are the shipped `stock/order` and `stock/day`, a robot with a battery (`battery`), and parts that are placed
on two trays of limited size (`trays`). Both sides of a pair have the same states and the same optimal cost, or the
script fails. Each side runs in a process of its own, after a small task that loads the compiled code.

- `rate` is the number of states that the sweep reaches in a second of processor time; `slower` is the rate by hand,
  divided by that with numbers.
- `translate` is the processor time of reading the files, computing the values of numbers, and Fast Downward's
  translator; `longer` is the time with numbers, divided by that by hand.

Both ratios are medians over alternating pairs of processes.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click
from tables import Columns, cell, record_option, write_record

ROOT = Path(__file__).resolve().parent.parent
DOMAINS = ROOT / "domains"
Texts = tuple[str, str]
"""A domain and a problem."""

COLUMNS: Columns = {
    "task": cell("task"), "states": cell("states", ","), "cost": cell("cost", "g"),
    "states/s by hand": cell("rate by hand", ",.0f"), "states/s": cell("rate", ",.0f"), "slower": cell("slower", ".2f"),
    "translated by hand, s": cell("translate by hand", ".2f"), "translated, s": cell("translate", ".2f"),
    "longer": cell("longer", ".2f"), "sweep, s": cell("sweep", ".2f"),
}  # fmt: skip


def numbers(most: int) -> tuple[str, list[str]]:
    """Return the objects for the numbers from 0, and the facts that order them."""
    return " ".join(f"n{n}" for n in range(most + 1)), [f"(next n{n} n{n + 1})" for n in range(most)]


def problem(domain: str, objects: str, init: Iterable[str], goal: Iterable[str], metric: str = "") -> str:
    """Return the text of a problem file."""
    return (f"(define (problem p) (:domain {domain}) (:objects {objects})\n  (:init {' '.join(init)})\n"
            f"  (:goal (and {' '.join(goal)})){metric})\n")  # fmt: skip


def stock(name: str) -> tuple[Texts, Texts]:
    """Return a shipped task of counted bins, and the same by hand: one predicate for each quantity."""
    domain, text = ((DOMAINS / "stock" / f"{each}.pddl").read_text(encoding="utf-8") for each in ("domain", name))
    plain = re.sub(r";[^\n]*", "", text)
    values = {tuple(key.split()): int(number) for key, number in re.findall(r"\(= \(([^)]+)\) (\d+)\)", plain)}
    objects = re.search(r"\(:objects ([^)]*)\)", plain)
    assert objects is not None
    kinds = objects[1].partition("- kind")[0].split()
    most = max(values.values())
    names, init = numbers(most)
    init += [*re.findall(r"\(holds [^)]*\)", plain), "(= (total-cost) 0)"]
    for (what, *key), number in values.items():
        if what in ("parts", "packs", "placed", "ordered"):
            init.append(f"({what} {' '.join(key)} n{number})")
        elif what in ("size", "room"):
            init += [f"({what} {' '.join(key)} n{n})" for n in range(number + 1)]
        elif what == "pack":
            init += [f"(filled {key[0]} n{n} n{n + number})" for n in range(most + 1 - number)]
    rows = " ".join(f"?m{n} - amount" for n in range(len(kinds)))
    exact = " ".join(f"(placed {kind} ?t ?m{n}) (ordered {kind} ?t ?m{n})" for n, kind in enumerate(kinds))
    by_hand = f"""(define (domain stock)
  (:requirements :typing :negative-preconditions :action-costs)
  (:types kind bin tray amount)
  (:constants {" ".join(kinds)} - kind)
  (:predicates (holds ?b - bin ?k - kind) (sent ?t - tray) (next ?m ?n - amount)
    (parts ?b - bin ?n - amount) (size ?b - bin ?n - amount) (packs ?b - bin ?n - amount)
    (filled ?b - bin ?m ?n - amount) (placed ?k - kind ?t - tray ?n - amount)
    (ordered ?k - kind ?t - tray ?n - amount) (room ?k - kind ?t - tray ?n - amount))
  (:functions (total-cost))
  (:action pick :parameters (?k - kind ?b - bin ?t - tray ?less ?more ?few ?many - amount)
    :precondition (and (holds ?b ?k) (not (sent ?t)) (parts ?b ?more) (next ?less ?more) (placed ?k ?t ?few)
      (next ?few ?many) (room ?k ?t ?many))
    :effect (and (not (parts ?b ?more)) (parts ?b ?less) (not (placed ?k ?t ?few)) (placed ?k ?t ?many)
      (increase (total-cost) 1)))
  (:action put-back :parameters (?k - kind ?b - bin ?t - tray ?less ?more ?few ?many - amount)
    :precondition (and (holds ?b ?k) (not (sent ?t)) (parts ?b ?less) (next ?less ?more) (size ?b ?more)
      (placed ?k ?t ?many) (next ?few ?many))
    :effect (and (not (parts ?b ?less)) (parts ?b ?more) (not (placed ?k ?t ?many)) (placed ?k ?t ?few)
      (increase (total-cost) 1)))
  (:action refill :parameters (?b - bin ?less ?more ?few ?many - amount)
    :precondition (and (packs ?b ?many) (next ?few ?many) (parts ?b ?less) (filled ?b ?less ?more) (size ?b ?more))
    :effect (and (not (packs ?b ?many)) (packs ?b ?few) (not (parts ?b ?less)) (parts ?b ?more)
      (increase (total-cost) 3)))
  (:action send :parameters (?t - tray {rows})
    :precondition (and (not (sent ?t)) {exact})
    :effect (and (sent ?t) (increase (total-cost) 1))))"""
    rest = objects[1].partition("- kind")[2]
    goal = re.findall(r"\(sent [^)]*\)", plain)
    hand = problem("stock", f"{rest} {names} - amount", init, goal, " (:metric minimize (total-cost))")
    return (domain, text), (by_hand, hand)


def battery(side: int, capacity: int, points: int) -> tuple[Texts, Texts]:
    """Return a robot on a grid whose battery lasts for some moves, and that has to inspect points."""
    cells = [f"c{x}-{y}" for x in range(side) for y in range(side)]
    roads = [
        f"(road c{x}-{y} c{v}-{w})" for x, y, v, w in itertools.product(range(side), repeat=4)
        if abs(x - v) + abs(y - w) == 1
    ]  # fmt: skip
    wanted = cells[:: max(1, len(cells) // points)][:points]
    shared = [*roads, f"(at {cells[0]})", f"(station {cells[0]})", f"(station {cells[-1]})"]
    goal = [f"(seen {cell})" for cell in wanted]
    predicates = "(at ?c - cell) (road ?c ?d - cell) (station ?c - cell) (seen ?c - cell) (point ?c - cell)"
    shared += [f"(point {cell})" for cell in wanted]
    look = """(:action inspect :parameters (?c - cell) :precondition (and (at ?c) (point ?c)) :effect (seen ?c))"""
    counted = f"""(define (domain battery) (:requirements :typing :numeric-fluents) (:types cell)
  (:predicates {predicates}) (:functions (charge) (capacity))
  (:action move :parameters (?c ?d - cell) :precondition (and (at ?c) (road ?c ?d) (>= (charge) 1))
    :effect (and (not (at ?c)) (at ?d) (decrease (charge) 1)))
  (:action plug-in :parameters (?c - cell) :precondition (and (at ?c) (station ?c))
    :effect (assign (charge) (capacity)))
  {look})"""
    by_hand = f"""(define (domain battery) (:requirements :typing) (:types cell amount)
  (:predicates {predicates} (charge ?n - amount) (full ?n - amount) (next ?m ?n - amount))
  (:action move :parameters (?c ?d - cell ?less ?more - amount)
    :precondition (and (at ?c) (road ?c ?d) (charge ?more) (next ?less ?more))
    :effect (and (not (at ?c)) (at ?d) (not (charge ?more)) (charge ?less)))
  (:action plug-in :parameters (?c - cell ?now ?full - amount)
    :precondition (and (at ?c) (station ?c) (charge ?now) (full ?full))
    :effect (and (not (charge ?now)) (charge ?full)))
  {look})"""
    names, order = numbers(capacity)
    values = [f"(= (charge) {capacity})", f"(= (capacity) {capacity})"]
    objects = f"{' '.join(cells)} - cell"
    hand = [*shared, *order, f"(charge n{capacity})", f"(full n{capacity})"]
    return (
        (counted, problem("battery", objects, [*shared, *values], goal)),
        (by_hand, problem("battery", f"{objects} {names} - amount", hand, goal)),
    )


def trays(kinds: int, parts: int, capacity: int) -> tuple[Texts, Texts]:
    """Return parts of some kinds that are placed on two trays, each with room for parts of all kinds together."""
    names = [f"k{n}" for n in range(kinds)]
    objects = f"{' '.join(names)} - kind t0 t1 - tray"
    counted = """(define (domain trays) (:requirements :typing :numeric-fluents) (:types kind tray)
  (:functions (left ?k - kind) (placed ?k - kind ?t - tray) (load ?t - tray) (capacity ?t - tray))
  (:action place :parameters (?k - kind ?t - tray)
    :precondition (and (>= (left ?k) 1) (< (load ?t) (capacity ?t)))
    :effect (and (decrease (left ?k) 1) (increase (placed ?k ?t) 1) (increase (load ?t) 1)))
  (:action remove :parameters (?k - kind ?t - tray) :precondition (>= (placed ?k ?t) 1)
    :effect (and (increase (left ?k) 1) (decrease (placed ?k ?t) 1) (decrease (load ?t) 1))))"""
    by_hand = """(define (domain trays) (:requirements :typing) (:types kind tray amount)
  (:predicates (next ?m ?n - amount) (left ?k - kind ?n - amount) (placed ?k - kind ?t - tray ?n - amount)
    (load ?t - tray ?n - amount) (room ?t - tray ?n - amount) (may ?k - kind ?n - amount))
  (:action place :parameters (?k - kind ?t - tray ?less ?more ?few ?many ?light ?heavy - amount)
    :precondition (and (left ?k ?more) (next ?less ?more) (placed ?k ?t ?few) (next ?few ?many) (load ?t ?light)
      (next ?light ?heavy) (room ?t ?heavy) (may ?k ?more) (may ?k ?many))
    :effect (and (not (left ?k ?more)) (left ?k ?less) (not (placed ?k ?t ?few)) (placed ?k ?t ?many)
      (not (load ?t ?light)) (load ?t ?heavy)))
  (:action remove :parameters (?k - kind ?t - tray ?less ?more ?few ?many ?light ?heavy - amount)
    :precondition (and (left ?k ?less) (next ?less ?more) (placed ?k ?t ?many) (next ?few ?many) (load ?t ?heavy)
      (next ?light ?heavy) (may ?k ?more) (may ?k ?many))
    :effect (and (not (left ?k ?less)) (left ?k ?more) (not (placed ?k ?t ?many)) (placed ?k ?t ?few)
      (not (load ?t ?heavy)) (load ?t ?light))))"""
    numbered, hand = numbers(max(parts, capacity))
    values, wanted, by_number = [], [], []
    for tray in ("t0", "t1"):
        values += [f"(= (load {tray}) 0)", f"(= (capacity {tray}) {capacity})"]
        hand += [f"(load {tray} n0)", *(f"(room {tray} n{n})" for n in range(capacity + 1))]
    for place, kind in enumerate(names):
        values += [f"(= (left {kind}) {parts})", f"(= (placed {kind} t0) 0)", f"(= (placed {kind} t1) 0)"]
        hand += [f"(may {kind} n{n})" for n in range(parts + 1)]
        hand += [f"(left {kind} n{parts})", f"(placed {kind} t0 n0)", f"(placed {kind} t1 n0)"]
        wanted.append(f"(= (placed {kind} t{place % 2}) {min(parts, 2)})")
        by_number.append(f"(placed {kind} t{place % 2} n{min(parts, 2)})")
    return (
        (counted, problem("trays", objects, values, wanted)),
        (by_hand, problem("trays", f"{objects} {numbered} - amount", hand, by_number)),
    )


PAIRS: dict[str, Callable[[], tuple[Texts, Texts]]] = {
    "stock/two-trays": lambda: stock("two-trays"),
    "stock/order": lambda: stock("order"),
    "stock/day": lambda: stock("day"),
    "battery": lambda: battery(8, 30, 6),
    "trays": lambda: trays(4, 5, 12),
}


def work(folder: Path) -> dict[str, float]:
    """Return what a side of a pair takes, in this process."""
    from planner import Instance, sweep
    from planner.grounding import fast_downward
    from planner.grounding.translation import ground
    from planner.pddl.compilation import compiled
    from planner.pddl.reader import read

    def clock() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    small = DOMAINS / "kitting"
    sweep(ground(compiled(read(Instance(small / "tiny.pddl", small / "domain.pddl")))))
    begin = clock()
    made = compiled(read(Instance(folder / "p.pddl", folder / "domain.pddl")))
    fast_downward.translate(made.reading)
    translated = clock()
    task = ground(made)
    before = clock()
    table = sweep(task)
    spent = clock() - before
    return {
        "states": len(table), "cost": table[table.initial], "translate": translated - begin, "sweep": spent,
        "rate": len(table) / spent,
    }  # fmt: skip


def side(folder: Path) -> dict[str, float]:
    """Return what a side of a pair takes, in a process of its own."""
    own = [sys.executable, __file__, "--one", str(folder)]
    done = subprocess.run(
        own, capture_output=True, text=True, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
    )  # fmt: skip
    found: dict[str, float] = json.loads(done.stdout)
    return found


def compared(name: str, pairs: int) -> dict[str, Any]:
    """Return the figures of a pair of tasks."""
    with tempfile.TemporaryDirectory() as folder:
        places = []
        for what, (domain, text) in zip(("numbers", "hand"), PAIRS[name](), strict=True):
            places.append(place := Path(folder, what))
            place.mkdir()
            (place / "domain.pddl").write_text(domain, encoding="utf-8")
            (place / "p.pddl").write_text(text, encoding="utf-8")
        ran: list[tuple[dict[str, float], dict[str, float]]] = []
        for pair in range(pairs):
            if pair % 2:
                hand = side(places[1])
                ran.append((side(places[0]), hand))
            else:
                ran.append((side(places[0]), side(places[1])))
    alike = {(one["states"], one["cost"]) for both in ran for one in both}
    if len(alike) != 1:
        raise click.ClickException(f"{name}: the sides are different tasks: {alike}")

    def median(of: Callable[[dict[str, float], dict[str, float]], float]) -> float:
        return statistics.median(of(*both) for both in ran)

    ((states, cost),) = alike
    return {
        "task": name, "states": states, "cost": cost, "rate": median(lambda one, _: one["rate"]),
        "rate by hand": median(lambda _, hand: hand["rate"]),
        "slower": median(lambda one, hand: hand["rate"] / one["rate"]),
        "translate": median(lambda one, _: one["translate"]),
        "translate by hand": median(lambda _, hand: hand["translate"]),
        "longer": median(lambda one, hand: one["translate"] / hand["translate"]),
        "sweep": median(lambda one, _: one["sweep"]),
    }  # fmt: skip


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(PAIRS)))
@click.option("--pairs", type=click.IntRange(min=1), default=7, show_default=True, help="Number of pairs of processes.")
@click.option("--one", type=click.Path(path_type=Path), hidden=True)
@record_option
def main(names: tuple[str, ...], pairs: int, one: Path | None, record: Path | None) -> None:
    """Compare tasks with numbers with the same tasks by hand."""
    if one is not None:
        print(json.dumps(work(one)))
        return
    rows = []
    for name in names or list(PAIRS)[1:]:
        rows.append(row := compared(name, pairs))
        print("  ".join(f"{title} {show(row)}" for title, show in COLUMNS.items()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
