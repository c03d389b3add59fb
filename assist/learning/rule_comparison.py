"""Comparison of trust rules, on logs of planning tasks and on logs of judgements with advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from .advice_fit import COMPARED, base_of, fit_to, fold_of
from .advice_log import AdviceLog
from .advice_model import AdviceModel
from .comparison import FOLDS, Comparison, FitTo, compared, folds_of
from .evidence import Evidence, observations_of
from .influence_population import InfluencePopulation
from .likelihood import Method
from .likelihood_table import LikelihoodTable
from .observations import Observations
from .rule_families import RuleFamily, families, parameters_of
from .rule_search import RuleSearch

REFERENCE = "constant"

Rules: TypeAlias = Mapping[str, Any]
"""Rules by name: a `RuleFamily` each or, of advice, a `Rule` or None."""


@shows_progress
def compare_rules(
    people: Evidence | Sequence[Observations] | AdviceLog, method: Method | None = None, *,
    rules: Rules | None = None, reference: str = REFERENCE, folds: int = FOLDS, carry: bool = True,
    time_limit: float | None = None, progress: Wanted = None,
) -> Comparison:  # fmt: skip
    """Return a comparison of trust rules by the log probability of the choices of held-out people.

    The parameters of each rule and its population are fitted to the people of the other folds.

    Parameters
    ----------
    people : Evidence, sequence of Observations, or AdviceLog
        A log that was replayed, or observations, as for `fit_influence`; or judgements with advice.
    method : Method, optional
        As for `fit_influence`; of advice, only the level of the intervals is used.
    rules : mapping of str to RuleFamily, or to Rule or None
        The rules; the reference is among them. Those of `families` unless given. Of advice, those of `COMPARED`; None
        stands for base rates.
    reference : str
        The rule with which the others are compared.
    folds : int
        Groups of people that are left out in turn.
    carry : bool
        As for `fit_influence`.
    time_limit : float, optional
        Seconds after which no further model is begun; those without a result are in `Comparison.left_out`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of rules that have been compared.

    Raises
    ------
    InputFileError
        Nothing was ever suggested, or there are fewer than two people.
    ValueError
        There are fewer than two folds, or the reference is missing, or the likelihood is not finite.
    """
    assert callable(progress)
    method = method or Method()
    people = people if isinstance(people, AdviceLog) else observations_of(people)
    if rules is None:
        usual: Rules = COMPARED if isinstance(people, AdviceLog) else families(method)
        rules = usual
    fits: dict[str, FitTo[Any]]
    if reference not in rules:
        raise ValueError(f"rules {', '.join(rules)}: expected '{reference}' among them")
    if isinstance(people, AdviceLog):
        names, choices = tuple(people.people), people.counts
        folds_of(len(names), folds)
        fold = fold_of(names, folds)
        base = base_of(people)
        starts = {name: None if rule is None else AdviceModel.of(base, rule) for name, rule in rules.items()}
        fits = {name: partial(fit_to, people, start) for name, start in starts.items()}
    else:
        fold = folds_of(len(people), folds)
        log = LikelihoodTable.of_advised(people, method, carry=carry)
        names, choices = log.people, log.counts
        fits = {name: partial(_fit_to, log, family, carry) for name, family in rules.items()}
    return compared(
        fits, names, choices, reference, fold=fold, level=method.level, time_limit=time_limit,
        progress=adding(progress, "comparing trust rules", len(fits)),
    )  # fmt: skip


@dataclass(frozen=True)
class FittedRule:
    """A rule with its population, fitted to some people of a log."""

    log: LikelihoodTable
    family: RuleFamily
    carry: bool
    values: tuple[float, ...]
    population: InfluencePopulation

    @property
    def parameters(self) -> dict[str, float]:
        """Those of the rule and of the population."""
        return parameters_of(self.family.rule(self.values)) | vars(self.population)

    def log_probability(self, people: NDArray[np.bool_]) -> Floats:
        """Return the log probability of all that each of some people chose; `people` has shape (K,)."""
        some = self.log.only(people)
        return self.population.marginal(some, some.log_likelihood(self.family.rule(self.values), carry=self.carry))


def _fit_to(
    log: LikelihoodTable, family: RuleFamily, carry: bool, people: NDArray[np.bool_], fits: Sequence[FittedRule]
) -> FittedRule:
    search = RuleSearch(log.only(people), family, carry, fits[0].population if fits else None)
    values = search.best(fits[0].values if fits else None)
    return FittedRule(log, family, carry, values, search.fitted(values)[0])
