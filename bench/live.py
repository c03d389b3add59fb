"""How long one observation and the next recommendation take in a large team.

    python bench/live.py [--people 1000] [--instance domains/kitting/paper.pddl] [--steps 300]

A person at random acts (follows the suggestion that stands, or does anything), then the assistant is asked.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

from assist.live.assistant import Assistant
from planner import cost_to_go, load


@click.command()
@click.option("--instance", default=str(Path(__file__).parent.parent / "domains/kitting/paper.pddl"))
@click.option("--people", multiple=True, type=click.IntRange(min=1), default=(10, 1000, 10_000))
@click.option("--policy", "policies", multiple=True, default=("attention", "priority"))
@click.option("--steps", type=click.IntRange(min=1), default=300)
def main(instance: str, people: tuple[int, ...], policies: tuple[str, ...], steps: int) -> None:
    """Print times in milliseconds."""
    table = cost_to_go(load(instance))
    print("policy     people  set up   join one   observe  recommend   both, median   both, 95 %   saved   restored")
    for policy in policies:
        for count in people:
            begun = time.perf_counter()
            desk = Assistant(table, [str(number) for number in range(count)], policy=policy)
            desk.recommend()
            set_up = time.perf_counter() - begun
            rng = np.random.default_rng(0)
            times = np.array([_step(desk, str(rng.integers(count)), rng) for _ in range(steps)])[steps // 10 :]
            begun = time.perf_counter()
            desk.join("another")
            joined = time.perf_counter() - begun
            begun = time.perf_counter()
            document = desk.to_json()
            saved = time.perf_counter() - begun
            begun = time.perf_counter()
            again = Assistant.from_json(document, table)
            restored = time.perf_counter() - begun
            assert again.to_json() == document
            both = times.sum(axis=1)
            print(
                f"{policy:10} {count:6} {1e3 * set_up:7.0f} {1e3 * joined:10.2f} "
                f"{1e3 * np.median(times[:, 0]):9.3f} {1e3 * np.median(times[:, 1]):10.3f} "
                f"{1e3 * np.median(both):14.3f} {1e3 * np.quantile(both, 0.95):12.3f} "
                f"{1e3 * saved:7.0f} {1e3 * restored:10.0f}"
            )


def _step(desk: Assistant, name: str, rng: np.random.Generator) -> tuple[float, float]:
    person = desk.person(name)
    if person.finished:
        desk.begin(name)
        person = desk.person(name)
    action = person.suggestion or person.applicable[rng.integers(len(person.applicable))]
    begun = time.perf_counter()
    desk.observe(name, action)
    observed = time.perf_counter()
    desk.recommend()
    return observed - begun, time.perf_counter() - observed


if __name__ == "__main__":
    main()
