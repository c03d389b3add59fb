"""A tighter bound on team policies, from samples: a robot that knows everybody's luck and pays for using it.

The bound of `assist.certify.team_bound` lets the robot be in two places at a time as long as it is in one on average.
Here it is in one place in every step, but knows how everything will come out, and pays a penalty that is zero on
average for whoever does not know (Brown, Smith and Sun, "Information relaxations and duality in stochastic dynamic
programs", 2010; for weakly coupled problems with Lagrangian penalties Ye, Zhu and Zhou, arXiv 1405.3363, 2014).

**Theorem.** Let W(s) be any function of the team's state, zero where all have finished, and V(s) one that no policy
exceeds, both discounted to step 0. With

    D(s, a) = W(s) - r(s, a) - E[W(s') | s, a]

the mean return of every policy that does not know what comes is at most

    W(s_0) - E[ min over a_0, a_1, ...  of  sum_{t < T} D(s_t, a_t) - (V - W)(s_T) ].

*Proof.* For such a policy the sum of W(s_{t+1}) - E[W(s_{t+1}) | s_t, a_t] has mean zero, since each term has, given
all before it. So its return is on average at most that of r(s_0, a_0) + ... + V(s_T) less that sum, which is W(s_0)
less the sum of D plus (V - W)(s_T); and along each luck that is at most what the best actions for this luck make of it.

Here V is the sum of the prices to be paid and of people's bounds, W = V - alpha U with U of
`assist.certify.information_relaxation.congestion`, and s is made of nodes of
`assist.certify.information_relaxation.belief_nodes`, at which the robot knows more than it can. For V alone D is what
people lose by not getting what is best for them, and the price of a step in which the robot is with nobody: with alpha
0 the bound is that of the prices, less what is lost in any case. Alpha is chosen on lucks of its own; any is sound.

**People who leave a truncated task.** A person whose task is truncated leaves it at a leaf. The leaf's value u(t, y) is
an upper bound on the person's return from step t and state y on with a robot of their own, whose attention costs the
price lambda_t at each step. The theorem needs the rewards r of a process that no policy of the team exceeds. Let a_k be
1 in a step in which the robot attends to person k, else 0, let c_k be the person's reward, and let

    r_t = sum over k still in the truncated task of (c_k - lambda_t a_k) + g_t,

with g_t = lambda_t sum_k a_k while all people are in the truncated task or at the goal, and g_t = lambda_t from the
step on in which a first person has left; a person who leaves adds u(t, y) once.

*Claim.* The mean of the discounted sum of r is at least the mean return of every policy of the team.

*Proof.* The team's reward in a step is sum_k c_k = sum_k (c_k - lambda_t a_k) + lambda_t sum_k a_k. One robot attends
to one person at most, so that sum_k a_k <= 1, and prices are not negative: the last term is at most g_t in every step.
Of a person who has left, the discounted sum of c_k - lambda_t a_k is on average at most u(t, y), given all that was
observed until then, since u bounds every way of attending to this person.

So D has the term lambda_t - g_t: a step with nobody costs its price while no person has left, and nothing afterwards.
The prices of the steps after all have ended come back on the same condition. To refund them in spite of a leaf whose
value has paid them would charge these prices twice, and what comes out is not a bound.

The least sum is found by A* over all people's graphs at a time. That the mean of U, with the weights that it had,
falls by no more than `AttentionDemand.fall`, and that what comes nearer counts no less and is nowhere below 0, makes D
at least a sum over people, which prices for this luck take apart: the least of that is the estimate that guides the
search. Where it is given up, after `POPPED` states, the least estimate of what is open stands for the least sum, and is
not above it.

The mean over lucks has a standard error, so that the bound holds with a confidence. People are worked out side by side,
and so are lucks, which changes nothing in what comes out.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import NamedTuple, TypeVar

import numba
import numpy as np
from numba.typed import Dict
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from .belief_nodes import END, LEFT, BeliefNodes, Ints, SampleGraph
from .confidence import SampledBound
from .congestion import AttentionDemand, Congestion, OutOfTimeError, Scale, lost

S = TypeVar("S")
T = TypeVar("T")

ALPHAS = (0.0, 0.2, 0.3, 0.45, 0.6, 0.7, 0.8)
"""What share of U the penalty takes into account: that of these from which most is expected."""

FIRST = ALPHAS.index(0.45)
"""Where looking for it begins; large ones take the search longest."""

PILOT = 0.1
"""The share of lucks, in addition, on which alpha is chosen."""

FOR_LUCKS = 0.5
"""The share of the time that is kept for the others: once no more is left, no larger alpha is tried."""

AFTER = 10
"""Steps without prices in which the robot is still in one place at a time."""

WISHES = 22
"""Steps from the beginning whose conflicts U counts; what later ones would count is next to nothing."""

ROUNDS = 60
"""Times that the prices for one luck are changed."""

STEP = 0.3
"""What they change by in the first round, in cost units."""

POPPED = 1_600_000
"""States that are looked at for one luck, at most, times people: with fewer, large alphas come to nothing."""


class SamplePath(NamedTuple):
    """What can come about with one luck of all people.

    Attributes
    ----------
    graphs : list of SampleGraph
        Each person's.
    wishes : list of AttentionDemand
        What they want in these; their means are parts of the next.
    mean : float array, shape (e, A * (L + 2))
        One person's after the other's.
    """

    graphs: list[SampleGraph]
    wishes: list[AttentionDemand]
    mean: Floats

    @classmethod
    def of(cls, people: Sequence[tuple[SampleGraph, AttentionDemand]]) -> SamplePath:
        """Join what there is of each person; no mean is kept twice, as they are by far the largest part."""
        mean = np.concatenate([wish.mean for _, wish in people])
        ends = np.cumsum([len(graph.to) for graph, _ in people])
        means = np.split(mean, ends[:-1])
        wishes = [wish._replace(mean=own) for (_, wish), own in zip(people, means, strict=True)]
        return cls([graph for graph, _ in people], wishes, mean)


class _Team(NamedTuple):
    """All people's graphs for one luck, n nodes and e edges, one person's after the other's.

    Attributes
    ----------
    first : int array, shape (K + 1,)
        The nodes of person k are those from `first[k]` to `first[k + 1]`.
    edge, to, cost, attends : arrays
        As of a `SampleGraph`.
    row : float array, shape (n + 1, A * (L + 2))
        What is wanted at each node; the last two rows are those of `LEFT` and `END`, so that these are their indices.
    mean : float array, shape (e, A * (L + 2))
        The mean of what may follow.
    guide : float array, shape (n,)
        An estimate of what costs are still to come from each node on, not above these.
    """

    first: Ints
    edge: Ints
    to: Ints
    cost: Floats
    attends: NDArray[np.bool_]
    row: Floats
    mean: Floats
    guide: Floats

    @classmethod
    def of(cls, path: SamplePath, rows: Sequence[Floats], guide: Sequence[Floats]) -> _Team:
        """Join these; `rows` are each person's, of which nodes have some."""
        graphs = path.graphs
        *nodes, node = np.cumsum([0, *(len(graph.node) for graph in graphs)])
        *edges, edge = np.cumsum([0, *(len(graph.to) for graph in graphs)])
        return cls(
            np.array([*nodes, node]),
            np.concatenate([*(graph.edge[:-1] + e for graph, e in zip(graphs, edges, strict=True)), [edge]]),
            np.concatenate([np.where(g.to < 0, g.to, g.to + j) for g, j in zip(graphs, nodes, strict=True)]),
            np.concatenate([graph.cost for graph in graphs]),
            np.concatenate([graph.attends for graph in graphs]),
            np.concatenate([*(row[wish.of] for row, wish in zip(rows, path.wishes, strict=True)), rows[0][[1, 0]]]),
            path.mean,
            np.concatenate(guide),
        )  # fmt: skip


