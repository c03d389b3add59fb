"""Bounds against time on one person's POMDP: this project's solver, SARSOP, and pomdp-py's planners.

    python bench/pomdp.py [--instances a,b] [--settings G/C/S]... [--seeds N] [--timeout S] [--solvers a,b] [--no-cold]
        [--out DIR]

A case consists of a kitting instance, gamma, c_suggest, sigma, and the seed of the person's misconception, which the
robot knows. Every solver solves the same problem in the same run; SARSOP reads it from a POMDPX file of
`assist.interop.pomdpx`.

- `kitassist`: `assist.person.solver` in a new process, with compiled code loaded (warm). The first case is also run
  cold, without compiled code, unless `--no-cold` is given.
- `sarsop`: APPL's `pomdpsol`, the program in the environment variable SARSOP.
- `pomdp-py`: the simulated returns of its POUCT and POMCP, by time per decision. They compute no bounds and so have no
  gap. The environment variable PEER_PYTHON names a Python interpreter with this project and pomdp-py.

The relative gap is (upper - lower) / |lower| in the initial state. The time begins when the problem is in memory and
includes SARSOP's initialisation; reading the model and the whole process are reported separately. Times are processor
seconds, so that other load does not matter, except for the time limit of this project's solver. SARSOP reports its
bounds about every 50 backups, this project's solver every tenth of a second; both are late by up to that. The results
are written to `results.jsonl` (a line per solver and case, with the curve) and `pomdp.png`. The exit code is 1 if the
bounds of two solvers exclude each other.
"""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from peers.pomdp import Case
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from assist.interop import write_pomdpx
from assist.person.qmdp import evaluate, qmdp

HERE = Path(__file__).resolve().parent
OUT = Path("build/bench/pomdp")
SOLVERS = ("kitassist", "sarsop", "pomdp-py")
INSTANCES = ("paper-fixed", "paper", "ladder-5x5")
SETTINGS = ("0.95/0.5/0.5", "0.95/1/1", "0.99/0.2/0.5", "0.99/0.5/0.5", "0.99/1/0.5")
GAPS = (1e-2, 1e-3, 1e-4)
SEARCHES = [["POUCT", 100], ["POUCT", 1000], ["POMCP", 1000]]
ROUNDING = 2e-5  # relative, since SARSOP prints six digits

Row = dict[str, Any]

# Colours of Okabe and Ito; the dashes repeat the distinction.
STYLES = {"kitassist": ("#0072B2", "-"), "sarsop": ("#D55E00", "--")}


class Memory(threading.Thread):
    """Monitors the peak memory of a process in MB, and kills the process above a limit.

    Limiting the address space would not work, since SARSOP reserves far more than it uses. The maximum that `wait4`
    reports for a child includes that of its parent before the fork.
    """

    def __init__(self, process: subprocess.Popen[bytes], limit: float) -> None:
        super().__init__(daemon=True)
        self.process, self.limit, self.peak = process, limit, 0.0

    def run(self) -> None:
        file = Path(f"/proc/{self.process.pid}/status")
        while True:
            try:
                found = re.search(r"VmHWM:\s+(\d+)", file.read_text())
            except OSError:
                return
            if found is None:  # the process has ended
                return
            self.peak = int(found[1]) * 1024 / 1e6
            if self.peak > self.limit:
                self.process.kill()
                return
            time.sleep(0.05)


def run(
    command: Sequence[str], on_line: Callable[[float, str], None], limit: float, memory: int, **environment: str
) -> tuple[int, dict[str, float], str]:
    """Run a program on a pseudo-terminal, so that each line arrives when it is printed.

    Returns the exit code; wall-clock seconds, processor seconds and peak memory in MB; and the last line printed.
    """
    inner, outer = pty.openpty()
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=outer, stderr=outer, env={**os.environ, **environment}
    )  # fmt: skip
    os.close(outer)
    timer = threading.Timer(limit, process.kill)
    timer.start()
    watch = Memory(process, memory)
    watch.start()
    last = rest = b""
    try:
        while True:
            try:
                data = os.read(inner, 1 << 16)
            except OSError:  # Linux reports a closed terminal as an error
                break
            if not data:
                break
            now = time.perf_counter() - start
            *lines, rest = (rest + data).replace(b"\r", b"").split(b"\n")
            for line in lines:
                last = line.strip() or last
                on_line(now, line.decode(errors="replace"))
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    finally:
        timer.cancel()
        os.close(inner)
        if process.poll() is None:
            process.kill()
            process.wait()
        watch.join()
    seconds = time.perf_counter() - start
    measured = {"process": seconds, "cpu": usage.ru_utime + usage.ru_stime, "peak_mb": watch.peak}
    if watch.peak > memory:
        return process.returncode, measured, f"stopped above {memory:,} MB"
    return process.returncode, measured, last.decode(errors="replace")


