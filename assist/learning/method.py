"""The options of an estimation."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..declare.declared import Number, Seed, declared
from ..people.neighbours import Watched

LARGE = 1e9
"""Squares and products of smaller parameters stay within floating-point range."""


@declared
class Method:
    """Options of the estimation.

    Unless given, `largest_beta` is the beta at which the smallest possible mistake has odds of exp(-10), or 5 in
    100,000. This is below the lapse rate, so that data cannot distinguish larger values.
    """

    level: Annotated[Number, Field(gt=0, lt=1, description="Confidence level of the intervals.")] = 0.95
    lapse: Annotated[
        Number, Field(gt=0, lt=1, description="Weight of a uniform choice, so that no action has probability zero.")
    ] = 1e-3
    utility_scale: Annotated[
        Number, Field(ge=1 / LARGE, le=LARGE, description="Unit of value in the trust update, in cost units.")
    ] = 1.0
    eta: Annotated[
        Number | None,
        Field(ge=0, le=LARGE, description="Rate of the trust update (equation 7); estimated in [0, 1] unless given."),
    ] = None
    largest_beta: Annotated[
        Number | None,
        Field(ge=1 / LARGE, le=LARGE, description="Upper end of estimates and intervals of expertise (beta)."),
    ] = None
    largest_sigma: Annotated[
        Number,
        Field(
            ge=1 / LARGE,
            le=LARGE,
            description="Upper end of the search for sigma, in units of the smallest mistake that was possible.",
        ),
    ] = 5.0
    misconception_memory_mb: Annotated[
        Number, Field(gt=0, description="Largest memory of one person's misconceptions, in MB.")
    ] = 500.0
    neighbours: Watched = None
    seed: Annotated[Seed, Field(description="Random seed of the model check.")] = 0
