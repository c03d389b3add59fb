"""Both shipped domains with numbers and durations go the whole way, as commands and in other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import invoke

from planner import load, sweep

SHIPPED = {"stock/one-bin": 3.0, "timed/one-part": 2.0}
"""Their smallest problems, and the optimal costs: actions, and minutes."""
BETA = ("--set", "population.beta=[2, 8]")


def answered(*arguments: Any) -> Any:
    """Return what a command prints as JSON."""
    done = invoke(*arguments, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_they_go_the_whole_way(name: str, tmp_path: Path) -> None:
    """Policy, bound, simulation, fit, drawing, and an environment agree about costs and actions."""
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from assist.connect.gymnasium import TeamEnv

    best = SHIPPED[name]
    policy = answered("policy", name, "--time-limit", 1, *BETA)
    assert policy["lower"] <= policy["upper"] <= -0.98 * best
    bound = answered("bound", name, "--humans", 2, "--value-episodes", 20, "--time-limit", 2, *BETA)
    seldom = 0.05  # what people lose by mistakes that are too rare for twenty episodes
    assert bound["value"] - 4 * bound["value_stderr"] - seldom <= bound["upper"] <= -2 * 0.98 * best

    table, out, log = sweep(load(name)), tmp_path / "episodes.jsonl", tmp_path / "log.jsonl"
    team = ("--humans", 2, "--pool", 2, "--episodes", 4, "--seed", 1, "--policy", "attention", *BETA)
    (record,) = answered("simulate", name, *team, "--out", out, "--trace", log)["policies"]
    costs = [cost for line in out.read_text().splitlines() for cost in json.loads(line)["costs"]]
    assert record["cost_per_person"]["mean"] == pytest.approx(sum(costs) / 8)
    assert min(costs) >= best - 1e-9
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    assert {row["action"] for row in rows} <= set(table.task.actions)
    found = answered("fit", name, log)
    assert (sum(one["actions"] for one in found), {one["error"] for one in found}) == (len(rows), {None})

    plan = tmp_path / "best.plan"
    plan.write_text("\n".join(table.optimal_plan() or []))
    assert invoke("draw", name, "--plan", plan, "--out", tmp_path / "plan.html").exit_code == 0
    assert invoke("export", name, "--out", tmp_path / "one.pomdpx").exit_code == 0
    assert f"suggests {table.task.actions[0]}" in (tmp_path / "one.pomdpx").read_text()
    env = TeamEnv(instance=name, humans=2)
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    assert seen["cost_to_go"].tolist() == pytest.approx([table[table.initial]] * 2)
    total, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, _ = env.step(0)
        total, over = total + float(reward), terminated or truncated
    assert total <= -2 * best + 1e-6  # both finish, at the least cost or at more
