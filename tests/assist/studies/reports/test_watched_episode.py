"""An episode that is watched: the gains that a robot expects are the scores by which it chooses."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from assist import Pool, compare, simulate, watch
from assist.people import Human
from assist.person import Setting
from assist.studies.reports import WatchedEpisode
from assist.team import TeamAction, TeamState


@pytest.fixture(scope="module")
def pool() -> Pool:
    return Pool.sample("kitting/tiny", 4, seed=0, setting=Setting(c_suggest=0.2, c_move=0.1))


@pytest.fixture(scope="module")
def watched(pool: Pool) -> WatchedEpisode:
    return watch(pool, humans=3, episode=2, seed=5)


def test_the_episode_is_that_of_simulate(pool: Pool, watched: WatchedEpisode) -> None:
    run = simulate(pool, "attention", humans=3, episodes=[2], seed=5)
    assert watched.episode == run[0]
    assert watched.gain.shape == (run[0].steps, 3)
    assert pickle.loads(pickle.dumps(watched)) == watched != watch(pool, humans=3, episode=1, seed=5)


def test_a_robot_speaks_to_the_person_with_the_largest_positive_gain(watched: WatchedEpisode) -> None:
    told = [row for row in watched.trace if row["suggestion"]]
    assert told
    for row in told:
        gains = watched.gain[row["step"]]
        assert row["place"] == np.nanargmax(gains)
        assert gains[row["place"]] > 0
    silent = sorted({row["step"] for row in watched.trace} - {row["step"] for row in told})
    assert silent
    assert (np.nan_to_num(watched.gain[silent]) <= 0).all()


def test_it_is_a_table_with_reasons_and_a_figure(watched: WatchedEpisode) -> None:
    frame = watched.to_frame()
    assert len(frame) == len(watched.trace)
    assert (frame.reason != "").sum() == frame.suggestion.notna().sum() == len(watched.reasons().splitlines())
    assert "I suggest that you" in watched.reasons()
    assert frame.robot_here[frame.suggestion.notna()].all()
    assert [axis.get_title(loc="left") for axis in watched.figure().axes[::2]] == list(watched.episode.people)
    assert repr(watched).startswith("<episode 2 of human-")
    assert watched.figure()._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_all_suggestions_are_in_the_figure_also_where_none_is_worth_its_cost(pool: Pool) -> None:
    dear = watch(pool.under(Setting(c_suggest=50.0)), "reactive", humans=3, episode=2, seed=5)
    told = sum(row["suggestion"] is not None for row in dear.trace)
    assert told
    assert np.isnan(dear.gain).all()
    marks = [line for axis in dear.figure().axes[::2] for line in axis.lines if line.get_marker() == "v"]
    seen = [np.isfinite(np.asarray(line.get_ydata(), dtype=float)).sum() for line in marks]
    assert sum(seen[::2]) == told


def test_an_episode_without_suggestions_says_why(pool: Pool) -> None:
    dear = watch(pool.under(Setting(c_suggest=50.0)), humans=3, episode=2, seed=5)
    assert np.isnan(dear.gain).all()
    none = "There was no suggestion in this episode."
    assert dear.reasons() == f"{none} By Algorithm 1, none was worth its cost to anybody."
    far = watch(pool.under(Setting(c_suggest=0.1, c_move=50.0)), "none", humans=3, episode=2, seed=5)
    assert f"expected was {np.nanmax(far.gain):.2g} at step" in far.reasons()
    assert (far.gain[np.isfinite(far.gain)] != 0).all()
    with pytest.raises(TypeError, match="expected one policy"):
        watch(pool, ["none", "attention"])  # type: ignore[arg-type]


def test_people_have_their_names() -> None:
    people = {"Ann": Human(0.4, 0.8), "Ben": Human(0.5, 0.7), "Cem": Human(2.0, 0.9)}
    pool = Pool.of("kitting/tiny", people, setting=Setting(c_suggest=0.1, c_move=0.1))
    watched = watch(pool, humans=["Cem", "Ann"], seed=1)
    assert watched.episode.people == ("Cem", "Ann")
    assert watched.episode.beta == (2.0, 0.4)
    assert set(watched.to_frame().person) == {"Cem", "Ann"}
    run = simulate(pool, "none", humans=["Ann", "Cem"], episodes=2, seed=1)
    assert run.to_frame().person.tolist() == ["Ann", "Cem"] * 2
    assert compare(pool, ["none", "attention"], humans=["Ann", "Cem"], episodes=2)[0].humans == 2
    assert pool.to_frame().person.tolist() == list(people)
    assert "Ann, Ben, Cem" in repr(pool)
    with pytest.raises(ValueError, match="person 'Bn'; did you mean 'Ben'"):
        simulate(pool, "none", humans=["Bn"], episodes=1, seed=0)
    with pytest.raises(TypeError, match="humans 'Ann': expected a number, numbers, or a list of names"):
        compare(pool, ["none"], humans="Ann")  # type: ignore[arg-type]


def test_a_policy_of_ones_own_is_watched_as_well(pool: Pool) -> None:
    def stays(team: TeamState) -> TeamAction:
        return team.act(np.full(team.location.shape, -1), np.zeros_like(team.x))

    found = watch(pool, stays, humans=[0, 1], seed=1)
    assert found.episode.policy == "stays"
    assert found.reasons().startswith("There was no suggestion in this episode. ")
    assert [row["action"] for row in found.trace] == [row["action"] for row in found.alone]
    with pytest.raises(TypeError, match="expected people at a task"):
        watch("kitting/tiny")  # type: ignore[arg-type]