NUMBER = r"(-?[\d.]+(?:e[+-]?\d+)?)"
PHASE = re.compile(rf"(loading|initialization) time *: *{NUMBER}")
TRIAL = re.compile(rf"^ *{NUMBER} +(\d+) +(\d+) +{NUMBER} +{NUMBER} +{NUMBER} +(\d+) +(\d+) *$")


def sarsop(model: Path, reference: dict[str, float], options: dict[str, Any]) -> Row:
    """Run SARSOP on the exported problem."""
    row: Row = {"solver": "sarsop", "curve": []}
    program = os.environ.get("SARSOP")
    if not program:
        return {**row, "status": "not run", "note": "the environment variable SARSOP names no program"}
    marks: dict[str, float] = {}
    warnings: list[str] = []

    def on_line(_: float, line: str) -> None:
        if match := PHASE.search(line):
            marks[match[1]] = float(match[2])
        elif "warning" in line.lower() or "error" in line.lower():
            warnings.append(line)
        elif match := TRIAL.match(line):
            row["curve"].append([float(match[1]), float(match[4]), float(match[5])])
            row["vectors"], row["backups"] = int(match[7]), int(match[3])

    # SARSOP's precision is absolute. The gap is taken relative to QMDP's value, the smaller of the two relevant ones.
    precision = options["gap"] * abs(reference["qmdp"])
    timeout, policy = f"{options['timeout']:g}", str(model.with_suffix(".policy"))
    command = [program, "--timeout", timeout, "--precision", f"{precision:g}",
               "--memory", str(options["memory"]), "--output", policy, str(model)]  # fmt: skip
    # SARSOP checks its time limit between trials only, from the end of reading, in processor time.
    code, measured, last = run(command, on_line, 20 * options["timeout"] + 900, options["memory"])
    row["note"] = warnings[0] if warnings else last if code else ""
    row |= {**measured, "load": marks.get("loading"), "initialise": marks.get("initialization")}
    row["status"] = "ok" if code == 0 and row["curve"] else "failed"
    return row


def own(case: Case, options: dict[str, Any], cache: Path | None, *, warm: bool) -> Row:
    """Run this project's solver, with compiled code in the given folder or in the usual one."""
    row: Row = {"solver": "kitassist" if warm else "kitassist (cold)", "curve": []}

    def on_line(_: float, line: str) -> None:
        if line.startswith("{"):
            event = json.loads(line)
            if event.pop("event") == "point":
                row["curve"].append([event["seconds"], event["lower"], event["upper"]])
            else:
                row.update(event)

    settings = {**case._asdict(), "timeout": options["timeout"], "gap": options["gap"], "warm": warm}
    command = [sys.executable, str(HERE / "peers" / "pomdp.py"), "kitassist", json.dumps(settings)]
    limit = options["timeout"] * 3 + 300
    environment = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    code, measured, last = run(command, on_line, limit, options["memory"], **environment)
    row |= {**measured, "status": "failed" if code else "ok", "note": last if code else ""}
    return row


def searches(case: Case, options: dict[str, Any]) -> list[Row]:
    """Run pomdp-py's planners."""
    rows: list[Row] = []

    def on_line(_: float, line: str) -> None:
        if line.startswith("{"):
            event = json.loads(line)
            if event.pop("event") == "search":
                rows.append({"solver": f"pomdp-py {event['planner']}", "status": "ok", **event})

    each = options["timeout"] / len(SEARCHES)
    settings = {**case._asdict(), "searches": SEARCHES, "seconds_each": each}
    python = os.environ.get("PEER_PYTHON", sys.executable)
    command = [python, str(HERE / "peers" / "pomdp.py"), "pomdp-py", json.dumps(settings)]
    code, _, last = run(command, on_line, 10 * options["timeout"] + 300, options["memory"])
    if code:
        rows.append({"solver": "pomdp-py", "status": "failed", "note": last})
    return rows


def finish(row: Row) -> Row:
    """Add the final bounds, and the time at which each gap was reached first."""
    if row.get("curve"):
        _, row["lower"], row["upper"] = row["curve"][-1]
        row["gap"] = (row["upper"] - row["lower"]) / abs(row["lower"])
        for gap in GAPS:
            reached = [t for t, low, high in row["curve"] if high - low <= gap * abs(low)]
            row[f"to_{gap:g}"] = reached[0] if reached else None
    return row


