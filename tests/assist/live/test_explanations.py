"""Explanations: their numbers, their consequences by replay, and their sentences."""

from __future__ import annotations

import math
import pickle
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DOMAINS, kit, table_of

from assist.declare import AbsentError, Catalogue, InapplicableError, Refusal, catalogue, languages
from assist.live import (
    Advice,
    Assistant,
    Consequence,
    Contrast,
    Elapsed,
    Explanation,
    Prospect,
    Remark,
    TeamRecord,
    TraceReasons,
    WhyNothing,
    WhyPerson,
    WhyQuestion,
    WhyStep,
    contrast,
)
from assist.live.causes import CAUSES
from assist.live.live_task import LiveTask
from assist.live.simulated_person import SimulatedPerson
from assist.people.choices import Choices
from assist.person import QMDP, ObservationModel, Setting
from assist.person.qmdp import look_ahead
from assist.team import Pool, simulate
from assist.team.trace import Trace
from planner import CostToGo, Instance, OnDemand, Table, optimal_choices

DOMAINS_SEEN = (
    "kitting/paper", "kitting/costs/ways", "delivery/one-way", "lockers/two-lockers", "stations/three-boxes",
    "blocks/blocks-5",
)  # fmt: skip
SETTING = Setting(c_suggest=0.1, c_move=0.1)


def table(name: str) -> Table:
    problem = DOMAINS / f"{name}.pddl"
    return table_of(Instance(problem, problem.parent / "domain.pddl"))


class Replayed:
    """A task followed action by action, from its table alone."""

    def __init__(self, known: CostToGo) -> None:
        self.known = known
        self.rows = cache(self._rows)
        self.fewest = cache(self._fewest)

    def _rows(self, state: int) -> dict[str, tuple[float, int, bool]]:
        """Return the cost, the successor and the optimality of each applicable action."""
        found = self.known.choices([state])
        best = optimal_choices(self.known, [state], found)
        task = self.known.task
        return {
            task.actions[action]: (task.costs[action], int(to), bool(optimal))
            for action, to, optimal in zip(found.actions, found.targets, best, strict=True)
        }

    def h(self, state: int) -> float:
        return float(self.known.lookup([state])[0])

    def follows(self, state: int, plan: tuple[str, ...]) -> bool:
        """Return whether a plan reaches the goal at the cost h* of the state."""
        left, cost = state, 0.0
        for action in plan:
            paid, left, _ = self.rows(left)[action]
            cost += paid
        return bool(self.known.is_goal([left])[0]) and cost == self.h(state)

    def _fewest(self, state: int, action: str) -> int:
        """Return how often an action occurs at least in an optimal continuation, by recursion over all of them."""
        if self.known.is_goal([state])[0]:
            return 0
        return min(
            self.fewest(to, action) + (name == action) for name, (_, to, best) in self.rows(state).items() if best
        )

    def check(self, state: int, found: Contrast) -> str:
        """Check all claims of a contrast, and return the kind of its consequence."""
        rows = self.rows(state)
        (cost_a, to_a, _), (cost_b, to_b, _) = rows[found.step], rows[found.alternative]
        in_all_a, in_all_b = cost_a + self.h(to_a), cost_b + self.h(to_b)
        assert found.difference == (0 if in_all_a == in_all_b else in_all_b - in_all_a)
        assert found.unit == ("actions" if set(self.known.task.costs) == {1} else "cost")
        said = found.consequence
        if found.difference < 0:
            assert said is None
            return "better"
        if found.difference == 0:
            longer = rows[found.step][2] and not rows[found.alternative][2]
            assert said == (Consequence("longer") if longer else None)
            return "longer" if longer else "equal"
        kind = "none" if said is None else said.kind
        if kind == "dead-end":
            assert found.difference == math.inf
            return kind
        if kind == "same":
            assert to_a == to_b
            return kind
        if kind in ("needed", "possible"):
            assert said is not None
            self.check_action(said, found, to_a, to_b)
        if kind != "needed" and not self.known.searches:  # there is no simpler consequence
            for action in {a for plan in self.plans(to_b) for a in plan} - {found.step}:
                assert self.fewest(to_b, action) <= self.fewest(to_a, action)
        if kind == "no-closer":
            assert self.h(to_b) == self.h(state)
        elif kind == "further":
            assert self.h(to_b) > self.h(state)
        else:
            assert kind in ("needed", "possible", "none")
        return kind

    def check_action(self, said: Consequence, found: Contrast, to_a: int, to_b: int) -> None:
        action = said.action
        assert action is not None
        assert self.follows(to_b, said.after)
        assert self.follows(to_a, said.instead)
        otherwise = (found.step, *said.instead)
        assert said.after.count(action) > otherwise.count(action)
        assert said.again == (action in otherwise or action == found.alternative)
        if said.kind == "needed":  # in every optimal continuation, and more often
            assert self.fewest(to_b, action) > otherwise.count(action)
        elif not self.known.searches:
            assert not said.again
            assert all(action not in plan for plan in self.plans(to_a))

    def plans(self, state: int, most: int = 200) -> list[list[str]]:
        """Return optimal continuations from a state."""
        found: list[list[str]] = []

        def extend(at: int, plan: list[str]) -> None:
            if len(found) == most:
                return
            if self.known.is_goal([at])[0]:
                found.append(plan)
                return
            for name, (_, to, best) in self.rows(at).items():
                if best:
                    extend(to, [*plan, name])

        extend(state, [])
        return found


