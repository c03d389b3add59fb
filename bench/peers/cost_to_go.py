"""One measurement of `bench/cost_to_go.py`: one peer on one instance, in a process of its own.

    python bench/peers/cost_to_go.py PEER DOMAIN PROBLEM OPTIONS

OPTIONS is a JSON object (see `Options`). The result is one line of JSON on standard output. Only the standard library
is imported before the peer. Any interpreter that has the peer can therefore run this file, and no other package adds to
the peer's memory.

The measured time begins with the two PDDL files and ends when the peer holds its values in memory. Before that the peer
solves a trivial instance (`warm_up`), so that lazy imports and just-in-time compilation count neither in the seconds
nor in the memory. The time of this first call is `first_call_seconds`.
"""

# ruff: noqa: ARG002  # the peers share their methods' signatures
from __future__ import annotations

import importlib.metadata
import json
import os
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

INFINITE = "inf"  # JSON has no infinity
SHOWN = 200  # characters of an error message that are kept


class Options(NamedTuple):
    """Options from the parent process.

    Attributes
    ----------
    warm_up : list of str
        Domain and problem file of the trivial instance.
    sample_file : str
        File to which `kitassist` writes some states with their cost-to-go, for the peers that solve single states.
    sample : int
        Number of states in it.
    sample_seconds : float
        Seconds after which no further state of the sample is started.
    memory_mb : int or None
        Limit of the process's address space.
    """

    warm_up: list[str]
    sample_file: str
    sample: int
    sample_seconds: float
    memory_mb: int | None


class Own(NamedTuple):
    """This project's answer: its table, and the seconds of each step."""

    task: Any
    table: Any
    parts: dict[str, float]


def solve_with_this_project(domain: Path, problem: Path) -> Own:
    """Compute h* of every state."""
    import planner

    clock = [time.perf_counter()]
    task = planner.load(problem, domain)
    clock.append(time.perf_counter())
    table = planner.sweep(task)
    clock.append(time.perf_counter())
    return Own(task, table, {"load": clock[1] - clock[0], "sweep": clock[2] - clock[1]})


def own_answer(own: Own, sample: int) -> tuple[dict[str, Any], list[dict[str, Any]], list[str]]:
    """Return fields of the row, sampled states, and all atoms that can change."""
    import numpy as np

    if own.task.decided_by_translator:  # Fast Downward's translator then drops the task and its states
        fields = {"initial_cost": INFINITE, "note": "the translator proves that there is no plan: no states"}
        return fields, [], []
    table = own.table
    values, counts = np.unique(table.distance, return_counts=True)
    dead = np.iinfo(table.distance.dtype).max
    by_cost = {
        float("inf") if value == dead else float(value): n
        for value, n in zip(values.tolist(), counts.tolist(), strict=True)
    }
    fields = histogram(by_cost, table[table.initial])
    chosen = np.random.default_rng(0).choice(len(table), size=min(sample, len(table)), replace=False)
    states = [
        {
            "values": table.values([state])[0].tolist(),
            "facts": table.space.facts(state),
            "h": number(table[state]),
        }
        for state in chosen.tolist()
    ]
    facts = (fact for variable in own.task.variables for fact in variable.facts)
    return fields, states, sorted({fact.removeprefix("Atom ") for fact in facts if fact.startswith("Atom ")})


class Peer:
    """A method for the cost-to-go of all states. `prepare` imports it; `solve` is timed."""

    package = ""
    extrapolated = False

    def prepare(self) -> None:
        """Import what `solve` needs."""
        raise NotImplementedError

    def solve(self, domain: Path, problem: Path, options: Options) -> Any:
        """Compute the values in memory from the files."""
        raise NotImplementedError

    def describe(self, result: Any, options: Options) -> dict[str, Any]:
        """Return the fields of the row that follow from the result of `solve`."""
        raise NotImplementedError


class Kitassist(Peer):
    """This project."""

    package = "kitassist"

    def prepare(self) -> None:
        """Import the planner package."""
        import planner  # noqa: F401

    def solve(self, domain: Path, problem: Path, options: Options) -> Own:
        """Ground the task, and sweep forward and backward."""
        return solve_with_this_project(domain, problem)

    def describe(self, result: Own, options: Options) -> dict[str, Any]:
        """Return the fields of the table, and write a sample for the peers that solve single states."""
        fields, states, atoms = own_answer(result, options.sample)
        sample = {"count": fields.get("states"), "states": states, "atoms": atoms}
        Path(options.sample_file).write_text(json.dumps(sample), encoding="utf-8")
        return {**fields, "parts": {name: round(seconds, 4) for name, seconds in result.parts.items()}}


