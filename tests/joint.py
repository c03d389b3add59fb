"""Exact solution of a team's joint POMDP between bounds, for tiny teams and tasks.

Nothing is relaxed or decomposed. Observed are the states of all tasks and the robot's location; hidden are beta and
theta of all people. Theta of several people may move in one step, also where nothing is suggested. The numbers of
states are products over people, so that two people with a task of some dozen states are about the limit. The solution
is the reference for scalable methods: team policies, and the bound for large teams (`assist.certify.team_bound`).

It is found by heuristic search value iteration (Smith and Simmons, "Heuristic search value iteration for POMDPs", 2004)
in its basic form. The lower bound consists of alpha vectors, the first of which is the policy that never helps. The
upper bound consists of the MDP values with everything observed, and of points with sawtooth interpolation. The code is
independent of the solver of one person's POMDP, so that each checks the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, reduce
from itertools import cycle, product
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from assist.people.decision import Floats
from assist.people.neighbourhood import Neighbourhood
from assist.people.neighbours import SeenEvent
from assist.person import AssistPOMDP
from assist.team import NOBODY, Pool

Ints = NDArray[np.int64]

SETTLED = 1e-7
"""Value iteration stops when a sweep changes no value by more, in cost units. Each iterate is a bound."""

MARGIN = 1e-10
"""The bounds are widened by this relative margin, which exceeds the accumulated rounding error."""

AIM = 0.5
"""A trial ends where the bounds are closer than this share of their distance at the root, discounted."""

FINEST, LEAST = 1e-2, 1e-6
"""An improvement is stored if it exceeds this share of a trial's target: at first, and at the end."""


class JointBounds(NamedTuple):
    """Bounds on the optimal value of a team, of never helping, and how many states are observed and hidden."""

    lower: float
    upper: float
    never: float
    states: int
    hidden: int

    @property
    def gap(self) -> float:
        """The distance of the bounds, relative to the lower one."""
        return (self.upper - self.lower) / abs(self.lower) if self.lower else 0.0


class Deed(NamedTuple):
    """What the robot does in some states of all tasks, and its L outcomes, which are people's actions.

    Attributes
    ----------
    person : int
        Whom it concerns, or `NOBODY`.
    reward : float array, shape (H,)
        Minus the expected costs of the robot's and people's actions, without moving.
    chance : float array, shape (L, H)
    target : int array, shape (L,)
        The number of the states of all tasks after each outcome.
    moved : float array, shape (L, H, H) or (1, H, H)
        The probability of each hidden state after each, as theta moves; of each outcome, or of all alike.
    """

    person: int
    reward: Floats
    chance: Floats
    target: Ints
    moved: Floats


class Act(NamedTuple):
    """The outcomes of one person's next action: their targets, costs and chances, and how theta moves.

    With a suggestion, neighbours see how much nearer each outcome comes to the goal, and whether it was followed.
    """

    target: Ints
    cost: Floats
    chance: Floats
    moved: Floats
    seen: tuple[SeenEvent, ...] = ()


def map_of(pomdp: AssistPOMDP, low: Ints, weight: Floats) -> Floats:
    """Return the probability of each (beta, theta) after each, shape (H, H), where theta moves between two cells."""
    betas, thetas = pomdp.grid.shape
    cell = np.eye(thetas)
    return np.kron(np.eye(betas), (1 - weight)[:, None] * cell[low] + weight[:, None] * cell[low + 1])


def act(pomdp: AssistPOMDP, x: int, action: int) -> Act:
    """Return the outcomes of a person in a state under an action of the robot."""
    (betas, thetas), choices, place = pomdp.grid.shape, pomdp.model.choices, int(pomdp.afterstate[x, action])
    moved = np.eye(betas * thetas)
    if pomdp.moves[x, action]:
        moved = map_of(pomdp, pomdp.low[x, action, 0], pomdp.weight[x, action, 0])
    if choices.goal[place]:  # finished, or finished by the robot's execution
        return Act(np.array([place]), np.zeros(1), np.ones((1, len(moved))), moved)
    slots = np.flatnonzero(choices.applicable[place])
    chance = pomdp.likelihood(np.full_like(slots, x), np.full_like(slots, action), slots)
    chance = np.broadcast_to(chance, (len(slots), betas, thetas)).reshape(len(slots), -1)
    told, targets, seen = pomdp.suggested[x, action], choices.targets[place, slots], ()
    if told >= 0:
        gains = (choices.h[x] - choices.h[targets]).tolist()
        seen = tuple(SeenEvent(np.array(gain), slot == told, 1.0) for gain, slot in zip(gains, slots, strict=True))
    return Act(targets, choices.costs[place, slots], chance, moved, seen)


