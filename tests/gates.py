"""What a change of the core must keep: simulated episodes, live teams and bounds, recorded over a matrix of features.

    python tests/gates.py [--axis AXIS] [--record] [--refusals]

Without options, everything is computed and compared with `tests/data/gates`. What differs is printed, and the exit code
is then 1. `--record` replaces the records, and says what has changed. With `--axis robots`, only the cases with a
feature of that axis are considered, and with `--axis reports` or `--axis bounds`, those of another kind. `--refusals`
lists what is refused.

What is compared, and how closely:

- **Decisions**: all arrays of whole numbers and truth values, by a hash. They are equal on every machine as far as two
  values are not within rounding of each other.
- **Bits**: all arrays of floats, by a hash, for people with one goal. This is compared only where processor, numpy and
  numba are those of the record, since `exp` and sums of numpy differ between processors.
- **Values**: the mean return, and a weighted sum of the returns, to 1e-12, with several goals too. On other machines
  than that of the record, it is 1e-9.
- **Reports**: the sequence of calls of a live team is part of the record. The answers are compared as they are; beliefs
  and cost-to-go to 1e-12.
- **Bounds** and certificates, to 1e-9.
- **Refusals**: the whole sentence.

Live people who are simulated are not part of this.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gates_bounds
import gates_episodes
import gates_reports
from gates_records import here

FOLDER = Path(__file__).parent / "data" / "gates"
KINDS = {"episodes": gates_episodes, "reports": gates_reports, "bounds": gates_bounds}


@dataclass(frozen=True)
class Gate:
    """A case, with what it computes; `quick` ones are among the tests that always run."""

    kind: str
    name: str
    axes: frozenset[str]
    quick: bool
    found: Callable[[], dict[str, Any]]


def gates() -> Iterator[Gate]:
    """Yield all cases."""
    for kind, module in KINDS.items():
        for name, axes, quick, found in module.cases():
            yield Gate(kind, name, frozenset({kind, *axes}), quick, found)


def recorded(kind: str) -> dict[str, Any]:
    """Return the recorded cases of a kind by their names, and the machine on which they were recorded."""
    file = FOLDER / f"{kind}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"machine": here(), "cases": {}}


def write(kind: str, known: dict[str, Any]) -> None:
    """Write the cases of a kind, one a line."""
    lines = [f"{json.dumps(name)}: {json.dumps(case)}" for name, case in known["cases"].items()]
    text = f'{{"machine": {json.dumps(known["machine"])}, "cases": {{\n' + ",\n".join(lines) + "\n}}\n"
    (FOLDER / f"{kind}.json").write_text(text, encoding="utf-8")


def difference(gate: Gate, known: dict[str, Any]) -> str | None:
    """Return what differs between a case and its record; None if nothing does."""
    expected = known["cases"].get(gate.name)
    if expected is None:
        return "not recorded"
    return KINDS[gate.kind].difference(expected, gate.found(), same_machine=known["machine"] == here())


def main() -> int:
    """Compare or record."""
    parser = argparse.ArgumentParser(description="Compare what must stay the same with its record.")
    parser.add_argument("--axis", help="only the cases of this axis, or of this kind")
    parser.add_argument("--record", action="store_true", help="replace the record, and say what has changed")
    parser.add_argument("--refusals", action="store_true", help="list what is refused, and how often")
    chosen = parser.parse_args()
    known = {kind: recorded(kind) for kind in KINDS}
    if chosen.refusals:
        said = Counter(case["refused"] for one in known.values() for case in one["cases"].values() if "refused" in case)
        for text, count in said.most_common():
            sys.stdout.write(f"{count:5} {text}\n")
        return 0
    wanted = [gate for gate in gates() if chosen.axis is None or chosen.axis in gate.axes]
    if not wanted:
        parser.error(f"axis {chosen.axis!r}: expected one of {', '.join(sorted({a for g in gates() for a in g.axes}))}")
    changed = 0
    for gate in wanted:
        same = known[gate.kind]["machine"] == here()
        found = gate.found()
        expected = known[gate.kind]["cases"].get(gate.name)
        said = "new" if expected is None else KINDS[gate.kind].difference(expected, found, same_machine=same)
        changed += said is not None
        if said is not None:
            sys.stdout.write(f"{gate.name}: {said}\n")
        if chosen.record and (said is not None or not same):
            known[gate.kind]["cases"][gate.name] = found
    if chosen.record:
        if chosen.axis is None:
            names = {gate.name for gate in wanted}
            for one in known.values():
                gone = one["cases"].keys() - names
                sys.stdout.writelines(f"{name}: gone\n" for name in sorted(gone))
                one["cases"] = {name: case for name, case in one["cases"].items() if name not in gone}
                one["machine"] = here()
        for kind, one in known.items():
            write(kind, one)
    sys.stdout.write(f"{len(wanted)} cases, {changed} differ from the record\n")
    return int(changed and not chosen.record)


if __name__ == "__main__":
    sys.exit(main())
