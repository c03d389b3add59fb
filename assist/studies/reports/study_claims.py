"""The claims of a study's `[reference]`, and whether they hold here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from planner.system.results import markdown_table

from ...team.policy_names import BASELINES
from ..study import Contrast, Study
from .wording import Record, beside, interval, named, prior, sign


def claims(study: Study, summary: Record) -> str:
    """Return the table of the reference's claims with verdicts; empty without claims."""
    reference = study.reference
    if reference is None:
        return ""
    rows = []
    for key, published in reference.headline.items():
        for instance, found in summary["headline"]["instances"].items():
            if key in found:
                verdict = {"yes": "holds", "not shown": "is not shown"}.get(sign(found[key]), "does not hold")
                claim = f"saves {named(key)} ({published:g} %)"
                rows.append([claim, instance, f"{verdict}; {beside(found[key], published)}", interval(found[key])])
    for r in summary["decline"] if reference.declines else ():
        if r["population"] == summary["headline"]["population"]:
            verdict = {"yes": "holds", "not shown": "is not shown"}.get(sign(r), "the opposite holds")
            claim = f"saves fewer {r['measure']} against {r['against']} in large teams"
            rows.append([claim, r["instance"], verdict, interval(r)])
    head = [f"claim: {study.focus} ...", "instance", "verdict", "percent, or percentage points"]
    return markdown_table(head, rows) if rows else ""


def contrasts(study: Study, summary: Record) -> Iterator[tuple[Contrast, dict[str, list[str]]]]:
    """Yield the contrasts that the reference claims, with the interpretations under which each holds or does not."""
    for contrast in study.contrasts:
        if study.reference is None or contrast.name not in study.reference.contrasts:
            continue
        found: dict[str, list[str]] = {"yes": [], "not shown": [], "no, the opposite": []}
        for c in summary["contrasts"]:
            if c["contrast"] == contrast.name and c["policy"] not in BASELINES:
                name = ", ".join([c["instance"], c["policy"], c["setting"] or "default", f"prior {prior(c['prior'])}"])
                if name not in found[sign(c, 1.0)]:
                    found[sign(c, 1.0)].append(name)
        if any(found.values()):
            yield contrast, found


def readings(study: Study, found: Sequence[Record]) -> str:
    """Return a table of interpretations of unspecified details, compared with the reference."""
    targets = study.reference.interventions if study.reference else ()
    head = [
        "policy", "setting", "robot's prior", "instance", "counted",
        *(f"published {one.mean:g}" for one in targets), "off",
    ]  # fmt: skip
    rows = [
        [
            r["policy"], r["setting"] or "default", prior(r["prior"]), r["instance"], r["counted"],
            *(interval(estimate) for estimate in r["interventions"]), f"{r['off']:.1f}",
        ]
        for r in found
    ]  # fmt: skip
    return markdown_table(head, rows)
