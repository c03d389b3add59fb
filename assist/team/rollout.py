"""A team policy by rollout: priority, with the next decision improved by simulation.

At a decision, priority's action is compared with a few alternatives that its values rank close to it. Sample paths are
simulated in the robot's model: they begin in the most probable task states, everybody's type is drawn from the belief,
and priority acts from the next step on. (D. P. Bertsekas, J. N. Tsitsiklis and C. Wu, "Rollout algorithms for
combinatorial optimization", Journal of Heuristics 3, 1997.)

An alternative is measured by advantages rather than by rewards. With V and Q of each person's problem with a robot that
comes and goes (`assist.person.attention_subproblem`), in the sampled type,

    sum_{h<H} gamma^h r_h + gamma^H V(s_H) = V(s_0) + sum_{h<H} gamma^h (Q(s_h, a_h) - V(s_h)) + D,

summed over people. D is a discounted sum of differences between V and its expectation one step before, so that its mean
is 0. The sum of advantages has the mean of the rewards, followed by V, without the part of their variance that V
explains. The prices of attention in Q are added again. These problems do not know what people see of each other. So
V(s_h) has theta before what was seen in the step before, and Q has theta after it. All alternatives meet the same
random numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..people.arguments import number, whole
from ..people.decision import NOTHING, Floats
from ..person.known_states import KnownStates
from ..person.policy import Policy
from ..person.robots import NOTHING_DONE
from ..person.rows_of_people import by_model
from ..person.ties import NEAR, first_best, ranked
from ..person.time_expansion import AWAY, HERE
from ..person.travel import Travel
from .by_policy import ByPolicy
from .engine import Engine
from .model_group import ModelGroup
from .people_at_work import PeopleAtWork
from .priority import Priority, to_the_best
from .robots_at_work import RobotsAtWork
from .schedule import Schedule
from .state import BASE, NOBODY, TeamAction, TeamState
from .team_tasks import TeamTasks

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class RolloutOptions:
    """Effort of a rollout policy at one decision.

    Attributes
    ----------
    samples : int
        Sample paths of each alternative. After an eighth and three eighths of them, alternatives are dropped that are
        not ahead, or not by a standard error.
    horizon : int
        Steps of a sample path. V stands for later steps.
    alternatives : int
        Alternatives at most to priority's action: to attend to a person whom it leaves out, or to leave one out.
    near : float
        Largest loss of an alternative by priority's own values, in costs of the cheapest action.
    errors : float
        Standard errors by which an alternative has to be better.
    people : int
        Number of people at work up to which alternatives are simulated. With more, priority acts.
    seed : int
        Seed of the sample paths. In the same state of the team, the policy always takes the same action.
    """

    samples: int = 512
    horizon: int = 20
    alternatives: int = 3
    near: float = 0.5
    errors: float = 2.0
    people: int = 12
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("samples", 8), ("horizon", 1), ("alternatives", 1), ("people", 0), ("seed", 0)):
            object.__setattr__(self, name, whole(name, getattr(self, name), least))
        for name in ("near", "errors"):
            value = number(name, getattr(self, name))
            if value < 0:
                raise ValueError(f"{name} {value:g}: expected a number of 0 or more")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Priority, with the next decision improved by simulation.

    Attributes
    ----------
    base : Priority
        At a constant price.
    near : float
        As in the options, in cost units.
    options : RolloutOptions
    models : ByPolicy of ModelGroup
        The people of each policy, as the robot's model has them.
    """

    base: Priority
    near: float
    options: RolloutOptions
    models: ByPolicy[ModelGroup]
    uses_belief, weighs_costs = True, True

    @classmethod
    def of(cls, policies: Sequence[Policy], travel: Travel, options: RolloutOptions | None = None) -> Rollout:
        """Return the policy for people with the given policies and travel.

        The data about each of them are computed on first use, or by `prepare`.

        Parameters
        ----------
        policies : sequence of Policy
        travel : Travel
        options : RolloutOptions, optional
        """
        options = options or RolloutOptions()
        near = options.near * min(policy.problem.cheapest for policy in policies)
        return cls(Priority.of(policies, travel), near, options, ByPolicy(policies, ModelGroup))

    def prepare(self, policy: Policy) -> None:
        """Compute now the data about the people of a policy."""
        self.base.prepare(policy)

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return priority's action in every team, or an alternative that is better by simulation."""
        actions, simulated = self._alternatives(team)
        best = np.zeros(len(team.x), dtype=np.int64)
        teams = np.flatnonzero(simulated.any(axis=1))
        if len(teams):
            best[teams] = self._best(team, teams, actions, simulated[teams])
        each = np.arange(len(team.x))
        return TeamAction(*(np.stack([getattr(one, name) for one in actions])[best, each] for name in _ACTION))

    def _alternatives(self, team: TeamState) -> tuple[list[TeamAction], Bools]:
        """Return priority's action and C alternatives, and which alternatives are to be simulated, shape (N, C)."""
        action, going, holding = self.base.worth(team)
        actions = [to_the_best(team, action, going, holding)]
        N, K = team.x.shape
        person, staying = actions[0].person, holding.clip(0)
        n, m = np.nonzero(person != NOBODY)
        served = np.zeros((N, K), dtype=bool)
        served[n, person[n, m]] = True
        gained = staying.copy()
        gained[n, m] = going[n, m, person[n, m]]
        instead = np.maximum(np.where(served[:, None], -np.inf, going).max(axis=2), staying)
        loss = np.full((N, 2, K), np.inf)  # of attending to a person, and of leaving one out
        least = np.where(team.ready, gained, np.inf).min(axis=1)
        loss[:, 0] = np.where(served, np.inf, least[:, None] - going.max(axis=1))
        loss[n, 1, person[n, m]] = gained[n, m] - instead[n, m]
        loss[team.active.sum(axis=1) > self.options.people] = np.inf
        flat = loss.reshape(N, -1)
        order = ranked(-flat)[:, : self.options.alternatives]
        simulated = np.take_along_axis(flat, order, axis=1) <= self.near
        each, above_all = np.arange(N), 1 + 2 * np.abs(going[np.isfinite(going)]).sum()  # to send a robot to a person
        for column, (omits, k) in enumerate(zip(*np.divmod(order.T, K), strict=True)):
            wanted, held = going.copy(), holding.copy()
            wanted[each, :, k] = np.where(omits[:, None] == 1, -np.inf, wanted[each, :, k] + above_all)
            held[(omits == 1)[:, None] & (team.location == k[:, None])] = 0.0
            actions.append(to_the_best(team, action, wanted, held))
            for other in actions[:-1]:
                same = [getattr(other, one) == getattr(actions[-1], one) for one in _ACTION]
                simulated[:, column] &= ~np.concatenate(same, axis=1).all(axis=1)
        return actions, simulated

    def _best(self, team: TeamState, teams: Ints, actions: list[TeamAction], simulated: Bools) -> Ints:
        """Return the number of the best action in some teams: 0 unless an alternative is better by enough."""
        alive = np.concatenate([simulated.any(axis=1, keepdims=True), simulated], axis=1)
        total, squares, mean, error = (np.zeros(alive.shape) for _ in range(4))
        done = 0
        for batch, share in enumerate((1 / 8, 3 / 8, 1.0)):
            size = round(share * self.options.samples) - done
            done += size
            for part in self._parts(alive, size, team.x.shape[1]):
                paths = _Paths(self, team, teams[part], actions, alive[part], size, batch)
                ahead = np.zeros((*alive[part].shape, size))
                ahead[alive[part]] = paths.values()
                ahead -= ahead[:, :1]
                total[part] += ahead.sum(axis=2)
                squares[part] += (ahead**2).sum(axis=2)
            mean = total / done
            error = np.sqrt((squares / done - mean**2).clip(0) / done)
            alive[:, 1:] &= (mean > (batch if share < 1 else self.options.errors) * error + NEAR)[:, 1:]
            alive[:, 0] = alive[:, 1:].any(axis=1)
        return first_best(np.where(alive, mean, 0.0))

    def _parts(self, alive: Bools, size: int, people: int, at_once: int = 30_000) -> list[Ints]:
        """Divide the teams with alternatives that are left into parts with about `at_once` people on all paths."""
        teams = np.flatnonzero(alive[:, 0])
        paths = np.cumsum(alive[teams].sum(axis=1)) * size * people
        return np.split(teams, np.flatnonzero(np.diff(paths // at_once)) + 1) if len(teams) else []


_ACTION = ("person", "action")


class PathNumbers:
    """The random numbers of sample paths, which are the same for all pairs of a team and an action."""

    def __init__(self, rng: np.random.Generator, pairs: int, shape: tuple[int, int]) -> None:
        self._rng, self._pairs, self._shape = rng, pairs, shape
        self._drawn = np.empty(0)

    def draw(self, stream: int, teams: Ints) -> Floats:
        """Return uniform numbers for some paths: for choices (1), drawn with those for theta (2), or for others."""
        if stream > 2:
            return self._rng.random(self._shape)[teams % self._shape[0]]
        if stream == 1:
            self._drawn = self._rng.random((*self._shape, 2))
        return self._drawn[teams % len(self._drawn), :, stream - 1]


class _Paths:
    """Sample paths of actions in some teams: L pairs of team and action, with S paths each, in the rows of all arrays.

    Parameters
    ----------
    rollout : Rollout
    team : TeamState
    teams : int array, shape (n,)
        The teams.
    actions : list of TeamAction
        Actions for all teams.
    used : bool array, shape (n, C)
        Which actions are simulated in each team.
    samples : int
    batch : int
        Number of the batch of paths, which have random numbers of their own.
    """

    def __init__(
        self, rollout: Rollout, team: TeamState, teams: Ints, actions: list[TeamAction], used: Bools, samples: int,
        batch: int,
    ) -> None:  # fmt: skip
        n, c = np.nonzero(used)
        self.rollout, self.team, self.samples = rollout, team, samples
        self.pairs, people = len(n), team.x.shape[1]
        rng, own = np.random.default_rng([rollout.options.seed, batch]), teams[n].repeat(samples)
        person, said = (np.stack([getattr(one, name) for one in actions])[c, teams[n]] for name in _ACTION)
        self.first = TeamAction(person.repeat(samples, axis=0), said.repeat(samples, axis=0))
        grid = team.policies[0].pomdp.grid
        assert team.belief is not None
        strata = np.stack([rng.permutation(samples) for _ in range(people)], axis=1)
        uniform = (strata + rng.random(strata.shape)) / samples
        cells = team.belief[teams[n]].reshape(self.pairs, 1, people, -1).cumsum(axis=3)
        cells = (cells <= uniform[:, :, None] * cells[..., -1:]).sum(axis=3).reshape(-1, people)
        mind, cell = np.divmod(cells, len(grid.theta))

        state, active, model = team.x[own], team.active[own], team.model[own]
        situation = np.zeros_like(state)
        for group, flat in by_model(model.reshape(-1), np.flatnonzero(active), len(team.policies)):
            situation.reshape(-1)[flat] = team.policies[group].situations(state.reshape(-1)[flat])
        them = PeopleAtWork(
            number=mind, draws=PathNumbers(rng, self.pairs, (samples, people)), on_grid=True, situation=situation,
            row=state.copy(), goal=np.zeros_like(state), theta=grid.theta[cell], outcomes=grid.count[cell],
            finished=~active, presence=Schedule.of(people),
        )  # fmt: skip
        models = {n: rollout.models[team.policies[n]] for n in np.unique(model).tolist()}
        known = team.beliefs.of((own[:, None] * people + np.arange(people)).reshape(-1))
        robots = RobotsAtWork(team.fleet, team.travel, len(own))
        self.engine = Engine(
            TeamTasks(team.policies, models, model, mind), them, robots,
            KnownStates(them.row.reshape(-1), known.belief, known.erred, known.neighbours.believed),
        )  # fmt: skip
        # A robot that is under way is taken to arrive in the next step: the team's state does not have the number.
        self.engine.clock[:], self._own_theta = team.clock[own], them.theta.copy()
        robots.location[:], robots.busy_until[:] = team.location[own], (team.clock[own] + 1)[:, None] - team.ready[own]

    def values(self) -> Floats:
        """Return the sum of discounted advantages on each path, shape (L, S)."""
        values, discount = np.zeros(self.pairs * self.samples), 1.0
        gamma = self.team.policies[0].pomdp.gamma
        for step in range(self.rollout.options.horizon):
            if not self.engine.begin_step().active.any():
                break
            values += discount * self._step(self.first if step == 0 else self.rollout.base(self.engine.state()))
            discount *= gamma
        return values.reshape(self.pairs, self.samples)

    def _step(self, action: TeamAction) -> Floats:
        """Advance all paths by one step; return their advantages."""
        engine, grid = self.engine, self.team.policies[0].pomdp.grid
        before, outcomes = self._positions(engine.clock), engine.people.outcomes.copy()
        taken = engine.step(action)
        now, sent = self._positions(taken.clock), taken.sent
        by, gained = np.zeros_like(before), np.zeros(len(before))
        team, number = np.nonzero(engine.robots.location != BASE)
        by[team, engine.robots.location[team, number]] = number
        np.subtract.at(gained, sent.team, sent.cost)
        attended = taken.now.active & (now != AWAY)
        gained += self.rollout.base.price[0] * attended.sum(axis=1)
        # In the position after the robot's way: leave or stay away (0), or stay (1), or make a suggestion (2 and up).
        move = np.where(now == HERE, 1 + taken.heard, 0)
        was_cell = cell = np.searchsorted(grid.values, self._own_theta) + outcomes * len(grid.values)
        if not np.array_equal(self._own_theta, taken.theta):
            cell = np.searchsorted(grid.values, taken.theta) + outcomes * len(grid.values)
        after_way, advantage = np.where(now == AWAY, before, now), np.zeros(before.size)
        each = (before, after_way, move, taken.heard, by, taken.before, engine.tasks.who, was_cell, cell)
        for group, flat in taken.now.by_policy:
            was, at, does, heard, its, x, h, first, t = (array.reshape(-1)[flat] for array in each)
            policy = self.team.policies[group]
            solved = policy.with_robot(self.rollout.base)
            fleet = self.team.fleet
            speaking = fleet.extra_of(its, policy.pomdp.suggested[x, heard] == NOTHING)
            waiting = np.where(does == 1, fleet.extra[its, NOTHING_DONE], 0.0)
            advantage[flat] = solved.advantage(was, at, x, does, h, first, t)
            advantage[flat] -= np.where(heard > 0, speaking, waiting)
        self._own_theta = taken.own_theta
        return gained + advantage.reshape(before.shape).sum(axis=1)

    def _positions(self, clock: Ints) -> Ints:
        """Return the robot's position for each person, as in their problem with a robot that comes and goes."""
        location, left = self.engine.robots.location, self.engine.robots.left(clock)
        position = np.full(self.engine.people.situation.shape, AWAY)
        somewhere = np.nonzero(location != BASE)
        position[somewhere[0], location[somewhere]] = HERE + left[somewhere]
        return position
