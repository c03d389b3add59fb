"""Simulation of a team with several robots, each of which may go to any person, for `team.py fluid`.

The simulator's teams have one robot, so this module simulates step by step. People act as in the simulator.
"""

from __future__ import annotations

import numpy as np

from assist.person.beliefs import Acts, PersonModel, Seen
from assist.person.dynamics import Minds, PeopleArrays, act
from assist.simulation.pool import Pool
from assist.team.priority import Priority
from assist.team.time_expansion import HERE


def pooled(pool: Pool, priority: Priority, robots: int, humans: int, episodes: int) -> np.ndarray:
    """Return the discounted returns of teams with several robots, shape (episodes,), by the m largest priorities.

    All people have the same model, and all distances are equal.
    """
    solved, pomdp = priority.solved(pool.policies[0]), pool.policies[0].pomdp
    choices, setting = pomdp.model.choices, pool.setting
    model, rng = PersonModel.of(pomdp), np.random.default_rng(robots)
    minds = Minds.of_model(pomdp)
    size = episodes * humans
    cell = rng.choice(pomdp.prior.size, size, p=pomdp.prior.ravel() / pomdp.prior.sum())
    b, t = np.divmod(cell, len(pomdp.grid.theta))
    people = PeopleArrays(
        np.full(size, choices.initial), np.zeros(size, dtype=np.int64), b, pomdp.grid.theta[t].copy(),
        np.zeros(size, dtype=np.int64), np.empty((size, 2)), np.zeros(size, dtype=np.int64), np.zeros(size),
    )  # fmt: skip
    known = Seen(people.x, np.repeat(pomdp.prior[None], size, axis=0), np.zeros(size, dtype=bool))
    here, total = np.zeros(size, dtype=bool), np.zeros(episodes)
    for step in range(2000):
        active = np.flatnonzero(~choices.goal[people.x])
        if not len(active):
            break
        q = solved.policy.q_values(solved.states[0, HERE][people.x[active]], known.belief[active])
        gain = q - q[:, :1] + priority.price[-1]
        speak, hold = gain[:, 2:].max(axis=1), np.where(here[active], gain[:, 1], -np.inf)
        worth = np.full(size, -np.inf)
        worth[active] = np.maximum(speak - np.where(here[active], 0.0, setting.c_move), hold)
        ranked = np.argsort(-worth.reshape(episodes, humans), axis=1)[:, :robots]
        chosen = (ranked + humans * np.arange(episodes)[:, None]).ravel()
        chosen = chosen[worth[chosen] > 0]
        speaks = np.zeros(size, dtype=bool)
        speaks[active] = speak - np.where(here[active], 0.0, setting.c_move) >= hold
        robot, best = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
        best[active] = gain[:, 2:].argmax(axis=1) + 1
        robot[chosen] = np.where(speaks[chosen], best[chosen], 0)
        paid = np.zeros(size)
        paid[chosen] = setting.c_move * ~here[chosen]
        paid += pomdp.robot_costs[people.x, robot]
        here[:] = False
        here[chosen] = True
        people.robot[:] = robot
        people.cost[:] = 0.0
        people.uniform[active] = rng.random((len(active), 2))
        before = people.x.copy()
        act(active, people, minds, model.arrays)
        acts = Acts(before, people.robot, people.slot, ~choices.goal[people.x])
        known.observe(acts, people.robot, [(model, active)], lambda _: np.empty(0))
        total -= setting.gamma**step * (paid + people.cost).reshape(episodes, humans).sum(axis=1)
    return total
