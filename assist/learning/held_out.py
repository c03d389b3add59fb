"""Comparisons of choice models and of trust rules, on people to whom they were not fitted.

`compare_models` compares cost alone (`boltzmann`), cost and one term, and cost and all terms; a model's parameters are
those of largest likelihood for people together. `compare_rules` compares trust rules, on logs of planning tasks and on
logs of judgements with advice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.system.progress import Wanted, adding, shows_progress

from ..people.decision import Floats
from ..people.terms import TERMS
from ..people.trust_rules import TrustRule
from .advice_fit import base_of, fit_model
from .advice_log import AdviceLog
from .advice_model import AdviceModel
from .advice_rules import DEFAULT_STEPS, OF_THE_PAPER, ONE_THETA, RULES, Rule
from .comparison import FOLDS, Comparison, Fitted, FitTo, Some, compared, folds_of
from .evidence import Evidence, is_carried, observations_of
from .hierarchy import pooled
from .likelihood import Method
from .likelihood_table import LikelihoodTable
from .logit_likelihood import Likelihood
from .neighbours_in_logs import seen_families
from .observations import Observations
from .rule_families import RuleFamily, families, family_of, name_of, parameters_of
from .trust_fit import RuleSearch

REFERENCE = "constant"

COMPARED: dict[str, Rule | None] = {
    "base rates": None, ONE_THETA.name: ONE_THETA, OF_THE_PAPER.name: OF_THE_PAPER, **RULES,
    DEFAULT_STEPS.name: DEFAULT_STEPS,
}  # fmt: skip
"""What is compared unless other rules are given: simpler predictions, and the shipped rules, as shipped and fitted.

Base rates are the shares of people who followed, at agreement and at disagreement; there is no rule.
"""

Rules: TypeAlias = Mapping[str, Any] | Iterable[Any]
"""Rules, by name or as a list; see `compare_rules`."""


@shows_progress
def compare_models(
    people: Evidence | Sequence[Observations], method: Method | None = None, *, folds: int = FOLDS,
    time_limit: float | None = None, progress: Wanted = None,
) -> Comparison:  # fmt: skip
    """Return a comparison of choice models by their predictions for people to whom they were not fitted.

    Parameters
    ----------
    people : Evidence, or sequence of Observations
        A log that was replayed, compared with all `TERMS`; or observations with terms, such as those of `observed(task,
        log, terms=TERMS)`, of one task or of several.
    method : Method, optional
    folds : int
        Number of groups of people, each of which is held out once.
    time_limit : float, optional
        Seconds after which no further model is begun; those without a result are in `Comparison.left_out`.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of models that have been compared.

    Raises
    ------
    InputFileError
        There are fewer than two people.
    """
    assert callable(progress)
    method = method or Method()
    known = method.eta is not None
    likelihood = Likelihood.of(observations_of(people, TERMS), method)
    person, terms = likelihood.steps.person, likelihood.terms

    def with_terms(chosen: Iterable[str]) -> FitTo:
        own = likelihood.with_terms(chosen)

        def fit_to(some: Some, fits: Sequence[Fitted]) -> Fitted:
            fitted, at = pooled(own, some[person], fits[-1].start if len(fits) > 1 else None, known=known)

            def log_probability(those: Some) -> Floats:
                of_steps = fitted.together(those[person]).log_probability(at)
                return np.bincount(person[those[person]], of_steps, len(those))[those].astype(np.float64)

            return Fitted(fitted.parameters(at[0]), log_probability, at)

        return fit_to

    sets: dict[str, tuple[str, ...]] = {"boltzmann": (), **{term: (term,) for term in terms}}
    sets |= {"terms": terms} if len(terms) > 1 else {}
    fits = {model: with_terms(chosen) for model, chosen in sets.items()}
    return compared(
        fits, likelihood.people, np.bincount(person), "boltzmann", fold=folds_of(len(likelihood.people), folds),
        level=method.level, time_limit=time_limit, progress=adding(progress, "comparing models", len(fits)),
    )  # fmt: skip


@shows_progress
def compare_rules(
    people: Evidence | Sequence[Observations] | AdviceLog, method: Method | None = None, *,
    rules: Rules | None = None, beside: str | TrustRule | None = None, folds: int = FOLDS, carry: bool | None = None,
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
    rules : mapping of str to rule, or sequence of rules, optional
        The rules, each as for `fit_influence`, by their names or as a list. The others are compared with "constant", or
        without it with the first. All shipped ones unless given. Of advice, a mapping as `COMPARED`, which it is unless
        given; None stands for base rates.
    beside : str or TrustRule, optional
        A rule of people's own: then rules by which theta also moves by what they see of neighbours are compared,
        beside this one.
    folds : int
        Groups of people that are left out in turn.
    carry : bool, optional
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
        There are fewer than two folds, or there is no such rule, or the likelihood is not finite.
    """
    assert callable(progress)
    method, carry = method or Method(), is_carried(people, carry)
    if beside is not None:
        if rules is not None:
            raise ValueError(f"beside '{beside}': expected no other rules")
        rules = seen_families(family_of(beside, method), method.neighbours)
    if isinstance(people, AdviceLog):
        names, choices = tuple(people.people), people.counts
        folds_of(len(names), folds)
        fold, base, of_advice = fold_of(names, folds), base_of(people), COMPARED if rules is None else rules
        if not isinstance(of_advice, Mapping):
            raise TypeError(f"rules: a {type(rules).__name__}; expected a mapping of names to rules of advice")
        fits = {name: _of_base_rates(people) if rule is None else _of_advice(people, base, rule)
                for name, rule in of_advice.items()}  # fmt: skip
    else:
        log = LikelihoodTable.of_advised(people, method, carry=carry)
        fold = folds_of(len(log.people), folds)
        names, choices = log.people, log.counts
        fits = {name: _of_family(log, family, carry) for name, family in _families(rules, method).items()}
    if not fits:
        raise ValueError("rules: expected at least one")
    reference = REFERENCE if REFERENCE in fits else next(iter(fits))
    return compared(
        fits, names, choices, reference, fold=fold, level=method.level, time_limit=time_limit,
        progress=adding(progress, "comparing trust rules", len(fits)),
    )  # fmt: skip


