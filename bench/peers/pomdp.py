"""One measurement of `bench/pomdp.py`: a solver in a process of its own.

    python bench/peers/pomdp.py kitassist|pomdp-py CASE

CASE is a JSON object with the fields of `Case`, and `timeout`, `gap`, `warm` and `simulations`. The output is JSON
lines: `{"event": "point", "seconds", "lower", "upper"}` whenever bounds improve, in processor seconds, and a last line
with `"event": "result"`.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from assist.people.choices import Choices
from assist.people.human import Human, HumanModel
from assist.people.misconception import perceived_cost_to_go
from assist.person.pomdp import AssistPOMDP
from planner import find_instances, load, sweep

KITTING = Path(__file__).resolve().parent.parent.parent / "domains" / "kitting"
STEPS = 200  # an episode is cut off; gamma^200 is 0.13 for 0.99, and few episodes are that long


class Case(NamedTuple):
    """One person's POMDP."""

    instance: str
    gamma: float
    c_suggest: float
    sigma: float
    seed: int

    def problem(self) -> AssistPOMDP:
        """Return the problem of a person whose misconception, of size sigma, is drawn by the seed and known to the
        robot.
        """
        choices = Choices.of(sweep(load(find_instances([str(KITTING / f"{self.instance}.pddl")], None)[0])))
        h = perceived_cost_to_go(choices, self.sigma, np.random.default_rng(self.seed))
        model = HumanModel.own(choices, Human(1.0, 0.6, self.sigma, h))
        return AssistPOMDP.of(model, gamma=self.gamma, c_suggest=self.c_suggest)


def say(event: str, **fields: Any) -> None:
    print(json.dumps({"event": event, **fields}), flush=True)


def own(case: Case, options: dict[str, Any]) -> None:
    """Run this project's solver; with `warm`, after a trivial problem that loads the compiled code."""
    from assist.person.solver import solve

    if options["warm"]:
        solve(Case("tiny", 0.95, 0.5, 0.5, 0).problem(), gap=0.01)
    start = time.process_time()
    pomdp = case.problem()
    loaded = time.process_time()

    def bounds(_: float, lower: float, upper: float) -> None:
        say("point", seconds=time.process_time() - loaded, lower=lower, upper=upper)

    solution = solve(pomdp, gap=options["gap"], time_limit=options["timeout"], bounds=bounds)
    bounds(solution.seconds, solution.lower, solution.upper)
    say("result", load=loaded - start, vectors=len(solution.policy.vectors), stopped=solution.stopped)


def tree_search(case: Case, options: dict[str, Any]) -> None:
    """Run pomdp-py's POUCT with an exact filter and POMCP with its particles; report their returns.

    Every episode draws a person from the prior. Transitions and the filter are those of the model.
    """
    import random

    import pomdp_py

    from assist.interop import to_pomdp_py
    from assist.person.qmdp import evaluate

    pomdp = case.problem()
    never = float(
        (
            evaluate(pomdp, np.zeros(len(pomdp.robot_actions), dtype=np.int64), tolerance=1e-6)[
                pomdp.model.choices.initial
            ]
            * pomdp.prior
        ).sum()
    )
    for name, simulations in options["searches"]:
        rng = np.random.default_rng(case.seed)
        random.seed(case.seed)
        problem = to_pomdp_py(pomdp, rng)
        returns, decisions, deprived, started = [], [], 0, time.perf_counter()
        while time.perf_counter() - started < options["seconds_each"]:
            total, steps, lost = episode(pomdp_py, problem, pomdp, name, simulations, -never, decisions)
            deprived += lost
            if steps is not None:
                returns.append(total)
        say("search", planner=name, simulations=simulations, never=never, episodes=len(returns), deprived=deprived,
            mean=float(np.mean(returns)) if returns else None,
            stderr=float(np.std(returns, ddof=1) / np.sqrt(len(returns))) if len(returns) > 1 else None,
            decision_seconds=float(np.mean(decisions)) if decisions else None)  # fmt: skip
    say("result")


def episode(
    pomdp_py: Any, problem: Any, pomdp: AssistPOMDP, name: str, simulations: int, scale: float, decisions: list[float]
) -> tuple[float, int | None, bool]:
    """Simulate one episode; return its return, its steps, and whether POMCP ran out of particles."""
    choices = pomdp.model.choices
    settings = {
        "max_depth": 100, "discount_factor": pomdp.gamma, "num_sims": simulations, "exploration_const": scale / 2,
        "rollout_policy": problem.policy,
    }  # fmt: skip
    agent = problem.agent()
    if name == "POMCP":
        agent.set_belief(pomdp_py.Particles([problem.belief.random() for _ in range(1000)]), prior=True)
    planner = getattr(pomdp_py, name)(**settings)
    state, total, discount = problem.belief.random(), 0.0, 1.0
    belief = pomdp.prior[None]
    for step in range(STEPS):
        if choices.goal[state.data[0]]:
            return total, step, False
        start = time.perf_counter()
        action = planner.plan(agent)
        decisions.append(time.perf_counter() - start)
        after = problem.transition.sample(state, action)
        total += discount * problem.reward.sample(state, action, after)
        discount *= pomdp.gamma
        observation = problem.observation.sample(after, action)
        agent.update_history(action, observation)
        try:
            planner.update(agent, action, observation)
        except ValueError as error:
            if "deprivation" not in str(error):
                raise
            return total, None, True
        if name == "POUCT":  # POUCT has no filter; use the exact one
            x, robot = state.data[0], int(action.name.removeprefix("robot") if action.name != "nothing" else 0)
            slot = int(np.flatnonzero(choices.targets[x] == after.data[0])[0])
            belief = pomdp.update(belief, *(np.array([v]) for v in (x, robot, slot)))
            cells = {
                type(state)((after.data[0], b, t)): float(p) for (b, t), p in np.ndenumerate(belief[0]) if p > 1e-9
            }
            agent.set_belief(pomdp_py.Histogram(cells))
        state = after
    return total, STEPS, False


def main() -> None:
    what, options = sys.argv[1], json.loads(sys.argv[2])
    case = Case(*(options[field] for field in Case._fields))
    {"kitassist": own, "pomdp-py": tree_search}[what](case, options)


if __name__ == "__main__":
    main()
