"""Tables in the documentation equal their records, which name the commands that made them."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from conftest import SMALL, named, solvable, table_of
from test_bench import commands

from assist.cli import main as kitassist
from planner import Instance

TABLES = importlib.import_module("tables")
RECORDS = sorted(file.stem for file in TABLES.RECORDS.glob("*.json"))
NUMBER = re.compile(r"[-<≈\[*]*\d")


def tables(page: Path) -> Iterator[tuple[str, list[list[str]]]]:
    """The tables of a page: the line above each, and its cells."""
    above, rows = "", []
    for line in [*page.read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line[1:-1])])
            continue
        if rows:
            yield above, rows
        above, rows = line, []


def of_figures(rows: list[list[str]]) -> bool:
    """Whether at least two columns hold numbers in half of their cells."""
    columns = zip(*rows[2:], strict=True)
    return sum(2 * sum(bool(NUMBER.match(cell)) for cell in column) >= len(column) for column in columns) >= 2


@pytest.mark.parametrize("page", TABLES.PAGES, ids=lambda page: page.name)
def test_tables_of_figures_show_their_records(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    unmarked = [rows[0] for above, rows in tables(page) if of_figures(rows) and not above.startswith("<!-- table: ")]
    assert unmarked == [], "figures need a record in bench/records, see bench/tables.py"
    assert TABLES.filled(text) == text, "python bench/tables.py writes what the records have"


def test_every_record_is_shown() -> None:
    """As a table or as a link; a table stands on one page only."""
    texts = [page.read_text(encoding="utf-8") for page in TABLES.PAGES]
    shown = [name for text in texts for name in TABLES.MARKED.findall(text)]
    assert len(set(shown)) == len(shown)
    linked = {name for text in texts for name in re.findall(r"records/([\w-]+)\.json\)", text)}
    assert sorted({*shown, *linked}) == RECORDS


@pytest.mark.parametrize("name", RECORDS)
def test_commands_of_records_can_be_run(name: str) -> None:
    """Only the options are parsed, since many commands take long."""
    for command in TABLES.read_record(name)["commands"]:
        program, first, *arguments = shlex.split(command)
        if program == "kitassist" and not first.startswith("-"):
            known, name = kitassist.get_command(click.Context(kitassist), first), first
        elif program == "python" and Path(first).parent == Path("bench"):  # those of others need more than tests have
            script = Path(first).stem
            benchmarks = commands(script) if (TABLES.ROOT / first).exists() else {}
            name = next((one for one in (script, " ".join([script, *arguments[:1]])) if one in benchmarks), "")
            if not name and script in TABLES.SETTLED:
                continue
            known, arguments = benchmarks[name], arguments[name.count(" ") :]
        else:
            assert program in ("kitassist", "python", "mutmut", "make"), command
            continue
        assert known is not None, command
        with known.make_context(name, arguments):
            pass


@pytest.mark.parametrize("instance", solvable(SMALL), ids=named)
def test_instances_are_what_their_readme_says(instance: Instance) -> None:
    """Only small instances are checked."""
    readme = next(folder / "README.md" for folder in instance.problem.parents if (folder / "README.md").exists())
    name = str(instance.problem.relative_to(readme.parent))
    described = [
        dict(zip(rows[0], row, strict=True)) for _, rows in tables(readme) for row in rows[2:] if row[0] == f"`{name}`"
    ]
    table = table_of(instance)
    is_so = {
        "states": f"{len(table):,}",
        "optimal cost": f"{table[table.initial]:g}",
        "actions": str(len(table.optimal_plan() or [])),
        "dead ends": f"{table.dead_end.sum():,}",
    }
    assert f"`kitassist solve domains/{readme.parent.name}`" in readme.read_text(encoding="utf-8")
    assert len(described) == 1
    assert described[0].items() & is_so.items() == {item for item in is_so.items() if item[0] in described[0]}


def test_benchmarks_write_what_is_shown() -> None:
    team = importlib.import_module("team")
    shown = {"team-latency": team.LATENCY, "team-rate": team.RATE, "team-gap": team.GAP, "team-gap-100": team.GAP}
    for name, columns in shown.items():
        assert TABLES.read_record(name)["table"][0] == list(columns)
