"""Explanations of random choices on six tasks: their claims replayed, and ten texts of each task to read.

    python bench/explanations.py [--pairs 1000] [--texts 10] [--seed 1] [--record FILE]

In random states, an optimal step is compared with another action. The difference must be that of the tables. If an
action is said to be needed, or possible, both given plans are followed by the definitions of actions: they must reach
the goal at the cost h*, and the plan after the alternative must have the action more often. A wrong claim ends the run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.drawing import Artist
from assist.live import Contrast, Explanation, contrast
from assist.people.choices import Choices
from planner import Table, instance, load, sweep

TASKS = (
    "kitting/paper", "kitting/costs/ways", "delivery/three-parcels", "lockers/two-lockers", "stations/three-boxes",
    "blocks/blocks-5",
)  # fmt: skip
COLUMNS: Columns = {"task": cell("task"), "suggested": cell("step"), "text": cell("text")}


def contrasts(known: Table, artist: Artist, seed: int) -> Iterator[tuple[int, Contrast]]:
    """Yield random states, and an optimal step there compared with another action."""
    choices, rng = Choices.of(known), np.random.default_rng(seed)
    useful = np.isfinite(choices.h) & ~choices.goal & (choices.applicable.sum(axis=1) > 1)
    for state in rng.choice(np.flatnonzero(useful), 1_000_000):
        step = rng.choice(np.flatnonzero(choices.optimal[state]))
        other = rng.choice([slot for slot in np.flatnonzero(choices.applicable[state]) if slot != step])
        names = choices.name(state, int(step)), choices.name(state, int(other))
        yield int(state), contrast(choices, int(state), *names, say=artist.say)


def check(known: Table, state: int, found: Contrast) -> None:
    """Raise an error if a claim is wrong."""
    to_a, to_b = (reached(known, state, [name]) for name in (found.step, found.alternative))
    costs = [price(known, name) + known.h[to] for name, to in ((found.step, to_a), (found.alternative, to_b))]
    claims = [found.difference == costs[1] - costs[0]]
    said = found.consequence
    if said is not None and said.action is not None:
        for to, plan in ((to_a, said.instead), (to_b, said.after)):
            claims.append(bool(known.is_goal([reached(known, to, plan)])[0]))
            claims.append(sum(price(known, name) for name in plan) == known.h[to])
        claims.append(said.after.count(said.action) > (found.step, *said.instead).count(said.action))
    if not all(claims):
        raise AssertionError(f"{known.task.instance}, state {state}: {found}")


def price(known: Table, name: str) -> int:
    """Return the cost of an action."""
    return known.task.costs[known.task.actions.index(name)]


def reached(known: Table, state: int, plan: Sequence[str]) -> int:
    """Return the state after the actions of a plan."""
    for name in plan:
        rows = known.choices([state])
        (slot,) = np.flatnonzero(rows.actions == known.task.actions.index(name))
        state = int(rows.targets[slot])
    return state


@click.command()
@click.option("--pairs", type=click.IntRange(1), default=1000, show_default=True, help="Comparisons of each task.")
@click.option("--texts", type=click.IntRange(1), default=10, show_default=True, help="Texts of each task.")
@click.option("--seed", type=int, default=1, show_default=True)
@record_option
def main(pairs: int, texts: int, seed: int, record: Path | None) -> None:
    """Check random comparisons, and show some as texts, those of a rarer kind first."""
    rows: list[dict[str, Any]] = []
    for name in TASKS:
        known = sweep(load(instance(name)))
        artist, kinds, shown = Artist(known.task), Counter[str](), dict[str, tuple[int, str, str]]()
        for _, (state, found) in zip(range(pairs), contrasts(known, artist, seed), strict=False):
            check(known, state, found)
            kind = "equal" if found.consequence is None else found.consequence.kind + " again" * found.consequence.again
            told = Explanation(against=found)
            text = told.in_words({action: artist.say(action) for action in told.actions}).text()
            shown.setdefault(text, (kinds[kind], artist.say(found.step), text))
            kinds[kind] += 1
        print(f"{name}: {pairs:,} claims hold;", ", ".join(f"{kind} {n:,}" for kind, n in kinds.most_common()))
        for _, step, text in sorted(shown.values())[:texts]:
            rows.append({"task": name, "step": step, "text": text})
            print(f"- {step}? {text}")
    write_record(record, COLUMNS, rows)


if __name__ == "__main__":
    main()
