"""Execution of studies, in parallel, on this machine or a cluster, and access to their results.

A folder of results contains `study.json` (the study), `episodes.jsonl` (one line for each episode) and `profile.jsonl`
(the seconds of each cell). The lines of a cell are appended at once when the cell is complete; an interrupted cell is
run again. At the end, the lines are sorted into the study's order. The same study therefore gives the same bytes,
however the work was divided or interrupted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.system.errors import InputFileError, require_package
from planner.system.files import ResumableFolder, each_record, held, read_records, write_text
from planner.system.limits import Deadline, LimitError
from planner.system.processes import outcomes
from planner.system.progress import Wanted, adding, shows_progress

from .cells import Outcome, carry_out
from .protocol import study_of
from .study import SCHEMA, Cell, EpisodeRecord, Study

if TYPE_CHECKING:
    import pandas as pd

EPISODES, PROFILE, ABOUT = "episodes.jsonl", "profile.jsonl", "study.json"
KEY = tuple(field.name for field in fields(Cell))
EPISODE = ("policy", "humans", "draw", "trial")
"""Fields that identify an episode within a cell."""


@shows_progress
def run_study(
    study: Study | str | Path,
    out: str | Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    time_limit: float | None = None,
    progress: Wanted = None,
    warn: Callable[[str], None] | None = None,
) -> list[tuple[Cell, Exception]]:
    """Run a study, and return the cells that failed, each with its error.

    Parameters
    ----------
    study : Study, or str or Path
        A study, or a file or a shipped name, as `read` takes them.
    out : path
        Folder of results.
    jobs : int
        Number of worker processes.
    scheduler : str, optional
        Address of a Dask scheduler whose workers run the cells. The workers need the same files at the same paths, and
        one thread each.
    resume : bool
        Keep the complete cells in the folder, and run the remaining ones. A cell with a damaged line is run again.
    time_limit : float, optional
        Seconds after which no further cell is waited for. The folder has the finished ones; the others are returned
        with a `LimitError`, and `resume` continues with them.
    progress : callable or bool, optional
        Receives the number of finished episodes, as in `planner.system.progress`.
    warn : callable, optional
        Called with one line for each damaged file.

    Raises
    ------
    InputFileError
        The folder contains results and `resume` is not set.
    InputFileError
        The folder contains results of another study or of more repeats.
    InputFileError
        `study.json` does not identify the study of the results.
    """
    assert callable(progress)
    ends = Deadline.after(time_limit)
    study = study_of(study)
    out = Path(out)
    order = {cell: number for number, cell in enumerate(study.cells())}
    failed: list[tuple[Cell, Exception]] = []
    with held(out):
        results: ResumableFolder[Cell] = ResumableFolder(out / EPISODES, out / PROFILE, resume=resume)
        _begin(study, out, results, order, warn or (lambda _: None))
        total = sum(map(study.episodes, order))
        advance = adding(progress, "episodes", total, done=sum(map(study.episodes, results.lines)))
        todo = [cell for cell in order if cell not in results.lines]
        with closing(outcomes(carry_out, todo, (study,), jobs=jobs, scheduler=scheduler)) as coming:
            for cell, outcome in coming:
                if isinstance(outcome, Outcome):
                    results.add(cell, outcome.lines, {**asdict(cell), "seconds": outcome.seconds})
                else:
                    failed.append((cell, outcome))
                advance(study.episodes(cell))
                if ends.passed:
                    break
        results.finish(order)
    ended = {*results.lines, *(cell for cell, _ in failed)}
    late = LimitError("out of time; `resume` continues with this cell")
    failed += [(cell, late) for cell in order if cell not in ended]
    return sorted(failed, key=lambda pair: order[pair[0]])


def _begin(
    study: Study, out: Path, results: ResumableFolder[Cell], order: Mapping[Cell, int], warn: Callable[[str], None],
) -> None:  # fmt: skip
    """Prepare the folder of results, which must be of the same study; complete cells are kept."""
    known = {"schema": SCHEMA, "fingerprint": study.fingerprint()}
    kept: dict[Cell, str] = {}
    spent: dict[Cell, dict[str, Any]] = {}
    if results.begun:  # a study that fails before its first episode leaves no results
        before = _about(out)
        if any(before.get(name) != value for name, value in known.items()):
            raise InputFileError(
                f"{out / ABOUT}: the results belong to another study or to changed files; expected another folder"
            )
        kept = _whole_cells(study, out / EPISODES, order, warn)
        found, damaged = _readable(out / PROFILE, lambda record: isinstance(record["seconds"], dict))
        spent = {_cell(record): record for record, _ in found if _cell(record) in kept}
        _say(damaged, "the times of these cells are lost", warn)
    write_text(out / ABOUT, [json.dumps({**known, "study": study.record()}, indent=1) + "\n"])
    results.begin(kept, spent, [out / "figures"])


def _about(folder: Path) -> dict[str, Any]:
    """Read the description of a folder's results."""
    file = folder / ABOUT
    lost = f"the study to which {EPISODES} belongs is unknown; choose another folder"
    try:
        about = json.loads(file.read_bytes().decode())
    except FileNotFoundError:
        raise InputFileError.of(file, None, f"is missing; {lost}") from None
    except (ValueError, RecursionError) as error:
        what = "is not text (UTF-8)" if isinstance(error, UnicodeDecodeError) else "is not valid JSON"
        raise InputFileError.of(file, getattr(error, "lineno", None), f"{what}; {lost}") from None
    if not isinstance(about, dict) or "schema" not in about:
        raise InputFileError.of(file, None, f"has no field 'schema'; {lost}")
    return about


