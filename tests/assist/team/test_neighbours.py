"""People who see their neighbours helped: theta in the world, and the filter against a joint one by brute force."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from assist.connect.teams import Teams
from assist.declare.declared import DeclarationError
from assist.people import Goals
from assist.people.neighbourhood import NOBODY_SEES, Helped, Neighbourhood
from assist.people.neighbours import Neighbours, SeenFollowed, SeenOutcome, SeenRule, SeenSteps
from assist.person import ObservationModel, Policy, Setting
from assist.team import Pool, TeamAction, TeamState, simulate
from assist.team.common_random_numbers import CommonRandomNumbers
from assist.team.outlook import outlook
from assist.team.trace import Trace
from planner import OnDemand, Table, sweep_goals


@dataclass
class Talkative:
    """Suggests a random optimal action to a random person, and keeps the beliefs before each step."""

    seed: int

    def __post_init__(self) -> None:
        self.rng, self.kept = np.random.default_rng(self.seed), list[TeamState]()
        self.did, self.before = list[TeamAction](), list[np.ndarray]()

    def __call__(self, team: TeamState, /) -> TeamAction:
        self.before.append(team.belief[0].copy())
        self.kept.append(team)
        n, k = team.active.shape
        person = np.array([self.rng.choice(np.flatnonzero(row)) for row in team.active])
        said = np.zeros((n, k), dtype=np.int64)
        for e, p in enumerate(person.tolist()):
            pomdp = team.policies[team.model[e, p]].pomdp
            said[e, p] = self.rng.integers(pomdp.robot_actions[team.x[e, p]])
        action = team.act(person[:, None], said)
        self.did.append(action)
        return action


def moved_by_hand(rule: SeenRule, theta: float, gain: float, followed: bool, weight: float) -> float:
    """The rules, for single numbers."""
    if isinstance(rule, SeenOutcome):
        return min(max(theta + weight * rule.eta_seen * gain / rule.utility_scale, 0.0), 1.0)
    if isinstance(rule, SeenFollowed):
        return min(max(theta + weight * (rule.rise if followed else -rule.fall), 0.0), 1.0)
    if not followed:
        return theta
    at = min(max(theta, 0.01), 0.99)
    odds = at / (1 - at) * np.exp(weight * (rule.seen_gain if gain > 0 else -rule.seen_loss))
    return min(max(odds / (1 + odds), 0.01), 0.99)


def joint_filter(
    pool: Pool, team: TeamState, trace: Trace, kept: list[np.ndarray], sees: np.ndarray, rule: SeenRule
) -> list[np.ndarray]:
    """The belief over both people's types and thetas together, before each step, by brute force."""
    pomdps = [pool.policies[m].pomdp for m in team.model[0].tolist()]
    joint = np.multiply.outer(pomdps[0].prior, pomdps[1].prior)  # axes: type and theta of one, then of the other
    x, found = [one.model.choices.initial for one in pomdps], []
    rows = {(row["step"], row["place"]): row for row in trace}
    for step in range(len(kept)):
        found.append(joint)
        after, events = list(x), list[tuple[int, float, bool]]()
        for k, pomdp in enumerate(pomdps):
            row = rows.get((step, k))
            if row is None:
                continue
            choices, theta, others = pomdp.model.choices, pomdp.grid.theta, range(2 * k, 2 * k + 2)
            names = [choices.name(x[k], slot) for slot in range(int(choices.applicable[x[k]].sum()))]
            slot, told = names.index(row["action"]), row["suggestion"]
            said = 0
            if told is not None:
                said = int(np.flatnonzero(pomdp.suggested[x[k]] == names.index(told))[0])
            likelihood = pomdp.likelihood(np.array([x[k]]), np.array([said]), np.array([slot]))[0]
            joint = joint * (likelihood[:, :, None, None] if k == 0 else likelihood[None, None])
            y = int(choices.targets[x[k], slot])
            low, weight = pomdp.low[x[k], said], pomdp.weight[x[k], said]
            moved = np.zeros_like(joint)
            for h in range(len(pomdp.hidden)):
                for t in range(len(theta)):
                    at, share = low[pomdp.hidden.goal_of[h], t], weight[pomdp.hidden.goal_of[h], t]
                    for to, part in ((at, 1 - share), (at + 1, share)):
                        put, get = [[slice(None)] * 4 for _ in range(2)]
                        put[others[0]], put[others[1]], get[others[0]], get[others[1]] = h, to, h, t
                        moved[tuple(put)] += part * joint[tuple(get)]
            joint, after[k] = moved, y
            reached = choices.goals.goal[:, y][pomdp.hidden.goal_of]
            if told is not None:
                goals = choices.goals
                share = np.array(list(goals.prior.values()))
                value = [np.where(goals.goal[:, at], 0.0, pomdp.model.q[at].min(axis=0)) @ share for at in (x[k], y)]
                events.append((k, value[0] - value[1], slot == names.index(told)))
            if not pomdp.final[:, y].all() and reached.any() and not reached.all() and kept[step][k]:
                stays = np.where(reached, 0.0, 1.0)
                joint = joint * (stays[:, None, None, None] if k == 0 else stays[None, None, :, None])
        for k, gain, followed in events:
            i = 1 - k
            theta, moved = pomdps[i].grid.theta, np.zeros_like(joint)
            if not sees[i, k] or not kept[step][i]:
                continue
            for t, value in enumerate(theta.tolist()):
                to = moved_by_hand(rule, value, gain, followed, sees[i, k])
                at = min(max(int(np.searchsorted(theta, to, side="right")) - 1, 0), len(theta) - 2)
                share = (to - theta[at]) / (theta[at + 1] - theta[at])
                for place, part in ((at, 1 - share), (at + 1, share)):
                    if i == 0:
                        moved[:, place] += part * joint[:, t]
                    else:
                        moved[:, :, :, place] += part * joint[:, :, :, t]
            joint = moved
        joint = joint / joint.sum()
        x = after
    return found


