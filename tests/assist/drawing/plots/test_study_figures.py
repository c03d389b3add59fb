from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, thinned
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

from assist.drawing.plots import belief_figure, episode_figure, trade_off_figure
from assist.drawing.plots import study as study_figures
from assist.drawing.plots import userstudy as userstudy_figures
from assist.drawing.plots.study import COMPARISONS
from assist.drawing.plots.style import LOOKS, PolicyLook, looks, save_for_pages
from assist.people import Choices, Goals, Neighbours, Population
from assist.person.settings import Setting
from assist.team import AttentionSwitching, NoAssistance, Pool, beliefs_of_episode, simulate
from assist.team.illustration import sights
from assist.team.trace import Trace
from planner import load, sweep_goals

POLICIES = ("none", "reactive", "attention", "our-own")
INSTANCES = ("paper", "paper-fixed")
CATEGORIES = ("novices, wary", "experts, wary", "novices, trusting", "experts, trusting")
SAVINGS = {"actions against none": 24.5, "actions against reactive": 12.5, "interventions against reactive": 26.0}


def intervals(rows: list[dict[str, object]], seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    mean = rng.uniform(5, 25, len(rows))
    return pd.DataFrame(rows).assign(mean=mean, sd=mean / 3, low=mean - 1.5, high=mean + 2, n=30)


@pytest.fixture(scope="module")
def team_sizes() -> pd.DataFrame:
    rows = [
        {"instance": i, "policy": p, "humans": k, "measure": m}
        for i in INSTANCES for m in ("actions", "interventions") for p in POLICIES for k in (3, 1, 2)
    ]  # fmt: skip
    return intervals(rows)


@pytest.fixture(scope="module")
def categories() -> pd.DataFrame:
    rows = [
        {"instance": i, "policy": p, "category": c, "measure": m}
        for i in INSTANCES for m in ("actions", "interventions") for p in POLICIES for c in reversed(CATEGORIES)
    ]  # fmt: skip
    return intervals(rows)


@pytest.fixture(scope="module")
def costs() -> pd.DataFrame:
    rows = [
        {"instance": "paper", "policy": p, "c_suggest": c, "c_move": c, "actions": a, "interventions": i}
        for p, points in {
            "none": [(20.0, 0.0)] * 3,
            "reactive": [(16.0, 10.0)] * 3,
            "attention": [(12.0, 9.0), (14.0, 5.0), (19.0, 1.0)],
        }.items()
        for c, (a, i) in zip((0.0, 0.5, 4.0), points, strict=True)
    ]
    frame = pd.DataFrame(rows)
    for name in ("actions", "interventions"):
        frame = frame.assign(**{f"{name}_low": frame[name] - 0.5, f"{name}_high": frame[name] + 0.7})
    return frame


@pytest.fixture(scope="module")
def pool(tiny_choices: Choices) -> Pool:
    return Pool.sample(tiny_choices, 4, seed=0, population=Population(beta=(0.1, 1.5)))


def where(frame: pd.DataFrame, **values: str) -> pd.DataFrame:
    for column, value in values.items():
        frame = frame[frame[column] == value]
    return frame


def lines_of(axis: Axes, look: PolicyLook) -> np.ndarray:
    """Return the points of a policy's line, without those of its markers."""
    [line] = [one for one in axis.get_lines() if one.get_color() == look.color and one.get_linestyle() != "None"]
    return np.asarray(line.get_xydata())


def bars_of(axis: Axes, color: str) -> list[tuple[float, float]]:
    """Return the ends of all vertical bars of a colour."""
    bars = [bar for bar in axis.collections if isinstance(bar, LineCollection) and to_hex(bar.get_color()[0]) == color]
    return [(part[0][1], part[1][1]) for bar in bars for part in bar.get_segments()]


def words(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[-1].get_texts()]


def overlaps(texts: list[Text]) -> list[tuple[str, str]]:
    boxes = [(text.get_text(), Text.get_window_extent(text)) for text in texts]  # without the line to the point
    return [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)]


