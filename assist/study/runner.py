"""Carrying a study out: in parallel, on this machine or on a cluster, resumable; and reading what came of it.

A folder of results holds `study.json`, which says what was run, `episodes.jsonl` with a line for each episode, and
`profile.jsonl` with the seconds that each cell took. The lines of a cell are added in one go when it has ended; what
was cut off is run again. At the end the lines are put into the study's order, so that the same study gives the same
bytes however the work was divided or interrupted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.errors import MissingExtraError
from planner.storage import append_record, atomic, read_records, write_records
from planner.workers import outcomes

from .study import SCHEMA, Cell, Outcome, Study, StudyError, carry_out

if TYPE_CHECKING:
    import pandas as pd

EPISODES, PROFILE, ABOUT = "episodes.jsonl", "profile.jsonl", "study.json"
KEY = tuple(field.name for field in fields(Cell))


def run_study(
    study: Study,
    out: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Callable[[int], None] | None = None,
) -> list[tuple[Cell, Exception]]:
    """Carry a study out, and return the cells that failed, each with its error.

    Parameters
    ----------
    study : Study
    out : Path
        The folder of results.
    jobs : int
        Worker processes.
    scheduler : str, optional
        Address of a Dask scheduler whose workers do the work instead. They have to see the same files at the same
        paths, and run one thread each.
    resume : bool
        Keep the cells that are in the folder, and run the rest.
    progress : callable, optional
        Called with the number of episodes that have been added since the last call.

    Raises
    ------
    StudyError
        The folder holds results already and `resume` is not set; or they are those of another study, or of more
        repeats than are asked for.
    """
    order = {cell: number for number, cell in enumerate(study.cells())}
    kept = _begin(study, out, resume, order)
    if progress is not None:
        progress(sum(study.episodes(cell) for cell in kept))
    failed: list[tuple[Cell, Exception]] = []
    todo = [cell for cell in order if cell not in kept]
    with (out / EPISODES).open("a", encoding="utf-8") as stream:
        for cell, outcome in outcomes(carry_out, todo, (study,), jobs=jobs, scheduler=scheduler):
            if isinstance(outcome, Outcome):
                kept[cell] = outcome.lines
                stream.write(outcome.lines)
                stream.flush()
                append_record(out / PROFILE, {**asdict(cell), "seconds": outcome.seconds})
            else:
                failed.append((cell, outcome))
            if progress is not None:
                progress(study.episodes(cell))
    _write(out / EPISODES, [kept[cell] for cell in order if cell in kept])
    spent = {_cell(record): record for record in read_records(out / PROFILE)}
    write_records(out / PROFILE, [spent[cell] for cell in order if cell in spent])
    return sorted(failed, key=lambda pair: order[pair[0]])


def _begin(study: Study, out: Path, resume: bool, order: Mapping[Cell, int]) -> dict[Cell, str]:
    """Prepare the folder; return the lines of each cell that is in it, whole."""
    about, episodes = out / ABOUT, out / EPISODES
    known = {"schema": SCHEMA, "fingerprint": study.fingerprint()}
    kept: dict[Cell, str] = {}
    if episodes.exists():
        if not resume:
            raise StudyError(f"{episodes} exists; resume it, or choose another folder")
        before = json.loads(about.read_text(encoding="utf-8")) if about.is_file() else {}
        if any(before.get(name) != value for name, value in known.items()):
            raise StudyError(f"{about}: these are results of another study, or of other files; choose another folder")
        kept = _whole_cells(study, episodes, order)
    _write(about, [json.dumps({**known, "study": study.record()}, indent=1) + "\n"])
    _write(episodes, list(kept.values()))
    spent = read_records(out / PROFILE) if kept else []
    write_records(out / PROFILE, [record for record in spent if _cell(record) in kept])
    return kept


def _whole_cells(study: Study, file: Path, order: Mapping[Cell, int]) -> dict[Cell, str]:
    lines: dict[Cell, list[str]] = {}
    for line in file.read_text(encoding="utf-8").split("\n")[:-1]:
        cell = _cell(json.loads(line))
        if cell not in order:
            raise StudyError(f"{file}: has {cell}; expected --repeats {cell.repeat + 1} or more")
        lines.setdefault(cell, []).append(line + "\n")
    return {cell: "".join(own) for cell, own in lines.items() if len(own) == study.episodes(cell)}


def _cell(record: Mapping[str, Any]) -> Cell:
    return Cell(**{name: record[name] for name in KEY})


def _write(file: Path, texts: Sequence[str]) -> None:
    with atomic(file) as path, path.open("w", encoding="utf-8") as stream:
        stream.writelines(texts)


def load_study(folder: str | Path) -> pd.DataFrame:
    """Read a study's episodes, one row each, in the study's order.

    The columns are the fields of `episodes.jsonl`, which `docs/study.md` describes, and two more:
    `human_actions_per_person`, and `cut_off`: whether somebody had not finished at the step limit.

    Raises
    ------
    StudyError
        No results, or results that this version does not read.
    MissingExtraError
        pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError:
        raise MissingExtraError("data frames need pandas: pip install 'kitassist[study]'") from None
    folder = Path(folder)
    if not (folder / EPISODES).is_file() or not (folder / ABOUT).is_file():
        raise StudyError(f"{folder}: no results of a study; expected {EPISODES} and {ABOUT}")
    schema = json.loads((folder / ABOUT).read_text(encoding="utf-8"))["schema"]
    if schema != SCHEMA:
        raise StudyError(f"{folder}: results of schema {schema}; expected {SCHEMA}")
    frame = pd.DataFrame(read_records(folder / EPISODES))
    if len(frame):
        frame["human_actions_per_person"] = [sum(actions) / len(actions) for actions in frame["actions"]]
        frame["cut_off"] = [not all(finished) for finished in frame["finished"]]
        for name in (*KEY[:-1], "policy"):
            frame[name] = pd.Categorical(frame[name], categories=frame[name].unique())
    return frame


def profile(folder: Path) -> dict[str, float]:
    """Give how many seconds of the workers each part of a study took, the longest first."""
    spent: dict[str, float] = {}
    for record in read_records(folder / PROFILE):
        for what, seconds in record["seconds"].items():
            spent[what] = spent.get(what, 0.0) + seconds
    return dict(sorted(spent.items(), key=lambda item: -item[1]))
