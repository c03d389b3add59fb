"""How many people the policies of a user study would assist: by simulation, before the first participant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from statistics import fmean

from planner import CostToGo, Table

from ...team.policy_names import SELDOM, WEIGHING
from ...team.pool import Pool
from ...team.simulate import simulate
from .plan import Condition, UserStudy

PEOPLE, EPISODES = 24, 40
"""Numbers of simulated people, and of episodes of each task with teams of them."""


def seldom_assisted(study: UserStudy, tasks: Mapping[str, CostToGo]) -> Iterator[tuple[Condition, float]]:
    """Yield conditions whose policy weighs costs and hardly assists, with the percentage of people whom it does.

    Parameters
    ----------
    study : UserStudy
    tasks : mapping of str to CostToGo
        Tasks by name. Those that are solved on demand are too large to be simulated here.
    """
    known = [tasks[name] for name, _ in study.tasks if isinstance(tasks[name], Table)]
    for one in study.conditions:
        if one.policy in WEIGHING and known:
            assisted = fmean(_assisted(study, one, task) for task in known)
            if assisted < SELDOM:
                yield one, assisted


def _assisted(study: UserStudy, condition: Condition, task: CostToGo) -> float:
    """Return the percentage of simulated people to whom a condition's policy makes a suggestion in an episode."""
    team = 1 + study.simulated if study.group is None else study.group.size
    pool = Pool.sample(task, PEOPLE, seed=study.seed, setting=condition.setting, population=study.population)
    found = simulate(pool, condition.policy, humans=team, episodes=EPISODES, seed=study.seed)
    return 100 * float((found.helped > 0).mean())
