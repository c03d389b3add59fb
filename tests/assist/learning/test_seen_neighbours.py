"""What people saw of neighbours, from a team's log: theta as in the simulation, and rules that are found again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from assist.learning import compare_rules, fit_influence, places_of, replayed, seen_families, with_neighbours
from assist.learning.likelihood import Method
from assist.learning.likelihood_table import LikelihoodTable
from assist.learning.observations import Observations
from assist.learning.rule_families import RuleFamily, parameters_of
from assist.people.neighbours import Neighbours, SeenFollowed, SeenOutcome, SeenSteps, WithSeen
from assist.people.ranges import Population
from assist.people.trust_rules import EquationSeven, constant, outcome
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.simulate import simulate
from assist.team.state import TeamAction, TeamState
from assist.team.trace import Trace
from planner import Table


class ToEverybody:
    """Suggests a random action to somebody in each step."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(3)

    def __call__(self, team: TeamState, /) -> TeamAction:
        number = np.array([[team.policies[m].pomdp.robot_actions[x] for x, m in zip(*row, strict=True)]
                           for row in zip(team.x, team.model, strict=True)])  # fmt: skip
        person = np.where(team.active, self.rng.random(team.x.shape), -1).argmax(axis=1)
        return team.act(person[:, None], self.rng.integers(number.clip(2)) % number)


def logged(task: Table, rule: Any, trust: str, *, people: int, episodes: int) -> tuple[Pool, Trace, list[Observations]]:
    neighbours = Neighbours(rule=rule, sees="next", weight=0.7)
    setting = Setting(
        c_suggest=0.0, c_move=0.0, knowledge="exact", suggestions="all", trust=trust, neighbours=neighbours
    )
    population = Population(beta=(0.5, 1.5), theta=(0.2, 0.8), sigma=(0.0, 0.0))
    pool, trace = Pool.sample(task, people, seed=1, setting=setting, population=population), Trace()
    _ = simulate(pool, ToEverybody(), humans=3, episodes=episodes, seed=1, trace=trace)
    return pool, trace, with_neighbours(replayed(task, trace), neighbours, places_of(trace))


@pytest.mark.parametrize("trust", ["constant", "paper", "outcome"])
@pytest.mark.parametrize("rule", [SeenOutcome(0.2), SeenFollowed(0.1, 0.2), SeenSteps(0.5, 0.8)])
def test_theta_at_each_suggestion_is_that_of_the_simulation(tiny: Table, rule: Any, trust: str) -> None:
    pool, trace, found = logged(tiny, rule, trust, people=5, episodes=12)
    own = {"constant": constant(), "paper": EquationSeven(), "outcome": outcome()}[trust]
    moved = 0
    for o in found:
        theta = np.array([pool.people[pool.names.index(o.person)].theta])
        before, _ = LikelihoodTable.of([o], Method(), np.ones(1), theta).thetas(WithSeen(own, rule), carry=False)
        told = [row for row in trace if row["person"] == o.person and row["suggestion"]]
        told.sort(key=lambda row: (o.episodes.index(row["episode"]), row["step"]))
        expected = np.array([row["theta"] for row in told])
        np.testing.assert_allclose(before[0, :, 0], expected, atol=1e-12)
        moved += int((expected != theta).sum())
    assert moved > 10


def test_the_rate_is_found_again(tiny: Table) -> None:
    _, _, found = logged(tiny, SeenOutcome(0.3), "constant", people=8, episodes=20)
    rules = seen_families(constant())
    none, fit = (fit_influence(found, rules[name], carry=False) for name in ("none", "outcome"))
    assert fit.parameters["eta_seen"] == pytest.approx(0.3, abs=0.15)
    assert fit.intervals["eta_seen"][0] > 0
    assert fit.log_likelihood > none.log_likelihood + 2
    assert none.intervals == {}
    with pytest.raises(ValueError, match="expected 'constant' among them"):
        compare_rules(found, rules=rules)


def test_a_family_may_have_the_parameters_of_both_rules() -> None:
    paper = RuleFamily(EquationSeven, {"eta": (0.0, 1.0)}, ((0.1,), (0.3,)))
    family = seen_families(paper)["followed"]
    assert list(family.ranges) == ["eta", "rise", "fall"]
    assert family.rule((0.2, 0.1, 0.3)) == WithSeen(EquationSeven(0.2), SeenFollowed(0.1, 0.3))
    assert parameters_of(family.rule((0.2, 0.1, 0.3)))["fall"] == 0.3
    assert family.tried == ((0.1, 0.03, 0.03), (0.1, 0.1, 0.1), (0.3, 0.03, 0.03), (0.3, 0.1, 0.1))


def test_who_is_alone_sees_nothing(tiny: Table) -> None:
    _, trace, _ = logged(tiny, "none", "constant", people=4, episodes=2)
    evidence = replayed(tiny, trace)
    seen = with_neighbours(evidence, Neighbours(pairs=[]), places_of(trace))
    assert all(len(o.seen.gain) == 0 for o in seen if o.seen is not None)
    plain = LikelihoodTable.of(evidence.observations(), Method()).log_likelihood(constant())
    same = LikelihoodTable.of(seen, Method()).log_likelihood(WithSeen(constant(), SeenOutcome()))
    np.testing.assert_array_equal(plain, same)
