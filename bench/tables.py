"""Tables of figures in the documentation, each generated from a record that says how it was made.

    python bench/tables.py      write all tables into their pages

A record is `bench/records/NAME.json`. It contains the `commands` that made the table, the date and commit (`made`), and
the `table`: titles first, and cells as text. A page has a comment, `<!-- table: NAME -->`, followed by the table and
its commands. With `<!-- table: NAME, columns 1 3-5, rows 2 4 -->` it shows these columns and rows, counted from 1, the
first command, and a link to the record. Benchmarks write their records with `--record FILE`; a record may contain more
than its table. A table of more than 30 rows stays in its record, to which the page links. Records that were made "on
this page since ..." were taken from pages, with the commands given there. Scripts in `SETTLED` were taken out.
"""

from __future__ import annotations

import datetime
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click

SETTLED = (
    "carried", "confidence", "counters", "covered", "enhsp", "goals", "habits", "honesty", "ignored", "joint", "kits",
    "line", "live", "live_timing", "robots", "symbolic", "team", "training", "trust_study", "unreliable",
    "userstudy_intervals",
)  # fmt: skip
"""Scripts, or some of their commands, whose questions are settled; `git show c450d907:bench/NAME.py` has them."""

ROOT = Path(__file__).resolve().parent.parent
RECORDS = ROOT / "bench" / "records"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LONGEST = 30  # rows that a page shows of a table: about a screen
MARKED = re.compile(
    r"^<!-- table: ([\w-]+)(?:, [\w ,-]+)? -->\n(?:\|.*\n)*(?:\[All \d+ rows\].*\n)?(?:\nMade by .*\n(?:.+\n)*)?", re.M
)
"""A table in a page or a link to one, with what made it up to the next empty line."""
PART = re.compile(r"(columns|rows)((?: \d+(?:-\d+)?)+)")
"""The columns or rows of a record that a page shows."""
Columns = Mapping[str, Callable[[dict[str, Any]], str]]
"""Columns of a benchmark's table: titles, and functions that format a row."""

record_option = click.option(
    "--record", type=click.Path(path_type=Path, dir_okay=False), help="Write the table for the documentation here."
)


more_option = click.option(
    "--more", is_flag=True, help="Append the rows to the record, if it exists, instead of replacing it."
)


def cell(name: str, form: str = "", error: str | None = None) -> Callable[[dict[str, Any]], str]:
    """Return a formatter of one entry of a row, with its standard error if there is one."""
    if error is None:
        return lambda row: format(row[name], form)
    return lambda row: f"{row[name]:{form}} ± {row[error]:{form}}"


def write_record(
    file: Path | None, columns: Columns, rows: Iterable[dict[str, Any]], *, more: bool = False, **rest: Any
) -> None:
    """Write the rows of a benchmark as a record, or append them to one with the same columns. Without a file, do
    nothing.
    """
    if file is None:
        return
    commands, table = [], [list(columns)]
    if more and file.exists():
        begun = json.loads(file.read_text(encoding="utf-8"))
        if begun["table"][0] != table[0]:
            raise click.UsageError(f"--more: {file} has other columns; expected {', '.join(columns)}")
        commands, table = begun["commands"], begun["table"]
    table += [[show(row) for show in columns.values()] for row in rows]
    save(file, {"commands": [*commands, _command()], "made": _now(), **rest, "table": table})


def save(file: Path, record: dict[str, Any]) -> None:
    """Write a record, with a line for each row of its table."""
    rest = json.dumps({name: value for name, value in record.items() if name != "table"}, indent=1, ensure_ascii=False)
    rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in record["table"])
    file.write_text(f'{rest[:-2]},\n "table": [\n  {rows}\n ]\n}}\n', encoding="utf-8")


def read_record(name: str) -> dict[str, Any]:
    """Return a stored record."""
    return json.loads((RECORDS / f"{name}.json").read_text(encoding="utf-8"))


def shown(comment: str) -> str:
    """Return what a page of results shows of a record: the comment, the table or a link to it, and the commands."""
    name = comment.split()[2].rstrip(",")
    record = read_record(name)
    titles, *rows = record["table"]
    file = f"../../bench/records/{name}.json"
    parts = {kind: _numbers(numbers) for kind, numbers in PART.findall(comment)}
    columns = parts.get("columns", range(len(titles)))
    picked = [titles, *(rows[row] for row in parts.get("rows", range(len(rows))))]
    head, *body = (re.sub(" +", " ", f"| {' | '.join(cells[column] for column in columns)} |") for cells in picked)
    lines = [comment, head, "|" + "---|" * len(columns), *body]
    if len(body) > LONGEST:
        lines[1:] = [f"[All {len(rows)} rows]({file}) are in the record."]
    first, *more = [f"`{command}`" for command in record["commands"]]
    if parts:
        made = f"Made by {first}{', ...' if more else ''}; [record]({file})."
    else:
        made = ",\n".join([f"Made by {first}", *more]) + f"; {record['made']}."
    return "\n".join([*lines, "", made, ""])


def filled(page: str) -> str:
    """Return a page's text with its tables updated from their records."""
    return MARKED.sub(lambda match: shown(match[0].partition("\n")[0]), page)


def _numbers(text: str) -> list[int]:
    """Return the indices, from 0, of numbers such as `1 3-5`, which count from 1."""
    ends = [[int(end) for end in one.split("-")] for one in text.split()]
    return [number - 1 for begin in ends for number in range(begin[0], begin[-1] + 1)]


def _command() -> str:
    script, *arguments = sys.argv
    if "--record" in arguments:
        place = arguments.index("--record")
        del arguments[place : place + 2]
    arguments = [argument for argument in arguments if argument != "--more"]
    return shlex.join(["python", f"bench/{Path(script).name}", *arguments])


def _now() -> str:
    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], capture_output=True, text=True, cwd=ROOT, check=True).stdout.strip()

    changed = " with changes" if git("status", "--porcelain", "--untracked-files=no") else ""
    return f"{datetime.date.today()}, {git('rev-parse', '--short', 'HEAD')}{changed}"


def main() -> None:
    """Write all tables into their pages."""
    for page in PAGES:
        before = page.read_text(encoding="utf-8")
        after = filled(before)
        if after != before:
            page.write_text(after, encoding="utf-8")
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()