def deeds_of(people: list[AssistPOMDP], sees: Neighbourhood) -> list[list[Deed]]:
    """Return what the robot may do in each state of all tasks; the last person's index varies fastest."""
    sizes = [len(p.robot_actions) for p in people]
    acts = cache(lambda k, x, action: act(people[k], x, action))

    def moves(each: list[Act], k: int, outcome: tuple[int, ...]) -> Floats:
        """Return how theta of all moves, where those who go on have seen what person k was told and did."""
        own = [one.moved for one in each]
        for j, pomdp in enumerate(people):
            if j != k and sees.sees[j, k] and not pomdp.model.choices.goal[each[j].target[outcome[j]]]:
                event = replace(each[k].seen[outcome[k]], weight=sees.sees[j, k])
                own[j] = own[j] @ map_of(pomdp, *pomdp.grid.shares(sees.rule.update(pomdp.grid.theta, event)))
        return reduce(np.kron, own)

    def at(tasks: tuple[int, ...]) -> Iterator[Deed]:
        helping = [(k, r) for k, x in enumerate(tasks) for r in range(1, people[k].robot_actions[x])]
        over = all(p.model.choices.goal[x] for p, x in zip(people, tasks, strict=True))
        for k, action in helping if over else [(NOBODY, 0), *helping]:
            each = [acts(j, x, action if j == k else 0) for j, x in enumerate(tasks)]
            chance, moved = (reduce(np.kron, [getattr(one, name) for one in each]) for name in ("chance", "moved"))
            moved = moved[None]
            if k != NOBODY and each[k].seen and len(sees.sees):
                moved = np.array([moves(each, k, one) for one in np.ndindex(*(len(one.target) for one in each))])
            cost = np.sum(np.meshgrid(*[one.cost for one in each], indexing="ij"), axis=0).ravel()
            to = [one.ravel() for one in np.meshgrid(*[one.target for one in each], indexing="ij")]
            charge = 0.0 if k == NOBODY else people[k].robot_costs[tasks[k], action]
            yield Deed(k, -charge - cost @ chance, chance, np.ravel_multi_index(to, sizes), moved)

    return [list(at(tasks)) for tasks in product(*map(range, sizes))]


