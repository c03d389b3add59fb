"""Time and memory of the sweep on other encodings, relative to this project's kitting ladder.

    python bench/foreign.py [NAME...] [--record FILE]

The instances are encodings that this file generates (`counters`, `stacks`, `grid`, `transport`), `domains/depot`, and
instances of the public benchmark collection if the environment variable DOWNWARD_BENCHMARKS names its folder. Each runs
in a process of its own, after small instances that load the compiled code. `domains/kitting/ladder-4x8.pddl` runs
first: `ratio` is its rate of states per processor second, divided by the instance's rate. `bytes` is the peak memory
per state, beyond that before the sweep.

    python bench/foreign.py --write FOLDER

writes the generated instances instead.
"""

from __future__ import annotations

import importlib
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
from tables import Columns, record_option, write_record

HERE = Path(__file__).resolve().parent
DOMAINS = HERE.parent / "domains"
LADDER = DOMAINS / "kitting" / "ladder-4x8.pddl"
COLLECTION = (
    "openstacks-opt08-strips/p05.pddl",
    "transport-opt08-strips/p03.pddl",
    "visitall-opt11-strips/problem05-half.pddl",
    "rovers/p01.pddl",
    "elevators-opt08-strips/p02.pddl",
    "elevators-opt08-strips/p03.pddl",
)

COUNTERS = """(define (domain counters) (:requirements :strips)
  (:predicates (next ?m ?n) (way ?p ?q) (at ?p) (here ?k ?p ?n) (loaded ?k ?n) (space ?n))
  (:action drive :parameters (?p ?q) :precondition (and (at ?p) (way ?p ?q)) :effect (and (at ?q) (not (at ?p))))
  (:action load :parameters (?k ?p ?less ?more ?few ?many ?tight ?wide)
    :precondition (and (at ?p) (here ?k ?p ?more) (next ?less ?more) (loaded ?k ?few) (next ?few ?many)
                       (space ?wide) (next ?tight ?wide))
    :effect (and (here ?k ?p ?less) (loaded ?k ?many) (space ?tight)
                 (not (here ?k ?p ?more)) (not (loaded ?k ?few)) (not (space ?wide))))
  (:action unload :parameters (?k ?p ?less ?more ?few ?many ?tight ?wide)
    :precondition (and (at ?p) (here ?k ?p ?less) (next ?less ?more) (loaded ?k ?many) (next ?few ?many)
                       (space ?tight) (next ?tight ?wide))
    :effect (and (here ?k ?p ?more) (loaded ?k ?few) (space ?wide)
                 (not (here ?k ?p ?less)) (not (loaded ?k ?many)) (not (space ?tight)))))
"""

STACKS = """(define (domain stacks) (:requirements :strips)
  (:predicates (on ?b ?s) (clear ?s) (lifting ?b) (free))
  (:action lift :parameters (?b ?s) :precondition (and (free) (on ?b ?s) (clear ?b))
    :effect (and (lifting ?b) (clear ?s) (not (free)) (not (on ?b ?s)) (not (clear ?b))))
  (:action put :parameters (?b ?s) :precondition (and (lifting ?b) (clear ?s))
    :effect (and (free) (on ?b ?s) (clear ?b) (not (lifting ?b)) (not (clear ?s)))))
"""

GRID = """(define (domain tokens) (:requirements :strips)
  (:predicates (beside ?c ?d) (at ?t ?c) (empty ?c))
  (:action slide :parameters (?t ?c ?d) :precondition (and (at ?t ?c) (beside ?c ?d) (empty ?d))
    :effect (and (at ?t ?d) (empty ?c) (not (at ?t ?c)) (not (empty ?d)))))
"""

TRANSPORT = """(define (domain vans) (:requirements :strips)
  (:predicates (van ?v) (parcel ?p) (road ?a ?b) (at ?x ?a) (in ?p ?v) (capacity ?v ?n) (next ?m ?n))
  (:action drive :parameters (?v ?a ?b) :precondition (and (van ?v) (at ?v ?a) (road ?a ?b))
    :effect (and (at ?v ?b) (not (at ?v ?a))))
  (:action pick :parameters (?p ?v ?a ?less ?more)
    :precondition (and (van ?v) (parcel ?p) (at ?v ?a) (at ?p ?a) (capacity ?v ?more) (next ?less ?more))
    :effect (and (in ?p ?v) (capacity ?v ?less) (not (at ?p ?a)) (not (capacity ?v ?more))))
  (:action drop :parameters (?p ?v ?a ?less ?more)
    :precondition (and (van ?v) (parcel ?p) (at ?v ?a) (in ?p ?v) (capacity ?v ?less) (next ?less ?more))
    :effect (and (at ?p ?a) (capacity ?v ?more) (not (in ?p ?v)) (not (capacity ?v ?less)))))
"""


