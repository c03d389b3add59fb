"""Tables of estimates, and notes on them."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table

from ...learning.fit import FittedPeople
from ...learning.log import in_order
from ...learning.population import PopulationFit


def table_of(people: FittedPeople) -> Table:
    """Return a table of the estimates of every person in the log, with intervals."""
    table = Table(box=None, pad_edge=False)
    table.add_column("person")
    for name in ("beta", "theta", "eta", "actions", "suboptimal", "log-likelihood", "check p"):
        table.add_column(name, justify="right")
    if any(record.misconception is not None for record in people.values()):
        table.add_column("sigma", justify="right")
    terms = list(next((record.weights for record in people.values()), {}))
    for name in terms:
        table.add_column(name, justify="right")
    for name in _everybody(people):
        if name not in people:
            table.add_row(name, *["-"] * (7 + len(terms)))
            continue
        record = people[name]
        every, m = record.estimates, record.misconception
        cells = [
            "-" if name not in every else _interval(value, every[name].interval, every[name].open_above)
            for name, value in (("beta", record.beta), ("theta", record.theta), ("eta", record.eta))
        ]
        cells += [f"{record.actions}", f"{record.suboptimal_actions}", f"{record.log_likelihood:.2f}"]
        cells.append("-" if record.check.p is None else f"{record.check.p:.3f}")
        if m is not None:
            cells.append(_interval(m.sigma, m.interval, m.open_above))
        cells += [_interval(one.value, one.interval, one.open_above) for one in (every[name] for name in terms)]
        table.add_row(name, *cells)
    return table


def lines_of(people: FittedPeople, found: PopulationFit | None) -> Iterable[str]:
    """Return notes on each person's estimates, followed by the distribution over people if it is known."""
    for name in _everybody(people):
        notes = people[name].notes if name in people else [people.unknown[name]["error"]]
        yield from (f"{name}: {note}" for note in notes)
    if found is None:
        return
    whose = f"population of {found.people}"
    for name, margin in (("beta", found.beta), ("theta", found.theta)):
        if margin is not None:
            spread = f"mean {margin.mean:.2f}, standard deviation {margin.spread:.2f}"
            yield f"{whose}: {name} is {margin.family}, {spread}"
    for name, (mean, deviation) in found.weights.items():
        yield f"{whose}: the weight of {name} is normal, mean {mean:.2f}, standard deviation {deviation:.2f}"
    if found.eta is not None:
        yield f"{whose}: eta {found.eta:.2f}"


def _everybody(people: FittedPeople) -> list[str]:
    return sorted([*people, *people.unknown], key=in_order)


def _interval(value: float | None, interval: tuple[float, float], open_above: bool) -> str:
    shown = "?" if value is None else f"{value:.2f}"
    return f"{shown} ({interval[0]:.2f} to {interval[1]:.2f}{'+' if open_above else ''})"
