"""Distances by decision diagrams, for `bench/symbolic.py`: a breadth-first search of sets of states.

The task is JSON on standard input, the answer JSON on standard output. Only `dd` with CUDD is used, nothing of this
project. Sets of states are Boolean functions of the bits of the variables' values. The search goes forward from the
initial state to all reachable states. It then goes backward from the goal, one operator at a time, within the reachable
states.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from dd import cudd


class Symbolic:
    """A task with unconditional effects, whose operators have equal costs.

    Parameters
    ----------
    task : dict
        `domains`: number of values of each variable. `initial`: a value of each. `goal`: pairs of variable and value.
        `operators`: pairs of lists of such pairs, preconditions and effects.
    memory : int
        Bytes for the diagrams.
    """

    def __init__(self, task: dict[str, Any], memory: int) -> None:
        self.bdd = cudd.BDD(memory_estimate=memory)
        self.bdd.configure(reordering=True)
        self.names = [
            [f"v{v}_{bit}" for bit in range(max(1, (n - 1).bit_length()))] for v, n in enumerate(task["domains"])
        ]
        for own in self.names:
            self.bdd.declare(*own)
        self.bits = sum(map(len, self.names))
        self.initial = self.cube(enumerate(task["initial"]))
        self.goal = self.cube(task["goal"])
        self.operators = [
            (self.cube(needed), self.cube(effects), self.assigned(effects), list(self.assigned(effects)))
            for needed, effects in task["operators"]
        ]

    def assigned(self, facts: Any) -> dict[str, bool]:
        """Return the bits of facts."""
        return {name: bool(value >> bit & 1) for v, value in facts for bit, name in enumerate(self.names[v])}

    def cube(self, facts: Any) -> Any:
        """Return the set of states in which facts hold."""
        return self.bdd.cube(self.assigned(facts))

    def count(self, states: Any) -> int:
        """Return the number of states in a set."""
        return int(self.bdd.count(states, self.bits))

    def after(self, states: Any) -> Any:
        """Return the successors of a set of states under any operator."""
        result = self.bdd.false
        for needed, effects, _, changed in self.operators:
            applicable = states & needed
            if applicable != self.bdd.false:
                result |= self.bdd.exist(changed, applicable) & effects
        return result

    def before(self, states: Any) -> Any:
        """Return the predecessors of a set of states under any operator."""
        result = self.bdd.false
        for needed, _, assigned, _ in self.operators:
            result |= self.bdd.let(assigned, states) & needed
        return result


def main() -> None:
    """Read the task, and print the answer."""
    start = time.monotonic()
    task = json.load(sys.stdin)
    search = Symbolic(task, int(task["memory"]))
    sample = [search.assigned(enumerate(values)) for values in task["sample"]]
    layer = reached = search.initial
    while layer != search.bdd.false:
        layer = search.after(layer) & ~reached
        reached |= layer
        print(f"states: {search.count(reached):,}, {time.monotonic() - start:.0f} s", file=sys.stderr)
    forward = time.monotonic() - start
    distances: list[int | None] = [None] * len(sample)
    layer = settled = reached & search.goal
    d = 0
    while layer != search.bdd.false:
        for number, state in enumerate(sample):
            if distances[number] is None and search.bdd.let(state, layer) == search.bdd.true:
                distances[number] = d
        layer = search.before(layer) & reached & ~settled
        settled |= layer
        d += 1
        print(f"distance {d}: {search.count(settled):,}, {time.monotonic() - start:.0f} s", file=sys.stderr)
    answer = {"states": search.count(reached), "largest": d - 1, "distances": distances}
    print(json.dumps({**answer, "forward": forward, "seconds": time.monotonic() - start}))


if __name__ == "__main__":
    main()