def references(case: Case, model: Path) -> tuple[dict[str, float], Row]:
    """Export the problem; return the values of two simple policies and QMDP's bound."""
    pomdp = case.problem()
    start = time.perf_counter()
    write_pomdpx(pomdp, model)
    row = {"export_seconds": time.perf_counter() - start, "export_mb": model.stat().st_size / 1e6}
    x = pomdp.model.choices.initial
    values = {"qmdp": float(qmdp(pomdp).value(np.array([x]), pomdp.prior[None])[0])}
    for name, robot in (
        ("never", np.zeros(len(pomdp.robot_actions), dtype=np.int64)),
        ("always", pomdp.first_optimal[:, 0]),
    ):
        values[name] = float((evaluate(pomdp, robot, tolerance=1e-6)[x] * pomdp.prior).sum())
    return values, {**row, "states": len(pomdp.robot_actions), "hidden": pomdp.prior.size}


def disagreements(name: str, rows: Sequence[Row], reference: dict[str, float]) -> list[str]:
    """Describe bounds that contradict each other, or contradict the exact value of a simple policy."""
    known = [("never", reference["never"], np.inf), ("always", reference["always"], np.inf)]
    known += [("QMDP", -np.inf, reference["qmdp"])]
    known += [(row["solver"], row["lower"], row["upper"]) for row in rows if "lower" in row]
    slack = ROUNDING * abs(reference["qmdp"])
    return [
        f"{name}: {one}'s lower bound {low:g} is above {other}'s upper bound {high:g}"
        for one, low, _ in known
        for other, _, high in known
        if low > high + slack
    ]


def losses(name: str, rows: Sequence[Row]) -> list[str]:
    """Describe where SARSOP is ahead of this project's solver."""
    ours = next((row for row in rows if row["solver"] == "kitassist" and "gap" in row), None)
    theirs = next((row for row in rows if row["solver"] == "sarsop" and "gap" in row), None)
    if ours is None or theirs is None:
        return []
    found = []
    for gap in GAPS:
        mine, other = ours[f"to_{gap:g}"], theirs[f"to_{gap:g}"]
        if other is not None and (mine is None or mine > other):
            found.append(f"{name}: to {gap:g} SARSOP takes {other:.2f} s, this solver {shown(mine)} s")
    if theirs["gap"] < ours["gap"] and ours["gap"] > GAPS[-1]:
        found.append(f"{name}: SARSOP ends at a gap of {theirs['gap']:.2e}, this solver at {ours['gap']:.2e}")
    return found


def shown(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:,.{digits}f}"


def as_table(results: Sequence[Row]) -> Table:
    table = Table(title="Bounds on one person's problem; seconds from where the problem is in memory")
    for column in ("case", "solver"):
        table.add_column(column, no_wrap=True)
    columns = (
        "to 1e-2",
        "to 1e-3",
        "to 1e-4",
        "final gap",
        "lower",
        "upper",
        "load s",
        "init s",
        "process s",
        "cpu s",
        "MB",
    )
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("note", overflow="fold")
    last = None
    for row in results:
        if last not in (None, row["case"]):
            table.add_section()
        case, last = ("" if last == row["case"] else row["case"]), row["case"]
        note = escape(row.get("note") or "")
        if row["solver"].startswith("pomdp-py ") and row["status"] == "ok":
            mean = "no episode" if row["mean"] is None else f"{row['mean']:.3f} ± {row['stderr'] or np.nan:.3f}"
            note = f"return {mean} in {row['episodes']} episodes, {shown(row['decision_seconds'], 3)} s a decision "
            note += f"({row['simulations']} simulations)"
            if row["deprived"]:
                note += f"; {row['deprived']} episodes ended without particles"
        if row["status"] != "ok":
            note = f"[red]{row['status']}[/red] {note}"
        cells = [shown(row.get(f"to_{gap:g}")) for gap in GAPS]
        cells.append("–" if "gap" not in row else f"{row['gap']:.1e}")
        cells += [shown(row.get(key), 4) for key in ("lower", "upper")]
        cells += [shown(row.get(key)) for key in ("load", "initialise", "process", "cpu")] + [
            shown(row.get("peak_mb"), 0)
        ]
        table.add_row(case, row["solver"], *cells, note)
    return table


