"""Estimates, intervals and comparisons from logs of simulated people, which a change of learning must keep.

    python tests/learning_figures.py FILE [--large] [--advice FOLDER]

writes the figures of small logs, which `test_learning_figures.py` compares with `tests/data/learning.json`; with
`--large` those of larger logs, and with `--advice` those of the data of docs/results/trust.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path += [str(ROOT / "bench"), str(ROOT / "tests"), str(ROOT / "tests" / "together")]

from gates_records import here  # noqa: E402
from recorded import predictions, simulated  # noqa: E402
from simulated_people import People, record, record_with_terms, record_with_trust  # noqa: E402

from assist.learning import (  # noqa: E402
    Log,
    Method,
    compare_models,
    compare_rules,
    fit,
    fit_influence,
    fit_population,
    infer_goals,
    maximum_likelihood,
    observed,
    read_advice,
)
from assist.learning.advice_fit import base_of, fit_advice, fit_model  # noqa: E402
from assist.learning.advice_model import AdviceModel  # noqa: E402
from assist.learning.advice_rules import RULES  # noqa: E402
from assist.learning.held_out import COMPARED, fold_of  # noqa: E402
from assist.learning.hierarchy import fit_terms  # noqa: E402
from assist.people.choices import Choices  # noqa: E402
from assist.people.trust_rules import constant, outcome, outcome_at_disagreement  # noqa: E402
from planner import Table, cost_to_go, load  # noqa: E402


def estimates(fits: Any) -> list[Any]:
    return [
        [one.observations.person, one.log_likelihood]
        + [
            None if e is None else [e.value, *e.interval, e.open_below, e.open_above]
            for e in map(one.estimates.get, ("beta", "theta", "eta", *one.observations.terms))
        ]
        for one in fits
    ]


def population(found: Any) -> list[Any]:
    return [
        found.eta, found.log_likelihood,
        *[[m.family, *m.parameters, m.mean, m.spread, *m.recorded] for m in (found.beta, found.theta) if m is not None],
    ]  # fmt: skip


def comparison(found: Any) -> list[Any]:
    of = attrgetter("model", "nats_per_choice", "stderr", "difference", "interval", "p", "p_corrected")
    return [[*of(score), list(score.parameters.values())] for score in found.scores]


def models(found: Any) -> list[Any]:
    of = attrgetter("model", "nats_per_choice", "stderr")
    known = ("beta", "theta", "eta")
    return [
        [
            *of(m),
            m.parameters["beta"],
            [v for name, v in m.parameters.items() if name not in known],
            m.of_people.tolist(),
        ]
        for m in found.scores
    ]


def influences(found: Any) -> list[Any]:
    return [
        found.log_likelihood, found.parameters, found.intervals, vars(found.population),
        [[o.beta, *o.beta_interval, o.theta_first, *o.theta_first_interval, o.theta, *o.theta_interval]
         for o in found.people],
    ]  # fmt: skip


def short_sighted(choices: Choices, q: np.ndarray, beta: np.ndarray) -> np.ndarray:
    seen = np.minimum(q, 4.0)
    weight = np.exp(-beta[:, None, None] * (seen - seen.min(axis=1, keepdims=True))) * choices.applicable
    return weight / np.maximum(weight.sum(axis=2, keepdims=True), 1e-300)


def people(count: int, rng: np.random.Generator) -> People:
    return People(rng.uniform(0.1, 4.0, count), rng.uniform(0.3, 0.95, count))


def of_acting(table: Table, count: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield figures of people who act in a task; `count` is their number."""
    rng = np.random.default_rng(1)
    seen = observed(table, record(table, people(count, rng), episodes=3, rng=rng, suggest=0.5, most=300))
    plain = observed(table, record(table, people(count, rng), episodes=3, rng=rng, most=300))
    yield "each", lambda: estimates(maximum_likelihood(seen))
    yield "each, eta known", lambda: estimates(maximum_likelihood(seen, Method(eta=0.2, level=0.9)))
    yield "each, no suggestions", lambda: estimates(maximum_likelihood(plain))
    yield "population", lambda: population(fit_population(seen, Method(eta=0.2)))
    yield "population, histogram", lambda: population(fit_population(seen, Method(eta=0.2), family="histogram"))
    yield "population, no suggestions", lambda: population(fit_population(plain))
    rows = record(table, people(3, rng), episodes=3, rng=rng, suggest=0.3, most=300)

    def full() -> Any:
        found = fit(table, Log.of(rows))
        return [estimates(r for r in found.values()), [[r.check.p, *r.check.scores.values()] for r in found.values()]]

    yield "checked", full
    yield "own model", lambda: estimates(r for r in fit(table, Log.of(rows), model=short_sighted).values())

    mistaken_people = People(np.array([2.0, 1.0]), np.array([0.5, 0.5]), noise=rng.standard_normal((2, len(table))))
    noisy = record(table, mistaken_people, episodes=8, rng=rng, most=300)

    def mistaken() -> Any:
        found = fit(table, Log.of(noisy), model="misconceptions")
        return [[m.sigma, *m.interval, m.beta, m.log_likelihood, m.without, m.perceived.tolist()]
                for m in (r.misconception for r in found.values()) if m is not None]  # fmt: skip

    yield "misconceptions", mistaken
    weights = rng.normal((0.5, -1.0, 0.6, -1.0), (0.5, 1.0, 0.6, 0.8), (count, 4))
    told = record_with_terms(table, np.exp(rng.uniform(-1, 1, count)), weights, 30, rng)
    from assist.people import TERMS

    yield "terms", lambda: estimates(fit_terms(observed(table, told, terms=TERMS), Method())[0])
    yield "models", lambda: models(compare_models(observed(table, told, terms=TERMS), folds=3))