class InformationRelaxation:
    """The bound for a team whose people have these lattices, at these prices.

    Parameters
    ----------
    lattices : sequence of BeliefNodes
        One for each person; people with one problem share one.
    price : float array, shape (W,)
        Of the steps that the lattices' problems tell apart.
    steps : int
        For so many, at least, and for `AFTER` without a price, the robot is in one place at a time.
    left : callable
        Called with how many lucks have been looked at; gives the share of the time that is left, 0 or less if none.
    workers : int
        People and lucks that are looked at at a time.

    Raises
    ------
    OutOfTimeError
        It was over before what people will want was worked out.
    """

    def __init__(
        self, lattices: Sequence[BeliefNodes], price: Floats, steps: int = 0,
        left: Callable[[int], float] = lambda _: 1.0, workers: int = 1,
    ) -> None:  # fmt: skip
        self.left, self.done, self.workers = left, 0, workers
        gamma = lattices[0].arrays.gamma
        tasks = [lattice.visits.alone.model.choices for lattice in lattices]
        unit = min(task.unit for task in tasks)
        self.steps = max(steps, len(price) + AFTER)
        self.price = np.append(price, np.zeros(self.steps + 1 - len(price)))
        self.scale = Scale.of(self.price[: min(self.steps, WISHES)], gamma, unit)
        kinds = {id(lattice): Congestion(lattice, self.scale, self._go_on) for lattice in lattices}
        self.kinds, self.people = list(kinds.values()), [kinds[id(lattice)] for lattice in lattices]
        self.discount: Floats = np.power(gamma, np.arange(self.steps + 1))
        # All prices are paid, those of the steps as well whose conflicts U does not count.
        self.value = float(self.price @ self.discount) + sum(lattice.value for lattice in lattices)
        roots = dict(zip(kinds, self._each(Congestion.at_root, self.kinds), strict=True))
        self.lost = lost(0, np.array([roots[id(lattice)] for lattice in lattices]), self.scale)

    def _each(self, do: Callable[[S], T], those: Iterable[S]) -> list[T]:
        with ThreadPoolExecutor(self.workers) as threads:
            return list(threads.map(do, those))

    def _go_on(self) -> None:
        if self.left(self.done) <= 0:
            raise OutOfTimeError

    def paths(self, generators: Sequence[np.random.Generator]) -> list[SamplePath]:
        """Draw everybody's luck, with each of these."""
        lucks = [rng.random((len(self.people), self.steps + 1)) for rng in generators]

        def of(kind: Congestion) -> list[list[tuple[SampleGraph, AttentionDemand]]]:
            own = [luck[[person is kind for person in self.people]] for luck in lucks]
            graphs = [[kind.lattice.graph(one) for one in luck] for luck in own]
            return [[(graph, kind.of(graph)) for graph in of_luck] for of_luck in graphs]

        found = dict(zip(map(id, self.kinds), self._each(of, self.kinds), strict=True))
        return [
            SamplePath.of([found[id(person)][number].pop(0) for person in self.people]) for number in range(len(lucks))
        ]

    def bound(self, path: SamplePath, alpha: float) -> float:
        """Give what the robot gets at most that knows this luck, less its penalty."""
        told = np.zeros(len(self.price))  # what U counts of each step's conflict; of the rest D is what people lose
        told[: len(self.scale.price)] = alpha * self.scale.counts[:-1]
        least = []
        for graph, wish in zip(path.graphs, path.wishes, strict=True):
            step = np.repeat(np.arange(len(graph.layer) - 1), np.diff(graph.edge[graph.layer]))
            least.append(graph._replace(cost=(1 - told[step]) * graph.cost - alpha * wish.fall))
        # Once a person has left, a step with nobody costs nothing.
        left = any((graph.to == LEFT).any() for graph in path.graphs)
        ahead, guide = _guide(least, np.zeros_like(told) if left else (1 - told) * self.price, self.discount)
        team = _Team.of(path, [person.rows.row for person in self.people], guide)
        found = _search(
            team, ahead, self.price * self.discount, alpha, self.scale, self.steps, POPPED // len(self.people)
        )  # fmt: skip
        return self.value - alpha * self.lost - found

    def sampled(self, paths: int, seed: int) -> SampledBound:
        """Average over so many lucks, or fewer where time is short, but no fewer than 2.

        Raises
        ------
        OutOfTimeError
            It was over before these were looked at: where what people will want takes long to work out.
        """
        few, paths = max(2, math.ceil(PILOT * paths)), max(2, paths)
        pilot: list[SamplePath] = []
        # The share of the time that the last of these took, each: the first set up rows that all others share.
        drawing = 0.0
        while len(pilot) < few and (len(pilot) < 2 or self.left(self.done) > FOR_LUCKS):
            before, numbers = self.left(self.done), range(len(pilot), min(few, len(pilot) + self.workers))
            pilot += self._draw(seed, 0, numbers)
            self.done = len(pilot)
            drawing = (before - self.left(self.done)) / len(numbers)
        alpha = self._best_alpha(pilot, paths, drawing)
        found: list[float] = []
        with suppress(OutOfTimeError):
            while len(found) < paths and (len(found) < 2 or self.left(self.done) > 0):
                numbers = range(len(found), min(paths, len(found) + self.workers))
                found += self._bounds(self._draw(seed, 1, numbers), alpha)
                self.done = len(pilot) + len(found)
        if len(found) < 2:
            raise OutOfTimeError
        return SampledBound.of(found, len(found), alpha)

    def _draw(self, seed: int, kind: int, numbers: Sequence[int]) -> list[SamplePath]:
        seeds = [np.random.SeedSequence(seed, spawn_key=(4, kind, number)) for number in numbers]
        return self.paths([np.random.default_rng(one) for one in seeds])

    def _bounds(self, paths: Sequence[SamplePath], alpha: float) -> list[float]:
        return self._each(lambda path: self.bound(path, alpha), paths)

    def _best_alpha(self, pilot: Sequence[SamplePath], paths: int, drawing: float) -> float:
        """Go on from `FIRST` while it makes the bound lower that is to be expected of the lucks that there is time for.

        The mean over lucks is convex in alpha where no search is given up. But a large alpha takes the search longer:
        of what is left of the time each luck takes the share `drawing` and what the search took on the pilot's.
        """
        rest = self.left(self.done)
        uppers: dict[int, float] = {}

        def upper(number: int) -> float:
            if number not in uppers:
                before = self.left(self.done)
                found = self._bounds(pilot, ALPHAS[number])
                each = drawing + (before - self.left(self.done)) / len(pilot)
                lucks = max(2, min(paths, int(rest / each))) if each > 0 else paths
                uppers[number] = SampledBound.of(found, lucks, ALPHAS[number]).upper
            return uppers[number]

        best = FIRST
        while best > 0 and upper(best - 1) < upper(best):
            best -= 1
        if best < FIRST:
            return ALPHAS[best]
        while best + 1 < len(ALPHAS) and self.left(self.done) > FOR_LUCKS and upper(best + 1) < upper(best):
            best += 1
        return ALPHAS[best]