def problem(domain: str, objects: Iterable[str], init: Iterable[str], goal: Iterable[str]) -> str:
    """Return the text of a problem file."""
    return (
        f"(define (problem large) (:domain {domain})\n  (:objects {' '.join(objects)})\n"
        f"  (:init {' '.join(init)})\n  (:goal (and {' '.join(goal)})))\n"
    )


def successors(numbers: int) -> list[str]:
    """Return facts that order the numbers from 0."""
    return [f"(next n{n} n{n + 1})" for n in range(numbers - 1)]


def counters(places: int, totals: tuple[int, ...], space: int) -> tuple[str, str]:
    """Return a task with goods of several kinds, counted at each place and on a van with limited space."""
    kinds = [f"k{k}" for k in range(len(totals))]
    sites = [f"p{p}" for p in range(places)]
    numbers = [f"n{n}" for n in range(max(*totals, space) + 1)]
    init = [*successors(len(numbers)), f"(at p0) (space n{space})"]
    init += [f"(way {a} {b}) (way {b} {a})" for a, b in itertools.pairwise(sites)]
    for kind, total in zip(kinds, totals, strict=True):
        init += [f"(loaded {kind} n0)", f"(here {kind} p0 n{total})", *(f"(here {kind} {p} n0)" for p in sites[1:])]
    goal = [f"(here {kind} {sites[-1]} n{total})" for kind, total in zip(kinds, totals, strict=True)]
    return COUNTERS, problem("counters", [*kinds, *sites, *numbers], init, goal)


def stacks(boxes: int, stands: int) -> tuple[str, str]:
    """Return a task with boxes that are stacked on each other or on stands."""
    names, bases = [f"b{n}" for n in range(boxes)], [f"s{n}" for n in range(stands)]
    init = ["(free)", f"(on b0 {bases[0]})", f"(clear {names[-1]})", *(f"(clear {base})" for base in bases[1:])]
    init += [f"(on {above} {below})" for below, above in itertools.pairwise(names)]
    goal = [f"(on {above} {below})" for above, below in itertools.pairwise(names)]
    return STACKS, problem("stacks", [*names, *bases], init, goal)


def grid(width: int, height: int, tokens: int) -> tuple[str, str]:
    """Return a task with tokens on a board, at most one in each cell."""
    cells = {(x, y): f"c{x}-{y}" for x in range(width) for y in range(height)}
    names = [f"t{n}" for n in range(tokens)]
    init = []
    for (x, y), cell in cells.items():
        others = [cells[other] for other in ((x + 1, y), (x, y + 1)) if other in cells]
        init += [f"(beside {cell} {other}) (beside {other} {cell})" for other in others]
    places = list(cells.values())
    init += [f"(at {token} {cell})" for token, cell in zip(names, places, strict=False)]
    init += [f"(empty {cell})" for cell in places[tokens:]]
    goal = [f"(at {token} {cell})" for token, cell in zip(names, reversed(places), strict=False)]
    return GRID, problem("tokens", [*names, *places], init, goal)


def transport(places: int, vans: int, parcels: int, capacity: int) -> tuple[str, str]:
    """Return a task with parcels, and vans of limited capacity."""
    sites, cars, goods = ([f"{letter}{n}" for n in range(count)] for letter, count in
                          (("a", places), ("v", vans), ("p", parcels)))  # fmt: skip
    init = [*successors(capacity + 1), *(f"(parcel {p}) (at {p} a{n % 2})" for n, p in enumerate(goods))]
    init += [f"(van {v}) (at {v} {sites[-1]}) (capacity {v} n{capacity})" for v in cars]
    init += [f"(road {a} {b}) (road {b} {a})" for a, b in zip(sites, [*sites[1:], sites[0]], strict=True)]
    goal = [f"(at {p} {sites[places // 2]})" for p in goods]
    return TRANSPORT, problem("vans", [*sites, *cars, *goods, *(f"n{n}" for n in range(capacity + 1))], init, goal)


GENERATED = {
    "counters": lambda: counters(4, (5, 5, 4), 3),
    "stacks": lambda: stacks(7, 4),
    "grid": lambda: grid(6, 6, 4),
    "transport": lambda: transport(6, 2, 5, 2),
}