def _readable(
    file: Path, good: Callable[[dict[str, Any]], bool]
) -> tuple[list[tuple[dict[str, Any], str]], list[InputFileError]]:
    """Return the valid records, each with its line, and the errors of the others."""
    found, damaged = [], []
    for number, record in enumerate(each_record(file), start=1):
        if isinstance(record, InputFileError):
            damaged.append(record)
            continue
        try:
            if _cell(record) and good(record):
                found.append((record, json.dumps(record) + "\n"))
                continue
        except (KeyError, TypeError):
            pass
        damaged.append(InputFileError.of(file, number, "lacks fields, or has others than expected"))
    return found, damaged


def _say(damaged: Sequence[InputFileError], consequence: str, warn: Callable[[str], None]) -> None:
    """Report the first damaged line of a file, and the number of damaged lines."""
    if damaged:
        more = f" (and {len(damaged) - 1} other damaged lines)" if len(damaged) > 1 else ""
        warn(f"{damaged[0]}{more}; {consequence}")


def _whole_cells(study: Study, file: Path, order: Mapping[Cell, int], warn: Callable[[str], None]) -> dict[Cell, str]:
    """Return the lines of the cells in which every episode occurs exactly once, undamaged."""
    found, damaged = _readable(file, _is_episode)
    lines: dict[Cell, dict[tuple[object, ...], str]] = {}
    broken = set()
    beyond = max((cell for record, _ in found if (cell := _cell(record)) not in order), key=_repeat, default=None)
    if beyond is not None:
        raise InputFileError(f"{file}: has {beyond}; expected --repeats {beyond.repeat + 1} or more")
    for record, line in found:
        cell = _cell(record)
        own = lines.setdefault(cell, {})
        which = tuple(record[name] for name in EPISODE)
        if which in own:
            broken.add(cell)
        own[which] = line
    _say(damaged, "the cells of such lines are run again", warn)
    order_of = {cell: list(study.episodes_of(cell)) for cell in lines.keys() - broken}
    whole = [cell for cell in lines if cell in order_of and set(order_of[cell]) == set(lines[cell])]
    return {cell: "".join(lines[cell][which] for which in order_of[cell]) for cell in whole}


def _repeat(cell: Cell) -> int:
    return cell.repeat


def _is_episode(record: Mapping[str, Any]) -> bool:
    """Whether a record is one of an episode."""
    try:
        EpisodeRecord(**record)
    except ValueError:
        return False
    return True


def _cell(record: Mapping[str, Any]) -> Cell:
    cell = Cell(**{name: record[name] for name in KEY})
    hash(cell)  # raises TypeError for a field that is a list
    return cell


def load_study(folder: str | Path) -> pd.DataFrame:
    """Read a study's episodes as a data frame, one row for each, in the study's order.

    The columns are the fields of `episodes.jsonl`, which `docs/study.md` describes, and five more:
    `human_actions_per_person`, `cost_per_person` (cost units), `cut_off`, whether a person had not finished at the step
    limit, and the percentages of people who had, `finished_percent`, and who were helped, `helped_percent`.

    Parameters
    ----------
    folder : path

    Raises
    ------
    InputFileError
        There are no results, or results of another format.
    InputFileError
        A line is not a valid record.
    MissingExtraError
        pandas is not installed.
    """
    require_package("data frames need", "pandas", "study")
    import pandas as pd

    folder = Path(folder)
    if not (folder / EPISODES).is_file() or not (folder / ABOUT).is_file():
        raise InputFileError(f"{folder}: no results of a study; expected {EPISODES} and {ABOUT}")
    schema = _about(folder)["schema"]
    if schema != SCHEMA:
        raise InputFileError(f"{folder}: results of schema {schema}; expected {SCHEMA}")
    frame = pd.DataFrame(read_records(folder / EPISODES))
    if len(frame):
        frame["human_actions_per_person"] = [sum(actions) / len(actions) for actions in frame["actions"]]
        frame["cost_per_person"] = [sum(costs) / len(costs) for costs in frame["costs"]]
        frame["cut_off"] = [not all(finished) for finished in frame["finished"]]
        for name in ("finished", "helped"):
            frame[f"{name}_percent"] = [100 * sum(map(bool, each)) / len(each) for each in frame[name]]
        for name in (*KEY[:-1], "policy"):
            frame[name] = pd.Categorical(frame[name], categories=frame[name].unique())
    return frame


def profile(folder: str | Path) -> dict[str, float]:
    """Return the total seconds of each part of a study over all workers, in decreasing order.

    Parameters
    ----------
    folder : path
    """
    spent: dict[str, float] = {}
    for record in read_records(Path(folder) / PROFILE):
        for what, seconds in record["seconds"].items():
            spent[what] = spent.get(what, 0.0) + seconds
    return dict(sorted(spent.items(), key=lambda item: -item[1]))
