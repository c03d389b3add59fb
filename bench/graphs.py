"""Tasks whose states are the nodes of a graph, for tests on random tasks."""

from __future__ import annotations

from pathlib import Path

from planner import Instance, Task
from planner.grounding.translation import from_sas


def graph_task(edges: list[tuple[int, int, int]], goal: int = 0, start: int = 1) -> Task:
    """Return a task whose states are the nodes of a graph. An edge (from, to, cost) is an action `(go number)`."""
    nodes = 1 + max(goal, start, *(node for edge in edges for node in edge[:2]))
    lines = ["begin_version", "3", "end_version", "begin_metric", "1", "end_metric", "1"]
    lines += [
        "begin_variable",
        "var0",
        "-1",
        f"{nodes}",
        *(f"Atom at({node})" for node in range(nodes)),
        "end_variable",
    ]
    lines += ["0", "begin_state", f"{start}", "end_state", "begin_goal", "1", f"0 {goal}", "end_goal", f"{len(edges)}"]
    for number, (origin, target, cost) in enumerate(edges):
        lines += ["begin_operator", f"go {number:03}", "0", "1", f"0 0 {origin} {target}", f"{cost}", "end_operator"]
    return from_sas("\n".join([*lines, "0", ""]), Instance(Path("graph.pddl"), Path("domain.pddl")))
