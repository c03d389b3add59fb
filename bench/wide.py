"""Policies on whole and on truncated tasks: values, times and memory for the same people and random numbers.

    python bench/wide.py [--instance kitting/paper] [--people 4] [--region 20000] [--episodes 20000] [--record FILE]

Each variant runs in a process of its own, so that its memory can be measured. Times are processor seconds of all
threads; *prepared* is the time before the first episode. *Part less whole* is the mean difference of the discounted
returns, with its standard error.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import cell, record_option, write_record

from assist import Pool, simulate
from assist.person import Setting
from planner import cost_to_go, load

WHOLE = 10**9  # states

COLUMNS = {
    "task": cell("task"), "states": cell("states", ","), "region": cell("region", ","), "policy": cell("policy"),
    "episodes": cell("episodes", ","), "whole": cell("whole", ".2f"), "part less whole": cell("ahead", ".3f", "error"),
    "prepared, s: whole": cell("whole prepared", ".1f"), "part": cell("part prepared", ".1f"),
    "simulated, s: whole": cell("whole simulated", ".1f"), "part ": cell("part simulated", ".1f"),
    "MB: whole": cell("whole memory", ".0f"), "part  ": cell("part memory", ".0f"),
}  # fmt: skip


@click.command()
@click.option(
    "--instance", "instances", multiple=True,
    default=("kitting/paper", "kitting/ladder-3x5", "stations/three-benches", "kitting/ladder-4x6", "depot/six-items"),
)  # fmt: skip
@click.option("--people", type=click.IntRange(min=1), default=4, help="In the pool, and in each team.")
@click.option("--region", "regions", multiple=True, type=click.IntRange(min=1), default=(20_000,))
@click.option("--policy", "policies", multiple=True, default=("none", "reactive", "attention", "priority"))
@click.option("--episodes", type=click.IntRange(min=2), default=20_000)
@record_option
def main(
    instances: tuple[str, ...], people: int, regions: tuple[int, ...], policies: tuple[str, ...], episodes: int,
    record: Path | None,
) -> None:  # fmt: skip
    """Print values, times and memory of both variants."""
    rows = []
    print(" | ".join(COLUMNS))
    for instance in instances:
        for policy in policies:
            whole = _apart(instance, policy, people, episodes, None)
            for region in regions:
                part = _apart(instance, policy, people, episodes, region)
                difference = part.pop("returns") - whole["returns"]
                row = {"task": instance, "region": region, "policy": policy, "episodes": episodes}
                row |= {"states": whole["states"], "whole": whole["returns"].mean(), "ahead": difference.mean()}
                row |= {"error": difference.std(ddof=1) / np.sqrt(episodes)}
                row |= {f"{way} {name}": found[name] for way, found in (("whole", whole), ("part", part))
                        for name in ("prepared", "simulated", "memory")}  # fmt: skip
                rows.append(row)
                print(" | ".join(show(row) for show in COLUMNS.values()), flush=True)
    write_record(record, COLUMNS, rows)


def _apart(*case: Any) -> dict[str, Any]:
    """Run a case in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as apart:
        return apart.submit(_run, *case).result()


def _run(instance: str, policy: str, people: int, episodes: int, region: int | None) -> dict[str, Any]:
    table = cost_to_go(load(instance))
    memory = _most()
    begun = time.process_time()
    part = {"states": WHOLE} if region is None else {"states": 0, "region": region}
    pool = Pool.sample(table, people, seed=0, setting=Setting(), memory_limit_mb=1e6, **part)
    ready = pool.policy(policy)
    prepared = time.process_time()
    returns = simulate(pool, ready, humans=people, episodes=episodes, seed=0).discounted_return
    return {
        "returns": returns, "states": len(table), "prepared": prepared - begun,
        "simulated": time.process_time() - prepared, "memory": _most() - memory,
    }  # fmt: skip


def _most() -> float:
    """Return the peak memory of the process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    main()