RULES = {
    "outcome": SeenOutcome(eta_seen=0.15, utility_scale=1.0),
    "followed": SeenFollowed(rise=0.1, fall=0.07),
    "steps": SeenSteps(seen_gain=0.4, seen_loss=0.7),
}


def two_goals(table: Table) -> Goals:
    """The task with its own goal, and with one that holds a few steps earlier on an optimal plan."""
    at = table.initial
    for _ in range(3):
        own = table.choices([at]).targets
        at = int(own[np.argmin([table[int(y)] for y in own])])
    facts = tuple(enumerate(table.values([at])[0].tolist()))
    tables = sweep_goals([table.task, replace(table.task, goal=facts)])
    return Goals(dict(zip("ab", tables, strict=True)), {"a": 0.7, "b": 0.3}, sharpness=1)


@pytest.mark.parametrize("knowledge", ["own", "exact", "exact, two goals"])
@pytest.mark.parametrize("name", RULES)
def test_the_filter_is_that_of_both_people_together(tiny: Table, name: str, knowledge: str) -> None:
    rule, task = RULES[name], two_goals(tiny) if "two" in knowledge else tiny
    neighbours = Neighbours(rule=rule, matrix=((0, 0.8), (0.5, 0)))
    setting = Setting(
        neighbours=neighbours, knowledge="own" if knowledge == "own" else "exact", c_suggest=0.0, c_move=0.0,
        suggestions="all",
    )  # fmt: skip
    pool, largest = Pool.sample(task, 4, seed=2, setting=setting), 0.0
    for seed in range(2):
        talks, trace = Talkative(seed), Trace()
        _ = simulate(pool, talks, humans=2, episodes=[seed], seed=1, trace=trace)
        goes_on = [team.active[0] for team in talks.kept[1:]] + [np.zeros(2, dtype=bool)]
        expected = joint_filter(pool, talks.kept[0], trace, goes_on, neighbours.weights(2), rule)
        for joint, belief, active in zip(expected, talks.before, [t.active[0] for t in talks.kept], strict=True):
            for k, own in enumerate((joint.sum(axis=(2, 3)), joint.sum(axis=(0, 1)))):
                if active[k]:
                    np.testing.assert_allclose(belief[k], own, atol=1e-12)
                    largest = max(largest, float(np.abs(own - pool.policies[0].pomdp.prior).max()))
            # Given what was seen, people are independent: the joint belief is the product of its margins.
            product = np.multiply.outer(joint.sum(axis=(2, 3)), joint.sum(axis=(0, 1)))
            np.testing.assert_allclose(joint, product, atol=1e-12)
    assert largest > 0.05


