"""What a user study would show, before it begins."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from userstudies import ALIKE, PLAN, foreseen, written

from assist.cli.study_prepare import _participants
from assist.studies.repeated_measures import within_participants
from assist.studies.statistics import between_groups
from assist.studies.userstudy import forecast as forecasts
from assist.studies.userstudy.forecast import Forecast, Sensitivity
from assist.studies.userstudy.plan_file import read
from planner import Table

__all__ = ["foreseen"]


def forecast(
    folder: Path, tiny: Table, more: str = "participants = 24", like: Forecast | None = None, text: str = PLAN
) -> Forecast:
    """Return the forecast of a study; one `like` it has the same people, tasks and conditions."""
    study = read(written(folder / "study.toml", text.replace("seed = 3", f"seed = 3\n{more}")))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forecasts, "EFFORT", 0)  # one round, whose people are enough here
        return Forecast.of(study, {"tiny": tiny}) if like is None else replace(like, study=study)


@pytest.fixture
def found(foreseen: Forecast) -> Forecast:
    return foreseen


def test_a_study_says_before_it_begins_which_difference_it_can_show(
    found: Forecast, tiny: Table, tmp_path: Path
) -> None:
    (shown,) = found.sensitivity()
    assert (shown.condition, shown.against, shown.units) == ("attention", "none", 12)
    assert shown.hedges_g == pytest.approx(1.2, abs=0.005)  # as G*Power has it: 12 in each group
    own, other = found.actions["attention"], found.actions["none"]
    assert shown.actions == pytest.approx(shown.hedges_g * math.sqrt((own.var(ddof=1) + other.var(ddof=1)) / 2))
    assert shown.expected == pytest.approx(own.mean() - other.mean())
    # As many participants as are needed show the difference of simulated people, and two fewer do not.
    assert shown.needed is not None
    assert shown.needed % 2 == 0
    others = (forecast(tmp_path, tiny, f"participants = {shown.needed - n}", found) for n in (0, 2))
    enough, fewer = (next(other.sensitivity()) for other in others)
    assert enough.actions is not None
    assert fewer.actions is not None
    assert enough.actions <= abs(shown.expected) < fewer.actions


def test_what_no_simulation_says_is_left_out(found: Forecast, tiny: Table, tmp_path: Path) -> None:
    (unlimited,) = forecast(tmp_path, tiny, "tick = 2", found).sensitivity()
    assert (unlimited.units, unlimited.hedges_g, unlimited.actions) == (None, None, None)
    assert unlimited.needed is not None
    assert [str(one) for one in Forecast(found.study, {}, {}).sensitivity()] == [
        "attention minus none: with 12 in each, four of five studies show g = 1.20, or more"
    ]
    alone = Sensitivity(
        condition="a", against="b", units=6, hedges_g=1.796, actions=4.0, expected=-0.01, expected_low=-0.015,
        expected_high=-0.005, simulated=200,
    )  # fmt: skip
    assert str(alone) == (
        "a minus b: with 6 in each, four of five studies show 4.0 actions per task, g = 1.80, or more; simulated "
        "people differ by -0.0 (-0.0 to -0.0), which takes more than 10,000 participants in all"
    )


@pytest.mark.cases
def test_no_number_of_participants_is_said_where_simulated_people_may_not_differ(
    found: Forecast, tiny: Table, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    other = rng.gamma(0.5, 20.0, 400)
    for design in ("between", "within"):
        study = forecast(tmp_path, tiny, f'participants = 24\ndesign = "{design}"', found).study
        for more, known in ((0.0, False), (-6.0, True)):
            own = rng.permutation(other) + rng.normal(more, 1.0, 400)
            (shown,) = Forecast(study, {"attention": own, "none": other}, {}).sensitivity()
            assert shown.expected_low is not None
            assert shown.expected_high is not None
            assert shown.simulated == 400
            assert (shown.expected_high < 0) == known
            assert (shown.needed is not None) == known
            assert ("400 of them do not tell how many participants" in str(shown)) == (not known)
            if known:
                assert shown.needed_low is not None
                assert shown.needed is not None
                assert shown.needed_low < shown.needed
                assert shown.needed_high is None or shown.needed < shown.needed_high
                ((_, counted),) = Forecast(study, {"attention": own, "none": other}, {}).participants(
                    shown.expected or 0
                )
                assert counted.value == shown.needed


@pytest.mark.parametrize("paired", [False, True])
def test_intervals_of_a_forecast_hold_where_numbers_of_actions_are_skewed(paired: bool) -> None:
    """Gamma numbers, whose means and deviations are known: of 400 intervals, 95 % should hold, and 91 % do surely."""
    rng, held = np.random.default_rng(1), np.zeros(3)
    spread = math.sqrt(2 * 50) if paired else math.sqrt(50)
    for _ in range(400):
        own, other = rng.gamma(2.0, 5.0, (2, 500))
        one = forecasts._Difference.of(own + 2.0, other, paired=paired)
        size = one.size - 1.96 * one.errors[2], one.size + 1.96 * one.errors[2]
        pairs = ((one.expected_interval, 2.0), (one.spread_interval, spread), (size, 2.0 / spread))
        held += [low <= true <= high for (low, high), true in pairs]
    assert (held / 400 > 0.91).all(), held / 400


def test_who_does_not_finish_is_left_out_as_in_the_report(found: Forecast, tiny: Table, tmp_path: Path) -> None:
    """Between participants, who finishes in one condition counts in that one; of a group, the members who finish."""
    own, other = found.actions["attention"].copy(), found.actions["none"].copy()
    own[:10], other[5:20] = np.nan, np.nan
    (shown,) = replace(found, actions={"attention": own, "none": other}).sensitivity()
    known = own[np.isfinite(own)], other[np.isfinite(other)]
    assert shown.expected == pytest.approx(known[0].mean() - known[1].mean())
    assert shown.actions is not None
    assert shown.hedges_g is not None
    variance = (known[0].var() + known[1].var()) / 2 * 35 / 34  # of 40 units, 5 finish in neither condition
    assert shown.actions / shown.hedges_g == pytest.approx(np.sqrt(variance))
    rng, missed = np.random.default_rng(1), 0
    for _ in range(400):
        own, other = rng.gamma(2.0, 5.0, (2, 100))
        own[rng.random(100) < 0.3], other[rng.random(100) < 0.1] = np.nan, np.nan
        one = forecasts._Difference.of(own, other, paired=False)
        missed += not one.expected_interval[0] < 0 < one.expected_interval[1]
    assert missed / 400 < 0.08

    groups = PLAN.replace("simulated = 2", "group = { size = 2 }").replace("[setting]", "[setting]\nmax_steps = 9")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forecasts, "PEOPLE", 40)
        some = forecast(tmp_path, tiny, text=groups)
        each = forecasts._Round(some.study, [tiny], 0, 40)
    (run,) = each.simulated(0, "none")
    finished, actions = run.finished[:, :2], run.actions[:, :2]
    expected = [row[ended].mean() if ended.any() else np.nan for row, ended in zip(actions, finished, strict=True)]
    assert (finished.sum(axis=1) == 1).sum() > 0
    np.testing.assert_allclose(some.actions["none"], expected)


def test_rounds_end_when_the_effort_is_spent_and_each_has_people_of_its_own(
    tiny: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = read(written(tmp_path / "study.toml", ALIKE))
    monkeypatch.setattr(forecasts, "PEOPLE", 20)
    ended = []
    for effort in (0, 2500):
        monkeypatch.setattr(forecasts, "EFFORT", effort)
        seen: list[tuple[str, int, int | None]] = []
        ended += [list(Forecast.rounds(study, {"tiny": tiny}, progress=lambda *now: seen.append(now)))[-1]]  # noqa: B023
    assert [total for _, _, total in seen] == [effort] * len(seen)
    assert [done for _, done, _ in seen] == sorted({done for _, done, _ in seen})
    few, more = (one.actions["none"] for one in ended)
    assert (len(few), len(more) % 20) == (20, 0)
    assert 40 <= len(more) < 200
    assert (more[:20] == few).all()
    assert (more[20:40] != few).any()


@pytest.mark.slow
@pytest.mark.parametrize(("design", "places"), [("between", 24), ("between", 80), ("within", 12), ("within", 40)])
def test_four_of_five_studies_show_what_was_forecast(tiny: Table, tmp_path: Path, design: str, places: int) -> None:
    """Studies of simulated people, whose conditions differ by the difference that was called detectable."""
    found = forecast(tmp_path, tiny, f'participants = {places}\ndesign = "{design}"')
    (shown,) = found.sensitivity()
    assert shown.actions is not None
    assert shown.expected is not None
    assert shown.units is not None
    own, other = found.actions["attention"] - shown.expected + shown.actions, found.actions["none"]
    rng, studies = np.random.default_rng(1), 1500
    if design == "between":
        p = [between_groups(rng.choice(own, shown.units), rng.choice(other, shown.units)).p for _ in range(studies)]
    else:
        periods = [(1, 2), (2, 1)] * (shown.units // 2)
        p = [within_participants(rng.choice(own - other, shown.units), periods).p for _ in range(studies)]
    # No less than .8, up to three standard errors and .01. Numbers of actions are skewed, so that few studies have
    # those who take hundreds: small studies show the difference more often than with normal numbers, in .87 to .89.
    assert 0.8 - 0.041 <= np.mean(np.array(p) < 0.05) <= 0.91


def test_people_who_do_not_vary_show_any_difference_and_nobody_none(found: Forecast) -> None:
    same = replace(found, actions={name: np.full(40, 3.0 + (name == "none")) for name in found.actions})
    (shown,) = same.sensitivity()
    assert (shown.actions, shown.expected, shown.needed) == (None, -1.0, 4)
    assert "0.0 (0.0 to 0.0)" not in str(shown)
    assert [str(needed) for _, needed in same.participants(2.0)] == ["4"]
    assert [needed for _, needed in replace(found, actions={}).participants(2.0)] == [None]
    unknown = [*_participants(found.study, replace(found, actions={}), 2.0)]
    assert unknown == [
        "attention minus none: not known how many participants show 2 actions per task; "
        "tasks on demand are not simulated, and of others too few people finish one"
    ]
    assert [*_participants(found.study, same, 2.0)] == ["attention minus none: 2 actions per task take 4 participants"]
