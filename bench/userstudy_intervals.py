"""Coverage of the intervals in the report of a user study, and the family-wise error of its confirmatory tests.

    python bench/userstudy_intervals.py [--studies N] [--people N] [--record FILE]

Studies with three conditions are simulated and summarised as in the report. People differ in level, and in designs
within participants they are faster by 1.5 actions in each period. Some do not finish. One condition has a larger
variance, unless variances are equal. Seconds are skewed (a gamma distribution). Intervals have to contain the true
differences of each condition; without any differences, no test of actions and answers from 1 to 7 has to be
significant.
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
FINISHING = {"none": 0.7, "a": 0.5, "b": 0.8}
"""Probability of finishing in each condition."""
CASES = {"between": "between", "within": "within", "within, equal variances": "within"}


def _study(folder: Path, design: str) -> UserStudy:
    tiny = Path(__file__).parents[1] / "domains" / "kitting" / "tiny.pddl"
    conditions = "".join(f'[[conditions]]\nname = "{name}"\npolicy = "priority"\n' for name in EFFECTS)
    file = folder / f"{design}.toml"
    file.write_text(STUDY.format(tiny=tiny, design=design) + conditions, encoding="utf-8")
    return read(file)


def _simulated(
    study: UserStudy, people: int, effects: dict[str, float], rng: np.random.Generator, *, equal: bool
) -> Tables:
    """Return the tables of a study in which conditions have these effects, and perhaps equal variances."""
    found = Tables()
    assigned = rng.permutation([list(study.orders)[number % len(study.orders)] for number in range(people)])
    for number, name in enumerate(map(str, assigned)):
        who, own = f"P{number}", rng.normal(0, 3)
        found.participants.append(dict.fromkeys(COLUMNS["participants"]) | {
            "participant": who, "simulated": False, "status": "done", "stage": "thanks", "condition": name,
            "failed_checks": 0,
        })  # fmt: skip
        for period, condition in enumerate(study.orders[name], start=1):
            spread = 2.0 if equal or condition != "a" else 5.0
            mean = 20 + own + effects[condition] - 1.5 * period
            where = {"participant": who, "condition": condition, "period": period}
            found.tasks.append(where | {
                "task": "tiny", "position": 1, "finished": bool(rng.random() < FINISHING[condition]),
                "actions": mean + rng.normal(0, spread), "optimal_cost": 6.0, "suboptimal_actions": 0,
                "suggestions": 0, "followed": 0,
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
@click.option("--people", type=click.IntRange(min=6), default=36, show_default=True, help="Participants of a study.")
@record_option
def main(studies: int, people: int, record: Path | None) -> None:
    """Print the coverage of each kind of interval and the family-wise error."""
    held, all_, wrong = Counter[tuple[str, str, str]](), Counter[tuple[str, str, str]](), Counter[str]()
    true = {name: 100 * (share - FINISHING["none"]) for name, share in FINISHING.items()}
    with tempfile.TemporaryDirectory() as folder:
        for case, design in CASES.items():
            study, rng = _study(Path(folder), design), np.random.default_rng(1)
            equal = "equal" in case
            for _ in range(studies):
                found = _differences(study, _simulated(study, people, EFFECTS, rng, equal=equal))
                for (measure, condition), one in found.items():
                    for kind, given in (("", one), (", mixed model", one.get("mixed_model"))):
                        if measure in ("actions", "seconds", "completion") and given and given["low"] is not None:
                            key, difference = (case + kind, measure, condition), EFFECTS[condition]
                            all_[key] += 1
                            low, high = given["low"], given["high"]
                            held[key] += low <= (true[condition] if measure == "completion" else difference) <= high
                null = _differences(study, _simulated(study, people, dict.fromkeys(EFFECTS, 0.0), rng, equal=equal))
                tests = [one["p_holm"] for one in null.values() if one.get("p_holm") is not None]
                wrong[case] += any(p < 0.05 for p in tests)
    rows = []
    for kind, measure in dict.fromkeys((kind, measure) for kind, measure, _ in all_):
        counts = [(held[key], n) for key, n in all_.items() if key[:2] == (kind, measure)]
        shares = [f"{100 * count / n:.1f}" for count, n in counts]
        what = f"{kind}, {measure}: intervals that hold the truth, of each condition"
        rows.append({"what": what, "share": ", ".join(shares), "n": min(n for _, n in counts)})
    rows += [
        {"what": f"{case}, actions and trust: studies with an error", "share": f"{100 * n / studies:.1f}", "n": studies}
        for case, n in wrong.items()
    ]
    columns: Columns = {"what is counted": cell("what"), "%": cell("share"), "of": cell("n", ",")}
    for row in rows:
        click.echo("  ".join(show(row) for show in columns.values()))
    write_record(record, columns, rows)


if __name__ == "__main__":
    main()
