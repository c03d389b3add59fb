"""What the tests take and what they show, beside what they did before they were looked at as a whole.

python bench/suite.py LOG [--record FILE]     LOG: what `make test` printed
"""

from __future__ import annotations

import re
from pathlib import Path

import click
from tables import Columns, cell, read_record, record_option, write_record

COLUMNS: Columns = {"": cell("what"), "before": cell("before"), "now": cell("now")}


@click.command()
@click.argument("log", type=click.Path(path_type=Path, dir_okay=False))
@record_option
def main(log: Path, record: Path | None) -> None:
    """Put the figures of `make test` beside those of the records of coverage and mutants."""
    closing = re.findall(r"^(?:.* )?(\d+) passed.* in ([\d.]+)s", log.read_text(encoding="utf-8"), re.M)
    if not closing:
        raise click.UsageError(f"{log}: pytest's closing line is missing; expected what `make test` printed")
    tests, seconds = closing[-1]
    mutants = read_record("mutants")["table"][1:]
    run, killed = (sum(int(row[column].replace(",", "")) for row in mutants) for column in (2, 3))
    *_, (_, _, lines, _, branches) = read_record("coverage")["table"]
    # `before` is what commits had: 35821d3 (tests, and their time), 869b1d4 (coverage), 5862e96 (mutants).
    rows = [
        {"what": "`make test`, minutes on two cores", "before": "8", "now": f"{float(seconds) / 60:.1f}"},
        {"what": "tests in it", "before": "1,788", "now": f"{int(tests):,}"},
        {"what": "lines run", "before": "97.0 %", "now": lines},
        {"what": "branches taken", "before": "91.2 %", "now": branches},
        {"what": "mutants killed", "before": "81 % of 285", "now": f"{100 * killed / run:.0f} % of {run:,}"},
    ]
    for row in rows:
        print(*row.values(), sep="  ")
    write_record(record, COLUMNS, rows, commands=["make test >LOG 2>&1", "python bench/suite.py LOG"])


if __name__ == "__main__":
    main()
