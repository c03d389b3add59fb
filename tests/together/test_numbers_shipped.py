"""Both shipped domains with numbers and durations go the whole way, as commands and in other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import invoke, thinned

from assist.connect.observed import Observed
from assist.people import HumanModel
from assist.people.choices import Choices
from assist.person import AssistPOMDP
from planner import Table, load, sweep

SHIPPED = {"stock/one-bin": 3.0, "timed/one-part": 2.0}
"""Their smallest problems, and the optimal costs: actions, and minutes."""


@pytest.fixture(params=thinned(SHIPPED))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def table(name: str) -> Table:
    return sweep(load(name))


def answered(*arguments: Any) -> Any:
    """Return what a command prints as JSON."""
    done = invoke(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_a_team_is_simulated_and_its_log_is_fitted(name: str, table: Table, tmp_path: Path) -> None:
    options = (
        "--humans",
        2,
        "--pool",
        2,
        "--episodes",
        4,
        "--seed",
        1,
        "--set",
        "population.beta=[2, 8]",
        "--policy",
        "attention",
    )
    out = tmp_path / "episodes.jsonl"
    (record,) = answered("simulate", name, *options, "--out", out, "--trace", tmp_path / "log.jsonl")["policies"]
    episodes = [json.loads(line) for line in out.read_text().splitlines()]
    assert record["cost_per_person"]["mean"] == pytest.approx(sum(sum(one["costs"]) for one in episodes) / 8)
    assert min(cost for one in episodes for cost in one["costs"]) >= SHIPPED[name] - 1e-9
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert {row["action"] for row in rows} <= set(table.task.actions)
    found = answered("fit", name, tmp_path / "log.jsonl")
    assert sum(one["actions"] for one in found) == len(rows)
    assert all(one["error"] is None for one in found)


def test_the_policy_of_a_person_and_the_bound_of_a_team(name: str) -> None:
    best = -SHIPPED[name]
    policy = answered("policy", name, "--time-limit", 2, "--set", "population.beta=[2, 8]")
    assert policy["lower"] <= policy["upper"] <= 0.98 * best
    bound = answered(
        "bound", name, "--humans", 2, "--value-episodes", 20, "--time-limit", 5, "--set", "population.beta=[2, 8]"
    )
    seldom = 0.05  # what people lose by mistakes that are too rare for twenty episodes
    assert bound["value"] - 4 * bound["value_stderr"] - seldom <= bound["upper"] <= 2 * 0.98 * best


def test_a_plan_is_drawn_as_a_gif(name: str, table: Table, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("resvg_py")
    plan = table.optimal_plan()
    assert plan is not None
    (tmp_path / "best.plan").write_text("\n".join(plan))
    done = invoke("draw", name, "--plan", tmp_path / "best.plan", "--out", tmp_path / "plan.gif")
    assert done.exit_code == 0, done.output
    with image.open(tmp_path / "plan.gif") as animation:
        assert animation.n_frames == len(plan) + 1


def test_a_pomdp_is_exported(name: str, table: Table, tmp_path: Path) -> None:
    assert invoke("export", name, "--out", tmp_path / "one.pomdpx").exit_code == 0
    text = (tmp_path / "one.pomdpx").read_text()
    observed = Observed.of(AssistPOMDP.of(HumanModel.exact(Choices.of(table))), table)
    assert all(state in text for state in observed.names)
    assert f"suggests {table.task.actions[0]}" in text


def test_an_environment_is_stepped_through(name: str, table: Table) -> None:
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from assist.connect.gymnasium import TeamEnv

    env = TeamEnv(instance=name, humans=2)
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    assert seen["cost_to_go"].tolist() == pytest.approx([table[table.initial]] * 2)
    total, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, _ = env.step(0)
        total, over = total + float(reward), terminated or truncated
    assert total <= -2 * SHIPPED[name] + 1e-6  # both finish, at the least cost or at more
