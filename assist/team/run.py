"""A chunk of episodes that advance together: a loop over a policy, and the records of what happens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from threading import Event

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..people.user_code import UserCodeError, own_code
from .action_check import check
from .beginning import Beginning, Beginnings
from .common_random_numbers import CommonRandomNumbers
from .engine import Engine, StepTaken
from .episodes import Episodes
from .goal_knowledge import acted_on, first_beliefs, known_at_first
from .model_group import ModelGroup
from .people_at_work import PeopleAtWork
from .pool import Pool
from .questions import Questions
from .requested import Requested
from .robots_at_work import RobotsAtWork
from .state import NOBODY, TeamAction, TeamPolicy
from .team_tasks import TeamTasks
from .traced_run import Tracer

Ints = NDArray[np.int64]


class Tally:
    """The records of N episodes of K people, as far as they have come; the attributes are those of `Episodes`."""

    def __init__(self, shape: tuple[int, ...], gamma: float) -> None:
        self._gamma = gamma
        self.actions, self.helped, self.executed = np.zeros((3, *shape), dtype=np.int64)
        self.costs, self.discounted_return = np.zeros(shape), np.zeros(shape[0])
        self.moves, self.steps, self.questions = np.zeros((3, shape[0]), dtype=np.int64)

    def add(self, step: int, taken: StepTaken) -> None:
        """Add a step to the records."""
        sent = taken.sent
        self.discounted_return += self._gamma**step * taken.reward.sum(axis=1)
        self.actions += taken.slot != NOTHING
        self.costs += taken.cost
        self.steps[taken.now.running] += 1
        if len(sent.team):
            np.add.at(self.moves, sent.team, sent.changes_place)
            self.executed[sent.team, sent.person] += taken.executes
            self.helped[sent.team, sent.person] += sent.action > 0


@dataclass(frozen=True)
class Simulation:
    """A simulation, whose episodes are divided into chunks.

    Attributes
    ----------
    pool : Pool
    policy : TeamPolicy
    wanted : Requested
        The episodes, and the conditions under which they are simulated.
    beginnings : Beginnings
        How people begin.
    groups : mapping of int to ModelGroup
        The people of each policy that occurs.
    questions : Questions or None
        None if the robot does not ask people about their goals.
    over : Event
        Ends the simulation once it is set, as the results are not needed any more.
    """

    pool: Pool
    policy: TeamPolicy
    wanted: Requested
    beginnings: Beginnings
    groups: Mapping[int, ModelGroup]
    questions: Questions | None
    over: Event

    def chunk(self, part: slice, tracer: Tracer | None = None, *, keeps_beliefs: bool = False) -> Episodes:
        """Simulate some episodes until all people have finished or the limit is reached; return the records.

        Parameters
        ----------
        part : slice
            Which of the requested episodes.
        tracer : Tracer, optional
        keeps_beliefs : bool
            Whether beliefs are kept for policies, too, that do not use them.
        """
        pool, wanted, numbers = self.pool, self.wanted, self.wanted.numbers[part]
        draws = CommonRandomNumbers(wanted.seed, numbers, wanted.places)
        # It is in C order, and all arrays derived from it are, too. They are changed in place through flat views.
        people = np.ascontiguousarray(draws.team(len(pool.people)) if wanted.teams is None else wanted.teams[part])
        every = np.arange(len(numbers))
        began = self.beginnings.of(people, lambda stream: draws.draw(stream, every))
        uses_beliefs = getattr(self.policy, "uses_belief", True)
        engine = self.begin(people, began, draws, beliefs=uses_beliefs or keeps_beliefs)
        first_theta, tally = engine.people.theta.copy(), Tally(people.shape, pool.setting.gamma)
        questions = self.questions if uses_beliefs else None
        for step in range(pool.setting.max_steps):
            if not len(engine.begin_step().running) or self.over.is_set():
                break
            if questions is not None:
                asked = engine.ask(questions)
                tally.questions[[one.team for one, _ in asked]] += 1
                if tracer is not None:
                    tracer.asked(engine, asked)
            teams_now = engine.deciding()
            action = self._decided(engine, teams_now, tracer) if len(teams_now) else nothing(engine, teams_now)
            taken = engine.step(action, teams_now)
            tally.add(step, taken)
            if tracer is not None:
                tracer.took(engine, taken)
        finished = engine.people.finished
        return Episodes(
            policy=wanted.name, episode=numbers, people=people, names=pool.names, seed=wanted.seed, beta=began.beta,
            theta=first_theta, sigma=np.array([human.sigma for human in pool.people])[people], actions=tally.actions,
            costs=tally.costs, finished=finished, helped=tally.helped, executed=tally.executed,
            interventions=tally.helped.sum(axis=1), moves=tally.moves, steps=tally.steps,
            discounted_return=tally.discounted_return,
            cut_off=np.asarray((~finished & (wanted.presence.leaves > pool.setting.max_steps)).any(axis=1)),
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
        pool, wanted, situation = self.pool, self.wanted, began.situation.copy()
        tasks = TeamTasks(pool.policies, self.groups, began.model, began.who)
        row = np.ascontiguousarray(tasks.rows(situation, np.arange(situation.size)))
        them = PeopleAtWork(
            number=people, draws=draws, on_grid=wanted.world == "model", situation=situation, row=row, goal=began.goal,
            theta=began.theta, outcomes=np.zeros_like(situation), finished=began.finished, presence=wanted.presence,
        )  # fmt: skip
        hidden, knowledge = pool.hidden, wanted.goals
        prior: Floats | None = None
        if beliefs or pool.setting.observation is not None:
            each = np.array([policy.pomdp.prior for policy in pool.policies])[began.model]
            prior = first_beliefs(each, hidden, began.goal, knowledge)
        known = known_at_first(them.row, prior, pool.setting)
        robots = RobotsAtWork(pool.setting.fleet, wanted.travel, len(people))
        return Engine(tasks, them, robots, known, partial(acted_on, hidden=hidden, knowledge=knowledge))

    def _decided(self, engine: Engine, teams: Ints, tracer: Tracer | None) -> TeamAction:
        """Return what the policy does with the robots of some teams."""
        team = engine.state(teams)
        with own_code(self.policy):
            action = self.policy(team)
        try:
            check(team, action)
        except UserCodeError as error:
            source = getattr(self.policy, "source", self.wanted.name)
            raise UserCodeError(f"{source}: {error}", code=self.policy) from None
        if tracer is not None:
            tracer.decided(engine, team, action, teams)
        return action


def nothing(engine: Engine, teams: Ints) -> TeamAction:
    """Return the action of leaving the robots of some teams where they are."""
    stays = np.full((len(teams), len(engine.robots.fleet)), NOBODY)
    return TeamAction(stays, np.zeros_like(stays))