class Search:
    """Bounds at all observed states (y, place): the states of all tasks, and where the robot is; K is its base."""

    def __init__(self, deeds: list[list[Deed]], way: Floats, gamma: float) -> None:
        self.deeds, self.way, self.gamma = deeds, way, gamma
        self.seen, never = self.settled(None), self.settled(1)
        self.plans = {place: never[place][None] for place in np.ndindex(never.shape[:2])}
        self.points = {place: (np.empty((0, never.shape[2])), np.empty(0)) for place in self.plans}

    def settled(self, most: int | None) -> Floats:
        """Return values with everything observed, shape (Y, K + 1, H), of the first deeds: 1 is to never help.

        Costs are nonnegative. From 0, every iterate is an upper bound; from the largest cost in every step, a lower
        bound.
        """
        some = [(y, deed) for y, own in enumerate(self.deeds) for deed in own[:most]]
        alive, first = np.unique([y for y, _ in some], return_index=True)
        reward, places = np.array([deed.reward for _, deed in some]), np.arange(len(self.way))
        size, data, rows, columns = reward.shape[1], [], [], []
        for number, (_, deed) in enumerate(some):
            for chance, target, moved in zip(deed.chance, deed.target, cycle(deed.moved)):
                now, then = np.nonzero(moved)
                data.append(chance[now] * moved[now, then])
                rows.append(number * size + now)
                columns.append(target * size + then)
        shape = reward.size, len(self.deeds) * size
        after = csr_array((np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
        to = np.array([places if deed.person == NOBODY else np.full_like(places, deed.person) for _, deed in some])
        gain = reward[:, :, None] - self.way[places, to][:, None]
        value = np.zeros((len(self.deeds), size, len(places)))
        value[alive] = 0.0 if most is None else reward.min() / (1 - self.gamma)
        while True:
            ahead = (after @ value.reshape(shape[1], -1)).reshape(gain.shape)
            found = gain + self.gamma * np.take_along_axis(ahead, to[:, None], axis=2)
            found = np.maximum.reduceat(found, first, axis=0)
            change, value[alive] = np.abs(found - value[alive]).max(), found
            if change <= SETTLED:
                return value.transpose(0, 2, 1)

    def lower(self, place: tuple[int, int], belief: Floats) -> tuple[float, Floats]:
        """Return the largest product of an alpha vector and a belief, which may be unnormalised, and the vector."""
        found = self.plans[place] @ belief
        return float(found.max()), self.plans[place][found.argmax()]

    def upper(self, place: tuple[int, int], belief: Floats) -> float:
        """Return the sawtooth bound: the belief contains a multiple of each stored one, and that multiple's drop."""
        rows, drops = self.points[place]
        corner = float(self.seen[place] @ belief)
        if not len(drops):
            return corner
        share = np.divide(belief, rows, out=np.full_like(rows, np.inf), where=rows > 0).min(axis=1)
        return corner - float((share * drops).max())

    def outcomes(self, place: tuple[int, int], deed: Deed, belief: Floats) -> tuple[float, list[Any]]:
        """Return the reward of a deed, and each possible outcome's place and unnormalised belief."""
        to = place[1] if deed.person == NOBODY else deed.person
        after = ((belief * deed.chance)[:, None] @ deed.moved)[:, 0]
        ends = [((int(y), to), one) for y, one in zip(deed.target, after, strict=True) if one.any()]
        return float(deed.reward @ belief - self.way[place[1], to]), ends

    def trial(self, place: tuple[int, int], belief: Floats, gap: float, finest: float) -> int:
        """Follow a path to where the bounds are close, then back up along it; return how much was stored."""
        path = []
        while True:
            best, ends = -np.inf, []
            for deed in self.deeds[place[0]]:
                reward, after = self.outcomes(place, deed, belief)
                value = reward + self.gamma * sum(self.upper(*one) for one in after)
                if value > best:
                    best, ends = value, after
            path.append((place, belief, gap))
            excess = [self.upper(*one) - self.lower(*one)[0] - gap / self.gamma * one[1].sum() for one in ends]
            if max(excess, default=0.0) <= 0.0 or len(path) == 500:
                break
            place, belief = ends[int(np.argmax(excess))]
            belief, gap = belief / belief.sum(), gap / self.gamma
        return sum(self.backup(place, belief, finest * gap) for place, belief, gap in reversed(path))

    def backup(self, place: tuple[int, int], belief: Floats, finest: float) -> int:
        """Improve both bounds at a belief by a Bellman backup; return the number of improved bounds."""
        if not self.deeds[place[0]]:
            return 0
        known, bound, found = self.lower(place, belief)[0], self.upper(place, belief), []
        for deed in self.deeds[place[0]]:
            reward, after = self.outcomes(place, deed, belief)
            low, high = (sum(of(*one) for one in after) for of in (lambda *one: self.lower(*one)[0], self.upper))
            found.append((reward + self.gamma * low, reward + self.gamma * high, deed))
        stored, (low, _, deed), high = 0, max(found, key=itemgetter(0)), max(one for _, one, _ in found)
        if low > known + finest:
            to = place[1] if deed.person == NOBODY else deed.person
            after = ((belief * deed.chance)[:, None] @ deed.moved)[:, 0]
            best = np.array([self.lower((int(y), to), one)[1] for y, one in zip(deed.target, after, strict=True)])
            ahead = (best[:, None] @ deed.moved.transpose(0, 2, 1))[:, 0]
            row = deed.reward - self.way[place[1], to] + self.gamma * (deed.chance * ahead).sum(axis=0)
            kept = self.plans[place][(self.plans[place] > row).any(axis=1)]
            self.plans[place], stored = np.vstack([kept, row]), 1
        if high < bound - finest:
            rows, drops = self.points[place]
            drop = float(self.seen[place] @ belief) - high
            share = np.divide(rows, belief, out=np.full_like(rows, np.inf), where=belief > 0).min(axis=1)
            kept = share * drop < drops  # the others say no more
            self.points[place], stored = (np.vstack([rows[kept], belief]), np.append(drops[kept], drop)), stored + 1
        return stored


def begun(pool: Pool, team: tuple[int, ...]) -> tuple[Search, tuple[int, int], Floats]:
    """Return the search of a team in which all people start together, its root, and the belief there."""
    people, travel = [pool.policies[pool.model[person]].pomdp for person in team], pool.setting.travel(len(team))
    assert travel.at_once
    assert all(pomdp.frontier is None for pomdp in people)
    deeds = deeds_of(people, pool.setting.neighbourhood(len(team)))
    belief = reduce(np.kron, [pomdp.prior.ravel() for pomdp in people])
    tasks = np.ravel_multi_index([p.model.choices.initial for p in people], [len(p.robot_actions) for p in people])
    search = Search(deeds, travel.c_move[0] * travel.distance, people[0].gamma)
    return search, (int(tasks), len(people)), belief


def informed_optimum(pool: Pool) -> float:
    """Return the optimum of all people of a pool where the robot sees what is hidden, from above to 1e-6."""
    search, root, belief = begun(pool, tuple(range(len(pool.people))))
    return float(search.seen[root] @ belief)


def joint_bounds(pool: Pool, team: tuple[int, ...] | None = None, *, gap: float = 1e-3) -> JointBounds:
    """Solve the POMDP of a team in which all people start together, until (upper - lower) / |lower| is at most `gap`.

    The robot moves to a person only to act there. Moving earlier has no advantage as long as the distances satisfy the
    triangle inequality.
    """
    team = tuple(range(len(pool.people))) if team is None else team
    search, root, belief = begun(pool, team)
    finest = FINEST
    never = search.lower(root, belief)[0]
    while True:
        lower, upper = search.lower(root, belief)[0], search.upper(root, belief)
        if upper - lower <= gap * abs(lower):
            break
        if not search.trial(root, belief, max(gap * abs(lower), AIM * (upper - lower)), finest):
            finest /= 2
            if finest < LEAST:  # the rest is rounding error
                break
    states, hidden = (len(team) + 1) * len(search.deeds), len(belief)
    return JointBounds(lower - MARGIN * abs(lower), upper + MARGIN * abs(upper), never, states, hidden)
