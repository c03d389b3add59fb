"""The command `draw`, which draws a state, a plan or an episode."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import planner
from planner.system.errors import InputFileError
from planner.system.files import each_record

from ..declare.options import Given, setting_options
from .options.common import (
    INPUT_FILE,
    apart,
    domain_option,
    instance_argument,
    json_option,
    out_option,
    separate_files,
    together,
)
from .options.goals import goals_option, several_goals
from .options.help import command
from .options.settings import DrawSetting
from .options.task import one_instance
from .terminal.console import ExitCode, fail, print_json

if TYPE_CHECKING:
    from ..people.goals import Goals


class Shown(NamedTuple):
    """What is drawn: a state, a plan, or an episode of a log; without these, where the task begins."""

    state: Path | None
    plan: Path | None
    log: Path | None
    episode: str | None


shown_options = together(
    "shown", Shown,
    (
        click.option("--state", type=INPUT_FILE, help="State to draw: the facts that hold, as PDDL or a JSON list."),
        click.option("--plan", type=INPUT_FILE, help="Plan to draw: one action per line, as written by `solve --out`."),
        click.option(
            "--log", type=INPUT_FILE, help="Log of actions to draw (JSON Lines), as written by `simulate --trace`."
        ),
        click.option("--episode", metavar="E", help="Episode of the log. The first unless given."),
    ),
)  # fmt: skip


@command("draw kitting/tiny --out tiny.svg")
@instance_argument
@domain_option
@shown_options
@goals_option
@setting_options(DrawSetting)
@out_option("a file .svg, .png, .gif or .html", required=True)
@json_option
def draw(
    instance: str, domain: str | None, shown: Shown, problems: tuple[str, ...], out: Path, as_json: bool,
    setting: DrawSetting, given: Given[DrawSetting],
) -> None:  # fmt: skip
    """Draw a state, a plan or an episode as a picture (.svg, .png) or an animation (.gif, .html).

    With --goals, an episode shows how probable each goal was.
    """
    from ..drawing.files import FORMATS, save
    from ..drawing.frames import Frame, episode_frames, episode_of, plan_frames, with_goals
    from ..drawing.picture import Artist
    from ..drawing.raster import require
    from ..drawing.states import read_state

    state, plan, log, episode = shown
    if out.suffix not in FORMATS:
        raise click.UsageError(f"--out {out}: expected a name that ends in {', '.join(FORMATS)}")
    apart({"--state": state, "--plan": plan, "--log": log})
    if episode is not None and not log:
        raise click.UsageError(
            f"--episode {episode} has no effect without --log FILE, the log that has the episode "
            "(`simulate --trace FILE` writes one)"
        )
    if problems and not log:
        raise click.UsageError("--goals: expected --log as well, the actions from which goals are inferred")
    if not problems:
        given.refuse(["goal_prior"], "without --goals")
    separate_files({"--out": out}, {"--state": state, "--plan": plan, "--log": log})
    require(out.suffix)
    found = one_instance(instance, domain)
    goals = several_goals(instance, problems, setting.goal_prior, domain=domain)
    try:
        artist = Artist(planner.load(found), goal=goals is None)
        if plan:
            text = plan.read_text(encoding="utf-8")
            lines = (line.partition(";")[0].strip() for line in text.splitlines())
            with _told(plan):
                if not text.strip():
                    raise ValueError("the file is empty; expected one action per line")
                rows = plan_frames(artist, [line for line in lines if line and line != "SequentialPlan:"])
        elif log:
            records = list(each_record(log))
            damaged = next((record for record in records if isinstance(record, Exception)), None)
            if damaged is not None:
                raise damaged
            known = [record for record in records if isinstance(record, dict)]
            with _told(log):
                rows = episode_frames(artist, known, episode)
            if goals is not None:
                rows = with_goals(rows, _shares(goals, episode_of(known, episode)))
        else:
            values = read_state(state, artist.subject) if state else artist.subject.initial
            rows = [(Frame(tuple(values), "State" if state else "Start"),)]
    except UnicodeDecodeError:
        fail(f"{plan}: not a text file in UTF-8", ExitCode.FAILED)
    except InputFileError as error:
        fail(str(error), ExitCode.FAILED)
    frames = save(artist, rows, out, width=setting.width)
    record = {
        "instance": str(found.problem), "domain": str(found.domain), "out": str(out), "people": len(rows),
        "frames": frames, "bytes": out.stat().st_size,
    }  # fmt: skip
    if as_json:
        print_json(record)
    else:
        click.echo(f"{out}: {frames} frame{'s'[: frames > 1]}, {record['bytes']:,} bytes")


@contextmanager
def _told(file: Path) -> Iterator[None]:
    """Tell the fault of a plan or log that cannot be drawn with its file."""
    try:
        yield
    except ValueError as error:
        fail(f"{file}: {error}", ExitCode.FAILED)


def _shares(goals: Goals, rows: Sequence[Mapping[str, Any]]) -> list[list[dict[str, float]]]:
    """Return the probability of each goal of each person of an episode, before each of its steps and at the end."""
    from ..learning.goals import infer_goals
    from ..learning.log import Log

    people, steps = (
        list(dict.fromkeys(str(row.get("person")) for row in rows)),
        sorted({int(row["step"]) for row in rows}),
    )
    found = infer_goals(goals.tables, Log.of(rows, gaps=True, name="the trace"), prior=goals.prior, strict=True)
    after = {record["person"]: record["steps"] for record in found.as_dicts()}
    return [
        [
            next((one["posterior"] for one in reversed(after.get(person, [])) if one["step"] < step), dict(goals.prior))
            for step in [*steps, math.inf]
        ]
        for person in people
    ]
