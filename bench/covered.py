"""Coverage of lines and branches by the tests, by folder, from the data of coverage.py.

make coverage && python bench/covered.py [--data FILE] [--record FILE]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import click
from tables import ROOT, Columns, record_option, write_record

COUNTS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def share(row: dict[str, float], have: str, of: str) -> str:
    return f"{100 * row[have] / row[of]:.1f} %"


COLUMNS: Columns = {
    "folder": lambda row: f"`{row['folder']}`" if "/" in str(row["folder"]) else str(row["folder"]),
    "lines": lambda row: f"{row['num_statements']:,}",
    "of these run": lambda row: share(row, "covered_lines", "num_statements"),
    "branches": lambda row: f"{row['num_branches']:,}",
    "of these taken": lambda row: share(row, "covered_branches", "num_branches"),
}


@click.command()
@click.option("--data", default=ROOT / ".coverage" / "data", show_default=True, help="Data file of `make coverage`.")
@record_option
def main(data: Path, record: Path | None) -> None:
    """Print the shares of covered lines and branches by folder."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "report.json"
        command = [sys.executable, "-m", "coverage", "json", "--quiet", "-o", str(out), "--data-file", str(data)]
        subprocess.run(command, check=True, cwd=ROOT)
        files = json.loads(out.read_text())["files"]
    found: dict[str, dict[str, float]] = defaultdict(lambda: dict.fromkeys(COUNTS, 0))
    for name, file in sorted(files.items(), key=lambda pair: not pair[0].startswith("planner")):
        parts = Path(name).parts
        own = "planner/" if parts[0] == "planner" else "/".join(parts[:2]) + "/"
        for folder_name in ("all", own) if len(parts) > 2 or parts[0] == "planner" else ("all",):
            for count in COUNTS:
                found[folder_name][count] += file["summary"][count]
    rows = [{"folder": name, **row} for name, row in found.items() if name != "all"]
    rows.append({"folder": "all", **found["all"]})
    for row in rows:
        print(*(show(row) for show in COLUMNS.values()), sep="  ")
    write_record(record, COLUMNS, rows, commands=["make coverage", "python bench/covered.py"])


if __name__ == "__main__":
    main()