def test_people_of_the_model_are_distributed_as_the_robots_believe(tiny: Table) -> None:
    neighbours = Neighbours(rule={"rule": "outcome", "eta_seen": 0.25}, sees="next")
    setting = Setting(neighbours=neighbours, c_suggest=0.0, c_move=0.0, knowledge="exact", max_steps=4)
    pool, count = Pool.sample(tiny, 3, seed=2, setting=setting), 1000
    talks, beliefs = Talkative(3), list[np.ndarray]()

    def watched(team: TeamState) -> TeamAction:
        if team.step == 3:
            beliefs.append(team.belief.copy())
        return talks(team)

    trace = Trace()
    _ = simulate(pool, watched, humans=[0, 1, 2], episodes=count, seed=1, world="model", trace=trace)
    believed = np.concatenate(beliefs).sum(axis=2)
    theta = np.array([row["theta"] for row in trace if row["step"] == 3]).reshape(count, 3)
    values = pool.policies[0].pomdp.grid.theta
    for power in (1, 2):
        off = (theta**power - believed @ values**power).mean(axis=0)
        error = (theta**power).std(axis=0) / np.sqrt(count)
        assert (np.abs(off) < 3 * error).all()
    assert np.ptp(theta.mean(axis=0)) > 0.01  # who is in the middle sees more


def test_theta_moves_by_all_events_of_a_step_in_the_order_of_people() -> None:
    rule = SeenFollowed(rise=0.4, fall=0.4)
    team = Neighbourhood(rule, Neighbours(rule=rule).weights(3))
    told = Helped(np.array([0, 0]), np.array([1, 2]), np.zeros(2), np.array([True, False]))
    rows, theta = team.moved(np.array([[0.8], [0.8], [0.8]]), told, np.ones((1, 3), dtype=bool))
    # The first sees a neighbour follow (.8 to 1, not 1.2), then one who does not; the others see one of them each.
    assert rows.tolist() == [0, 1, 2]
    np.testing.assert_allclose(theta[:, 0], [0.6, 0.4, 1.0])
    swapped = told._replace(followed=np.array([False, True]))
    np.testing.assert_allclose(team.moved(np.full((3, 1), 0.8), swapped, np.ones((1, 3), dtype=bool))[1][0], 0.8)
    there = np.array([[False, True, True]])
    assert team.moved(np.full((3, 1), 0.8), told, there)[0].tolist() == [1, 2]


