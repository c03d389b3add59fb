"""A chunk of episodes that advance together: a loop over a policy, and the records of what happens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from threading import Event
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..people.user_code import UserCodeError
from ..person.beliefs import Beliefs, Seen
from ..person.hidden_beliefs import Hidden
from ..person.travel import Travel
from .action_check import check
from .beginning import Beginning, Beginnings
from .common_random_numbers import CommonRandomNumbers
from .engine import Engine, PeopleAtWork, StepTaken
from .episodes import Episodes
from .goal_knowledge import GoalKnowledge, acted_on, first_beliefs
from .model_group import ModelGroup, World
from .pool import Pool
from .questions import Asked, Questions
from .robots_at_work import RobotsAtWork
from .schedule import Schedule
from .state import TeamAction, TeamPolicy, TeamState
from .task_view import TaskView

Ints = NDArray[np.int64]


class Watcher(Protocol):
    """Sees what happens in the episodes of a chunk, for instance to write it down."""

    def asked(self, engine: Engine, asked: Sequence[tuple[Asked, bool]]) -> None:
        """See questions that were asked, and their answers."""
        ...

    def decided(self, engine: Engine, team: TeamState, action: TeamAction, teams: Ints) -> None:
        """See what the robots of some teams, given by their numbers, do in a step, before it is carried out."""
        ...

    def took(self, engine: Engine, taken: StepTaken) -> None:
        """See a step that has been taken."""
        ...


class Tally:
    """The records of N episodes of K people, as far as they have come; the attributes are those of `Episodes`."""

    def __init__(self, shape: tuple[int, ...], gamma: float) -> None:
        self._gamma = gamma
        self.actions, self.helped, self.executed = np.zeros((3, *shape), dtype=np.int64)
        self.costs, self.discounted = np.zeros(shape), np.zeros(shape[0])
        self.moves, self.steps, self.questions = np.zeros((3, shape[0]), dtype=np.int64)

    def add(self, step: int, taken: StepTaken) -> None:
        """Add a step to the records."""
        sent = taken.sent
        self.discounted += self._gamma**step * taken.reward.sum(axis=1)
        self.actions += taken.slot != NOTHING
        self.costs += taken.cost
        self.steps[taken.now.running] += 1
        if len(sent.team):
            np.add.at(self.moves, sent.team, sent.moved)
            self.executed[sent.team, sent.person] += taken.executes
            self.helped[sent.team, sent.person] += sent.action > 0


@dataclass(frozen=True)
class Simulation:
    """A simulation, whose episodes are divided into chunks.

    Attributes
    ----------
    pool, policy, name, travel, presence, world, goals
        As in `simulate`.
    seed : int
    groups : mapping of int to ModelGroup
        The people of each policy that occurs.
    questions : Questions or None
        None if the robot does not ask people about their goals.
    over : Event
        Ends the simulation once it is set, as the results are not needed any more.
    """

    pool: Pool
    policy: TeamPolicy
    name: str
    seed: int
    travel: Travel
    presence: Schedule
    world: World
    goals: GoalKnowledge
    groups: Mapping[int, ModelGroup]
    questions: Questions | None
    over: Event

    def chunk(
        self, numbers: Ints, teams: Ints | None, watcher: Watcher | None = None, *, keeps_beliefs: bool = False
    ) -> Episodes:
        """Simulate some episodes until all people have finished or the limit is reached; return the records.

        Parameters
        ----------
        numbers : int array, shape (N,)
            Numbers of the episodes.
        teams : int array, shape (N, K), or None
            The people at each place; by default they are drawn.
        watcher : Watcher, optional
        keeps_beliefs : bool
            Whether beliefs are kept for policies, too, that do not use them.
        """
        pool, draws = self.pool, CommonRandomNumbers(self.seed, numbers, len(self.travel))
        # It is in C order, and all arrays derived from it are, too. They are changed in place through flat views.
        people = np.ascontiguousarray(draws.team(len(pool.people)) if teams is None else teams)
        every = np.arange(len(numbers))
        began = Beginnings(pool, self.world).of(people, lambda kind: draws.draw(kind, every))
        uses_beliefs = getattr(self.policy, "uses_belief", True)
        engine = self.begin(people, began, draws, beliefs=uses_beliefs or keeps_beliefs)
        first_theta, tally = engine.people.theta.copy(), Tally(people.shape, pool.setting.gamma)
        questions = self.questions if uses_beliefs else None
        for step in range(pool.setting.max_steps):
            if not len(engine.now.running) or self.over.is_set():
                break
            if questions is not None:
                asked = engine.ask(questions)
                tally.questions[[one.team for one, _ in asked]] += 1
                if watcher is not None:
                    watcher.asked(engine, asked)
            teams_now = engine.deciding()
            action = self._decided(engine, teams_now, watcher) if len(teams_now) else nothing(engine, teams_now)
            taken = engine.step(action, teams_now)
            tally.add(step, taken)
            if watcher is not None:
                watcher.took(engine, taken)
        finished = engine.people.finished
        return Episodes(
            policy=self.name, episode=numbers, people=people, names=pool.names, beta=began.beta, theta=first_theta,
            sigma=np.array([human.sigma for human in pool.people])[people], actions=tally.actions, costs=tally.costs,
            finished=finished, helped=tally.helped, executed=tally.executed,
            interventions=tally.helped.sum(axis=1), moves=tally.moves, steps=tally.steps,
            discounted_return=tally.discounted,
            cut_off=np.asarray((~finished & (self.presence.leaves > pool.setting.max_steps)).any(axis=1)),
            questions=None if questions is None else tally.questions,
            pruned=None if engine.beliefs.sees_states else engine.beliefs.pruned.reshape(people.shape).sum(axis=1),
        )  # fmt: skip

    def begin(self, people: Ints, began: Beginning, draws: CommonRandomNumbers, *, beliefs: bool) -> Engine:
        """Return the teams at work, at the beginning.

        Parameters
        ----------
        people : int array, shape (N, K)
            Numbers of the people in the pool.
        began : Beginning
            How these people begin.
        draws : CommonRandomNumbers
        beliefs : bool
            Whether the robot keeps beliefs.
        """
        pool, place = self.pool, began.place.copy()
        tasks = TaskView(pool, self.groups, self.world, began.model, people, began.mind, began.goal)
        row = np.ascontiguousarray(tasks.rows(place, np.arange(place.size)))
        them = PeopleAtWork(
            people, draws, self.world == "model", place, row, began.goal, began.theta, np.zeros_like(place),
            began.finished, self.presence.joins, self.presence.leaves, pool.setting.neighbourhood(place.shape[1]),
        )  # fmt: skip
        hidden = pool.policies[0].pomdp.hidden
        prior = np.array([policy.pomdp.prior for policy in pool.policies])
        first = partial(first_beliefs, hidden=hidden, goal=began.goal, knowledge=self.goals)
        known = known_at_first(
            pool, them.row, first(prior[began.model]) if beliefs or pool.setting.observation else None
        )
        robots = RobotsAtWork(pool.setting.fleet, self.travel, len(people))
        return Engine(tasks, them, robots, known, partial(acted_on, hidden=hidden, knowledge=self.goals))

    def _decided(self, engine: Engine, teams: Ints, watcher: Watcher | None) -> TeamAction:
        """Return what the policy does with the robots of some teams."""
        team = engine.state(teams)
        action = self.policy(team)
        try:
            check(team, action)
        except UserCodeError as error:
            raise UserCodeError(f"{getattr(self.policy, 'place', self.name)}: {error}") from None
        if watcher is not None:
            watcher.decided(engine, team, action, teams)
        return action


def nothing(engine: Engine, teams: Ints) -> TeamAction:
    """Return the action of leaving the robots of some teams where they are."""
    stays = np.full((len(teams), len(engine.robots.fleet)), NOTHING)
    return TeamAction(stays, np.zeros_like(stays))


def known_at_first(pool: Pool, row: Ints, belief: Floats | None) -> Beliefs:
    """Return what the robots of a pool know of people who begin.

    Parameters
    ----------
    pool : Pool
    row : int array, shape (N, K)
        Row of each person's state, which the robots know at first.
    belief : float array, shape (N, K, H, T), or None
        None if no beliefs are kept.
    """
    sight, erred = pool.setting.observation, np.zeros(row.size, dtype=bool)
    flat = np.empty((0, 1, 1)) if belief is None else belief.reshape(-1, *belief.shape[2:])
    if sight is None:
        return Seen(row.reshape(-1), flat, erred)
    return Hidden(row.reshape(-1).copy(), flat, erred, sight)