class Pymimir(Peer):
    """pymimir's `StateSpace`: all states and transitions, with two goal distances of each state."""

    package = "pymimir"

    def prepare(self) -> None:
        """Import the two modules that are used."""
        from pymimir.advanced import datasets, search

        self.datasets, self.search = datasets, search

    def solve(self, domain: Path, problem: Path, options: Options) -> Any:
        """Build the state space, which includes the distances."""
        # The mode "grounded" is the faster one on all instances here.
        mode = self.search.SearchContextOptions(self.search.GroundedOptions())
        context = self.search.SearchContext.create(str(domain), str(problem), mode)
        wanted = self.datasets.StateSpaceOptions()
        wanted.remove_if_unsolvable = False  # by default, a task without a plan gives None
        created = self.datasets.StateSpace.create(context, wanted)
        if created is None:
            raise RuntimeError("no state space (a limit of its own)")
        # pymimir adds action costs even without a metric. PDDL then minimises the number of actions.
        text = "\n".join(line.partition(";")[0] for line in problem.read_text(encoding="utf-8").splitlines())
        return created[0], ":metric" in text.lower()

    def describe(self, result: Any, options: Options) -> dict[str, Any]:
        """Read the distances of all vertices."""
        space, has_costs = result
        graph, infinity = space.get_graph(), float("inf")
        distance = self.datasets.get_action_goal_distance
        if not has_costs:
            steps, dead = self.datasets.get_unit_goal_distance, self.datasets.is_unsolvable

            def distance(vertex: Any) -> float:
                return infinity if dead(vertex) else steps(vertex)

        start = time.perf_counter()
        counts = Counter(distance(graph.get_vertex(index)) for index in range(graph.get_num_vertices()))
        read = time.perf_counter() - start
        initial = distance(graph.get_vertex(space.get_initial_vertex()))
        parts = {"read the values from Python (not counted)": round(read, 4)}
        return {**histogram(counts, initial), "parts": parts}


class StateByState(Peer):
    """One Fast Downward call per state, measured on a sample."""

    extrapolated = True

    def read(self, domain: Path, problem: Path, atoms: list[str]) -> Any:
        """Do the work that all calls share."""
        raise NotImplementedError

    def state(self, shared: Any, state: dict[str, Any]) -> Any:
        """Solve one state."""
        raise NotImplementedError

    def cost(self, shared: Any, answer: Any) -> float:
        """Return h* from the result of `state`."""
        raise NotImplementedError

    def solve(self, domain: Path, problem: Path, options: Options) -> Any:
        """Solve as many states of the sample as time allows."""
        sample = json.loads(Path(options.sample_file).read_text(encoding="utf-8"))
        if not sample["states"]:
            raise SkipError("no states to sample")
        start = time.perf_counter()
        shared = self.read(domain, problem, sample["atoms"])
        once, calls, answers = time.perf_counter() - start, 0.0, []
        for state in sample["states"]:
            if calls > options.sample_seconds:
                break
            start = time.perf_counter()
            answers.append((self.state(shared, state), state["h"]))
            calls += time.perf_counter() - start
        return sample["count"], once, calls, [(number(self.cost(shared, a)), h) for a, h in answers]

    def describe(self, result: Any, options: Options) -> dict[str, Any]:
        """Extrapolate the time, and compare the sample with this project's values."""
        states, once, calls, answers = result
        each = calls / len(answers)
        equal = sum(answer == h for answer, h in answers)
        return {
            "states": states,
            "seconds": round(once + each * states, 4),
            "sampled": len(answers),
            "sampled_equal": equal,
            "seconds_per_state": round(each, 6),
            "note": f"from {len(answers)} states at {each * 1000:.1f} ms; {equal} of {len(answers)} equal h*",
        }


