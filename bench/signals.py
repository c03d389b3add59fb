"""Actions recovered from facts: random walks of shipped tasks, reported as changes of facts.

    python bench/signals.py [INSTANCE...] [--walks 1000] [--length 10] [--unreported 2] [--seed 0] [--record FILE]

Each action of a walk is reported as the changes of facts that it causes, at first all of them, then with 10 % of them
lost at random. After each action with a report left, the actions since the last known state are recovered. Where the
answer is not the truth, the state is corrected, as an operator would do. Actions that change no fact are never
reported. With losses, actions without any report are at first assumed to be rare, and then allowed for (`unseen`).
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.people.signals import ActionRecovery, FactChange
from planner import CostToGo, instance, load, sweep

DOMAINS = Path(__file__).parent.parent / "domains"
DEFAULT = (
    "kitting/paper-fixed", "blocks/blocks-4", "delivery/three-parcels", "gripper/balls-05", "lockers/two-parcels",
    "stations/two-benches",
)  # fmt: skip


def walk(known: CostToGo, length: int, rng: np.random.Generator) -> Iterator[tuple[str, int, list[FactChange]]]:
    """Yield the actions of a random walk, the state after each, and the changes of facts that it causes."""
    task, state = known.task, known.initial
    for _ in range(length):
        rows = known.choices([state])
        if not len(rows.targets):
            return
        chosen = int(rng.integers(len(rows.targets)))
        before, after = (set(task.facts(values)) for values in known.values([state, rows.targets[chosen]]).tolist())
        state = int(rows.targets[chosen])
        changes = [FactChange(fact, False) for fact in sorted(before - after)]
        changes += [FactChange(fact, True) for fact in sorted(after - before)]
        yield task.actions[rows.actions[chosen]], state, changes


def followed(
    recovery: ActionRecovery, length: int, lost: float, rng: np.random.Generator, count: Counter[str]
) -> float:
    """Add the outcomes of a walk's actions to the counts; return the seconds of all calls."""
    believed, since, took = recovery.known.initial, list[str](), 0.0
    for action, state, changes in walk(recovery.known, length, rng):
        if not changes:  # no report could tell of such an action
            count["unseen"] += 1
            continue
        since.append(action)
        reported = [change for change in changes if rng.random() >= lost]
        if not reported:
            continue
        began = time.perf_counter()
        found = recovery.recover(believed, reported)
        took += time.perf_counter() - began
        right = found.kind != "recovered" or list(found.actions) == since
        count[found.kind if right else "wrong"] += len(since)
        count["calls"] += 1
        believed = state
        since.clear()
    count["unseen"] += len(since)
    return took


def row_of(recovery: ActionRecovery, name: str, walks: int, length: int, lost: float, seed: int) -> dict[str, Any]:
    """Return the shares of one task, in per cent of the actions."""
    count, rng = Counter[str](), np.random.default_rng(seed)
    took = sum(followed(recovery, length, lost, rng, count) for _ in range(walks))
    kinds = ("recovered", "ambiguous", "impossible", "wrong", "unseen")
    actions = sum(count[kind] for kind in kinds)
    shares = {kind: 100 * count[kind] / actions for kind in kinds}
    return {
        "task": name,
        "lost": lost,
        "allowed": recovery.unseen,
        "actions": actions,
        "ms": 1000 * took / count["calls"],
        **shares,
    }


COLUMNS: Columns = {
    "task": cell("task"),
    "reports lost": cell("lost", ".0%"),
    "unseen": cell("allowed"),
    "actions": cell("actions", ","),
    "recovered, %": cell("recovered", ".2f"),
    "ambiguous, %": cell("ambiguous", ".2f"),
    "impossible, %": cell("impossible", ".2f"),
    "wrong, %": cell("wrong", ".2f"),
    "never reported, %": cell("unseen", ".2f"),
    "ms per call": cell("ms", ".2f"),
}


@click.command()
@click.argument("instances", nargs=-1)
@click.option("--walks", type=click.IntRange(1), default=1000, show_default=True, help="Random walks per task.")
@click.option("--length", type=click.IntRange(1), default=10, show_default=True, help="Actions in a walk.")
@click.option("--unreported", type=click.IntRange(0), default=2, show_default=True, help="As in `ActionRecovery`.")
@click.option("--seed", type=int, default=0, show_default=True)
@record_option
def main(instances: tuple[str, ...], walks: int, length: int, unreported: int, seed: int, record: Path | None) -> None:
    """Recover the actions of random walks from reported changes of facts."""
    rows = []
    for name in instances or DEFAULT:
        known = sweep(load(instance(DOMAINS / f"{name}.pddl")))
        for lost, slack, unseen in ((0.0, 0, 0), (0.1, unreported, 0), (0.1, unreported, 1)):
            recovery = ActionRecovery(known, unreported=slack, unseen=unseen)
            rows.append(row_of(recovery, name, walks, length, lost, seed))
            print("; ".join(show(rows[-1]) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
