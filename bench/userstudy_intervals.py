"""Coverage of the intervals in the report of a user study, and the family-wise error of its confirmatory tests.

    python bench/userstudy_intervals.py [--studies N] [--people N] [--record FILE]

Studies with three conditions are simulated and summarised as in the report. People differ in level. In designs within
participants they are faster by 1.5 actions in each period, and every fifth attempt is missing; in designs between them,
conditions have different variances. The last measure is skewed (a gamma distribution) or, for tests, an answer from 1
to 7. Intervals have to contain the true differences; without any differences, no test has to be significant.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import click
import numpy as np
from tables import Columns, cell, record_option, write_record

from assist.reports.userstudy_summary import _adjusted, _measure, measures
from assist.userstudy.plan import UserStudy
from assist.userstudy.plan_file import read
from assist.userstudy.tables import COLUMNS, Tables

STUDY = """title = "Simulated"
tasks = ["{tiny}"]
consent = "."
instructions = "."
reference = "none"
confirmatory = ["actions", "trust"]
design = "{design}"
[[questionnaires]]
form = "likert"
name = "trust"
items = [{{ name = "rely", text = "." }}]
"""
EFFECTS = {"none": 0.0, "a": -2.0, "b": 1.0}
"""Differences of the conditions' mean actions and seconds from the reference."""


def _study(folder: Path, design: str) -> UserStudy:
    tiny = Path(__file__).parents[1] / "domains" / "kitting" / "tiny.pddl"
    conditions = "".join(f'[[conditions]]\nname = "{name}"\npolicy = "priority"\n' for name in EFFECTS)
    file = folder / f"{design}.toml"
    file.write_text(STUDY.format(tiny=tiny, design=design) + conditions, encoding="utf-8")
    return read(file)


def _simulated(study: UserStudy, people: int, effects: dict[str, float], rng: np.random.Generator) -> Tables:
    """Return the tables of a study in which conditions have these effects."""
    found = Tables()
    assigned = rng.permutation([list(study.orders)[number % len(study.orders)] for number in range(people)])
    for number, name in enumerate(map(str, assigned)):
        who, own = f"P{number}", rng.normal(0, 3)
        found.participants.append(dict.fromkeys(COLUMNS["participants"]) | {
            "participant": who, "simulated": False, "status": "done", "stage": "thanks", "condition": name,
            "failed_checks": 0,
        })  # fmt: skip
        for period, condition in enumerate(study.orders[name], start=1):
            if study.is_within and rng.random() < 0.2:
                continue
            spread = 2.0 if study.is_within or condition != "a" else 5.0
            mean = 20 + own + effects[condition] - 1.5 * period
            where = {"participant": who, "condition": condition, "period": period}
            found.tasks.append(where | {
                "task": "tiny", "position": 1, "finished": True, "actions": mean + rng.normal(0, spread),
                "optimal_cost": 6.0, "suboptimal_actions": 0, "suggestions": 0, "followed": 0,
                "seconds": mean + rng.gamma(2.0, spread / 2**0.5) - 2**0.5 * spread,
            })  # fmt: skip
            answer = int(np.clip(round(4 + own / 3 - effects[condition] / 4 + rng.normal(0, 1)), 1, 7))
            found.answers.append(dict.fromkeys(COLUMNS["answers"]) | where | {
                "questionnaire": "trust", "item": "rely", "answer": answer, "score": answer,
            })  # fmt: skip
    return found


def _differences(study: UserStudy, tables: Tables) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the report's comparisons by measure and condition."""
    rows = _adjusted(study, [_measure(study, one, tables) for one in measures(study, tables)])
    return {(row["measure"], one["condition"]): one for row in rows for one in row["differences"]}


@click.command()
@click.option("--studies", type=click.IntRange(min=1), default=1000, show_default=True)
@click.option("--people", type=click.IntRange(min=6), default=24, show_default=True, help="Participants of a study.")
@record_option
def main(studies: int, people: int, record: Path | None) -> None:
    """Print the coverage of each kind of interval and the family-wise error."""
    held, all_, wrong = Counter[tuple[str, str]](), Counter[tuple[str, str]](), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for design in ("between", "within"):
            study, rng = _study(Path(folder), design), np.random.default_rng(1)
            for _ in range(studies):
                found = _differences(study, _simulated(study, people, EFFECTS, rng))
                for (measure, condition), one in found.items():
                    for kind in ("", "by_period", "mixed_model"):
                        given = one if not kind else one.get(kind)
                        if measure in ("actions", "seconds") and given is not None:
                            key = f"{design}, {kind or 'difference'}", measure
                            all_[key] += 1
                            held[key] += given["low"] <= EFFECTS[condition] <= given["high"]
                null = _differences(study, _simulated(study, people, dict.fromkeys(EFFECTS, 0.0), rng))
                tests = [one["p_holm"] for one in null.values() if one.get("p_holm") is not None]
                wrong[design] += any(p < 0.05 for p in tests)
    rows = [
        {"what": f"{kind}, {measure}: intervals that hold the truth", "share": 100 * held[kind, measure] / n, "n": n}
        for (kind, measure), n in all_.items()
    ]  # fmt: skip
    rows += [
        {"what": f"{design}, actions and trust: studies with an error", "share": 100 * count / studies, "n": studies}
        for design, count in wrong.items()
    ]
    columns: Columns = {"what is counted": cell("what"), "%": cell("share", ".1f"), "of": cell("n", ",")}
    for row in rows:
        click.echo("  ".join(show(row) for show in columns.values()))
    write_record(record, columns, rows)


if __name__ == "__main__":
    main()