class Astar(StateByState):
    """Fast Downward's binary on a task that is translated once: `planner.costtogo.astar`."""

    package = "up-fast-downward"

    def prepare(self) -> None:
        """Import the planner package and Fast Downward's."""
        import up_fast_downward  # noqa: F401

        import planner

        self.planner = planner

    def read(self, domain: Path, problem: Path, atoms: list[str]) -> Any:
        """Ground the task once."""
        return self.planner.load(problem, domain)

    def state(self, shared: Any, state: dict[str, Any]) -> Any:
        """Run A* from the state."""
        return self.planner.astar(shared, state["values"])

    def cost(self, shared: Any, answer: Any) -> float:
        """Return the cost from `astar`."""
        return float(answer[0])


PEERS: dict[str, type[Peer]] = {
    "kitassist": Kitassist,
    "pymimir": Pymimir,
    "fd-astar": Astar,
}


class SkipError(Exception):
    """The peer cannot run on this instance."""


def number(cost: float) -> float | str:
    """Return a cost in a form that is the same for all peers and valid in JSON."""
    return INFINITE if cost == float("inf") else int(cost) if cost == int(cost) else float(cost)


def histogram(counts: dict[float, int], initial: float) -> dict[str, Any]:
    """Return the fields of an exact answer, including the histogram of h*."""
    finite = [cost for cost in counts if cost != float("inf")]
    return {
        "states": sum(counts.values()),
        "initial_cost": number(initial),
        "max_cost": number(max(finite)) if finite else None,
        "dead_ends": counts.get(float("inf"), 0),
        "checksum": {str(number(cost)): counts[cost] for cost in sorted(counts)},
    }


def peak_mb() -> float:
    """Return the peak resident memory of this process, or of any process that it started, in MB.

    `getrusage` does not suffice for this process: on Linux its maximum includes that of the parent before the fork. The
    kernel's high-water mark of the address space does not.
    """
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KB elsewhere
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * unit / 1e6
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
        mark = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        own = int(mark.split()[1]) * 1024 / 1e6
    except (OSError, StopIteration):
        own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    return max(own, children)


def version(package: str) -> str | None:
    """Return the installed version of a package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def measure(name: str, domain: Path, problem: Path, options: Options) -> dict[str, Any]:
    """Run one peer on one instance, and return the row."""
    peer = PEERS[name]()
    row: dict[str, Any] = {
        "peer": name, "status": "ok", "states": None, "seconds": None, "peak_mb": None, "baseline_mb": None,
        "initial_cost": None, "max_cost": None, "dead_ends": None, "checksum": None,
        "extrapolated": peer.extrapolated, "note": "",
    }  # fmt: skip
    try:
        start = time.perf_counter()
        peer.prepare()
        # The peers that solve single states warm up on the first state of their sample.
        first = options._replace(sample=1, sample_seconds=0.0)
        trivial = Path(options.warm_up[0]), Path(options.warm_up[1])
        peer.solve(*((domain, problem) if peer.extrapolated else trivial), first)
        row["first_call_seconds"] = round(time.perf_counter() - start, 4)
        row["baseline_mb"] = round(peak_mb(), 1)
        start = time.perf_counter()
        result = peer.solve(domain, problem, options)
        row["seconds"] = round(time.perf_counter() - start, 4)
        row["peak_mb"] = round(peak_mb(), 1)
        row["version"] = version(peer.package)
        row.update(peer.describe(result, options))
    except ModuleNotFoundError as error:
        row.update(status="not installed", note=f"no module named {error.name}")
    except SkipError as error:
        row.update(status="not run", note=str(error))
    except MemoryError:
        row.update(status="out of memory", note=f"more than {options.memory_mb} MB of address space")
    except Exception as error:  # noqa: BLE001  # any exception of a peer is a result of the benchmark
        text = " ".join(str(error).split()).replace(str(problem.parent), "").replace(str(domain.parent), "")
        row.update(status="failed", note=f"{type(error).__name__}: {text}"[:SHOWN])
    return row


def main(arguments: Iterable[str]) -> None:
    """Measure, and print the row."""
    name, domain, problem, wanted = arguments
    options = Options(**json.loads(wanted))
    if options.memory_mb is not None:
        resource.setrlimit(resource.RLIMIT_AS, (options.memory_mb * 10**6,) * 2)
    # Libraries print, some of them from C++; only the row may reach the parent.
    out = os.dup(1)
    with open(os.devnull, "wb") as sink:  # noqa: PTH123
        os.dup2(sink.fileno(), 1)
    row = measure(name, Path(domain), Path(problem), options)
    os.write(out, (json.dumps(row) + "\n").encode())


if __name__ == "__main__":
    main(sys.argv[1:])
