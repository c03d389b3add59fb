"""Kill commands at random moments, and check processes, files, and the outcome of a resumed run.

As a script it kills many times, and prints the figures of `docs/results/reliability.md`:

    .venv/bin/python tests/kills.py [KILLS] [SEED]
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from planner.batch.results_folder import COMPARING, SWEEPING, VALIDATING

ROOT = Path(__file__).parent.parent
DOMAINS = ROOT / "domains"
TINY = DOMAINS / "kitting" / "tiny.pddl"
COMMAND = str(Path(sys.executable).with_name("kitassist"))
LONGEST_SURVIVAL = 3.0  # seconds; ending a process may take longer on a busy machine

STUDY = f"""
title = "killed"
seed = 3
repeats = 3
instances = ["{TINY}"]
humans = [1, 2]
pool = 3
draws = 1
trials = 2

[populations.everybody]

[[conditions]]
name = "first"
"""


@dataclass(frozen=True)
class Case:
    """A command that writes into a folder.

    `arguments(folder, resume)` are its words; `finished(folder)` is what it has finished by now, which must never be
    lost or made again; `outcome(folder)` is what a whole run leaves, which must not depend on any kill.
    """

    name: str
    arguments: Callable[[Path, bool], list[str]]
    finished: Callable[[Path], dict[str, object]]
    outcome: Callable[[Path], dict[str, object]]


def lines_of(file: Path) -> list[dict]:
    """Return the records of the complete lines of a file."""
    return [json.loads(line) for line in file.read_text().split("\n")[:-1]] if file.exists() else []


def solve(*instances: Path, options: tuple[str, ...] = ("--jobs", "2", "--verify", "1")) -> Case:
    def stable(record: dict) -> dict:
        # A record whose comparison with A*, or validation, was interrupted is kept, since it is solved.
        return {
            key: None if value in (COMPARING, VALIDATING) else value
            for key, value in record.items()
            if key not in ("seconds", "peak_memory_mb", "verified")
        }

    def outcome(folder: Path) -> dict[str, object]:
        files = {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
        records = [stable(record) for record in lines_of(folder / "results.jsonl")]
        lines = lines_of(folder / "fingerprints")  # the digest of a record is of its seconds, too
        named = [{key: value for key, value in line.items() if key != "record"} for line in lines]
        return {**files, "results.jsonl": records, "fingerprints": named}

    return Case(
        "solve",
        lambda folder, resume: ["solve", *map(str, instances), *options, "--out", str(folder), *["--resume"] * resume],
        lambda folder: {
            record["instance"]: stable(record)
            for record in lines_of(folder / "results.jsonl")
            if not (record["note"] or "").endswith(SWEEPING)
        },
        outcome,
    )


def study(protocol: Path) -> Case:
    protocol.write_text(STUDY)
    arguments = ["study", "--protocol", str(protocol), "--jobs", "2", "--out"]

    def finished(folder: Path) -> dict[str, object]:
        lines_of(folder / "episodes.jsonl")
        cells = {}
        for record in lines_of(folder / "profile.jsonl"):
            seconds = record.pop("seconds")
            cells[json.dumps(record)] = seconds
        return cells

    return Case(
        "study",
        lambda folder, resume: [*arguments, str(folder), *["--resume"] * resume],
        finished,
        lambda folder: {
            name: (folder / name).read_bytes() for name in ("episodes.jsonl", "study.json", "summary.json")
        },
    )


def fit(log: Path) -> Case:
    """Return a case of `fit` with states on demand, so that Fast Downward runs for every state and fills the cache."""
    people = ["simulate", str(TINY), "--humans", "2", "--pool", "2", "--episodes", "2", "--seed", "1"]
    subprocess.run([COMMAND, *people, "--trace", str(log)], check=True, capture_output=True)
    arguments = ["fit", str(TINY), str(log), "--set", "max_states=1", "--jobs", "2"]

    def outcome(folder: Path) -> dict[str, object]:
        return {name: (folder / name).read_bytes() for name in ("people.jsonl", "population.json")}

    return Case(
        "fit",
        lambda folder, _: [
            *arguments, "--set", f"cache={folder / 'cache'}", "--out", str(folder / "people.jsonl"),
            "--write-population", str(folder / "population.json"),
        ],
        lambda folder: outcome(folder) if (folder / "population.json").exists() else {},
        outcome,
    )  # fmt: skip


@dataclass
class Figures:
    """Counts of outcomes."""

    kills: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    too_late: int = 0
    survival: float = 0.0
    half_written: int = 0
    restarts: int = 0


def started(arguments: list[str]) -> subprocess.Popen[str]:
    """Start a command as from a terminal, also where this process ignores Ctrl-C as a script's background job does."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
    finally:
        signal.signal(signal.SIGINT, before)


