"""Tables of figures in the documentation: each is shown from a record, which says what made it.

    python bench/tables.py      write all tables into their pages

A record is `bench/records/NAME.json`: the `commands` that made the table, when it was `made` and at which commit, and
the `table` itself, its head first, cells as they are shown. A page has a comment, `<!-- table: NAME -->`, and below it
the table and what made it. Benchmarks write their records with `--record FILE`; a record may hold more than its table.
Records that were made "on this page since ..." were taken over from pages: their commands are those that the text gave.
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

ROOT = Path(__file__).resolve().parent.parent
RECORDS = ROOT / "bench" / "records"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MARKED = re.compile(r"^<!-- table: ([\w-]+) -->\n(?:\|.*\n)*(?:\nMade by .*\n(?:.+\n)*)?", re.M)
"""A table in a page, with what made it up to the next empty line."""
Columns = Mapping[str, Callable[[dict[str, Any]], str]]
"""How a page shows a benchmark's rows: heads of columns, and what each says of a row."""

record_option = click.option(
    "--record", type=click.Path(path_type=Path, dir_okay=False), help="Write the table for the documentation here."
)


more_option = click.option(
    "--more", is_flag=True, help="Add the rows to the record there, which another call has begun, instead of a new one."
)


def cell(name: str, form: str = "", error: str | None = None) -> Callable[[dict[str, Any]], str]:
    """Show one entry of a row in a format, with that of its standard error if there is one."""
    if error is None:
        return lambda row: format(row[name], form)
    return lambda row: f"{row[name]:{form}} ± {row[error]:{form}}"


def write_record(
    file: Path | None, columns: Columns, rows: Iterable[dict[str, Any]], *, more: bool = False, **rest: Any
) -> None:
    """Write what a benchmark has found as a record, or add it to one of the same columns; nothing without a file."""
    if file is None:
        return
    commands, table = [], [list(columns)]
    if more:
        begun = json.loads(file.read_text(encoding="utf-8"))
        if begun["table"][0] != table[0]:
            raise click.UsageError(f"--more: {file} has other columns; expected {', '.join(columns)}")
        commands, table = begun["commands"], begun["table"]
    table += [[show(row) for show in columns.values()] for row in rows]
    save(file, {"commands": [*commands, _command()], "made": _now(), **rest, "table": table})


def save(file: Path, record: dict[str, Any]) -> None:
    """Write a record, a line for each row of its table."""
    rest = json.dumps({name: value for name, value in record.items() if name != "table"}, indent=1, ensure_ascii=False)
    rows = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in record["table"])
    file.write_text(f'{rest[:-2]},\n "table": [\n  {rows}\n ]\n}}\n', encoding="utf-8")


def read_record(name: str) -> dict[str, Any]:
    """Give a stored record."""
    return json.loads((RECORDS / f"{name}.json").read_text(encoding="utf-8"))


def shown(name: str) -> str:
    """Give what a page has of a record, the comment included."""
    record = read_record(name)
    head, *rows = (re.sub(" +", " ", f"| {' | '.join(cells)} |") for cells in record["table"])
    lines = [f"<!-- table: {name} -->", head, "|" + "---|" * len(record["table"][0]), *rows]
    commands = ",\n".join(f"`{command}`" for command in record["commands"])
    return "\n".join([*lines, "", f"Made by {commands}; {record['made']}.", ""])


def filled(page: str) -> str:
    """Give a page's text with its tables as their records have them."""
    return MARKED.sub(lambda match: shown(match[1]), page)


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
