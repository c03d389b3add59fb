"""The trust rule of a population file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from ...declare.options import Given
from ...person.settings import Setting
from ..terminal.console import note
from .settings import record_of

S = TypeVar("S", bound=Setting)

RATES = ("eta", "utility_scale")
"""Fields of a setting for equation 7 alone."""


def chosen_setting(kind: type[S], setting: Setting, given: Given[Any], *, rate: bool) -> S:
    """Return the fields of a class from a command's setting, with the trust rule of a population file if it has one.

    With `rate`, a file without a rule gives the rate of equation 7 that was estimated, unless it is set. That is for
    simulated people, as theta of real people stays unless a rule is given.

    Raises
    ------
    click.UsageError
        The file has a trust rule, and so has the setting; or a rate is set that the trust rule does not have.
    """
    chosen = kind.of(setting)
    file = given.values.get("population")
    if chosen.trust not in (None, "paper"):
        given.refuse(RATES, f"with trust {given.values['trust']!r}")
    if not isinstance(file, str):
        return chosen
    from ...learning import distribution as populations
    from ...people.trust_rules import EquationSeven

    try:
        rule, estimated = populations.trust_of(record := record_of(Path(file))), populations.rate_of(record)
        unknown = populations.unidentified_of(record)
    except ValueError as error:
        raise click.UsageError(f"--population {file}: {error}") from None
    own = any(name in given for name in RATES)
    if rule is None:
        fits = rate and not own and chosen.trust is None
        return replace(chosen, **estimated) if fits else chosen  # type: ignore[arg-type]
    for name in ("trust", *RATES):
        if name in given:
            raise click.UsageError(f"--population {file} also sets {name}; expected one of them")
    for name, value in unknown.items():
        says_nothing = f"its log says nothing about {name} of the trust rule"
        note(f"--population {file}: {says_nothing}; {value:g} is one of many values")
    if isinstance(rule, EquationSeven):
        return replace(chosen, trust="paper", eta=rule.eta, utility_scale=rule.utility_scale)
    return replace(chosen, trust=rule)