def said(found: Contrast) -> tuple[Any, ...]:
    """Return what a contrast says, apart from the plans that show it."""
    consequence = None if found.consequence is None else replace(found.consequence, after=(), instead=())
    return found.difference, consequence


def random_contrasts(known: Table, seed: int, count: int) -> list[str]:
    """Check contrasts of random pairs of actions in random states, of which half have an optimal step.

    A table, with its smaller limit of states, says the same, perhaps with other optimal plans.
    """
    rng, replayed, kinds, choices = np.random.default_rng(seed), Replayed(known), [], Choices.of(known)
    while len(kinds) < count:
        state = int(rng.integers(len(known)))
        rows = replayed.rows(state)
        if len(rows) < 2 or not np.isfinite(replayed.h(state)) or known.is_goal([state])[0]:
            continue
        best = [name for name, (_, _, optimal) in rows.items() if optimal]
        step = str(rng.choice(best if rng.random() < 0.5 else list(rows)))
        alternative = str(rng.choice([name for name in rows if name != step]))
        found = contrast(choices, state, step, alternative)
        if len(kinds) % 5 == 0:
            of_table = contrast(known, state, step, alternative)
            limited = contrast(choices, state, step, alternative, largest=200)
            assert said(of_table) == said(limited)
        kinds.append(replayed.check(state, found))
    return kinds


