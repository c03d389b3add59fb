"""Teams for environments: the caller chooses the robots' actions and when an episode begins.

The dynamics are those of `assist.team`: the same random numbers and the same actions have the same outcome. Each
team has its own clock, so that one team may begin an episode while others continue theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import known_costs

from ..people.decision import NOTHING, Floats
from ..people.hidden_type import mean_over_goals
from ..people.ranges import Population
from ..person.pomdp import AssistPOMDP
from ..person.settings import Setting, require_effect
from ..team.beginning import Beginnings, World
from ..team.common_random_numbers import CommonRandomNumbers
from ..team.engine import Engine, StepTaken
from ..team.goal_knowledge import known_at_first
from ..team.people_at_work import PeopleAtWork
from ..team.pool import Pool
from ..team.requested import require_possible
from ..team.robots_at_work import RobotsAtWork
from ..team.schedule import Schedule
from ..team.solving import MAX_ENUMERATED
from ..team.state import BASE, NOBODY, TeamAction, TeamState
from ..team.team_tasks import TeamTasks

if TYPE_CHECKING:
    from planner import AnyTask

Ints = NDArray[np.int64]


class PoolSource:
    """The pool of an environment: a given one, or people at a task who are drawn with a seed.

    They are those of seed 0 until the first `reset` with a seed, which draws the people of `kitassist simulate` with
    that seed. They stay until the end.

    Parameters
    ----------
    instance : Pool, cost-to-go, or whatever `planner.load` takes
    humans : int
        Number of people in a team.
    setting, population, optional
        As in `TeamEnv`; not together with a pool.

    Raises
    ------
    TypeError
        `instance` is something else, such as a list of tasks.
    ValueError
        A parameter has no effect, or `humans` is not between 1 and the size of the pool.
    """

    def __init__(
        self, instance: AnyTask | Pool, humans: int, setting: Setting | None, population: Population | None
    ) -> None:  # fmt: skip
        self._options: dict[str, Any] = {"setting": setting, "population": population}
        if isinstance(instance, Pool):
            for name, value in self._options.items():
                if value is not None:
                    raise ValueError(f"{name} has no effect with a pool, which has its own; expected none")
            self._waits, self.pool = False, instance
        else:
            self._waits, self._size = True, max(12, humans)
            self._known = known_costs(instance)
            self.pool = self._sample(0)
        self.pool.setting.require_questions(possible=False)
        require_effect([self.pool.setting])
        if not 1 <= humans <= len(self.pool.people):
            raise ValueError(f"humans {humans}: expected 1 to {len(self.pool.people)}, the size of the pool")

    def _sample(self, seed: int) -> Pool:
        return Pool.sample(self._known, self._size, seed=seed, states=MAX_ENUMERATED, **self._options)

    def drawn(self, seed: int | None) -> bool:
        """Draw the pool if this is the first reset with a seed, and return whether it was drawn now."""
        if seed is None or not self._waits:
            return False
        self._waits, self.pool = False, self._sample(seed)
        return True


class AllTeams:
    """Random numbers that advance in all teams at a time, whichever of them are at work."""

    def __init__(self, draws: CommonRandomNumbers, teams: int) -> None:
        self._draws, self._every = draws, np.arange(teams)

    def draw(self, kind: int, teams: Ints) -> Floats:
        """Return uniform numbers of a kind for some teams, shape (m, K)."""
        return self._draws.draw(kind, self._every)[teams]


class Teams:
    """N teams of K people each, with the robots of the pool's setting, which begin episodes one by one.

    Attributes
    ----------
    engine : Engine
        The teams at work.
    tasks : TeamTasks
        The people's tasks.
    x, finished, theta, people, model : arrays, shape (N, K)
        States and so on, as in `PeopleAtWork`; `people` are indices into the pool.
    erred : bool array, shape (N, K)
    belief : float array, shape (N, K, H, T), or None
        As in `TeamState`; None without `filters`.
    location : int array, shape (N, M)
        Where each robot is or is going.
    """

    def __init__(
        self,
        pool: Pool,
        teams: int,
        places: int,
        *,
        distance: ArrayLike | None = None,
        world: World = "people",
        filters: bool = True,
    ) -> None:
        require_possible(pool, world, "inferred")
        pool.setting.require_all_seen("an environment")
        shape = (teams, places)
        self.pool, self._beginnings = pool, Beginnings(pool, world)
        self.travel, self.fleet = pool.setting.travel(places, distance), pool.setting.fleet
        self._prior = np.array([policy.pomdp.prior for policy in pool.policies])
        self.people, self.model, who, self.x, row, goal, outcomes = np.zeros((7, *shape), dtype=np.int64)
        groups = {number: self._beginnings.group(number) for number in range(len(pool.policies))}
        self.tasks = TeamTasks(pool.policies, groups, self.model, who)
        self.theta, self.finished = np.zeros(shape), np.zeros(shape, dtype=bool)
        self.belief = np.zeros((*shape, *self._prior.shape[1:])) if filters else None
        them = PeopleAtWork(
            number=self.people, draws=AllTeams(CommonRandomNumbers(0, np.arange(teams), places), teams),
            on_grid=world == "model", situation=self.x, row=row, goal=goal, theta=self.theta, outcomes=outcomes,
            finished=self.finished, presence=Schedule.of(places),
        )  # fmt: skip
        known, robots = known_at_first(row, self.belief, pool.setting), RobotsAtWork(self.fleet, self.travel, teams)
        self.erred = known.erred.reshape(shape)
        self.engine, self.location = Engine(self.tasks, them, robots, known), robots.location

    @property
    def clock(self) -> Ints:
        """The number of steps of each episode so far, shape (N,)."""
        return self.engine.clock

    @property
    def row(self) -> Ints:
        """The row of each person who has not finished in the problem of their policy, shape (N, K)."""
        self.engine.begin_step()  # which renews the rows
        return self.engine.people.row

    def draw_from(self, draws: CommonRandomNumbers) -> None:
        """Take the random numbers of all that happens from these, from now on."""
        self.engine.people.draws = AllTeams(draws, len(self.x))

    def begin(self, rows: NDArray[np.int64], people: NDArray[np.int64], draw: Callable[[int], Floats]) -> None:
        """Begin an episode in some teams.

        Parameters
        ----------
        rows : int array, shape (m,)
        people : int array, shape (m, K)
            Indices into the pool.
        draw : callable
            As in `Beginnings.of`.
        """
        began, them = self._beginnings.of(people, draw), self.engine.people
        self.tasks.model[rows], self.tasks.who[rows] = began.model, began.who
        self.people[rows], them.goal[rows], them.theta[rows], them.outcomes[rows] = people, began.goal, began.theta, 0
        self.x[rows], self.finished[rows], self.erred[rows] = began.situation, began.finished, False
        if self.belief is not None:
            self.belief[rows] = self._prior[began.model]
        self.engine.robots.begin(rows)
        self.engine.clock[rows] = 0
        self.engine.changed()

    def ready(self) -> NDArray[np.bool_]:
        """Return which robots are not under way, shape (N, M)."""
        return self.engine.robots.ready(self.engine.clock)

    def state(self) -> TeamState:
        """Return the state that team policies read."""
        return self.engine.state()

    def collisions(self, person: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which robots are sent to where another one goes or stays with its task, shape (N, M).

        Of two robots that are sent to a person, the first one goes there. A robot that is not sent makes room.
        """
        refused = np.zeros(person.shape, dtype=bool)
        while True:
            after = np.where((person == NOBODY) | refused, self.location, person)
            moves = after != self.location
            stays = ~moves & (person != NOBODY) & ~refused
            same = (after[:, :, None] == after[:, None]) & (after != BASE)[:, :, None]
            before = np.tri(person.shape[1], k=-1, dtype=bool)  # [m, l]: l is before m
            wrong = moves & (same & (before & moves[:, None] | stays[:, None])).any(axis=2)
            if not wrong.any():
                return refused
            refused |= wrong

    def step(self, rows: NDArray[np.int64], action: TeamAction) -> StepTaken:
        """Send the robots, and let each person who has not finished act once, in some teams; the others wait.

        Parameters
        ----------
        rows : int array, shape (m,)
        action : TeamAction
            The actions of all teams; those of the others send nobody.
        """
        waits = np.ones(len(self.x), dtype=bool)
        waits[rows] = False
        self.engine.leave_out(waits)
        taken = self.engine.step(action)
        self.engine.leave_out(np.zeros_like(waits))
        return taken