SHOWN = {
    "counters": "counters: goods counted at places and on a van",
    "stacks": "stacks: seven boxes on four stands",
    "grid": "grid: four tokens on 36 cells",
    "transport": "transport: two vans of capacity two",
}
COLUMNS: Columns = {
    "instance": lambda row: SHOWN.get(row["instance"], f"`{row['instance']}`"),
    "states": lambda row: f"{row['states']:,}",
    "M states/s": lambda row: f"{row['rate']:.2f}",
    "ratio": lambda row: f"{row['ratio']:.1f}",
    "transitions per state": lambda row: f"{row['transitions'] / row['states']:.1f}",
    "bytes per state": lambda row: f"{row['bytes']:.1f}",
}


def write(name: str, folder: Path) -> Path:
    """Write a generated instance with its domain."""
    target = folder / name
    target.mkdir(parents=True, exist_ok=True)
    domain, text = GENERATED[name]()
    (target / "domain.pddl").write_text(domain, encoding="utf-8")
    (target / "large.pddl").write_text(text, encoding="utf-8")
    return target / "large.pddl"


def measure(file: Path) -> dict[str, Any]:
    """Sweep one instance in this process."""
    from planner import load
    from planner.system.limits import peak_memory_mb, reset_peak_memory, used_mb

    module = importlib.import_module("planner.costtogo.table")
    for small in ("kitting/tiny.pddl", "kitting/costs/ways.pddl", "depot/two-columns.pddl"):
        module.sweep(load(DOMAINS / small))
    domain = next(d for d in (file.parent / f"{file.stem}-domain.pddl", file.parent / "domain.pddl") if d.is_file())
    task = load(file, domain)
    reset_peak_memory()
    before, start, cpu = used_mb() or 0.0, time.monotonic(), time.process_time()
    table = module.sweep(task, max_states=100_000_000)
    row = {"states": len(table), "seconds": time.monotonic() - start, "cpu": time.process_time() - cpu}
    coding = getattr(table.space.numbering, "coding", None)
    return {
        **row,
        "transitions": table.space.transition_count,
        "indices": None if coding is None else coding.size,
        "bytes": 1e6 * (peak_memory_mb() - before) / len(table),
        "h": table[table.initial],
    }


@click.command()
@click.argument("names", nargs=-1)
@record_option
@click.option("--write", "target", type=click.Path(path_type=Path), help="Write the generated instances instead.")
@click.option("--one", type=click.Path(path_type=Path), hidden=True)
def main(names: tuple[str, ...], record: Path | None, target: Path | None, one: Path | None) -> None:
    """Sweep instances in other encodings, and the kitting ladder."""
    if one is not None:
        click.echo(json.dumps(measure(one)))
        return
    if target is not None:
        for name in GENERATED:
            click.echo(write(name, target))
        return
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        files = {"ladder-4x8": LADDER, **{name: write(name, Path(folder)) for name in GENERATED}}
        files["depot/nine-items"] = DOMAINS / "depot" / "nine-items.pddl"
        if collection := os.environ.get("DOWNWARD_BENCHMARKS"):
            files |= {name.removesuffix(".pddl"): Path(collection) / name for name in COLLECTION}
        chosen = ["ladder-4x8", *(name for name in files if name != "ladder-4x8" and (not names or name in names))]
        click.echo(
            f"{'instance':34}{'states':>12}{'M states/s':>12}{'ratio':>7}{'trans.':>8}{'bytes':>8}{'indices':>10}"
        )
        for name in chosen:
            command = [sys.executable, __file__, "--one", str(files[name])]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                click.echo(f"{name:34}{(done.stderr.strip().splitlines() or ['?'])[-1][:80]}")
                continue
            row = {"instance": name, **json.loads(done.stdout)}
            rows.append(row)
            rate = [r["states"] / r["cpu"] for r in (row, rows[0])]
            indices = "-" if row["indices"] is None else f"{row['indices']:.2g}"
            click.echo(
                f"{name:34}{row['states']:>12,}{rate[0] / 1e6:>12.2f}{rate[1] / rate[0]:>7.1f}"
                f"{row['transitions'] / row['states']:>8.1f}{row['bytes']:>8.1f}{indices:>10}"
            )
    for row in rows:
        row["rate"] = row["states"] / row["cpu"] / 1e6
        row["ratio"] = rows[0]["rate"] / row["rate"]
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