def test_graphs() -> None:
    assert Neighbours().weights(3).tolist() == [[0, 1, 1], [1, 0, 1], [1, 1, 0]]
    assert Neighbours(sees="next", weight=0.5).weights(3).tolist() == [[0, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0]]
    pairs = Neighbours(pairs=[[1, 3], [2, 3, 0.25], [1, 9]])
    assert pairs.weights(3).tolist() == [[0, 0, 1], [0, 0, 0.25], [1, 0.25, 0]]
    assert Neighbourhood.of(replace(pairs, rule="followed"), 9).first(3).sees.tolist() == pairs.weights(3).tolist()
    assert Neighbours(matrix=np.array([[0, 0.1, 0], [1, 0, 0], [0, 0, 0]])).weights(2).tolist() == [[0, 0.1], [1, 0]]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"sees": "nobody"}, 'sees \'nobody\': expected "everybody" or "next"'),
        ({"weight": 2}, "weight 2: expected a number from 0 to 1"),
        ({"rule": "outcom"}, "rule: 'outcom'; did you mean 'outcome'"),
        ({"rule": {"rule": "outcome", "eta_sen": 0.1}}, "rule: eta_sen: unknown; did you mean 'eta_seen'"),
        ({"rule": {"eta_seen": 0.1}}, "rule: rule is missing; expected one of none, outcome, followed, steps"),
        ({"rule": 3}, "rule: 3; expected a name, or an object with a method update"),
        ({"pairs": [[1, 1]]}, "pairs: \\[1.0, 1.0\\]; expected two stations"),
        ({"pairs": [[0, 1]]}, "expected two stations, numbered from 1"),
        ({"matrix": [[0, 1], [1, 0.5]]}, "matrix: row 2"),
        ({"matrix": [[0, 1]]}, "matrix: row 1"),
        ({"pairs": [[1, 2]], "matrix": [[0]]}, "pairs and matrix: expected one of them"),
    ],
)
def test_what_is_no_graph_or_rule_is_refused_in_one_sentence(fields: dict[str, object], message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        Neighbours(**fields)  # type: ignore[arg-type]


def test_refusals_of_a_setting_and_a_team() -> None:
    with pytest.raises(ValueError, match="neighbours: expected none with an observation model"):
        Setting(neighbours=Neighbours(rule="outcome"), observation=ObservationModel(0.1, 0.0))
    assert Setting(neighbours=Neighbours(), observation=ObservationModel(0.1, 0.0)).neighbourhood(3) is NOBODY_SEES
    with pytest.raises(ValueError, match=r"neighbours.matrix: 2 stations for 3 people"):
        Setting(neighbours=Neighbours(rule="outcome", matrix=((0, 1), (1, 0)))).neighbourhood(3)
    with pytest.raises(ValueError, match=r"neighbours.pairs: station 9 in a team of 2; expected stations up to 2"):
        Setting(neighbours=Neighbours(rule="outcome", pairs=[[2, 1], [1, 9]])).neighbourhood(2)


def test_no_event_moves_theta_of_somebody_who_is_alone_or_sees_nobody(tiny: Table) -> None:
    every = [
        Setting(c_suggest=0.0, neighbours=given)
        for given in (None, Neighbours(), Neighbours(rule="outcome", weight=0), Neighbours(rule="outcome", pairs=[]))
    ]
    runs = [
        simulate(Pool.sample(tiny, 4, seed=2, setting=one), "attention", humans=3, episodes=8, seed=1) for one in every
    ]
    assert all(list(run) == list(runs[0]) for run in runs[1:])
    alone = [replace(every[0], neighbours=given) for given in (None, Neighbours(rule="outcome"))]
    runs = [
        simulate(Pool.sample(tiny, 4, seed=2, setting=one), "attention", humans=1, episodes=8, seed=1) for one in alone
    ]
    assert list(runs[0]) == list(runs[1])


def test_a_robot_that_does_not_know_of_it_believes_as_if_theta_stayed(tiny: Table) -> None:
    def beliefs(**fields: object) -> np.ndarray:
        setting = Setting(c_suggest=0.0, neighbours=Neighbours(rule=SeenFollowed(0.3, 0.3), **fields))  # type: ignore[arg-type]
        talks = Talkative(1)
        _ = simulate(Pool.sample(tiny, 4, seed=2, setting=setting), talks, humans=3, episodes=[0], seed=1)
        return talks.before[3]

    assert not np.array_equal(beliefs(), beliefs(known=False))


@pytest.mark.parametrize("rule", RULES.values())
def test_the_outlook_is_the_expected_change_of_those_who_see_it(tiny: Table, rule: SeenRule) -> None:
    """Against loops over people, suggestions, answers and those who see them."""
    neighbours = Neighbours(rule=rule, matrix=((0, 0.8, 0), (0.5, 0, 1), (0.3, 0, 0)))
    setting = Setting(neighbours=neighbours, c_suggest=0.1, suggestions="all")
    pool, found, talks = Pool.sample(tiny, 3, seed=2, setting=setting), list[float](), Talkative(2)

    def watched(team: TeamState) -> TeamAction:
        actions, sees = team.q_values().shape[2], neighbours.weights(3)
        got = outlook(team, actions, Policy.value)
        for e, k, r in np.ndindex(got.shape):
            pomdp, x = team.policies[team.model[e, k]].pomdp, team.x[e, k : k + 1]
            slot, expected = pomdp.suggested[x[0], r] if r < pomdp.suggested.shape[1] else -1, 0.0
            choices, cost = pomdp.model.choices, pomdp.model.q
            for a in range(int(choices.applicable[x[0]].sum()) if slot >= 0 and team.active[e, k] else 0):
                chance = (pomdp.likelihood(x, np.array([r]), np.array([a]))[0] * team.belief[e, k]).sum()
                y = choices.targets[x[0], a]
                gain = cost[x[0]].min() - (0.0 if choices.goal[y] else cost[y].min())
                for j in np.flatnonzero(sees[:, k] * team.active[e]).tolist():
                    policy, b = team.policies[team.model[e, j]], team.belief[e, j]
                    moved = np.zeros_like(b)
                    for t, theta in enumerate(policy.pomdp.grid.theta.tolist()):
                        low, up = policy.pomdp.grid.shares(moved_by_hand(rule, theta, gain, a == slot, sees[j, k]))
                        moved[:, low] += (1 - up) * b[:, t]
                        moved[:, low + 1] += up * b[:, t]
                    there = team.x[e, j : j + 1]
                    after, now = (policy.q_values(there, one[None]).max() for one in (moved, b))
                    expected += chance * float(after - now)
            assert got[e, k, r] == pytest.approx(setting.gamma * expected, abs=1e-12)
            found.append(expected)
        return talks(team)

    _ = simulate(pool, watched, humans=[0, 1, 2], episodes=[0], seed=1)
    assert np.ptp(found) > 0.01


def test_a_task_on_demand_shows_the_same(tiny: Table) -> None:
    """Theta moves as on the enumerated task, whose rows are all there from the start."""
    neighbours = Neighbours(rule=SeenOutcome(0.1), sees="next")
    setting = Setting(neighbours=neighbours, c_suggest=0.0, knowledge="exact", max_steps=30)
    traces = []
    for task in (tiny, OnDemand(tiny.task, jobs=1)):
        trace = Trace()
        pool = Pool.sample(task, 3, seed=2, setting=setting)
        _ = simulate(pool, "reactive", humans=[0, 1, 2], episodes=6, seed=1, trace=trace)
        traces.append([(row["action"], row["suggestion"], row["theta"]) for row in trace])
    assert [row[:2] for row in traces[0]] == [row[:2] for row in traces[1]]
    np.testing.assert_allclose(*([row[2] for row in one] for one in traces), atol=1e-12)
    assert any(row[1] for row in traces[0])


@pytest.mark.parametrize("known", [True, False])
def test_people_of_an_environment_see_each_other(tiny: Table, known: bool) -> None:
    neighbours = Neighbours(rule=SeenFollowed(0.03, 0.02), sees="next", known=known)
    pool = Pool.sample(tiny, 3, seed=2, setting=Setting(neighbours=neighbours, c_suggest=0.0, trust="constant"))
    teams, draws, every = Teams(pool, 4, 3), CommonRandomNumbers(0, np.arange(4), 3), np.arange(4)
    teams.draw_from(draws)
    teams.begin(every, np.tile([0, 1, 2], (4, 1)), lambda kind: draws.draw(kind, every))
    before, state = teams.theta.copy(), teams.state()
    assert (state.beliefs.neighbours.believed is not NOBODY_SEES) == known
    taken = teams.step(every, state.act(np.zeros(4, dtype=np.int64), state.first_optimal()))
    suggested = pool.policies[0].pomdp.suggested[taken.before[:, 0], taken.heard[:, 0]]
    moved = np.where(taken.slot[:, 0] == suggested, 0.03, -0.02)
    np.testing.assert_allclose(teams.theta - before, np.stack([0 * moved, moved, 0 * moved], axis=1), atol=1e-12)


def test_theta_of_an_episode_does_not_depend_on_the_other_episodes(tiny: Table) -> None:
    """In some steps only people of other episodes are shown anything."""
    neighbours = Neighbours(rule=SeenFollowed(0.03, 0.03), sees="everybody")
    pool = Pool.sample(tiny, 3, seed=1, setting=Setting(neighbours=neighbours, c_suggest=0.3, c_move=0.1))
    options: dict[str, Any] = {"humans": 2, "seed": 5, "world": "model"}

    def thetas(episodes: int | list[int]) -> list[tuple[object, ...]]:
        trace = Trace()
        _ = simulate(pool, "attention", episodes=episodes, trace=trace, **options)
        return [(row["episode"], row["step"], row["person"], row["theta"]) for row in trace]

    together = thetas(24)
    for number in range(8):
        alone = thetas([number])
        assert alone == [row for row in together if row[0] == alone[0][0]]
