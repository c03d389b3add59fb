"""What people saw of neighbours, from a team's log: theta as in the simulation, and rules that are found again."""

from __future__ import annotations

import json
import pickle
import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import invoke

from assist.learning import compare_rules, fit_influence, observed, replayed
from assist.learning.likelihood import Method
from assist.learning.likelihood_table import LikelihoodTable
from assist.learning.neighbours_in_logs import seen_families, with_neighbours
from assist.learning.observations import Observations
from assist.learning.rule_families import RuleFamily, parameters_of
from assist.live.session import Session
from assist.live.simulated_person import SimulatedPerson
from assist.people.neighbours import Neighbours, SeenFollowed, SeenOutcome, SeenSteps, WithSeen
from assist.people.perceived_suggestions import moved
from assist.people.ranges import Population
from assist.people.trust_rules import EquationSeven, Event, constant, outcome
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
    return pool, trace, with_neighbours(replayed(task, trace), neighbours)


OF_TRUST = ("constant", "paper", "outcome")
OF_SEEN = (SeenOutcome(0.2), SeenFollowed(0.1, 0.2), SeenSteps(0.5, 0.8))
PAIRS = [
    (rule, trust)
    for shift in range(3)
    for rule, trust in zip(OF_SEEN, OF_TRUST[shift:] + OF_TRUST[:shift], strict=True)
]


@pytest.mark.parametrize(
    ("rule", "trust"), PAIRS[:3] + [pytest.param(*pair, marks=pytest.mark.slow) for pair in PAIRS[3:]]
)
def test_theta_at_each_suggestion_is_that_of_the_simulation(tiny: Table, rule: Any, trust: str) -> None:
    pool, trace, found = logged(tiny, rule, trust, people=5, episodes=6)
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


@pytest.mark.parametrize("rule", [SeenOutcome(0.2), SeenFollowed(0.1, 0.2)])
def test_theta_at_last_is_that_of_the_last_suggestions_episode(tiny: Table, rule: Any) -> None:
    """What is seen in later episodes, which begin with theta_0, does not move it."""
    pool, trace, found = logged(tiny, rule, "outcome", people=5, episodes=6)
    compared = 0
    for o in found:
        theta = np.array([pool.people[pool.names.index(o.person)].theta])
        _, last = LikelihoodTable.of([o], Method(), np.ones(1), theta).thetas(WithSeen(outcome(), rule), carry=False)
        own = sorted((o.episodes.index(row["episode"]), row["step"], row) for row in trace
                     if row["person"] == o.person and row["action"])  # fmt: skip
        told = max(place for place, (*_, row) in enumerate(own) if row["suggestion"])
        episode = [one for one in own if one[0] == own[told][0]]
        if episode[-1] is not own[told]:
            assert last[0, 0] == pytest.approx(episode[-1][2]["theta"], abs=1e-12)
            compared += told < len(own) - 1
    assert compared > 0


@pytest.mark.slow
def test_the_rate_is_found_again(tiny: Table) -> None:
    _, _, found = logged(tiny, SeenOutcome(0.3), "constant", people=8, episodes=20)
    rules = seen_families(constant())
    none, fit = (fit_influence(found, rules[name], carry=False) for name in ("none", "outcome"))
    assert fit.parameters["eta_seen"] == pytest.approx(0.3, abs=0.15)
    assert fit.intervals["eta_seen"][0] > 0
    assert fit.log_likelihood > none.log_likelihood + 2
    assert none.intervals == {}


def test_a_family_may_have_the_parameters_of_both_rules() -> None:
    paper = RuleFamily(EquationSeven, {"eta": (0.0, 1.0)}, ((0.1,), (0.3,)))
    family = seen_families(paper)["followed"]
    assert list(family.ranges) == ["eta", "rise", "fall"]
    assert family.rule((0.2, 0.1, 0.3)) == WithSeen(EquationSeven(0.2), SeenFollowed(0.1, 0.3))
    assert parameters_of(family.rule((0.2, 0.1, 0.3)))["fall"] == 0.3
    steps = [(0.03, 0.03), (0.03, 0.1), (0.1, 0.03), (0.1, 0.1)]
    assert family.tried == tuple((eta, *both) for eta in (0.1, 0.3) for both in steps)


@dataclass(frozen=True)
class FallsAfterThree:
    """Theta falls after three suggestions in a row that were not followed."""

    counts = 2
    uses_answer, feedback = True, "never"

    def update(self, theta: np.ndarray, event: Event, count: Any = 0) -> np.ndarray:
        return np.where((np.asarray(count) == 2) & ~event.followed, theta / 2, theta)

    def counted(self, count: np.ndarray, event: Event) -> np.ndarray:
        return np.where(event.followed, 0, (count + 1) % 3)