def alive(session: int) -> list[str]:
    """Return the running processes of a session."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = status.read_text().rpartition(") ")[2].split()
            if int(words[3]) == session and words[0] not in "ZX":
                found.append(status.with_name("cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return found


def survival(session: int) -> float:
    """Return the seconds until the last process of a session has ended."""
    start = time.monotonic()
    while left := alive(session):
        assert time.monotonic() - start < LONGEST_SURVIVAL, left
        time.sleep(0.01)
    return time.monotonic() - start


def unfinished(folder: Path) -> set[Path]:
    """Return files that were not moved to their final names; no program takes them for results."""
    return set(folder.rglob(".unfinished-*"))


def whole_run(case: Case, folder: Path, *, resume: bool) -> float:
    start = time.monotonic()
    done = subprocess.run([COMMAND, *case.arguments(folder, resume)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return time.monotonic() - start


def kill(case: Case, folder: Path, moment: float, number: signal.Signals, *, group: bool, figures: Figures) -> None:
    """Start or resume a command, kill it after `moment` seconds, and check what the kill leaves."""
    before, left = (case.finished(folder), unfinished(folder)) if folder.exists() else ({}, set())
    process = started(case.arguments(folder, folder.exists()))
    try:
        stdout, stderr = process.communicate(timeout=moment)
    except subprocess.TimeoutExpired:
        (os.killpg if group else os.kill)(process.pid, number)
        # What a killed parent leaves may hold the pipes open: first see that it does not.
        process.wait(timeout=120)
        figures.survival = max(figures.survival, survival(process.pid))
        stdout, stderr = process.communicate(timeout=120)
    else:
        figures.too_late += 1
    figures.kills[f"{case.name} {number.name} {'group' if group else 'parent'}"] += 1
    figures.codes[f"{number.name} {process.returncode}"] += 1
    if number != signal.SIGKILL and process.returncode not in (-number, 0):  # not while the interpreter was starting
        assert process.returncode == 128 + number, (process.returncode, stderr)
        assert stdout == "" or case.name == "solve", stdout  # which shows what it has solved until then
        assert stderr.splitlines()[-1].startswith("interrupted"), stderr
        assert "Traceback" not in stderr, stderr
    if folder.exists():
        after = case.finished(folder)
        assert before.items() <= after.items(), "something finished was lost, or made again"
        figures.half_written += len(unfinished(folder) - left)
        assert number == signal.SIGKILL or unfinished(folder) <= left, unfinished(folder)


def uninterrupted(case: Case, folder: Path) -> tuple[float, dict[str, object]]:
    """Run a command without a kill; return its seconds and its outcome."""
    return whole_run(case, folder, resume=False), case.outcome(folder)


def kill_and_resume(
    case: Case, folder: Path, kills: list[tuple[float, signal.Signals, bool]], reference: dict[str, object],
    figures: Figures,
) -> None:  # fmt: skip
    """Kill a command after each of these times, and let it end at last."""
    for moment, number, group in kills:
        kill(case, folder, moment, number, group=group, figures=figures)
    before = case.finished(folder) if folder.exists() else {}
    whole_run(case, folder, resume=folder.exists())
    figures.restarts += 1
    kept = case.finished(folder)
    assert all(kept[name] == value for name, value in before.items()), "something finished was made again"
    assert case.outcome(folder) == reference
    assert case.name == "fit" or not unfinished(folder), unfinished(folder)  # `fit` has no folder of its own to tidy up


def small_batch() -> Case:
    names = ["kitting/tiny", "kitting/unsolvable", "gripper/balls-01"]
    return solve(*(DOMAINS / f"{name}.pddl" for name in names))


def main(count: int = 100, seed: int = 0) -> None:
    """Kill `count` times, and print the figures."""
    rng = np.random.default_rng(seed)
    figures = Figures()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one = replace(solve(TINY), name="solve one")
        cases = [small_batch(), one, fit(folder / "log.jsonl"), study(folder / "study.toml")]
        whole = {case.name: uninterrupted(case, folder / case.name) for case in cases}
        made = 0
        while made < count:
            case = cases[int(rng.choice(len(cases), p=(0.3, 0.3, 0.3, 0.1)))]
            duration, reference = whole[case.name]
            chain = [
                (
                    duration * rng.uniform(0.05, 1.0),
                    signal.Signals(int(rng.choice([2, 9, 15]))),
                    bool(rng.random() < 0.5),
                )
                for _ in range(min(5, count - made))
            ]
            kill_and_resume(case, Path(tempfile.mkdtemp(dir=folder)) / case.name, chain, reference, figures)
            made += len(chain)
            print(f"{made} kills: longest survival {figures.survival:.2f} s", file=sys.stderr, flush=True)
    print(f"{sum(figures.kills.values())} kills, {figures.too_late} of them after the end; {figures.restarts} restarts")
    for name, number in sorted(figures.kills.items()):
        print(f"  {name}: {number}")
    print("exit codes: " + ", ".join(f"{name}: {number}" for name, number in sorted(figures.codes.items())))
    print(f"SIGKILL left {figures.half_written} files .unfinished-*")
    print(f"the last process ended at most {figures.survival:.2f} s after the killed one")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