def _guide(graphs: list[SampleGraph], price: Floats, discount: Floats) -> tuple[Floats, list[Floats]]:
    """Find prices for this luck at which people's least costs, each by themselves, come to most (subgradients).

    Returns
    -------
    ahead : float array, shape (T + 2,)
        What the robot's time from each step on adds to the costs.
    values : list of float arrays, shape (n,)
        Each person's least cost from each node of their graph on.
    """
    steps = len(discount) - 1
    surcharge, past = np.zeros(steps), np.full(steps, 1e-12)
    best, kept = -np.inf, (np.zeros(steps + 2), [np.zeros(len(graph.node)) for graph in graphs])
    for _ in range(ROUNDS):
        busy = np.zeros(steps)
        values = [np.zeros(len(graph.node)) for graph in graphs]
        for graph, value in zip(graphs, values, strict=True):
            _least(graph, surcharge * discount[:steps], value, busy)
        ahead = np.append(np.cumsum((-surcharge * discount[:steps])[::-1])[::-1], [0.0, 0.0])
        total = ahead[0] + sum(float(value[0]) for value in values)
        if total > best:
            best, kept = total, (ahead, values)
        slope = busy - 1
        past += slope**2
        surcharge = np.maximum(-price[:steps], surcharge + STEP * slope / np.sqrt(past))
    return kept