def test_what_a_rule_of_ones_own_counts_is_counted_beside_what_is_seen() -> None:
    own: Any = FallsAfterThree()
    theta, count = np.array([0.8]), np.zeros(1, dtype=np.int64)
    for followed in (False, False, True, False, False, False):
        event = Event(
            np.zeros(1), np.zeros(1, dtype=bool), np.array([followed]), np.zeros(1, dtype=bool), np.zeros(1, bool)
        )
        expected = moved(own, theta, count, event)
        theta, count = moved(WithSeen(own, SeenFollowed()), theta, count, event)
        assert (theta, count) == expected
    assert theta == 0.4
    assert pickle.loads(pickle.dumps(WithSeen(own, SeenFollowed()))) == WithSeen(own, SeenFollowed())


def test_who_is_alone_sees_nothing(tiny: Table) -> None:
    _, trace, _ = logged(tiny, "none", "constant", people=4, episodes=2)
    evidence = replayed(tiny, trace)
    seen = with_neighbours(evidence, Neighbours(rule="outcome", pairs=[]))
    assert all(len(o.seen.gain) == 0 for o in seen)
    plain = LikelihoodTable.of(evidence.observations(), Method()).log_likelihood(constant())
    same = LikelihoodTable.of(seen, Method()).log_likelihood(WithSeen(constant(), SeenOutcome()))
    np.testing.assert_array_equal(plain, same)


class Quiet(ToEverybody):
    """The same in half of the steps."""

    def __call__(self, team: TeamState, /) -> TeamAction:
        action = super().__call__(team)
        return action if self.rng.random() < 0.5 else TeamAction(0 * action.person - 1, 0 * action.action)


LIVE = Neighbours(rule=SeenFollowed(0.1, 0.12), sees="next")