def of_goals(count: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield figures of people with one of three goals."""
    from test_unknown_goals import PRIOR, three_goals

    goals, rng, rows = three_goals("tiny"), np.random.default_rng(4), list[dict[str, Any]]()
    them = People(np.linspace(0.4, 2.4, count), np.full(count, 0.7))
    for (name, table), episodes in zip(goals.tables.items(), (4, 2, 2), strict=True):
        own = record(table, them, episodes=episodes, rng=rng, suggest=0.3)
        rows += [row | {"episode": f"{name}-{row['episode']}"} for row in own]
    log = Log.of(rows)

    def fitted() -> Any:
        found = fit(goals.tables, log, Method(eta=0.2), prior=PRIOR)
        return [
            estimates(r for r in found.values()),
            [list(r.goal_posteriors().values()) for r in found.values()],
            [r.suboptimal_actions for r in found.values()], population(found.distribution()),
        ]  # fmt: skip

    def posteriors() -> Any:
        found = infer_goals(goals.tables, log, prior=PRIOR)
        return [[o.person, o.episode, o.posterior.tolist(), o.beta.tolist()] for o in found.episodes]

    yield "goals", fitted
    yield "goals, inferred", posteriors


def of_rules(
    table: Table, count: int, suggestions: int, kinds: tuple[str, ...], compared: tuple[str, ...] | None
) -> Iterator[tuple[str, Any]]:
    """Yield figures of people whose influence moves: fitted by some rules, and compared by some, or by all."""
    rng = np.random.default_rng(3)
    them = People(np.exp(rng.normal(0, 0.4, count)), 1 / (1 + np.exp(-rng.normal(0.5, 1.2, count))))
    rows = record_with_trust(table, them, outcome(0.3, 0.5), suggestions=suggestions, rng=rng)
    seen = observed(table, rows)
    for name in kinds:
        yield f"influence, {name}", lambda name=name: influences(fit_influence(seen, name))
    own = outcome_at_disagreement(0.1, 0.3, 0.4)
    yield "influence, own rule, by episode", lambda: influences(fit_influence(seen, own, carry=False))
    yield "influence, constant, by episode", lambda: influences(fit_influence(seen, constant(), carry=False))
    yield "rules", lambda: comparison(compare_rules(seen, rules=compared, folds=2))


def of_advice(log: Any, folds: int, rules: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield figures of judgements with advice."""
    for name in ("constant", "paper", "outcome", "outcome-at-disagreement", "reliability"):
        yield name, lambda name=name: fit_advice(log, name).as_dict()
    yield "compared", lambda: comparison(compare_rules(log, rules=rules, folds=folds))

    def answers() -> Any:
        first = fold_of(log.people, folds) == 0
        model = fit_model(AdviceModel.of(base_of(log), RULES["constant"]), log.of(~first))
        return predictions(model, log.of(first)).tolist()[:50]

    yield "answers", answers


def figures(large: bool) -> Iterator[tuple[str, Callable[[], Any]]]:
    table = cost_to_go(load(ROOT / "domains" / "kitting" / f"{'paper' if large else 'tiny'}.pddl"))
    yield from of_acting(table, 40 if large else 5)
    yield from of_goals(6 if large else 2)
    every = ("constant", "paper", "outcome", "outcome-at-disagreement", "reliability")
    few_rules = ("paper", "reliability"), ("constant", "outcome")
    yield from of_rules(table, *((25, 60, every, None) if large else (5, 8, *few_rules)))

    few = {name: COMPARED[name] for name in ("constant", "outcome", "base rates")}
    log = simulated(24, 25, 2, steps=0.5) if large else simulated(10, 8, 2, steps=0.5)
    yield from ((f"advice, {name}", of) for name, of in of_advice(log, 3, COMPARED if large else few))


def of_data(folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    for name, log in (
        ("cards", read_advice(folder / "cards.csv", confidence="one", rows={"attention_fail": "0"})),
        ("dates_fb", read_advice(folder / "dates.csv", rows={"condition": "feedback"})),
        ("dates_none", read_advice(folder / "dates.csv", rows={"condition": "none"})),
    ):
        yield from ((f"{name}, {one}", of) for one, of in of_advice(log, 8, dict(COMPARED)))


def plain(value: Any) -> Any:
    """Return figures as JSON has them."""
    return json.loads(json.dumps(value, default=lambda one: one.item()))


if __name__ == "__main__":
    file, *options = sys.argv[1:]
    which = of_data(Path(options[1])) if "--advice" in options else figures("--large" in options)
    found = {}
    for name, of in which:
        found[name] = plain(of())
        print(name, flush=True)
        document = {"machine": here(), "figures": found}
        Path(file).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
