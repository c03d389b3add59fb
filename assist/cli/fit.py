"""The command `fit`: what a log of actions says of people."""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from planner import Cache, LimitError, Limits, OnDemand, cost_to_go, load
from planner.solving import SolveOptions

from .console import EXIT_FAILED, fail, one_line_errors, print_json, print_table
from .options import (
    INPUT_FILE,
    JOBS,
    NUMBER,
    OUTPUT_FILE,
    OUTPUT_FOLDER,
    SECONDS,
    SEED,
    domain_option,
    instance_argument,
)
from .progress import progress_bar
from .task import one_instance

FEWEST_FOR_CROWD = 3


@click.command()
@instance_argument
@click.argument("log", metavar="LOG", type=INPUT_FILE)
@domain_option
@click.option("--out", type=OUTPUT_FILE, help="Write a record of each person (JSON Lines).")
@click.option(
    "--population", "crowd_file", type=OUTPUT_FILE,
    help="Write the distribution of beta and theta over people, for `simulate --population`.",
)  # fmt: skip
@click.option(
    "--family", type=click.Choice(["uniform", "log-uniform", "log-normal", "histogram"]),
    help="Of beta's distribution over people; the parametric one that fits best unless given.",
)  # fmt: skip
@click.option("--figures", "folder", type=OUTPUT_FOLDER, help="Draw into this folder.")
@click.option("--misconception", is_flag=True, help="Also estimate sigma, and what people take for the cost-to-go.")
@click.option("--eta", type=NUMBER, help="Rate of the trust update where it is known; estimated unless given.")
@click.option(
    "--utility-scale", type=NUMBER, default=1.0, show_default=True, help="Cost units that change trust by eta."
)
@click.option("--lapse", type=NUMBER, default=1e-3, show_default=True, help="Weight of a uniform choice.")
@click.option("--level", type=NUMBER, default=0.95, show_default=True, help="Of the intervals.")
@click.option(
    "--largest-beta", type=NUMBER,
    help="Where beta's range ends.  [default: 10, divided by the cost of the smallest possible mistake]",
)  # fmt: skip
@click.option("--drop", multiple=True, metavar="NAME", help="Leave actions of this name out; may be repeated.")
@click.option(
    "--rename", multiple=True, metavar="OLD=NEW", help="What the log calls OLD the task calls NEW; may be repeated."
)
@click.option(
    "--gaps", is_flag=True, help="Steps may skip numbers without a line missing, since the log counts otherwise."
)
@click.option("--strict", is_flag=True, help="Fit nothing if any line cannot be used, or if any state takes too long.")
@click.option(
    "--max-states", type=click.IntRange(min=1), default=SolveOptions.max_states, show_default=True,
    help="On a larger task evaluate only states that were visited, and their successors.",
)  # fmt: skip
@click.option("--time-limit", type=SECONDS, metavar="S", help="Seconds for each of these states.")
@click.option(
    "--cache", type=OUTPUT_FOLDER,
    help="Folder where these states are kept.  [default: kitassist in the user's cache folder]",
)  # fmt: skip
@click.option("--jobs", type=JOBS, help="Processors to use; all unless given.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the check of the model.")
@click.option("--json", "as_json", is_flag=True, help="Print the records as one JSON list.")
def fit(
    instance: str,
    log: Path,
    domain: str | None,
    out: Path | None,
    crowd_file: Path | None,
    family: str | None,
    folder: Path | None,
    misconception: bool,
    drop: tuple[str, ...],
    rename: tuple[str, ...],
    gaps: bool,
    strict: bool,
    max_states: int,
    time_limit: float | None,
    cache: Path | None,
    jobs: int | None,
    seed: int,
    as_json: bool,
    **setting: Any,
) -> None:
    """Learn expertise, influence and trust of people from the LOG of their actions.

    LOG has a line of JSON for each action: {"person": "...", "episode": "...", "step": 0, "action": "(name arg ...)",
    "suggestion": "(...)" or null}.
    """
    from planner import storage

    from ..learning import fit as fitting
    from ..learning import log as logs
    from ..learning import population as populations
    from ..learning.record import failed, profiles
    from ..learning.recording import replay
    from ..plots import people as fit_figures
    from ..plots import style

    jobs = jobs or os.cpu_count() or 1
    wrong = next((pair for pair in rename if not all(part.strip() for part in pair.partition("=")[::2])), None)
    if wrong is not None:
        raise click.UsageError(f"--rename {wrong}: expected OLD=NEW")
    names: dict[str, str] = {}
    for old, _, new in (pair.partition("=") for pair in rename):
        if names.setdefault(old.strip().lower(), new.strip()) != new.strip():
            raise click.UsageError(f"--rename {old}={new}: '{old}' is renamed already")
    try:
        method = fitting.Method(**setting)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    with one_line_errors("interrupted; states that were evaluated on demand are kept"):
        found = one_instance(instance, domain)
        if folder:
            style.require()
        task = load(found)
        if task.decided_by_translator:
            fail(
                f"{found}: the goal cannot be reached, or holds from the start; there is nothing to learn from",
                EXIT_FAILED,
            )
        records_of = logs.read_log(log, gaps=gaps)
        walked = OnDemand(task)
        try:
            recording, more = replay(records_of, walked, drop=drop, rename=names)
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        faults = sorted([*records_of.faults, *more], key=lambda fault: fault.line)
        for line in logs.told(faults, log):
            click.echo(line, err=True)
        if strict and faults:
            fail(f"{log}: nothing is fitted, because of --strict", EXIT_FAILED)
        if not len(recording):
            if not records_of.people:
                fail(f"{log}: no recorded actions", EXIT_FAILED)
            fail(f"{log}: no episode can be followed through {found}; is it the log of another instance?", EXIT_FAILED)
        h, goal = _evaluate(walked, recording.wanted(), max_states, time_limit, cache, jobs, strict=strict)
        recording, left_out = recording.evaluated(h)
        if not len(recording):
            fail(f"{found}: the states after every action took more than --time-limit", EXIT_FAILED)
        if not math.isfinite(h[recording.wanted()].min()):
            fail(
                f"{found}: no state that was visited has a way to the goal, so that all actions are alike",
                EXIT_FAILED,
            )
        observations = fitting.observe(recording, h, goal)
        with progress_bar("fitting people", len(observations)) as advance:
            people = profiles(
                observations, method, np.random.default_rng(seed),
                misconceptions=misconception, jobs=jobs, progress=advance,
            )  # fmt: skip
        left = sorted(records_of.people - set(recording.people))
        records = [
            profile.record(
                lambda states: [task.facts(values) for values in walked.values(states).tolist()],
                left_out=left_out.get(profile.fit.observations.person, 0),
            )
            for profile in people
        ]
        records += [
            failed(
                person,
                "no action can be used" if left_out.get(person) else "no episode can be used",
                left_out=left_out.get(person, 0),
            )
            for person in left
        ]
        records.sort(key=lambda record: logs.in_order(record["person"]))
        general = None
        if crowd_file or (not as_json and len(people) >= FEWEST_FOR_CROWD):
            with progress_bar("fitting the population", populations.ETAS) as advance:
                general = populations.fit_crowd(observations, method, family=family, progress=advance)
        if crowd_file and general:
            sigmas = [p.misconception.sigma for p in people if p.misconception is not None]
            sigma = tuple(np.quantile(sigmas, (0.1, 0.9)).tolist()) if sigmas else (0.0, 0.0)
            with storage.atomic(crowd_file) as path:
                path.write_text(json.dumps(general.record(sigma), indent=1) + "\n", encoding="utf-8")
        if out:
            storage.write_records(out, records)
        if folder:
            fit_figures.draw([profile.fit for profile in people], folder)
    if as_json:
        print_json(records)
    else:
        _show_people(records)
        if general is not None:
            _show_crowd(general)
    if faults or left or left_out:
        sys.exit(EXIT_FAILED)