@pytest.mark.parametrize("count", [10, pytest.param(167, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", DOMAINS_SEEN)
def test_claims_hold_by_replay(name: str, count: int) -> None:
    known = table(name)
    kinds = random_contrasts(known, 2 if count > 10 else 1, count)
    assert len(set(kinds)) > 1
    assert kinds.count("needed") > 20 or count == 10


def test_the_other_action_may_reach_the_goal_at_a_higher_cost() -> None:
    choices = Choices.of(table("delivery/round-trip"))
    replayed, kinds = Replayed(table("delivery/round-trip")), set()
    for state, slot in np.argwhere(choices.applicable & choices.goal[choices.targets] & ~choices.optimal).tolist():
        if not choices.goal[state]:
            step, other = choices.name(state, int(choices.optimal[state].argmax())), choices.name(state, slot)
            kinds.add(replayed.check(state, contrast(choices, state, step, other)))
    assert kinds == {"none"}


def test_searched_tasks_compare_two_plans() -> None:
    """A task that is solved on demand is searched twice, for one plan each."""
    known = OnDemand(kit("tiny").task)
    replayed = Replayed(known)
    found = contrast(known, known.initial, "(fetch box-a)", "(fetch box-b)")
    assert found.difference == 0
    state = int(known.choices([known.initial]).targets[0])
    found = contrast(known, state, "(place hammer slot-1 box-a)", "(place hammer slot-2 box-a)")
    assert found.consequence is not None
    assert (found.consequence.kind, found.consequence.action) == ("possible", "(remove hammer slot-2 box-a)")
    assert replayed.check(state, found) == "possible"


def test_large_graphs_compare_two_plans() -> None:
    known = table("kitting/paper")
    choices = Choices.of(known)
    found = contrast(choices, choices.initial, "(fetch box-b)", "(fetch box-a)", largest=1)
    assert found.consequence is None or found.consequence.kind in ("possible", "no-closer", "further")
    state = int(choices.targets[choices.initial, 0])
    names = [choices.name(state, slot) for slot in range(int(choices.applicable[state].sum()))]
    step = choices.name(state, int(choices.optimal[state].argmax()))
    compared = [contrast(choices, state, step, name, largest=1) for name in names if name != step]
    worse = [one for one in compared if one.difference > 0]
    kinds = [one.consequence.kind for one in worse if one.consequence is not None]
    assert "possible" in kinds
    for one in worse:
        if one.consequence is not None and one.consequence.kind == "possible":
            replayed = Replayed(known)
            to = [replayed.rows(state)[action][1] for action in (one.step, one.alternative)]
            assert replayed.follows(to[1], one.consequence.after)
            assert replayed.follows(to[0], one.consequence.instead)


def test_an_action_in_the_same_words_is_no_consequence() -> None:
    """In this domain the words omit from where a block is moved."""
    known = table("tower/turn")
    choices, problem = Choices.of(known), LiveTask(known, SETTING, Assistant(known).population)
    seen = 0
    for state in range(len(known)):
        slots = [choices.name(state, slot) for slot in range(int(choices.applicable[state].sum()))]
        best = choices.name(state, int(choices.optimal[state].argmax()))
        for other in slots if not choices.goal[state] else ():
            if other != best:
                plain = contrast(choices, state, best, other).consequence
                said = contrast(choices, state, best, other, say=problem.say).consequence
                seen += plain != said
                assert said is None or said.action is None or problem.say(said.action) != problem.say(best)
    assert seen > 0


@pytest.mark.parametrize(
    ("step", "alternative", "message"),
    [
        ("(fetch box-a)", "(return box-a)", "(return box-a) is not applicable here"),
        ("(fetch box-a)", "(fetch box-z)", "(fetch box-z) is no action of the task"),
        ("(place hammer slot-1 box-a)", "(fetch box-a)", "is not applicable here"),
        ("(fetch box-a)", "(fetch box-a", "brackets"),
        ("(fetch box-a)", "fetch(box-a)", "(fetch box-a) is the step itself"),
    ],
)
def test_an_action_that_cannot_be_done_is_one_clear_error(step: str, alternative: str, message: str) -> None:
    known = kit("tiny")
    with pytest.raises(ValueError) as error:
        contrast(known, known.initial, step, alternative)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.cases
@pytest.mark.parametrize("policy", ["attention", "reactive"])
def test_a_dead_end_is_named(policy: str) -> None:
    """A person is told that the goal cannot be reached any more, and an operator when this is so of everybody."""
    team = Assistant(table("stations/one-way"), ["ann", "ben"], policy=policy, setting=SETTING)
    for person in ("ann", "ben"):
        team.observe(person, "(walk bench-1 bench-2)")
        assert math.isinf(team.person(person).cost_to_go)
        said = team.explain(person)
        assert said.nothing is not None
        assert said.nothing.reason == "dead-end"
        assert said.text() == "From here the goal can no longer be reached: undo the last step, or ask the operator."
        assert said.text("de").startswith("Von hier ist das Ziel nicht mehr zu erreichen: ")
        whole = team.explain().nothing
        assert whole is not None
        assert (whole.reason == "dead-end") == (person == "ben")
    team.undo("ben")
    again = team.explain("ben").nothing
    assert again is None or again.reason != "dead-end"


def test_there_is_nothing_to_compare_in_a_dead_end() -> None:
    known = table("kitting/sealed")
    dead = np.flatnonzero(np.isinf(known.h))
    state = next(int(x) for x in dead if np.diff(known.choices([x]).offsets)[0] > 1)
    step, alternative = (known.task.actions[action] for action in known.choices([state]).actions[:2])
    with pytest.raises(ValueError, match="can no longer be reached"):
        contrast(known, state, step, alternative)


# Advice.


def team(name: str = "kitting/paper", **more: Any) -> Assistant:
    return Assistant(table(name), ["ann", "ben"], setting=more.pop("setting", SETTING), **more)


def at_work(assistant: Assistant, known: Table, rounds: int = 30, seed: int = 0) -> list[Advice]:
    """Let two simulated people work, and return all advice."""
    mates = {name: SimulatedPerson(assistant.population, seed=seed + k) for k, name in enumerate(assistant.people)}
    given = []
    for _ in range(rounds):
        for name, mate in mates.items():
            given.append(assistant.recommend())
            seen = assistant.person(name)
            if not seen.finished:
                assistant.observe(name, mate.act(known, seen.state, seen.applicable, seen.suggestion))
    return given


def test_advice_explains_itself_when_asked_later() -> None:
    """Explanations are of the decision, whatever has happened since."""
    early, late = team(), team()
    known = table("kitting/paper")
    first = [advice.explanation for advice in [early.recommend()]]
    assert [late.recommend().explanation] == first
    mates = [SimulatedPerson(early.population, seed=7) for _ in range(2)]
    given, told = [], []
    for _ in range(12):
        for assistant, mate in zip((early, late), mates, strict=True):
            for name in ("ann", "ben"):
                advice = assistant.recommend()
                if assistant is early:
                    told.append(advice.explanation)
                else:
                    given.append(advice)
                seen = assistant.person(name)
                if not seen.finished:
                    assistant.observe(name, mate.act(known, seen.state, seen.applicable, seen.suggestion))
    assert [advice.explanation for advice in given] == told
    assert any(one.step is not None for one in told)
    assert any(one.nothing is not None for one in told)


def test_explanations_have_the_numbers_of_the_reason_and_of_the_belief() -> None:
    assistant, known = team(setting=Setting(c_suggest=0.05, c_move=0.02)), table("kitting/paper")
    given = at_work(assistant, known)
    suggested = [advice for advice in given if advice.suggestion is not None]
    assert len(suggested) > 3
    for advice in suggested:
        found = advice.explanation
        assert advice.reason is not None
        assert found.step is not None
        assert found.now is not None
        assert found.step.step == advice.suggestion
        mine = found.now.prospect
        assert mine.person == advice.person
        assert mine.score == pytest.approx(advice.reason.score, abs=1e-12)
        assert (mine.cost, mine.moving) == (0.05, advice.reason.moving)
        # Algorithm 1 goes to the largest score.
        assert all(other.score <= mine.score + 1e-12 for other in found.now.others)
        likely = found.step.likely
        assert likely is None or likely.probability is None or 0 <= likely.probability <= 1 - found.step.alone + 1e-12
    for advice in given:
        nothing = advice.explanation.nothing
        if nothing is not None and nothing.prospect is not None:
            assert nothing.prospect.score <= 0


def test_the_likeliest_worse_action_is_named_with_its_probability() -> None:
    """The probability is that of the robot's model without a suggestion, with beta integrated out."""
    known = kit("tiny")
    assistant = Assistant(known, ["ann"], setting=Setting(c_suggest=0.02, c_move=0.01))
    assistant.observe("ann", "(fetch box-a)")
    found = assistant.recommend().explanation
    assert found.step is not None
    assert found.step.likely is not None
    policy = LiveTask(known, assistant.setting, assistant.population).policy
    seen = assistant.person("ann")
    x = np.array([seen.state])
    choices = policy.pomdp.model.choices
    chances = {
        choices.name(seen.state, slot): float(
            (policy.pomdp.likelihood(x, np.array([0]), np.array([slot]))[0] * seen.belief).sum()
        )
        for slot in range(len(seen.applicable))
    }
    assert sum(chances.values()) == pytest.approx(1)
    assert found.step.alone == pytest.approx(chances[found.step.step])
    worse = {
        name: p
        for name, p in chances.items()
        if name != found.step.step and contrast(known, seen.state, found.step.step, name).difference > 0
    }
    assert found.step.likely.alternative == max(worse, key=worse.__getitem__)
    assert found.step.likely.probability == pytest.approx(max(worse.values()))


def test_the_threshold_is_where_the_decision_changes() -> None:
    """Nothing else about the problem changes: the cost of this one suggestion in this one state."""
    known = kit("paper")
    assistant = Assistant(known, ["ann"], setting=Setting(c_suggest=0.5, c_move=0.05))
    base = LiveTask(known, assistant.setting, assistant.population).policy
    assert isinstance(base, QMDP)
    for action in ("(fetch box-b)", None, None):
        advice = assistant.recommend()
        why = advice.explanation.nothing
        assert why is not None
        assert why.prospect is not None
        assert why.exact
        row = assistant.person("ann").state
        for above in (-1e-3, 1e-3):
            costs = base.pomdp.robot_costs.copy()
            names = [base.pomdp.suggestion(row, robot) for robot in range(costs.shape[1])]
            robot = names.index(why.prospect.action)
            costs[row, 1:] += 10
            costs[row, robot] = why.prospect.threshold + above
            priced = replace(base.pomdp, robot_costs=costs)
            other = Assistant(
                look_ahead(priced, base.value_mdp.copy()), ["ann"], setting=assistant.setting,
                population=assistant.population,
            )  # fmt: skip
            for done in [] if row == known.initial else assistant.log():
                other.observe("ann", done["action"])
            assert (other.recommend().suggestion == why.prospect.action) == (above < 0)
        if action is None:
            seen = assistant.person("ann")
            action = seen.applicable[0]
        assistant.observe("ann", action)


def test_asking_about_another_action() -> None:
    assistant = Assistant(kit("tiny"), ["ann", "ben"], setting=Setting(c_suggest=0.02, c_move=0.01))
    with pytest.raises(InapplicableError, match="nothing is suggested to ann now"):
        assistant.explain("ann", against="(fetch box-b)")
    assistant.observe("ann", "(fetch box-a)")
    assert assistant.recommend().suggestion == "(place hammer slot-1 box-a)"
    found = assistant.explain("ann", against="place(hammer, slot-2)")
    assert found.against is not None
    assert (found.against.difference, found.against.unit) == (2.0, "actions")
    assert found.text() == (
        "I suggest that you put hammer into slot-1. If you put hammer into slot-2 now, you will have to take hammer "
        "out of slot-2 later, even on the shortest way: 2 more steps."
    )
    assert found.sentences("de")[1] == (
        "Nach „Put hammer into slot-2“ kommt später noch „Take hammer out of slot-2“ dazu, auch auf dem kürzesten "
        "Weg: 2 Schritte mehr."
    )
    with pytest.raises(InapplicableError, match="not applicable here"):
        assistant.explain("ann", against="(fetch box-a)")
    with pytest.raises(Refusal, match="no action of the task"):
        assistant.explain("ann", against="(fly box-a)")
    with pytest.raises(AbsentError, match="not in the team"):
        assistant.explain("carl")


def test_policies_that_do_not_weigh_costs() -> None:
    nothing = team("kitting/tiny", policy="none").recommend().explanation.nothing
    assert nothing is not None
    assert nothing.reason == "never"
    assistant = team("kitting/tiny", policy="reactive")
    found = assistant.recommend().explanation
    assert found.text() == "I step in after a mistake, and of those without a suggestion, nobody's last step was one."
    assistant.observe("ann", "(fetch box-a)")
    assistant.observe("ann", "(return box-a)")
    assert assistant.erred("ann")
    advice = assistant.recommend()
    assert advice.person == "ann"
    assert "I step in after a mistake, and your last step was not one of the best." in advice.explanation.sentences()
    assert assistant.explain("ben").text() == "I step in after a mistake, and your last step was not one."


def test_other_reasons_why_nothing_is_suggested() -> None:
    assistant, known = team("kitting/tiny", setting=Setting(c_suggest=0.02, c_move=0.01)), kit("tiny")
    plan = known.optimal_plan()
    assert plan is not None
    for action in plan:
        assistant.observe("ann", action)
    assert assistant.explain("ann").text() == "You have reached the goal."
    assistant.leave("ben")
    assert assistant.recommend().explanation.text() == "There is nobody whom I could help right now."
    assistant.join("ben")
    assistant.observe("ben", "(fetch box-a)")
    advice = assistant.recommend()
    assert advice.suggestion is not None
    assert "there is nobody else whom I could help right now." in advice.explanation.text()
    assistant.elapse()
    assert assistant.recommend().explanation.text() == "Everybody who is still at work has a suggestion already."


def test_a_robot_on_its_way_says_so() -> None:
    setting = Setting(c_suggest=0.02, c_move=0.01, travel_time=2.0)
    assistant = Assistant(kit("tiny"), ["ann"], setting=setting)
    assistant.observe("ann", "(fetch box-a)")
    advice = assistant.recommend()
    assert not advice.arrived
    assert advice.explanation.sentences()[0] == "I am on my way to you."
    assert assistant.explain("ann").sentences()[0] == "I am on my way to you."


def test_large_tasks_are_explained_too() -> None:
    setting = Setting(c_suggest=0.02, c_move=0.01)
    assistant = Assistant(OnDemand(kit("tiny").task), ["ann"], setting=setting, policy="priority")
    found = assistant.recommend().explanation
    assert found.nothing is not None or found.step is not None
    assert found.text()


@pytest.mark.parametrize("options", [{}, {"robots": 2}, {"observation": ObservationModel(0.1, 0.1)}])
def test_a_trace_explains_suggestions_as_a_live_team_does(options: dict[str, Any]) -> None:
    """The trace is otherwise the same to the byte, also with a policy that uses no beliefs."""
    known = table("kitting/tiny")
    pool = Pool.sample(known, 3, seed=1, setting=replace(SETTING, **options))
    for policy in ("attention", "reactive"):
        plain, explained = Trace(), Trace()
        simulate(pool, policy, humans=[2, 0], episodes=4, seed=3, trace=plain)
        explains = TraceReasons(pool.policies, known)
        simulate(pool, policy, humans=[2, 0], episodes=4, seed=3, trace=explained, reasons=explains)
        reasons = [row.pop("explanation", None) for row in explained]
        assert explained == plain
        if not pool.setting.observation:  # else a suggestion may not be applicable in the true state
            assert [reason is not None for reason in reasons] == [row["suggestion"] is not None for row in plain]
        assert any(reasons)
        for row, reason in zip(plain, reasons, strict=True):
            if reason is not None:
                assert reason["now"]["prospect"]["person"] == row["person"]
                assert reason["step"]["step"] == row["suggestion"] or pool.setting.observation
                assert reason["text"].startswith("I suggest that you ")
    if options:
        return
    live = Assistant(people={row["person"]: pool.policies[0] for row in plain}, policy="reactive", setting=pool.setting)
    for row, reason in zip(plain, reasons, strict=True):
        if row["episode"] == "reactive-0":
            if row["place"] == 0:
                advice = live.recommend()
            if reason is not None:
                live_one = advice.explanation.as_dict()
                assert [live_one[part] for part in ("step", "now")] == [reason["step"], reason["now"]]
            live.observe(row["person"], row["action"])


def test_advice_stays_what_it_was() -> None:
    """An explanation is no field: records, copies and comparisons of advice are without it."""
    advice = team("kitting/tiny").recommend()
    assert advice.explanation
    assert set(asdict(advice)) == {"person", "suggestion", "reason", "arrived", "question"}
    assert pickle.loads(pickle.dumps(advice)) == advice
    record = TeamRecord.of(TeamRecord(n=1, event=Elapsed(), step=1, advices=(advice,)).text())
    assert record.advices == (advice,)
    with pytest.raises(ValueError, match="from a record"):
        _ = record.advices[0].explanation


# Texts.


def explanations() -> list[Explanation]:
    """Return explanations that use every text."""
    found = []
    kinds: list[Consequence | None] = [None]
    kinds += [Consequence(kind) for kind in ("same", "no-closer", "further", "dead-end")]  # type: ignore[arg-type]
    kinds += [Consequence(kind, "(undo b)", again) for kind in ("needed", "possible") for again in (False, True)]  # type: ignore[arg-type]
    for unit in ("actions", "cost"):
        found += [
            Explanation(against=Contrast("(a)", "(b)", size, unit, kind if size > 0 else None))  # type: ignore[arg-type]
            for kind in kinds
            for size in (-2.0, -1.0, 0.0, 1.0, 3.0, math.inf if kind and kind.kind == "dead-end" else 2.0)
        ]
    found.append(Explanation(against=Contrast("(a)", "(b)", 0.0, "cost", Consequence("longer"))))
    some = Contrast("(a)", "(b)", 2.0, "actions", None, 0.2)
    for moving, here in ((0.0, False), (0.0, True), (0.5, False)):
        for worth in (0.0, 0.001, 2.0):
            mine = Prospect("ann", "(a)", worth, 0.1, moving)
            for other in (None, 0.0, 0.4, 2.0, 9.0):
                others = () if other is None else (Prospect("ben", "(b)", other, 0.1, 0.0),)
                for rule in ("attention", "priority", "reactive"):
                    for arrived in (True, False):
                        now = WhyPerson(mine, here, arrived, others, rule)
                        found += [Explanation(WhyStep("(a)", 0.6, some), now), Explanation(now=now)]
            for exact in (True, False):
                for about in (None, "ann"):
                    for elsewhere in (False, True):
                        why = WhyNothing("cost", "attention", mine, exact=exact, elsewhere=elsewhere, about=about)
                        found.append(Explanation(nothing=why, words={"(a)": "Do A"}))
    hardly = Prospect("ann", "(a)", 1e-9, 0.1, 0.0)
    found.append(Explanation(nothing=WhyNothing("cost", "attention", hardly, exact=True)))
    found.append(Explanation(WhyStep("(a)", 1.0, None)))
    found.append(Explanation(WhyStep("(a)", 0.6, some, "kit-a", 0.8)))
    now = WhyPerson(Prospect("ann", "(a)", 2.0, 0.1, 0.0), True, True, (), "attention")
    found.append(Explanation(WhyStep("(a)", 0.5, Contrast("(a)", "(b)", 0.0, "actions", None, 0.5)), now))
    for seen, followed in ((0.5, True), (-0.5, False)):
        mine = Prospect("ann", "(a)", 0.2, 0.1, 0.0, seen)
        sight = Remark("saw_followed" if followed else "saw_declined", "Ben")
        found.append(Explanation(now=WhyPerson(mine, True, False, (), "attention-outlook", sight)))
        found.append(found[-1].without_names())
    found.append(Explanation(WhyStep("(a)", 0.6, some)).in_state(0.8))
    for reason in (one.key for one in CAUSES):
        if reason in ("cost", "asked"):
            continue
        found += [Explanation(nothing=WhyNothing(reason, "reactive", about=one)) for one in (None, "ann")]
    for asked in (WhyQuestion("ann", None, 0.5), WhyQuestion("ann", "kit-a", 0.001)):
        asking = [WhyNothing("asked", "attention", about=one, question=asked) for one in (None, "ann")]
        found += [Explanation(nothing=one) for one in asking]
    return found


@pytest.mark.parametrize("language", languages())
def test_every_text_is_used_and_is_a_sentence(language: str, monkeypatch: pytest.MonkeyPatch) -> None:
    used: set[str] = set()

    class Noted(dict[str, str]):
        def __getitem__(self, key: str) -> str:
            used.add(key)
            return super().__getitem__(key)

    noted = Catalogue(catalogue(language).file, Noted(catalogue(language).texts))
    monkeypatch.setattr("assist.live.explanation.catalogue", lambda _: noted)
    step = {"en": "step", "de": "Schritt"}[language]  # which a cost is not called
    for one in explanations():
        for sentence in one.sentences(language):
            assert sentence.endswith("."), sentence
            assert not sentence[0].islower(), sentence
            assert not set("{}") & set(sentence), sentence
            assert "None" not in sentence, sentence
            assert ".." not in sentence, sentence
            assert one.against is None or one.against.unit != "cost" or step not in sentence, sentence
    others = ("date", "page", "task", "study", "question", "form", "tlx", "refusals", "drawing", "report")
    assert used == {key for key in noted.texts if key.partition(".")[0] not in others}


def test_numbers_in_sentences() -> None:
    en, de = catalogue("en"), catalogue("de")
    assert [en.number(value) for value in (0.1, 0.0314, 3.14, 12.6, 1000)] == ["0.1", "0.031", "3.1", "13", "1000"]
    assert de.number(0.25) == "0,25"
    assert [en.percent(share) for share in (0, 0.001, 0.5, 0.999, 1)] == ["0 %", "1 %", "50 %", "99 %", "100 %"]
    assert [en.about(value) for value in (0.001, 0.5)] == ["less than 0.01", "about 0.5"]
    for value in (0.019999, 0.3149, 7.99, 0.5, 0.1, 1e-5, 12.9):
        said = float(en.below(value))
        assert value * 0.9 <= said <= value


def test_languages_are_files(tmp_path: Path) -> None:
    assert languages()[0] == "en"
    own = tmp_path / "own.toml"
    text = catalogue("en").file.read_text()
    own.write_text(text.replace("You have reached the goal.", "Done."))
    done = Explanation(nothing=WhyNothing("finished", "attention"))
    assert done.text(str(own)) == "Done."
    for wrong, message in (
        (text.replace('paused = "Suggestions are paused."', ""), "nothing.paused: is missing; expected a text"),
        (text + 'more = "..."', "refusals.more: unknown; expected no text"),
        (text.replace("{left}, and", "{rest}, and"), "person.nobody_else: {rest}; expected left"),
        ("a = ", ".toml:1: not TOML (end of document: Invalid value)"),
    ):
        file = tmp_path / f"own-{len(message)}.toml"
        file.write_text(wrong)
        with pytest.raises(ValueError, match=r"\.toml:[1-9]\d*: ") as error:
            done.text(str(file))
        assert message in str(error.value)
    with pytest.raises(ValueError, match="language 'fr': expected one of en, de"):
        done.text("fr")
    with pytest.raises(ValueError, match=r"nowhere\.toml"):
        done.text(str(tmp_path / "nowhere.toml"))


def test_actions_without_words_are_in_pddl() -> None:
    found = Explanation(against=Contrast("(a b)", "(c d)", 1.0, "actions", Consequence("no-closer")))
    assert found.text() == "If you do (c d) now, that brings you no closer to the goal: 1 more step."
    found = found.in_words({"(c d)": "See D"})
    assert found.text() == "If you see D now, that brings you no closer to the goal: 1 more step."


def test_data_without_other_peoples_names() -> None:
    now = WhyPerson(Prospect("ann", "(a)", 1, 0.1, 0), False, True, (Prospect("ben", "(b)", 0.5, 0.1, 0),), "attention")
    found = Explanation(now=now, against=Contrast("(a)", "(b)", math.inf, "cost", Consequence("dead-end")))
    assert "ben" in str(found.as_dict())
    assert "ben" not in str(found.without_names().as_dict())
    assert found.as_dict()["against"]["difference"] is None


def test_a_suggestion_that_is_open_again_after_an_undo_has_the_reason_that_its_explanation_has() -> None:
    rng = np.random.default_rng(1)
    team = Assistant(table("kitting/paper"), ["ann", "bob"], setting=SETTING)
    while (advice := team.recommend()).reason is None or not advice.reason.moving:
        for name in team.people:
            team.observe(name, str(rng.choice(team.person(name).applicable)))
    person = str(advice.person)
    team.observe(person, team.person(person).applicable[-1])
    team.undo(person)
    offer, why = team.entry(person).offer, team.explain(person).now
    assert offer is not None
    assert offer.reason is not None
    assert why is not None
    assert offer.action == advice.suggestion
    assert (offer.reason.moving, advice.reason.moving) == (0.0, 0.1), "the robot is there now"
    assert offer.reason.score == pytest.approx(why.prospect.score, abs=1e-12)
    assert offer.reason.beta == pytest.approx(advice.reason.beta, abs=1e-12), "the belief is the same as then"