def test_a_policy_looks_the_same_in_every_company() -> None:
    assert looks(["attention", "none"]) == {"none": LOOKS["none"], "attention": LOOKS["attention"]}
    for name in ("our-own", "bandit"):
        assert looks([name])[name] == looks(["none", "reactive", "attention", name])[name]
    assert looks(["b", "a"]) == looks(["a", "b", "a"])
    for names in (["p1", "p2", "p3", "p4"], ["oracle", "bandit", "random", "mine"]):
        found = looks([*LOOKS, *names])
        assert list(found) == [*LOOKS, *sorted(names)]
        assert len({look.color for look in found.values()}) == len(found)
        # Policies can be distinguished without colours: every colour has another marker.
        assert len({look.marker for look in found.values()}) == len(found)
    assert len(set(looks([f"policy-{n}" for n in range(12)]).values())) == 12
    assert len(looks([f"policy-{n}" for n in range(40)])) == 40


@pytest.mark.slow
def test_team_sizes_are_drawn_as_given(team_sizes: pd.DataFrame) -> None:
    figure = study_figures.team_size_figure(team_sizes)
    panels = iter(figure.axes)
    for instance in INSTANCES:
        for measure in ("actions", "interventions"):
            axis = next(panels)
            assert measure in axis.get_ylabel()
            for policy, look in looks(POLICIES).items():
                own = where(team_sizes, instance=instance, measure=measure, policy=policy)
                own = own.sort_values("humans")
                line = lines_of(axis, look)
                assert np.abs(line[:, 0] - [1, 2, 3]).max() < 0.4
                np.testing.assert_allclose(line[:, 1], own["mean"])
                bars = [*zip(own["mean"] - own["sd"], own["mean"] + own["sd"], strict=True)]
                bars += [*zip(own["low"], own["high"], strict=True)]
                np.testing.assert_allclose(bars_of(axis, look.color.lower()), bars)
                assert policy in [text.get_text() for text in axis.texts]
            assert axis.get_ylim()[0] == 0
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["paper", "", "paper-fixed", ""]
    assert any("30 runs" in text for text in legend(figure))


@pytest.mark.parametrize("sizes", thinned([{1, 3}, {2}]))
def test_team_sizes_that_were_simulated_are_marked_and_no_others(team_sizes: pd.DataFrame, sizes: set[int]) -> None:
    figure = study_figures.team_size_figure(team_sizes[team_sizes["humans"].isin(sizes)])
    for axis in figure.axes:
        low, high = axis.get_xlim()
        assert [tick for tick in axis.get_xticks() if low <= tick <= high] == sorted(sizes)


