"""What a study's reference claims, and what of it holds here. Without a `[reference]` nothing of this is written."""

from __future__ import annotations

from collections.abc import Iterator

from ..study.study import OWN, Contrast, Study
from .study_summary import BASELINES
from .wording import Record, beside, interval, named, sign, table

SHOWN_READINGS = 8


def claims(study: Study, summary: Record) -> Iterator[str]:
    """Say which of the reference's claims hold, and under which readings of what it leaves open."""
    reference = study.reference
    if reference is None:
        return
    yield f"## Which of the claims of {reference.name} hold"
    rows = []
    for key, published in reference.headline:
        for instance, found in summary["headline"]["instances"].items():
            if key in found:
                verdict = {"yes": "holds", "not shown": "is not shown"}.get(sign(found[key]), "does not hold")
                claim = f"saves {named(key)} ({published:g} %)"
                rows.append([claim, instance, f"{verdict}; {beside(found[key], published)}", interval(found[key])])
    for r in summary["decline"] if reference.declines else ():
        if r["population"] == summary["headline"]["population"]:
            verdict = {"yes": "holds", "not shown": "is not shown"}.get(sign(r), "the contrary holds")
            claim = f"saves fewer {r['measure']} against {r['against']} in large teams"
            rows.append([claim, r["instance"], verdict, interval(r)])
    if rows:
        yield table([f"claim: {study.focus} ...", "instance", "verdict", "percent, or percentage points"], rows)
    for contrast in study.contrasts:
        if contrast.name in reference.contrasts:
            yield from _of_contrast(contrast, summary)


def _of_contrast(contrast: Contrast, summary: Record) -> Iterator[str]:
    readings: dict[str, list[str]] = {"yes": [], "not shown": [], "no, the contrary": []}
    for c in summary["contrasts"]:
        if c["contrast"] == contrast.name and c["policy"] not in BASELINES:
            name = ", ".join([c["instance"], c["policy"], c["setting"] or "default", f"prior {prior(c['prior'])}"])
            if name not in readings[sign(c, 1.0)]:
                readings[sign(c, 1.0)].append(name)
    if any(readings.values()):
        more, fewer = (" and ".join(f"*{name}*" for name in side) for side in (contrast.of, contrast.to))
        yield (
            f"More interventions for {more} than for {fewer}: shown under {len(readings['yes'])} readings, undecided "
            f"under {len(readings['not shown'])}, the contrary under {len(readings['no, the contrary'])}. Shown under: "
            f"{'; '.join(readings['yes']) or 'none'}."
        )


def prior(name: str) -> str:
    """Say what the robot takes people to be."""
    return "the kind itself" if name == OWN else name


def readings(study: Study, summary: Record) -> Iterator[str]:
    """Show which reading of what the reference leaves open comes nearest to its interventions."""
    found, reference = summary["readings"], study.reference
    if not found or reference is None:
        return
    targets = reference.interventions
    yield f"## Which reading comes nearest to the interventions of {reference.name}"
    yield (
        f"{reference.source} says that "
        + "; ".join(f"{' and '.join(f'*{name}*' for name in names)} got {mean:g}" for names, mean in targets)
        + f". How they are counted is read in several ways, as is what the conditions vary. Of {len(found)} readings "
        f"these {min(SHOWN_READINGS, len(found))} come nearest (all are in `summary.json`); *off* is by how many "
        "interventions the means miss those, on average."
    )
    head = [
        "policy", "setting", "robot's prior", "instance", "counted", *(f"published {m:g}" for _, m in targets), "off",
    ]  # fmt: skip

    def row(r: Record) -> list[object]:
        return [
            r["policy"], r["setting"] or "default", prior(r["prior"]), r["instance"], r["counted"],
            *(interval(estimate) for estimate in r["interventions"]), f"{r['off']:.1f}",
        ]  # fmt: skip

    yield table(head, map(row, found[:SHOWN_READINGS]))
    default = [r for r in found if r["setting"] == "" and r["policy"] == study.focus and r["prior"] != OWN]
    if default:
        yield "Under the study's own setting, the robot's prior not being the kind itself:"
        yield table(head, map(row, default))
