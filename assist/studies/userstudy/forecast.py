"""How often the policies of a user study would assist: by simulation, before the first participant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from planner import CostToGo, Table

from ...team.policy_names import WEIGHING
from ...team.pool import Pool
from ...team.simulate import simulate
from .plan import Condition, UserStudy

PEOPLE, EPISODES = 24, 40
"""Numbers of simulated people, and of episodes of each task with teams of them."""

SELDOM = 0.1
"""Share of episodes with a suggestion below which a policy hardly assists."""


def seldom_assisted(study: UserStudy, tasks: Mapping[str, CostToGo]) -> Iterator[tuple[Condition, int, int]]:
    """Yield conditions whose policy weighs costs and hardly assists: with the episodes that have suggestions, and all.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name. Those that are solved on demand are too large to be simulated here.
    """
    known = [tasks[name] for name, _ in study.tasks if isinstance(tasks[name], Table)]
    for one in study.conditions:
        if one.policy in WEIGHING and known:
            assisted, episodes = sum(_assisted(study, one, task) for task in known), EPISODES * len(known)
            if assisted < SELDOM * episodes:
                yield one, assisted, episodes


def _assisted(study: UserStudy, condition: Condition, task: CostToGo) -> int:
    """Return the number of episodes in which a condition's policy makes a suggestion."""
    team = 1 + study.simulated if study.group is None else study.group.size
    pool = Pool.sample(task, PEOPLE, seed=study.seed, setting=condition.setting, population=study.population)
    found = simulate(pool, condition.policy, humans=team, episodes=EPISODES, seed=study.seed)
    return int((found.interventions > 0).sum())