def test_categories_are_drawn_as_given_beside_what_was_published(categories: pd.DataFrame) -> None:
    published = ((CATEGORIES[:2], 4.0), (CATEGORIES[2:3], 32.0))
    figure = study_figures.category_figure(categories, CATEGORIES, published, "theirs")
    for number, axis in enumerate(figure.axes):
        instance, measure = INSTANCES[number // 2], ("actions", "interventions")[number % 2]
        if number // 2 == 1:  # the axis is shared
            assert [label.get_text().replace("\n", " ") for label in axis.get_xticklabels()] == list(CATEGORIES)
        for policy, look in looks(POLICIES).items():
            own = where(categories, instance=instance, measure=measure, policy=policy)
            [marks] = [np.asarray(one.get_xydata()) for one in axis.get_lines() if one.get_color() == look.color]
            drawn = {CATEGORIES[round(x)]: y for x, y in marks}
            assert drawn == pytest.approx(dict(zip(own["category"], own["mean"], strict=True)))
        dashed = [np.asarray(one.get_xydata()) for one in axis.get_lines() if one.get_linestyle() == "--"]
        spans = {CATEGORIES[i]: y for (x0, y), (x1, _) in dashed for i in range(4) if x0 < i < x1}
        assert spans == (
            {CATEGORIES[0]: 4.0, CATEGORIES[1]: 4.0, CATEGORIES[2]: 32.0} if measure == "interventions" else {}
        )
        assert measure == "actions" or axis.get_ylim()[1] > 32.0
    assert "theirs: 4, 32" in legend(figure)
    assert set(POLICIES) <= set(legend(figure))
    without = study_figures.category_figure(categories, CATEGORIES)
    assert not any(one.get_linestyle() == "--" for axis in without.axes for one in axis.get_lines())
    assert len(legend(without)) == len(legend(figure)) - 1


def test_the_trade_off_has_every_point_and_the_papers(costs: pd.DataFrame) -> None:
    figure = trade_off_figure(costs, SAVINGS, "theirs")
    [axis] = figure.axes
    for policy, look in looks(["none", "reactive", "attention"]).items():
        own = costs[costs["policy"] == policy]
        np.testing.assert_allclose(lines_of(axis, look), own[["interventions", "actions"]])
        assert set(zip(own["actions_low"], own["actions_high"], strict=True)) <= set(bars_of(axis, look.color.lower()))
    stars = [one.get_xydata()[0].tolist() for one in axis.get_lines() if one.get_marker() == "*"]
    x = 10 * (1 - 0.26)
    assert stars == [pytest.approx([x, 20 * (1 - 0.245)]), pytest.approx([x, 16 * (1 - 0.125)])]
    # Costs are shown only next to points of a policy that depends on them.
    assert sorted(text.get_text() for text in axis.texts) == [
        "0, 0", "0.5, 0.5", "4, 4", "against none", "against reactive",
    ]  # fmt: skip
    without = trade_off_figure(costs[costs["policy"] == "attention"], SAVINGS)
    assert not any(one.get_marker() == "*" for one in without.axes[0].get_lines())


def test_each_cost_of_moving_has_a_line(costs: pd.DataFrame) -> None:
    own = costs[costs["policy"] == "attention"]
    grid = pd.concat([own.assign(c_move=0.0), own.assign(c_move=1.0, actions=own["actions"] + 1)])
    [axis] = trade_off_figure(grid).axes
    lines = [one.get_ydata().tolist() for one in axis.get_lines()]
    assert lines == [[12.0, 14.0, 19.0], [13.0, 15.0, 20.0]]


@pytest.mark.slow
def test_benefits_are_drawn_as_given() -> None:
    rows = [
        {"instance": i, "humans": k, "comparison": c} for i in INSTANCES for c in [*COMPARISONS, "x"] for k in (1, 2)
    ]
    cells = intervals(rows)
    cells.loc[cells["comparison"].eq("x") & cells["humans"].eq(2), "mean"] = np.nan
    figure = study_figures.benefit_figure(cells, SAVINGS, "theirs")
    for instance, axis in zip(INSTANCES, figure.axes, strict=True):
        for comparison, look in {**COMPARISONS, **looks(["x"])}.items():
            own = where(cells, instance=instance, comparison=comparison).dropna()
            [line, *_] = [one.get_ydata() for one in axis.get_lines() if one.get_color() == look.color]
            np.testing.assert_allclose(line, own["mean"])
        stars = {one.get_color(): one.get_ydata()[0] for one in axis.get_lines() if one.get_marker() == "*"}
        assert stars == {COMPARISONS[name].color: value for name, value in SAVINGS.items()}
    assert "theirs, over all team sizes" in legend(figure)
    without = study_figures.benefit_figure(cells)
    assert legend(without) == ["95 % interval"]
    assert not any(one.get_marker() == "*" for axis in without.axes for one in axis.get_lines())


def test_what_was_believed_is_what_the_episode_had(pool: Pool) -> None:
    """The beliefs are those of a filter, from which people's beta has the same shares between its ends."""
    for policy, humans in ((AttentionSwitching(), [0, 3]), (NoAssistance(), [2])):
        trace = Trace()
        [expected] = simulate(pool, policy, humans=humans, episodes=[5], seed=3, name="mine", trace=trace)
        episode, rows = beliefs_of_episode(pool, policy, humans=humans, episode=5, seed=3, name="mine")
        assert episode == expected
        assert sum(row["suggestion"] for row in rows) == episode.interventions
        assert [(row["place"], row["step"], row["theta_true"], row["robot_here"]) for row in rows] == [
            (row["place"], row["step"], row["theta"], row["place"] in row["robot_places"]) for row in trace
        ]
        for place, person in enumerate(humans):
            pomdp = pool.policies[person].pomdp
            choices, belief, x = pomdp.model.choices, pomdp.prior[None], pomdp.model.choices.initial
            own = [(row, action) for row, action in zip(rows, trace, strict=True) if row["place"] == place]
            assert len(own) == episode.actions[place]
            for row, action in own:
                beta, theta = belief[0].sum(axis=1), belief[0].sum(axis=0)
                assert row["beta_true"] == episode.beta[place]
                assert row["beta_mean"] == pytest.approx(float(pomdp.grid.beta @ beta))
                assert row["theta_mean"] == pytest.approx(float(pomdp.grid.theta @ theta))
                ends = np.interp([0.05, 0.95], [0, *beta.cumsum()], np.linspace(0.1, 1.5, len(beta) + 1))
                assert (row["beta_low"], row["beta_high"]) == pytest.approx(tuple(ends))
                names = [choices.name(x, slot) for slot in range(int(choices.applicable[x].sum()))]
                slot, said = names.index(action["action"]), 0
                if action["suggestion"] is not None:
                    said = int(np.flatnonzero(pomdp.suggested[x] == names.index(action["suggestion"]))[0])
                belief = pomdp.update(belief, np.array([x]), np.array([said]), np.array([slot]))
                x = int(choices.targets[x, slot])


def test_what_is_not_known_under_way_leaves_no_hole(tiny_choices: Choices) -> None:
    pool = Pool.sample(
        tiny_choices, 4, seed=0, setting=Setting(travel_time=2.0), population=Population(beta=(0.1, 0.3))
    )
    episode, rows = beliefs_of_episode(pool, AttentionSwitching(), humans=2, episode=0, seed=0)
    beliefs = pd.DataFrame(rows)
    unknown = beliefs["beta_mean"].isna()
    assert unknown.any()
    assert not unknown.all()
    assert beliefs["theta_high"].isna().equals(unknown)
    figure = belief_figure(beliefs, episode)
    known = beliefs[~unknown & beliefs["place"].eq(0)]
    np.testing.assert_allclose(figure.axes[0].get_lines()[0].get_xydata(), known[["step", "beta_mean"]])


def test_beliefs_are_drawn_beside_the_truth(pool: Pool) -> None:
    episode, rows = beliefs_of_episode(pool, AttentionSwitching(), humans=3, episode=5, seed=3, name="mine")
    beliefs = pd.DataFrame(rows)
    figure = belief_figure(beliefs, episode)
    assert [axis.get_title(loc="left") for axis in figure.axes[::2]] == list(episode.people)
    for number, axis in enumerate(figure.axes):
        own, name = beliefs[beliefs["place"] == number // 2], ("beta", "theta")[number % 2]
        believed, true, told = axis.get_lines()
        np.testing.assert_allclose(believed.get_xydata(), own[["step", f"{name}_mean"]])
        np.testing.assert_allclose(true.get_xydata(), own[["step", f"{name}_true"]])
        assert told.get_xdata().tolist() == own["step"][own["suggestion"]].tolist()
        assert len(axis.patches) == own["robot_here"].sum()
        assert axis.get_ylim()[1] > own[[f"{name}_high", f"{name}_true"]].max(axis=None)
    assert f"Episode {episode.episode} under the policy 'mine'" in words(figure)


@pytest.mark.slow
def test_four_files_are_written_whole(tmp_path: Path, costs: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    backgrounds = []

    def draw() -> Figure:
        figure = trade_off_figure(costs)
        backgrounds.append(to_hex(figure.get_facecolor()))
        return figure

    files = save_for_pages(draw, tmp_path / "new", "costs")
    assert [file.name for file in files] == ["costs.png", "costs.svg", "costs-dark.png", "costs-dark.svg"]
    assert sorted(files) == sorted((tmp_path / "new").iterdir())
    assert all(file.read_bytes().startswith(b"\x89PNG" if file.suffix == ".png" else b"<?xml") for file in files)
    light, dark = backgrounds
    assert light == "#ffffff"
    assert int(dark[1:3], 16) < 50
    assert dark in files[3].read_text()
    assert dark not in files[1].read_text()

    before = [file.read_bytes() for file in files]
    save_for_pages(draw, tmp_path / "new", "costs")
    assert [file.read_bytes() for file in files] == before

    def broken(_: Figure, path: Path, **how: object) -> None:
        path.write_text("half of a pic")
        raise OSError(f"no space for {path} {how}")

    monkeypatch.setattr(Figure, "savefig", broken)
    with pytest.raises(OSError, match="no space"):
        save_for_pages(draw, tmp_path / "new", "costs")
    assert [file.read_bytes() for file in files] == before
    assert sorted(files) == sorted((tmp_path / "new").iterdir())


def test_intervals_of_few_pools_do_not_squeeze_the_rest(costs: pd.DataFrame, team_sizes: pd.DataFrame) -> None:
    wide = costs.assign(interventions_low=-100.0, interventions_high=120.0, actions_low=-90.0, actions_high=130.0)
    [axis] = trade_off_figure(wide).axes
    assert -1 < axis.get_xlim()[0] <= 0  # the number of interventions is nonnegative
    assert axis.get_xlim()[1] < 15
    assert axis.get_ylim()[0] >= 10
    assert axis.get_ylim()[1] < 25
    for one in study_figures.team_size_figure(where(team_sizes, instance="paper").assign(low=-300.0, high=300.0)).axes:
        assert one.get_ylim()[0] == 0
        assert one.get_ylim()[1] < 60


def test_a_single_episode_has_no_bars(team_sizes: pd.DataFrame, categories: pd.DataFrame) -> None:
    nothing = {"sd": None, "low": None, "high": None, "n": 1}
    sizes, kinds = (where(frame, instance="paper").assign(**nothing) for frame in (team_sizes, categories))
    for figure in (study_figures.team_size_figure(sizes), study_figures.category_figure(kinds, CATEGORIES)):
        assert not any(isinstance(one, LineCollection) for axis in figure.axes for one in axis.collections)
        words_below = [text.get_text() for one in figure.legends for text in one.get_texts()]
        assert not any("interval" in text or "deviation" in text for text in words_below)


def test_an_episodes_picture_counts_what_the_robot_executes(tiny_choices: Choices) -> None:
    pool = Pool.sample(tiny_choices, 3, seed=2, setting=Setting(execute=True, c_execute=0.1, c_move=0.1))
    trace = Trace()
    [episode] = simulate(pool, "priority", humans=2, episodes=[0], seed=7, trace=trace)
    assert any(row["action"] is None for row in trace)
    suggested = sum(row["suggestion"] is not None for row in trace)
    figure = episode_figure(episode, trace)
    counts = f"suggestions: {suggested}, executed by the robot: {sum(episode.executed)}, moves: {episode.moves}"
    assert counts in " ".join(figure.get_suptitle().split())
    said = [next(text.get_text() for text in axis.texts if "after" in text.get_text()) for axis in figure.axes]
    assert said == [f"finished after {count} action{'s' * (count != 1)}" for count in episode.actions]


def test_an_episodes_picture_has_each_persons_goal_if_there_are_several() -> None:
    tables = sweep_goals([load(ROOT / f"docs/examples/kits/{name}.pddl") for name in ("travel", "mend")])
    goals = Goals(dict(zip(("travel", "a mend with a name that is long"), tables, strict=True)))
    pool, trace = Pool.sample(goals, 3, seed=2), Trace()
    [episode] = simulate(pool, "none", humans=3, episodes=[0], seed=7, trace=trace)
    pursued = [next(row["goal"] for row in trace if row["place"] == k) for k in range(3)]
    assert len(set(pursued)) == 2
    axes = episode_figure(episode, trace).axes
    said = [[text.get_text() for text in axis.texts if text.get_text().startswith("goal")] for axis in axes]
    assert said == [["goal travel" if goal == "travel" else "goal a mend with a name that …"] for goal in pursued]


def test_lines_between_stations_say_who_saw_a_suggestion(tiny_choices: Choices) -> None:
    neighbours = Neighbours(rule="followed", sees="next", weight=0.5)
    pool = Pool.sample(tiny_choices, 3, seed=2, setting=Setting(c_suggest=0.0, c_move=0.0, neighbours=neighbours))
    trace = Trace()
    [episode] = simulate(pool, "attention", humans=3, episodes=[0], seed=7, trace=trace)
    figure = episode_figure(episode, trace, None, list(sights(trace, pool.setting.neighbourhood(3))))
    lines = [one for one in figure.artists if one.get_gid() == "link"]
    last = {row["place"]: row["step"] for row in trace}
    told = [(row["place"], row["step"]) for row in trace if row["suggestion"]]
    expected = sum(abs(k - place) == 1 and last[k] > step for place, step in told for k in range(3))
    assert len(lines) == expected > 0
    assert "seen by a neighbour" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert not [one for one in episode_figure(episode, trace).artists if one.get_gid() == "link"]


def test_figures_of_scales_show_the_whole_scale() -> None:
    cells = [{"condition": "none", "item": "rely", "n": 2, "mean": 5.5, "low": 4.5, "high": 7.0}]
    measures = [{"measure": name, "label": name, "ends": ends, "cells": cells}
                for name, ends in (("trust", [1.0, 7.0]), ("actions", [0.0, None]))]  # fmt: skip
    points = {name: {"none": [4.0, 7.0]} for name in ("trust", "actions")}
    figure = userstudy_figures.outcomes_figure(measures, points)
    trust, actions = figure.axes[:2]
    assert trust.get_yticks().tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert trust.get_ylim() == pytest.approx((0.76, 7.24))
    assert actions.get_ylim()[0] == 0
    (axis,) = userstudy_figures.scales_figure({"items": cells}, {"rely": "I could rely on it."}, (1.0, 7.0)).axes
    assert axis.get_xticks().tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert axis.get_xlim()[1] > 7
    assert axis.get_ylim() == (-0.5, 0.5)


LONG = {f"a-policy-of-a-rather-long-name-{n}": n for n in range(6)}
KINDS = [f"people of a kind with a long name, number {n}" for n in range(9)]


def beside_lines(sizes: pd.DataFrame, *_: pd.DataFrame) -> Figure:
    return study_figures.team_size_figure(sizes.assign(mean=10.0, low=9.0, high=11.0))


def beside_points(_: pd.DataFrame, __: pd.DataFrame, costs: pd.DataFrame) -> Figure:
    own = costs[costs["policy"] == "attention"]
    near = [own.assign(policy=f"p{n}", interventions=own["interventions"] + 0.1 * n) for n in range(3)]
    return trade_off_figure(pd.concat([costs, *near]))


def of_kinds(_: pd.DataFrame, categories: pd.DataFrame, __: pd.DataFrame) -> Figure:
    own = where(categories, category=CATEGORIES[0], instance="paper")
    return study_figures.category_figure(pd.concat([own.assign(category=name) for name in KINDS]), KINDS)


def in_legends_of_sizes(sizes: pd.DataFrame, *_: pd.DataFrame) -> Figure:
    return study_figures.team_size_figure(pd.concat([sizes.assign(policy=name) for name in LONG]))


def in_legends(_: pd.DataFrame, categories: pd.DataFrame, __: pd.DataFrame) -> Figure:
    return study_figures.category_figure(pd.concat([categories.assign(policy=name) for name in LONG]), CATEGORIES)


@pytest.mark.parametrize(
    ("figure", "count"),
    [
        (of_kinds, len(KINDS)),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (
            (beside_lines, len(POLICIES)), (beside_points, 12), (in_legends_of_sizes, 6), (in_legends, 0))),
    ],
)  # fmt: skip
def test_words_fit_and_do_not_cover_each_other(
    figure: Any, count: int, team_sizes: pd.DataFrame, categories: pd.DataFrame, costs: pd.DataFrame
) -> None:
    drawn = figure(team_sizes, categories, costs)
    drawn.draw_without_rendering()
    for axis in drawn.axes[-2:]:
        labels = [label for label in axis.get_xticklabels() if label.get_text()] if figure is of_kinds else axis.texts
        assert len(labels) == count
        assert overlaps(list(labels)) == []
        assert all(Text.get_window_extent(text).x1 <= drawn.bbox.x1 for text in labels)
    box = drawn.legends[0].get_window_extent()
    assert (box.x0 >= 0, box.x1 <= drawn.bbox.x1, len(drawn.legends)) == (True, True, 1)
    assert not any(box.overlaps(axis.get_window_extent()) for axis in drawn.axes)


@pytest.mark.parametrize("people", [1, 3, 12])
@pytest.mark.slow
def test_words_of_an_episodes_picture_do_not_cover_each_other(pool: Pool, people: int) -> None:
    humans, (trace, alone) = [n % 4 for n in range(people)], (Trace(), Trace())
    name = "a-policy-of-a-rather-long-name-that-somebody-has-chosen-" * 2
    run: dict[str, Any] = {"humans": humans, "episodes": [1], "seed": 3}
    [episode] = simulate(pool, AttentionSwitching(), **run, trace=trace, name=name)
    simulate(pool, NoAssistance(), **run, trace=alone)
    names = tuple(f"Wolfeschlegelsteinhausenbergerdorff the {n + 1}th, of the second kitting line" for n in humans)
    figure = episode_figure(replace(episode, people=names), trace, alone)
    figure.draw_without_rendering()
    boxes = {text: text.get_window_extent() for text in figure.findobj(Text) if text.get_text() and text.get_visible()}
    shown = [text for text, box in boxes.items() if box.width > 0]
    assert overlaps(shown) == []
    assert [text.get_text() for text in shown if boxes[text].x0 < 0 or boxes[text].x1 > figure.bbox.x1] == []
    for who, rows in (("", trace), ("alone ", alone)):
        said = f"{who}finished after {sum(row['place'] == 0 for row in rows)}"
        assert any(text.get_text().startswith(said) for text in shown)