def _families(rules: Rules | None, method: Method) -> dict[str, RuleFamily]:
    """Return the families of some rules by their names; those of all shipped rules if none are given."""
    if rules is None:
        return families(method)
    if not isinstance(rules, Mapping):
        each = [rules] if isinstance(rules, str) else list(rules)
        named = {name_of(rule): rule for rule in each}
        if len(named) < len(each):
            raise ValueError("rules: two have one name; expected a mapping of names to rules")
        rules = named
    return {name: family_of(rule, method) for name, rule in rules.items()}


def _of_family(log: LikelihoodTable, family: RuleFamily, carry: bool) -> FitTo:
    """Return what fits the parameters of a rule, with the population."""

    def fit_to(some: Some, fits: Sequence[Fitted]) -> Fitted:
        values, near = fits[0].start if fits else (None, None)
        search = RuleSearch(log.only(some), family, carry, near)
        values = search.best(values)
        population, rule = search.fitted(values)[0], family.rule(values)

        def log_probability(those: Some) -> Floats:
            own = log.only(those)
            return population.marginal(own, own.log_likelihood(rule, carry=carry))

        return Fitted(parameters_of(rule) | vars(population), log_probability, (values, population))

    return fit_to


def _of_advice(log: AdviceLog, base: str, rule: Rule) -> FitTo:
    """Return what fits a rule to judgements with advice. The fit of the fold before is a good start."""

    def fit_to(some: Some, fits: Sequence[Fitted]) -> Fitted:
        model = fit_model(fits[-1].start if len(fits) > 1 else AdviceModel.of(base, rule), log.of(some))
        return Fitted(model.parameters, lambda those: model.log_likelihoods(log.of(those)), model)

    return fit_to


def _of_base_rates(log: AdviceLog) -> FitTo:
    """Return what finds the shares in which advice was followed, by whether it was the person's own choice."""

    def fit_to(some: Some, _: Sequence[Fitted]) -> Fitted:
        seen, rates = log.of(some), dict[str, float]()
        for name, rows in (("agreement", seen.agrees), ("disagreement", ~seen.agrees)):
            # With half a judgement for each answer, it is never 0 or 1.
            rates[name] = float((seen.follows[rows].sum() + 0.5) / (rows.sum() + 1))

        def log_probability(those: Some) -> Floats:
            own = log.of(those)
            rate = np.where(own.agrees, rates["agreement"], rates["disagreement"])
            return np.add.reduceat(np.log(np.where(own.follows, rate, 1 - rate)), np.flatnonzero(own.first))

        return Fitted(rates, log_probability)

    return fit_to


def fold_of(people: Sequence[str], folds: int = FOLDS) -> NDArray[np.int64]:
    """Return the fold of each person, shape (K,): the number in their name, modulo the number of folds.

    Where that leaves all people in one fold, as with names without numbers, it is the person's place in the log.
    """
    found = np.array([int("".join(filter(str.isdecimal, name)) or 0) % folds for name in people])
    return found if (found != found[0]).any() else np.arange(len(people)) % folds
