"""Teams at work, one step at a time, for given actions of their robots.

An `Engine` joins four parts:

- `TeamTasks` are the people's problems: the row of each person in theirs, and how people choose there.
- `PeopleAtWork` are the people as they are: states, theta, goals, and the random numbers of all that happens.
- `RobotsAtWork` are the robots: where they are, and when they arrive.
- `Beliefs` are what the robots know of the people.

A step has this order:

1. `begin_step`: who is at work is found, and each person's row.
2. `ask`: at most one person of each team is asked. The answer comes at once and changes the belief
   (`Beliefs.answered`).
3. `state`: what policies receive. In `simulate(goals="likeliest")` it has other beliefs than those that are kept
   (`acted_on`). A policy chooses an action.
4. `step`: the robots are sent, make room or stay, and speak. Everybody at work acts once: choices depend on the theta
   before the step, then theta moves. Beliefs follow what was seen (`Beliefs.observe`): the likelihood of the choice,
   the move of theta, and that the goal was not reached by those who go on. Then theta and the beliefs move by what
   people saw of each other (`seen.let_see`).

`simulate` is a loop over a policy, an environment passes actions in, and a rollout is an engine on copies.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..people.decision import NOTHING, Floats
from ..person.beliefs import Beliefs
from ..person.people_arrays import PeopleArrays
from ..person.problem_arrays import Acts
from ..person.random_streams import Stream
from ..person.robots import NOTHING_DONE
from ..person.rows_of_people import by_model
from .people_at_work import PeopleAtWork
from .questions import Asked, Questions
from .robots_at_work import RobotsAtWork, Sent
from .seen import let_see
from .state import BASE, TeamAction, TeamState
from .team_tasks import TeamTasks

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Now(NamedTuple):
    """Who is at work in the present step.

    Attributes
    ----------
    running : int array
        The teams in which a person is at work, or is to come.
    active : bool array, shape (N, K)
        Who is at work.
    by_policy : list of pairs of int and int array
        Index of each policy, with its people at work as indices of the flattened arrays.
    """

    running: Ints
    active: Bools
    by_policy: list[tuple[int, Ints]]


class StepTaken(NamedTuple):
    """What happened in a step.

    Attributes
    ----------
    now : Now
    clock : int array, shape (N,)
        The step of each team.
    sent : Sent
    executes : bool array
        Whether each robot that was sent executed an action.
    before, heard : int arrays, shape (N, K)
        Row of each person before the step, and the robot action that they heard.
    theta : float array, shape (N, K)
        Theta before the step.
    slot : int array, shape (N, K)
        Slot of each person's choice; `NOTHING` if they did not act.
    cost, reward : float arrays, shape (N, K)
        Cost of each person's choice; and minus this cost and those of the questions to the person, and of the robots'
        waiting, actions and ways for them.
    own_theta : float array, shape (N, K)
        Theta after what was suggested to the person, and before what they saw of others.
    """

    now: Now
    clock: Ints
    sent: Sent
    executes: Bools
    before: Ints
    heard: Ints
    theta: Floats
    slot: Ints
    cost: Floats
    reward: Floats
    own_theta: Floats


class Engine:
    """N teams of K people and M robots at work.

    Parameters
    ----------
    tasks : TeamTasks
    people : PeopleAtWork
    robots : RobotsAtWork
    beliefs : Beliefs
        Of the N K people, in the order of the flattened arrays. For people whose states are known, `x` is the array
        `people.row` itself, so that a step of people moves both.
    acted_on : callable, optional
        Returns the beliefs on which the robots act, from those that they have; by default the same.

    Attributes
    ----------
    clock : int array, shape (N,)
        The present step of each team.
    left_out : bool array, shape (N,)
        Teams that are left out.
    """

    def __init__(
        self, tasks: TeamTasks, people: PeopleAtWork, robots: RobotsAtWork, beliefs: Beliefs,
        acted_on: Callable[[Beliefs], Beliefs] | None = None,
    ) -> None:  # fmt: skip
        self.tasks, self.people, self.robots, self.beliefs, self._acted_on = tasks, people, robots, beliefs, acted_on
        self.clock = np.zeros(len(people.number), dtype=np.int64)
        self.left_out = np.zeros(len(people.number), dtype=bool)
        self._now: Now | None = None
        self._charged = np.zeros(people.situation.shape)

    def begin_step(self) -> Now:
        """Begin the step, unless it has begun, and return who is at work in it.

        The rows of people are renewed, and with them the known states in `beliefs.x`.
        """
        if self._now is None:
            them, clock = self.people, self.clock[:, None]
            to_come = ~them.finished & (clock < them.presence.leaves) & ~self.left_out[:, None]
            active = to_come & (clock >= them.presence.joins)
            flat = np.flatnonzero(active)
            them.row[:] = self.tasks.rows(them.situation, flat)
            by_policy = by_model(self.tasks.model.reshape(-1), flat, len(self.tasks.policies))
            self._now = Now(np.flatnonzero(to_come.any(axis=1)), active, by_policy)
        return self._now

    def changed(self) -> None:
        """Tell that somebody else has changed the people, so that the step begins anew."""
        self._now = None

    def leave_out(self, teams: Bools) -> None:
        """Leave these teams out, shape (N,), until others are named."""
        if (teams != self.left_out).any():
            self.left_out = teams
            self.changed()

    def deciding(self) -> Ints:
        """Return the teams in which a robot may be sent, and somebody is at work."""
        now = self.begin_step()
        may: Bools = np.logical_and(self.robots.ready(self.clock).any(axis=1), now.active.any(axis=1))
        return now.running[may[now.running]]

    def state(self, teams: Ints | None = None) -> TeamState:
        """Return what the robots know of some teams, given by their numbers, or of all: what policies act on."""
        now, (N, K), known = self.begin_step(), self.people.situation.shape, self.beliefs
        every = slice(None) if teams is None or len(teams) == N else teams
        if every is teams:
            known = known.of((teams[:, None] * K + np.arange(K)).reshape(-1))
        if self._acted_on is not None:
            known = self._acted_on(known)
        return TeamState(
            clock=self.clock[every].copy(), active=now.active[every], location=self.robots.location[every],
            model=self.tasks.model[every], beliefs=known, policies=self.tasks.policies, travel=self.robots.travel,
            ready=self.robots.ready(self.clock)[every], fleet=self.robots.fleet,
        )  # fmt: skip

    def ask(self, questions: Questions) -> list[tuple[Asked, bool]]:
        """Ask people what is worth its cost, at most one in each team, and return the questions with their answers.

        It is called before the robots decide, so that they act on the answer in the same step. Questions are chosen on
        all that is known, with people in their most probable states. The cost is one of the present step.
        """
        now, (N, K), found = self.begin_step(), self.people.goal.shape, list[tuple[Asked, bool]]()
        asked = questions.of_teams(self.beliefs, now.active, self.tasks.model, self.robots.fleet)
        uniform = self._uniform(Stream.ANSWER).reshape(N, K) if questions.error else np.ones((N, K))
        for one in asked:
            yes = one.question.answer(int(self.people.goal[one.team, one.person]), uniform[one.team, one.person])
            policy = self.tasks.policies[self.tasks.model[one.team, one.person]]
            self.beliefs.answered(one.team * K + one.person, one.question.likelihood(yes), policy)
            self._charged[one.team, one.person] += questions.cost
            found.append((one, yes))
        return found

    def step(self, action: TeamAction, teams: Ints | None = None) -> StepTaken:
        """Send the robots of some teams, or of all, and let everybody at work act once.

        Parameters
        ----------
        action : TeamAction
            The actions of these teams. The robots of other teams are not sent.
        teams : int array, optional
        """
        now, them, policies = self.begin_step(), self.people, self.tasks.policies
        sent = self.robots.send(action, np.arange(len(self.clock)) if teams is None else teams, self.clock)
        # What is said is a robot action in the most probable state, what is heard the same one in the person's own.
        said, executes = self._carry_out(sent)
        heard = self.beliefs.heard(
            said.reshape(-1), them.row.reshape(-1), [(policies[number].pomdp, flat) for number, flat in now.by_policy]
        ).reshape(said.shape)
        groups = self.tasks.groups
        before, theta, uniform = them.row.copy(), them.theta.copy(), np.empty((*said.shape, 2))
        for column, stream in enumerate((Stream.CHOICE, Stream.THETA) if them.on_grid else (Stream.CHOICE,)):
            uniform[now.running, :, column] = them.draws.draw(stream, now.running)
        arrays = PeopleArrays.of_teams(them.row, heard, self.tasks.who, them.theta, them.outcomes, uniform)
        situation, finished = them.situation.reshape(-1), them.finished.reshape(-1)
        for number, flat in now.by_policy:
            group = groups[number]
            # It moves `arrays.x`, that is `them.row`, and with it `beliefs.x` where states are known.
            group.act(flat, arrays)
            finished[flat] = group.ended(flat, arrays)
            situation[flat] = policies[number].situations(arrays.x[flat])
        acts = Acts(before.reshape(-1), arrays.heard, arrays.slot, ~finished)
        models = [(groups[number].model, flat) for number, flat in now.by_policy]
        self.beliefs.observe(acts, said.reshape(-1), models, self._uniform)
        own_theta = them.theta.copy()
        let_see(them, self.beliefs, acts, arrays.x, models, self._uniform)
        cost, clock, charged = arrays.cost.reshape(said.shape), self.clock.copy(), self._charged
        self.clock[now.running] += 1
        self._now, self._charged = None, np.zeros(said.shape)
        slot = arrays.slot.reshape(said.shape)
        return StepTaken(now, clock, sent, executes, before, heard, theta, slot, cost, -charged - cost, own_theta)

    def _carry_out(self, sent: Sent) -> tuple[Ints, Bools]:
        """Return the robot action for each person and which robots execute an action, and charge for all of it.

        Charged are moves, waiting beside somebody at work, suggestions and executions, in the most probable states,
        after this step's questions. No two robots go to one person, which `action_check` makes sure of.
        """
        policies, groups, fleet = self.tasks.policies, self.tasks.groups, self.robots.fleet
        said, executes = np.zeros_like(self.people.situation), np.zeros(len(sent.team), dtype=bool)
        if fleet.extra[:, NOTHING_DONE].any() or not all(
            policies[n].pomdp.waits_for_free for n, _ in self.begin_step().by_policy
        ):
            self._charge_waiting(sent)
        if not len(sent.team):
            return said, executes
        x, at = self.beliefs.x.reshape(said.shape), (sent.team, sent.person)
        said[at] = sent.action
        self._charged[at] += sent.cost
        for number, those in by_model(self.tasks.model[at], np.flatnonzero(sent.action > 0), len(policies)):
            to, does, arrays = (sent.team[those], sent.person[those]), sent.action[those], groups[number].arrays
            executes[those] = arrays.suggested[x[to], does] == NOTHING
            self._charged[to] += arrays.robot_costs[x[to], does]
            if fleet.costs_differ:
                self._charged[to] += fleet.extra_of(sent.robot[those], executes[those])
        return said, executes

    def _charge_waiting(self, sent: Sent) -> None:
        """Charge for the robots that are with a person at work and do nothing, after these were sent."""
        robots, tasks, x = self.robots, self.tasks, self.beliefs.x.reshape(self.people.situation.shape)
        waits = robots.ready(self.clock) & (robots.location != BASE)
        busy = sent.action > 0
        waits[sent.team[busy], sent.robot[busy]] = False
        team, robot = np.nonzero(waits)
        person = robots.location[team, robot]
        at_work = np.flatnonzero(self.begin_step().active[team, person])
        for number, those in by_model(tasks.model[team, person], at_work, len(tasks.policies)):
            there = team[those], person[those]
            cost = tasks.groups[number].arrays.robot_costs[x[there], 0]
            np.add.at(self._charged, there, cost + robots.fleet.extra[robot[those], NOTHING_DONE])

    def _uniform(self, stream: int) -> Floats:
        """Return uniform numbers of a stream for all people, 0 in teams that do not run any more."""
        uniform = np.zeros(self.people.situation.shape)
        running = self.begin_step().running
        uniform[running] = self.people.draws.draw(stream, running)
        return uniform.reshape(-1)
