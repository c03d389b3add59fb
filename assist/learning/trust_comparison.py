"""Comparison of trust rules by how well they predict held-out people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from .fit import LogError
from .likelihood import Method
from .observations import Observations
from .rule_families import RuleFamily, families, parameters_of
from .rule_search import RuleSearch
from .trust_log import TrustLog
from .trust_scores import REFERENCE, TrustComparison


def compare_trust(
    observations: Sequence[Observations],
    method: Method | None = None,
    *,
    rules: Mapping[str, RuleFamily] | None = None,
    folds: int = 8,
    carry: bool = True,
    progress: Callable[[int], None] | None = None,
) -> TrustComparison:
    """Return a comparison of trust rules by the log probability of the choices of held-out people.

    The parameters of each rule and its population are fitted to the people of the other folds.

    Parameters
    ----------
    observations, method, carry
        As for `fit_influence`.
    rules : mapping of str to RuleFamily, optional
        The rules; "constant" is among them. The shipped ones unless given.
    folds : int
        Groups of people that are left out in turn.
    progress : callable, optional
        Called with how many rules have been finished since the last call.

    Raises
    ------
    LogError
        Nothing was ever suggested, or there are fewer than two people.
    ValueError
        There are fewer than two folds, or "constant" is missing.
    """
    method = method or Method()
    if folds < 2:
        raise ValueError(f"folds {folds}: expected 2 or more")
    if len(observations) < 2:
        raise LogError("one person; a comparison needs two or more, to learn from some about others")
    rules = families(method) if rules is None else rules
    if REFERENCE not in rules:
        raise ValueError(f"rules {', '.join(rules)}: expected '{REFERENCE}' among them")
    log, found, estimates = TrustLog.of(observations, method), {}, {}
    people = len(log.people)
    fold = np.arange(people) % min(folds, people)
    for name, family in rules.items():
        every = RuleSearch(log, family, carry)
        best = every.best()
        _, population, _ = every.at(best)
        estimates[name] = parameters_of(family.rule(best)) | vars(population)
        found[name] = np.empty(people)
        for group in range(int(fold.max()) + 1):
            inside = fold == group
            others = RuleSearch(log.only(~inside), family, carry, population)
            values = others.best(best)
            logs = log.only(inside).log_likelihood(family.rule(values), carry=carry)
            found[name][inside] = others.at(values)[1].marginal(log, logs)
        if progress is not None:
            progress(1)
    return TrustComparison.of(found, log.counts, estimates, method.level)