def worked(task: Table, file: Path, people: int, tasks: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Let simulated people who see each other work in a live session; return its log, and their theta at each action.

    One comes late, leaves and comes back, and some take actions back.
    """
    setting = Setting(c_suggest=0.0, c_move=0.0, trust="constant", suggestions="all", neighbours=LIVE)
    population = Population(beta=(0.5, 1.5), theta=(0.2, 0.8), sigma=(0.0, 0.0))
    session = Session(task, file, setting=setting, policy=Quiet(), population=population, clock=lambda: 0.0)
    crew = {
        f"p{number}": SimulatedPerson(population, trust=setting.rule_of_people(), seed=1000 + number)
        for number in range(people)
    }
    rng, late, thetas = np.random.default_rng(5), f"p{people - 1}", list[dict[str, Any]]()
    for name in crew:
        if name != late:
            session.join(name)
    for number in range(tasks):
        left = [name for name in crew if name in session.people]
        while left:
            if len(thetas) == 20:
                session.join(late)
                left.append(late)
            if len(thetas) in (40, 60) and late in left:
                session.leave(late)
                left.remove(late)
            if len(thetas) in (50, 70) and late not in session.people:
                session.join(late)
                left.append(late)
            name = left[rng.integers(len(left))]
            view, (own, state) = session.person(name), session.task_and_state(name)
            crew[name].hear(session.history.news(name))
            theta, action = crew[name].theta, crew[name].act(own, state, view["applicable"], view["suggestion"])
            thetas.append({"person": name, "order": session.history.count + 1, "theta": theta})
            if session.observe(name, action)["finished"]:
                left.remove(name)
        for name in crew if number + 1 < tasks else ():
            if name in session.people:
                crew[name].hear(session.history.news(name))
                session.begin(name)
    log = session.log()
    session.close()
    return log, thetas


@pytest.mark.slow
def test_theta_at_each_suggestion_is_that_of_people_in_a_live_session(tiny: Table, tmp_path: Path) -> None:
    log, thetas = worked(tiny, tmp_path / "a.sqlite", 5, 2)
    at, moved = {(row["person"], row["order"]): row["theta"] for row in thetas}, 0
    for o in with_neighbours(replayed(tiny, log), LIVE):
        own = [row for row in log if row["person"] == o.person]
        told = [at[o.person, row["order"]] for row in own if row["suggestion"]]
        number = int(o.person[1:])
        first = SimulatedPerson(
            Population(beta=(0.5, 1.5), theta=(0.2, 0.8), sigma=(0.0, 0.0)), seed=1000 + number
        ).theta
        table = LikelihoodTable.of([o], Method(), np.ones(1), np.array([first]))
        before, _ = table.thetas(WithSeen(constant(), LIVE.rule), carry=True)
        np.testing.assert_allclose(before[0, :, 0], told, atol=1e-12)
        moved += sum(theta != first for theta in told)
    assert moved > 30
    assert {row["since"] for row in log if row["person"] == "p0"} == {1}
    assert len({row["since"] for row in log if row["person"] == "p4"}) == 3


@pytest.mark.slow
def test_the_rule_of_a_live_session_is_named_by_commands(tiny: Table, tmp_path: Path) -> None:
    log, _ = worked(tiny, tmp_path / "a.sqlite", 24, 4)
    file, graph = tmp_path / "log.jsonl", tmp_path / "graph.toml"
    file.write_text("".join(json.dumps(row) + "\n" for row in log))
    graph.write_text('[neighbours]\nsees = "next"\n')
    asked = ["kitting/tiny", str(file), "--influence", "constant", "--setting", str(graph)]
    found = invoke("compare", "rules", *asked, "--folds", "2", "--json")
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout)["best"] == "followed"
    found = invoke("fit", *asked, "--set", "neighbours.rule=followed", "--json")
    fit = json.loads(found.stdout)
    assert fit["rule"] == "constant, neighbours followed"
    for name, true in (("rise", 0.1), ("fall", 0.12)):
        low, high = fit["intervals"][name]
        assert low <= true <= high
        assert low > 0


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["fit"], "--set neighbours.sees has no effect without --influence"),
        (["compare", "models"], "--set neighbours.sees has no effect on a comparison of choice models"),
        (["compare", "rules"], "--influence and neighbours: expected both"),
        (["fit", "--influence", "constant", "--write-population", "p.json"], "--write-population and neighbours"),
        (["fit", "--influence", "constant", "--set", "neighbours.rule=outcome"], "neighbours.matrix: 2 stations for 3"),
    ],
)
def test_what_has_no_effect_or_is_no_graph_of_the_log_is_refused_in_one_sentence(
    tiny: Table, tmp_path: Path, command: list[str], said: str
) -> None:
    _, trace, _ = logged(tiny, "none", "constant", people=4, episodes=1)
    file = tmp_path / "log.jsonl"
    file.write_text("".join(json.dumps(row) + "\n" for row in trace))
    which = "neighbours.matrix=[[0, 1], [1, 0]]" if "matrix" in said else "neighbours.sees=next"
    found = invoke(*command, "kitting/tiny", str(file), "--set", which)
    assert found.exit_code != 0
    assert said in " ".join(found.output.split())


def test_observations_of_a_simulation_are_taken_as_its_log_is(tiny: Table) -> None:
    """Theta is not carried, and what is not known of neighbours is not left out without a word."""
    _, trace, _ = logged(tiny, "none", "outcome", people=4, episodes=4)
    evidence, method = replayed(tiny, trace), Method(neighbours=Neighbours(rule="outcome", sees="next"))
    whole = fit_influence(evidence, outcome())
    for same in (observed(tiny, trace), evidence.observations()):
        found = fit_influence(same, outcome())
        assert (found.carried, found.log_likelihood) == (False, whole.log_likelihood)
    assert fit_influence(observed(tiny, trace), outcome(), carry=True).carried
    with pytest.raises(ValueError, match=re.escape("neighbours: expected replayed(task, log)")):
        fit_influence(observed(tiny, trace), "constant", method)


def test_several_goals_are_refused_and_a_log_without_places_has_the_order_of_names(tiny: Table) -> None:
    _, trace, found = logged(tiny, SeenFollowed(0.1, 0.1), "constant", people=3, episodes=2)
    bare = [{name: row[name] for name in ("person", "episode", "step", "action", "suggestion")} for row in trace]
    graph = Neighbours(rule=SeenFollowed(0.1, 0.1), matrix=np.ones((3, 3)) - np.eye(3))
    places = {name: k for k, name in enumerate(sorted({row["person"] for row in trace}))}
    ordered = [row | {"place": places[row["person"]]} for row in trace]
    one, other = (with_neighbours(replayed(tiny, rows), graph) for rows in (bare, ordered))
    assert all(a.seen == b.seen and len(a.seen.gain) for a, b in zip(one, other, strict=True))
    with pytest.raises(ValueError, match="place -1: expected a number from 0"):
        with_neighbours(replayed(tiny, [row | {"place": -1} for row in trace]), graph)
    evidence = replayed({"own": tiny, "other": tiny}, trace)
    with pytest.raises(ValueError, match="neighbours: expected a log whose goal is known"):
        with_neighbours(evidence, graph)
    first_two = dict(islice(seen_families(constant()).items(), 2))
    assert [row.difference is None for row in compare_rules(found, rules=first_two, folds=2).scores] == [True, False]
    with pytest.raises(ValueError, match="trust 'trusting'; expected one of "):
        compare_rules(found, beside="trusting")