def _evaluate(
    walked: OnDemand, wanted: Any, max_states: int, time_limit: float | None, cache: Path | None, jobs: int, *,
    strict: bool,
) -> tuple[Any, Any]:  # fmt: skip
    """Give h* of the wanted states of a task, and which are goal states: from a sweep, or one by one on demand.

    States that took too long have NaN unless `strict`, where they are an error.
    """
    values, limits = walked.values(wanted), Limits(seconds=time_limit)
    answers: Any = cost_to_go(walked.task, values, max_states=max_states, jobs=jobs, limits=limits)
    h, goal = np.full(len(walked), np.nan), np.zeros(len(walked), dtype=bool)
    goal[wanted] = walked.is_goal(wanted)
    if answers.method == "sweep":
        h[wanted] = answers.lookup(answers.numbers(values))
    else:
        click.echo(f"evaluating {len(wanted)} states on demand: {answers.reason}", err=True)
        asked = OnDemand(walked.task, cache=Cache(walked.task, cache), jobs=jobs, limits=limits)
        with progress_bar("evaluating states", len(wanted)) as advance:
            numbers = asked.numbers(values)
            try:
                h[wanted] = asked.lookup(numbers, advance)
            except LimitError as error:
                if strict:
                    raise
                h[wanted] = asked.known(numbers)
                click.echo(f"{error}; actions that depend on them are left out", err=True)
    return h, goal


def _show_people(records: list[dict[str, Any]]) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("person")
    for name in ("beta", "theta", "eta", "actions", "suboptimal", "log-likelihood", "check p"):
        table.add_column(name, justify="right")
    if any("misconception" in r for r in records):
        table.add_column("sigma", justify="right")
    for r in records:
        if r["error"]:
            table.add_row(r["person"], *["-"] * 7)
            continue
        cells = [_show_estimate(r[name], r[f"{name}_interval"], r[f"{name}_open"]) for name in ("beta", "theta", "eta")]
        p = r["check"]["p"]
        cells += [f"{r['actions']}", f"{r['suboptimal_actions']}", f"{r['log_likelihood']:.2f}"]
        cells.append("-" if p is None else f"{p:.3f}")
        m = r.get("misconception")
        if m is not None:
            cells.append(_show_estimate(m["sigma"], m["sigma_interval"], m["sigma_open"]))
        table.add_row(r["person"], *cells)
    print_table(table, width=160)
    for r in records:
        for note in [*r["notes"], *([r["error"]] if r["error"] else [])]:
            click.echo(f"{r['person']}: {note}")


def _show_estimate(value: float | None, interval: list[float] | None, is_open: list[str] | None) -> str:
    if value is None or interval is None:
        return "-"
    return f"{value:.2f} ({interval[0]:.2f} to {interval[1]:.2f}{'+' if 'above' in (is_open or []) else ''})"


def _show_crowd(general: Any) -> None:
    for name in ("beta", "theta"):
        margin = getattr(general, name)
        if margin is not None:
            click.echo(
                f"population of {general.people}: {name} is {margin.family}, "
                f"mean {margin.mean:.2f}, standard deviation {margin.spread:.2f}"
            )
    if general.eta is not None:
        click.echo(f"population of {general.people}: eta {general.eta:.2f}")