@njit(nogil=True)
def _least(graph: SampleGraph, surcharge: Floats, value: Floats, busy: Floats) -> None:
    """Fill in the least costs from each node on, and count the steps of attention on the best way."""
    layers = len(graph.layer) - 1
    best = np.full(len(value), -1)
    for t in range(layers - 1, -1, -1):
        for j in range(graph.layer[t], graph.layer[t + 1]):
            least = np.inf
            for e in range(graph.edge[j], graph.edge[j + 1]):
                cost = graph.cost[e]
                if graph.attends[e]:
                    cost += surcharge[t]
                if graph.to[e] >= 0:
                    cost += value[graph.to[e]]
                if cost < least:
                    least, best[j] = cost, e
            value[j] = least if best[j] >= 0 else 0.0
    j = 0
    for t in range(layers):
        e = best[j]
        if e < 0:
            break
        busy[t] += graph.attends[e]
        j = graph.to[e]
        if j < 0:
            break


@njit()
def _copy(to: Floats, row: Floats) -> None:
    """Copy a row; an assignment of arrays takes seconds to compile."""
    for c in range(len(to)):
        to[c] = row[c]


@njit(nogil=True)
def _search(
    team: _Team, ahead: Floats, price: Floats, alpha: float, scale: Scale, steps: int, most: int
) -> float:  # fmt: skip
    """Give the least sum of D for one luck, or less where that takes more states than `most`; prices are discounted."""
    people = len(team.first) - 1
    start, estimate = team.first[:-1].copy(), ahead[0]
    for k in range(people):
        estimate += team.guide[start[k]]
    states, costs, times = [start], [0.0], [0]
    heap = [(estimate, 0)]
    radix = np.diff(team.first) + 2
    product = float(steps + 2)
    for k in range(people):
        product *= radix[k]
    exact = product < 2.0**62  # else states are not recognised when they are met again, which only takes longer
    seen = Dict.empty(numba.types.int64, numba.types.float64)
    here, next_ = np.ones((people, team.row.shape[1])), np.ones((people, team.row.shape[1]))
    idle = np.empty(people, np.int64)
    popped = 0
    while len(heap):
        estimate, number = heapq.heappop(heap)
        state, cost, t = states[number], costs[number], times[number]
        if t < 0:
            return estimate
        if exact:
            code = t
            for k in range(people):
                code = code * radix[k] + (state[k] - team.first[k] + 2 if state[k] >= 0 else state[k] - LEFT)
            if code in seen and seen[code] <= cost:
                continue
            seen[code] = cost
        popped += 1
        if popped > most:
            return estimate
        finished, left = True, False
        for k in range(people):
            _copy(here[k], team.row[state[k]])
            finished, left = finished and state[k] < 0, left or state[k] == LEFT
        granted = 0.0 if left else 1.0  # the prices of steps with nobody come back only while nobody has left
        loss = alpha * lost(t, here, scale)
        if finished or t == steps:  # nothing, or nothing more, is left out: from here on V is what is known
            total = cost - loss + (granted * price[t:].sum() if finished else 0.0)
            states.append(state)
            costs.append(total)
            times.append(-1)
            heapq.heappush(heap, (total, len(states) - 1))
            continue
        forced = -1
        for k in range(people):
            idle[k] = END
            if state[k] < 0:
                continue
            for e in range(team.edge[state[k]], team.edge[state[k] + 1]):
                if not team.attends[e]:
                    idle[k] = e
                    break
            if idle[k] == END:
                forced = k  # on its way to somebody the robot goes on
        for k in range(-1, people):
            if (forced >= 0 and k != forced) or (k >= 0 and state[k] < 0):
                continue
            first, end = 0, 1
            if k >= 0:
                first, end = team.edge[state[k]], team.edge[state[k] + 1]
            for e in range(first, end):
                if k >= 0 and not team.attends[e]:
                    continue
                total = cost - loss
                if k < 0:
                    total += granted * price[t]
                then, estimate = state.copy(), ahead[t + 1]
                for i in range(people):
                    if state[i] < 0:
                        _copy(next_[i], team.row[state[i]])
                        continue
                    does = e if i == k else idle[i]
                    total += team.cost[does]
                    then[i] = team.to[does]
                    _copy(next_[i], team.mean[does])
                    if then[i] >= 0:
                        estimate += team.guide[then[i]]
                total += alpha * lost(t + 1, next_, scale)
                states.append(then)
                costs.append(total)
                times.append(t + 1)
                heapq.heappush(heap, (total + estimate, len(states) - 1))
    return np.inf