class Sight:
    """Observations of teams for a learner, and masks of possible actions; the first axis of each array is the team.

    Attributes
    ----------
    robots : int
        R, the largest number of robot actions in any state of any model.
    states, models : int
        The number of states of the largest model, and the number of models.
    hidden : tuple of int
        H and T, the shape of a belief.
    largest : float
        The value that stands for the infinite cost-to-go of a dead end: 1 above the largest finite one (cost units). If
        that is unknown, 1 above what a person pays at most in an episode, which then stands for all that is larger.
    """

    def __init__(self, teams: Teams, *, beliefs: bool) -> None:
        self.teams, self.beliefs = teams, beliefs
        self._policies = teams.pool.policies
        extents = [policy.problem.extent for policy in self._policies]
        pomdps = [policy.pomdp for policy in self._policies]
        self.hidden, self._prior = pomdps[0].prior.shape, np.array([pomdp.prior for pomdp in pomdps])
        self.actions, self.states = max(one.robot_actions for one in extents), max(one.states for one in extents)
        self.models, farthest = len(pomdps), max(one.farthest for one in extents)
        paid = teams.pool.setting.max_steps * max(policy.problem.dearest for policy in self._policies)
        self.largest = (farthest if np.isfinite(farthest) else paid) + 1.0

    def _of_people(self, what: Callable[[AssistPOMDP, Ints], NDArray[Any]]) -> NDArray[Any]:
        """Return what holds in the row of each person, shape (N, K, ...); anything for those who have finished."""
        return self.teams.tasks.data(what, self.teams.row, np.flatnonzero(~self.teams.finished))

    def _alone(self, pomdp: AssistPOMDP, rows: Ints) -> Floats:
        """Return the probabilities of doing what each robot action suggests, without it; shape (m, R, H).

        Entry [i, r, h] is the probability that a person of type h chooses the action that robot action r suggests. For
        r = 0, nothing, it is the probability of an optimal action.
        """
        suggested, chosen = pomdp.suggested[rows], pomdp.chosen[rows]
        alone = np.zeros((len(rows), self.actions, chosen.shape[2]))
        does = np.take_along_axis(chosen, np.maximum(suggested, 0)[:, :, None], axis=1)
        alone[:, : suggested.shape[1]] = np.where((suggested != NOTHING)[:, :, None], does, 0.0)
        optimal = pomdp.model.choices.goals.optimal[rows][:, :, pomdp.hidden.goal_of]
        alone[:, 0] = np.where(optimal, chosen, 0.0).sum(axis=1)
        return alone.clip(0.0, 1.0)

    def _alone_at_first(self, pomdp: AssistPOMDP, rows: Ints) -> NDArray[np.float32]:
        """Return the mean of `_alone` over types under the robot's prior, shape (m, R)."""
        prior = np.broadcast_to(pomdp.prior.sum(axis=1), (len(rows), len(pomdp.prior)))
        return np.einsum("nrb,nb->nr", self._alone(pomdp, rows), prior).clip(0.0, 1.0).astype(np.float32)

    def _h(self, pomdp: AssistPOMDP, rows: Ints) -> NDArray[np.float32]:
        """Return the cost-to-go of each goal, shape (m, G)."""
        h = pomdp.model.choices.goals.h[:, rows].T
        return np.minimum(h, self.largest).astype(np.float32)

    def mask(self) -> NDArray[np.int8]:
        """Return the mask of robot actions of each person, shape (N, K, R); finished people have only action 0."""
        count = np.where(self.teams.finished, 1, self._of_people(_robot_actions))
        return (np.arange(self.actions) < count[:, :, None]).astype(np.int8)

    def _cost_to_go(self) -> NDArray[np.float32]:
        """Return the mean cost-to-go over the goals, shape (N, K), under the beliefs or, without them, the prior."""
        teams, hidden = self.teams, self._policies[0].pomdp.hidden
        share = hidden.share_of_goals(lambda: self._prior[teams.model] if teams.belief is None else teams.belief)
        return mean_over_goals(self._of_people(self._h).astype(np.float64), share).astype(np.float32)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the observation of all people, each array of shape (N, K) or (N, K, ...)."""
        teams = self.teams
        active = ~teams.finished
        if self.beliefs and teams.belief is not None:
            beta = teams.belief.sum(axis=3)
            alone = np.einsum("nkrb,nkb->nkr", self._of_people(self._alone), beta).clip(0.0, 1.0).astype(np.float32)
        else:
            alone = self._of_people(self._alone_at_first)
        seen: dict[str, NDArray[Any]] = {
            "active": active.astype(np.int8),
            "alone": alone * active[:, :, None],
            "cost_to_go": self._cost_to_go() * active,
            "erred": (teams.erred & active).astype(np.int8),
            "model": teams.model.copy(),
            "state": self._states(),
        }
        if self.beliefs and teams.belief is not None:
            seen["belief"] = teams.belief.astype(np.float32).clip(0.0, 1.0)
        return seen

    def _states(self) -> Ints:
        """Return the number of each person's state, shape (N, K); on an enumerated task, of a state with a memory."""
        return self.teams.tasks.numbered(self.teams.x)


def _robot_actions(pomdp: AssistPOMDP, rows: Ints) -> Ints:
    """Return the number of robot actions in some rows, shape (m,)."""
    return pomdp.robot_actions[rows]
