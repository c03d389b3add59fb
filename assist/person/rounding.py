"""The margin by which computed bounds are moved outwards, so that they hold in spite of rounding.

Claim. Let a sum of N terms of one sign be computed in double precision, each term by at most 20 operations without a
difference, in any order. Then its relative error is below (N + 20) u / (1 - (N + 20) u), where u = 2**-53 is the unit
roundoff (Higham, "Accuracy and stability of numerical algorithms", 2002, lemma 3.1 and section 4.2). The code computes
some sums as a difference, but only where the result is at least a tenth of the minuend. Its error is then ten times
larger, at most. So the error is below 10 (N + 20) u, up to a relative 1e-9 for fewer than a million terms.

The chances of choices are weights exp(-beta (Q - least)), whose exponent has a difference. People of the model choose
by the exponents as they are computed, to the last bit. So these have no error: only weights and their sums do. Whoever
computes a chance again, such as `compliance_relaxation`, does so by the operations of `decision.choice`: Q is the sum
of a cost and a perceived cost-to-go, `least` is the smallest Q, and their difference is multiplied by -beta. No
operation is exchanged or fused, so that the exponents are the same.

`rounding(N)` is 1e-12 up to 800 terms, which is above 10 (800 + 20) u = 9.1e-13. Beyond, it grows in proportion.
"""

from __future__ import annotations

from planner.system.jit import njit

ROUNDING = 1e-12
"""Relative margin of a computed bound that sums up to `TERMS` terms."""

TERMS = 800
"""The largest number of terms for which `ROUNDING` is enough."""


def rounding(terms: int) -> float:
    """Return the relative margin of a computed bound, given the number of terms of its largest sum."""
    return ROUNDING * max(1.0, terms / TERMS)


compiled = njit()(rounding)
"""`rounding` for compiled code."""