def draw(results: Sequence[Row], file: Path) -> None:
    """Plot the gap against time, with one panel per case."""
    from matplotlib.figure import Figure

    cases = list(dict.fromkeys(row["case"] for row in results if row.get("curve")))
    if not cases:
        return
    columns = min(3, len(cases))
    rows = -(-len(cases) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns, sharey=True)).ravel()
    for axis, case in zip(axes, cases, strict=False):
        for row in results:
            if row["case"] == case and row["solver"] in STYLES and row.get("curve"):
                colour, dashes = STYLES[row["solver"]]
                seconds, lower, upper = np.array(row["curve"], dtype=float).T
                gap = np.maximum((upper - lower) / np.abs(lower), 1e-6)
                axis.step(np.maximum(seconds, 1e-3), gap, where="post", color=colour, linestyle=dashes,
                          label=row["solver"])  # fmt: skip
        axis.set(xscale="log", yscale="log")
        axis.set_title(case, loc="left", fontsize=9)
        axis.grid(visible=True, which="major", color="0.88", linewidth=0.8)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[len(cases) :]:
        axis.set_visible(False)
    figure.supxlabel("seconds")
    figure.supylabel("relative gap")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)


def parse(settings: Sequence[str]) -> list[tuple[float, float, float]]:
    found = []
    for text in settings:
        parts = text.split("/")
        try:
            gamma, c_suggest, sigma = map(float, parts)
        except ValueError:
            raise click.BadParameter(f"{text}: expected GAMMA/C_SUGGEST/SIGMA", param_hint="--settings") from None
        found.append((gamma, c_suggest, sigma))
    return found


@click.command()
@click.option(
    "--instances", default="paper-fixed", show_default=True, help=f"From {', '.join(INSTANCES)}, separated by commas."
)
@click.option("--settings", multiple=True, default=SETTINGS, show_default=True, metavar="G/C/S",
              help="gamma/c_suggest/sigma; repeat it.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True, help="People per setting.")
@click.option("--timeout", type=click.FloatRange(min=1), default=60.0, show_default=True,
              help="Seconds for one solver on one case.")  # fmt: skip
@click.option("--gap", type=click.FloatRange(min=0, min_open=True), default=GAPS[-1], show_default=True)
@click.option("--memory", type=click.IntRange(min=500), default=12_000, show_default=True, help="MB for one solver.")
@click.option("--solvers", default=",".join(SOLVERS), show_default=True, help="Solvers to run, separated by commas.")
@click.option(
    "--cold/--no-cold", default=True, show_default=True, help="Whether to run the first case without compiled code too."
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=OUT, show_default=True)
def main(
    instances: str, settings: tuple[str, ...], seeds: int, timeout: float, gap: float, memory: int, solvers: str,
    cold: bool, out: Path,
) -> None:  # fmt: skip
    """Compare bounds against time."""
    wanted = solvers.split(",")
    if unknown := set(wanted) - set(SOLVERS):
        raise click.BadParameter(f"{', '.join(unknown)}: not among {', '.join(SOLVERS)}", param_hint="--solvers")
    options = {"timeout": timeout, "gap": gap, "memory": memory}
    cases = [Case(i, *s, n) for i in instances.split(",") for s in parse(settings) for n in range(seeds)]
    console = Console(width=None if sys.stdout.isatty() else 200)
    out.mkdir(parents=True, exist_ok=True)
    results: list[Row] = []
    wrong: list[str] = []
    behind: list[str] = []
    with tempfile.TemporaryDirectory(prefix="pomdp-") as scratch, (out / "results.jsonl").open("w") as stream:
        model, cache = Path(scratch, "problem.pomdpx"), Path(scratch, "cache") if cold else None
        for case in cases:
            name = f"{case.instance} {case.gamma:g}/{case.c_suggest:g}/{case.sigma:g} #{case.seed}"
            with console.status(name):
                reference, shared = references(case, model)
                rows: list[Row] = []
                if "kitassist" in wanted:
                    if cold:
                        rows.append(own(case, options, cache, warm=False))
                        cold = False
                    rows.append(own(case, options, cache, warm=True))
                if "sarsop" in wanted:
                    rows.append(sarsop(model, reference, options))
                if "pomdp-py" in wanted:
                    rows += searches(case, options)
            rows = [{"case": name, **case._asdict(), **shared, **reference, **finish(row)} for row in rows]
            wrong += disagreements(name, rows, reference)
            behind += losses(name, rows)
            stream.writelines(json.dumps(row) + "\n" for row in rows)
            stream.flush()
            results += rows
    console.print(as_table(results))
    try:
        draw(results, out / "pomdp.png")
    except ModuleNotFoundError:
        console.print("No figure: matplotlib is not installed (the extra 'plots').")
    for line in behind:
        console.print(f"[yellow]behind[/yellow] {escape(line)}")
    for line in wrong:
        console.print(f"[red]{escape(line)}[/red]")
    if wrong:
        sys.exit(1)
    compared = sum("lower" in row for row in results)
    console.print(
        f"No bounds exclude each other: {compared} pairs of bounds, and the values of QMDP, never and always."
    )


if __name__ == "__main__":
    main()
