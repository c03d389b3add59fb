"""The claims of a study's `[reference]`, and whether they hold here."""

from __future__ import annotations

from collections.abc import Iterator

from ..study.study import OWN, Contrast, Study
from .study_summary import BASELINES
from .wording import Record, beside, interval, named, sign, table


def claims(study: Study, summary: Record) -> Iterator[str]:
    """Yield a table of the reference's claims with verdicts, and the interpretations under which contrasts hold."""
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
            verdict = {"yes": "holds", "not shown": "is not shown"}.get(sign(r), "the opposite holds")
            claim = f"saves fewer {r['measure']} against {r['against']} in large teams"
            rows.append([claim, r["instance"], verdict, interval(r)])
    if rows:
        yield table([f"claim: {study.focus} ...", "instance", "verdict", "percent, or percentage points"], rows)
    for contrast in study.contrasts:
        if contrast.name in reference.contrasts:
            yield from _of_contrast(contrast, summary)


def _of_contrast(contrast: Contrast, summary: Record) -> Iterator[str]:
    readings: dict[str, list[str]] = {"yes": [], "not shown": [], "no, the opposite": []}
    for c in summary["contrasts"]:
        if c["contrast"] == contrast.name and c["policy"] not in BASELINES:
            name = ", ".join([c["instance"], c["policy"], c["setting"] or "default", f"prior {prior(c['prior'])}"])
            if name not in readings[sign(c, 1.0)]:
                readings[sign(c, 1.0)].append(name)
    if any(readings.values()):
        more, fewer = (" and ".join(f"*{name}*" for name in side) for side in (contrast.of, contrast.to))
        yield (
            f"More interventions for {more} than for {fewer}: shown under {len(readings['yes'])} interpretations, "
            f"undecided under {len(readings['not shown'])}, the opposite under {len(readings['no, the opposite'])}. "
            f"Shown under: {'; '.join(readings['yes']) or 'none'}."
        )


def prior(name: str) -> str:
    """Return the description of the robot's prior."""
    return "its population" if name == OWN else name


def readings(study: Study, summary: Record) -> Iterator[str]:
    """Yield the interpretations of unspecified details that fit the reference's interventions best."""
    found, reference = summary["readings"], study.reference
    if not found or reference is None:
        return
    targets, shown = reference.interventions, found[:8]
    yield f"## Which interpretation fits the interventions of {reference.name} best"
    yield (
        f"{reference.source} reports that "
        + "; ".join(f"{' and '.join(f'*{name}*' for name in names)} got {mean:g}" for names, mean in targets)
        + f". It leaves open how they are counted, and some settings. Of {len(found)} interpretations, "
        f"these {len(shown)} fit best (all are in `summary.json`). *Off* is the mean absolute "
        "difference in interventions."
    )
    head = [
        "policy", "setting", "robot's prior", "instance", "counted", *(f"published {m:g}" for _, m in targets), "off",
    ]  # fmt: skip

    def row(r: Record) -> list[object]:
        return [
            r["policy"], r["setting"] or "default", prior(r["prior"]), r["instance"], r["counted"],
            *(interval(estimate) for estimate in r["interventions"]), f"{r['off']:.1f}",
        ]  # fmt: skip

    yield table(head, map(row, shown))
    default = [r for r in found if r["setting"] == "" and r["policy"] == study.focus and r["prior"] != OWN]
    if default:
        yield "With the study's own setting and a prior other than the population:"
        yield table(head, map(row, default))
