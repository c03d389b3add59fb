"""A tighter bound on team policies from samples: an information relaxation with a penalty.

The bound of `assist.certify.team_bound` enforces only on average that M robots attend to at most M people. Here this
holds in every step, but the robots know all sample paths in advance. They pay a penalty whose mean is 0 for every
policy without this knowledge (Brown, Smith and Sun, "Information relaxations and duality in stochastic dynamic
programs", 2010; for weakly coupled problems with Lagrangian penalties: Ye, Zhu and Zhou, arXiv 1405.3363, 2014).

**Theorem.** Assume that W(s) is any function of the team's state that is 0 where all people have finished, and that
V(s) is an upper bound on the value of every policy from s on, both discounted to step 0. Let r be the reward,
discounted in the same way, and

    D(s, a) = W(s) - r(s, a) - E[W(s') | s, a].

Claim: the mean return of every policy without knowledge of the future is at most

    W(s_0) - E[ min over a_0, a_1, ...  of  sum_{t < T} D(s_t, a_t) - (V - W)(s_T) ].

*Proof.* Let M be the sum over t < T of W(s_{t+1}) - E[W(s_{t+1}) | s_t, a_t]. Each term has the conditional mean 0
given the past, so that E[M] = 0 for such a policy. Its mean return is therefore at most the mean of r(s_0, a_0) + ... +
r(s_{T-1}, a_{T-1}) + V(s_T) - M. By the definition of D, this sum equals W(s_0) - sum_{t < T} D(s_t, a_t) + (V -
W)(s_T). On every sample path it is at most its value for the best actions on that path.

**Choice of W.** V is the sum of the prices to be paid and of the upper bounds of the people. W = V - alpha U, with U of
`assist.certify.information_relaxation.congestion`. The state s consists of nodes of
`assist.certify.information_relaxation.belief_nodes`, which give the robots more information. For alpha = 0, D is D_V:
the regrets of all people, plus the price of the step for each robot that attends to no one. The bound is then that of
the prices, minus what is lost on each path. Every alpha gives a valid bound. It is chosen on separate sample paths.

**People who leave a truncated task.** The upper bound u(t, y) of a leaf y is an upper bound on the person's return from
step t on with a robot of their own, whose attention has the price lambda_t. The theorem needs rewards r of a process
whose value no policy of the team exceeds. Let a_k be 1 in a step in which a robot attends to person k, and 0
otherwise. Let c_k be the person's reward, let L people have left so far, and let

    r_t = sum over k still in the truncated task of (c_k - lambda_t a_k) + g_t,
    g_t = lambda_t min(M, L + sum over k still in the truncated task of a_k).

A person who leaves adds u(t, y) once.

*Claim.* The mean of the discounted sum of r is at least the mean return of every policy of the team.

*Proof.* The team's reward in a step is sum_k c_k = sum_k (c_k - lambda_t a_k) + lambda_t sum_k a_k. M robots attend to
at most M people, so that sum_k a_k <= M, and to at most L of those who have left. As prices are at least 0, the last
term is at most g_t in every step. For a person who has left, the mean of the discounted sum of c_k - lambda_t a_k,
given all observations until then, is at most u(t, y), because u bounds every way of attending to this person.

So D contains the term M lambda_t - g_t: a robot without a person costs the price of the step, except for as many robots
as people have left. The prices of the steps after all people have finished are refunded on the same condition. If they
were refunded although the bound of a leaf has paid them, they would be counted twice, and the result would not be a
bound.

**The search.** The minimum on a sample path is found by A* on the product of all people's graphs. Its heuristic is
admissible:

    D(s, a) >= (1 - alpha counts_t) D_V(s, a) - alpha sum_k fall_k(a).

*Proof.* D = D_V - alpha (U(s) - E[U(s') | s, a]). The term of step t in U(s) is counts_t times a lower bound on the
loss of every action in this step, hence at most counts_t D_V(s, a). (A person who has left counts there as one with G =
lambda_t. They cause no regret, and a robot with them costs nothing, as in D.) The later terms of U(s) are the mean of
U(s') after everyone's best action, with the weights before the step. After a, this mean is lower by at most sum_k
fall_k(a), the sum of `AttentionDemand.fall`, which also covers Q-values above the bound of their node: in E min(M, N),
the coefficient of P(G_k > g) is the probability that fewer than M others need a robot, which is between 0 and 1. As
a step approaches, its weight does not decrease, and every term is at least 0. So E[U(s') | s, a] is at least the later
terms minus that sum.

The right-hand side is a sum over people with the constraint that at most M of them receive attention. Prices for this
sample path relax the constraint and separate it. The least sums are the heuristic. If the search exceeds its limit of
expansions, the smallest estimate of an open state is a lower bound on the minimum, and takes its place.

The mean over sample paths has a standard error, so that the bound holds with a confidence level. People and paths are
processed in parallel, which does not affect the result. The number of paths follows from the time that other paths, the
pilot, have taken. If it depended on the paths of the bound, those that take long, whose values differ from the others',
would be left out more often. If there is too little time for all of them, there is no sampled bound.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numba
import numpy as np
from numba.typed import Dict
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from .belief_nodes import END, LEFT, BeliefNodes, Ints, SampleGraph
from .confidence import SampledBound
from .congestion import AttentionDemand, Congestion, Scale, lost
from .options import RelaxationOptions

COMPILED_FOR = "bounds from sample paths: about twenty seconds"

S = TypeVar("S")
T = TypeVar("T")


class SamplePath(NamedTuple):
    """The graphs of all people on one sample path.

    Attributes
    ----------
    graphs : list of SampleGraph
        Graph of each person.
    demand : list of AttentionDemand
        Demand of each person; the arrays `mean` are views of the next attribute.
    mean : float array, shape (e, A * (L + 2))
        The mean rows of all people, one person after the other.
    """

    graphs: list[SampleGraph]
    demand: list[AttentionDemand]
    mean: Floats

    @classmethod
    def of(cls, people: Sequence[tuple[SampleGraph, AttentionDemand]]) -> SamplePath:
        """Return the path of the given people. The mean rows, by far the largest part, are stored once."""
        mean = np.concatenate([single.mean for _, single in people])
        ends = np.cumsum([len(graph.to) for graph, _ in people])
        means = np.split(mean, ends[:-1])
        demand = [single._replace(mean=own) for (_, single), own in zip(people, means, strict=True)]
        return cls([graph for graph, _ in people], demand, mean)


class _Team(NamedTuple):
    """The joint graphs of all people on one sample path, n nodes and e edges, one person after the other.

    Attributes
    ----------
    first : int array, shape (K + 1,)
        The nodes of person k are `first[k]` up to `first[k + 1]`.
    edge, to, cost, attends : arrays
        As in `SampleGraph`.
    row : float array, shape (n + 1, A * (L + 2))
        Demand at each node. The last two rows are those of `LEFT` and `END`, so that these are their indices.
    mean : float array, shape (e, A * (L + 2))
        Mean demand after each edge.
    heuristic : float array, shape (n,)
        Lower bound on the costs from each node on.
    """

    first: Ints
    edge: Ints
    to: Ints
    cost: Floats
    attends: NDArray[np.bool_]
    row: Floats
    mean: Floats
    heuristic: Floats

    @classmethod
    def of(cls, path: SamplePath, rows: Sequence[Floats], heuristic: Sequence[Floats]) -> _Team:
        """Return the joint graphs; `rows` holds the rows of each person."""
        graphs = path.graphs
        *nodes, node = np.cumsum([0, *(len(graph.node) for graph in graphs)])
        *edges, edge = np.cumsum([0, *(len(graph.to) for graph in graphs)])
        return cls(
            np.array([*nodes, node]),
            np.concatenate([*(graph.edge[:-1] + e for graph, e in zip(graphs, edges, strict=True)), [edge]]),
            np.concatenate([np.where(g.to < 0, g.to, g.to + j) for g, j in zip(graphs, nodes, strict=True)]),
            np.concatenate([graph.cost for graph in graphs]),
            np.concatenate([graph.attends for graph in graphs]),
            np.concatenate([*(row[single.of] for row, single in zip(rows, path.demand, strict=True)), rows[0][[1, 0]]]),
            path.mean,
            np.concatenate(heuristic),
        )  # fmt: skip


class InformationRelaxation:
    """The sampled bound of a team, given the belief nodes of its people and prices.

    Parameters
    ----------
    belief_nodes : sequence of BeliefNodes
        One for each person; people with the same subproblem share one.
    price : float array, shape (W,)
        Prices of the steps that the subproblems distinguish.
    steps : int
        Each robot is in one place at a time for at least so many steps, and for `free_steps` steps without a price.
    left : callable
        Called with the number of processed paths; returns the share of the time that remains, at most 0 if none.
    workers : int
        Number of people and of paths that are processed at a time.
    options : RelaxationOptions, optional
    robots : int
        M, the number of robots.

    Raises
    ------
    TimeoutError
        The time has passed before the demand at the beginning was computed.
    """

    def __init__(
        self, belief_nodes: Sequence[BeliefNodes], price: Floats, steps: int = 0,
        left: Callable[[int], float] = lambda _: 1.0, workers: int = 1, options: RelaxationOptions | None = None,
        robots: int = 1,
    ) -> None:  # fmt: skip
        self.left, self.done, self.workers, self.latest = left, 0, workers, 0.0
        self.options = options = options or RelaxationOptions()
        gamma = belief_nodes[0].relaxed.m.gamma
        tasks = [one.visits.alone.model.choices for one in belief_nodes]
        unit = min(task.unit for task in tasks)
        self.steps = max(steps, len(price) + options.free_steps)
        self.price = np.append(price, np.zeros(self.steps + 1 - len(price)))
        self.scale = Scale.of(self.price[: min(self.steps, options.congestion_steps)], gamma, unit, options, robots)
        kinds = {id(one): Congestion(one, self.scale, self._go_on, options.rows_per_check) for one in belief_nodes}
        self.kinds, self.people = list(kinds.values()), [kinds[id(one)] for one in belief_nodes]
        self.robots = robots
        self.discount: Floats = np.power(gamma, np.arange(self.steps + 1))
        # All prices are paid, including those of steps whose conflicts do not count in U.
        self.value = robots * float(self.price @ self.discount) + sum(one.value for one in belief_nodes)
        roots = dict(zip(kinds, self._each(Congestion.at_root, self.kinds), strict=True))
        self.lost = lost(0, np.array([roots[id(one)] for one in belief_nodes]), self.scale)

    def _each(self, do: Callable[[S], T], those: Iterable[S]) -> list[T]:
        with ThreadPoolExecutor(self.workers) as threads:
            return list(threads.map(do, those))

    def _go_on(self) -> None:
        if self.left(self.done) <= self.latest:
            raise TimeoutError

    def paths(self, generators: Sequence[np.random.Generator]) -> list[SamplePath]:
        """Draw sample paths, one with each generator."""
        uniforms = [rng.random((len(self.people), self.steps + 1)) for rng in generators]

        def of(kind: Congestion) -> list[list[tuple[SampleGraph, AttentionDemand]]]:
            own = [numbers_of_path[[person is kind for person in self.people]] for numbers_of_path in uniforms]
            graphs = [[kind.belief_nodes.graph(one) for one in numbers_of_path] for numbers_of_path in own]
            return [[(graph, kind.of(graph)) for graph in of_path] for of_path in graphs]

        found = dict(zip(map(id, self.kinds), self._each(of, self.kinds), strict=True))
        return [
            SamplePath.of([found[id(person)][number].pop(0) for person in self.people])
            for number in range(len(uniforms))
        ]

    def bound(self, path: SamplePath, alpha: float) -> float:
        """Return the largest return, minus the penalty, of robots that know this sample path."""
        counted = np.zeros(len(self.price))  # the part of D_V of each step that U contains
        counted[: len(self.scale.price)] = alpha * self.scale.counts[:-1]
        least = []
        for graph, single in zip(path.graphs, path.demand, strict=True):
            step = np.repeat(np.arange(len(graph.layer) - 1), np.diff(graph.edge[graph.layer]))
            least.append(graph._replace(cost=(1 - counted[step]) * graph.cost - alpha * single.fall))
        # Once people have left, as many robots without a person cost nothing.
        left = any((graph.to == LEFT).any() for graph in path.graphs)
        ahead, heuristic = _path_prices(
            least, np.zeros_like(counted) if left else (1 - counted) * self.price, self.discount, self.robots
        )
        team = _Team.of(path, [person.rows.row for person in self.people], heuristic)
        most = self.options.max_expansions // len(self.people)
        found = _astar(team, ahead, self.price * self.discount, alpha, self.scale, self.steps, most)
        return self.value - alpha * self.lost - found

    def sampled(self, paths: int, seed: int) -> SampledBound:
        """Return the mean bound over `paths` sample paths, or over fewer if the time is short.

        A tenth as many additional paths, the pilot, serve the choice of alpha and of the number of paths.

        Raises
        ------
        TimeoutError
            The time, and a quarter of it more, has passed before all these paths were processed.
        """
        few, paths = max(2, math.ceil(0.1 * paths)), max(2, paths)
        self.latest = 0.0
        pilot: list[SamplePath] = []
        # Share of the time per path, measured on the last batch: the first one also computes rows that all paths share.
        drawing = 0.0
        while len(pilot) < few and (len(pilot) < 2 or self.left(self.done) > self.options.path_share):
            before, numbers = self.left(self.done), range(len(pilot), min(few, len(pilot) + self.workers))
            pilot += self._draw(seed, 0, numbers)
            self.done = len(pilot)
            drawing = (before - self.left(self.done)) / len(numbers)
        alpha, paths = self._choice(pilot, paths, drawing)
        self.latest, found = -0.25, list[float]()
        while len(found) < paths:
            self._go_on()
            numbers = range(len(found), min(paths, len(found) + self.workers))
            found += self._bounds(self._draw(seed, 1, numbers), alpha)
            self.done = len(pilot) + len(found)
        return SampledBound.of(found, len(found), alpha)

    def _draw(self, seed: int, kind: int, numbers: Sequence[int]) -> list[SamplePath]:
        seeds = [np.random.SeedSequence(seed, spawn_key=(4, kind, number)) for number in numbers]
        return self.paths([np.random.default_rng(one) for one in seeds])

    def _bounds(self, paths: Sequence[SamplePath], alpha: float) -> list[float]:
        return self._each(lambda path: self.bound(path, alpha), paths)

    def _choice(self, pilot: Sequence[SamplePath], paths: int, drawing: float) -> tuple[float, int]:
        """Return the alpha with the lowest expected bound for the time that remains, and the number of paths for it.

        The search begins at the middle candidate, since large alphas take longest, and moves to neighbours while the
        bound decreases. Without a limit of expansions, the mean over paths is convex in alpha. But a large alpha allows
        fewer paths in the remaining time: each takes the share `drawing`, and as long for its search as a pilot path.
        A fifth of the time is kept for paths that take longer than those of the pilot.
        """
        alphas, path_share, rest = self.options.alphas, self.options.path_share, self.left(self.done)
        uppers: dict[int, float] = {}
        shares: dict[int, float] = {}

        def within(time: float, share: float) -> int:
            """Return how many paths that each take a share of the time are processed in a part of it."""
            return max(2, min(paths, int(time / share))) if share > 0 else paths if time > 0 else 2

        def upper(number: int) -> float:
            if number not in uppers:
                before = self.left(self.done)
                found = self._bounds(pilot, alphas[number])
                shares[number] = drawing + (before - self.left(self.done)) / len(pilot)
                uppers[number] = SampledBound.of(found, within(rest, shares[number]), alphas[number]).upper
            return uppers[number]

        first = best = len(alphas) // 2
        while best > 0 and upper(best - 1) < upper(best):
            best -= 1
        while (
            best >= first
            and best + 1 < len(alphas)
            and self.left(self.done) > path_share
            and upper(best + 1) < upper(best)
        ):
            best += 1
        upper(best)  # known unless there is one alpha only
        return alphas[best], within(0.8 * self.left(self.done), shares[best])


def _path_prices(
    graphs: list[SampleGraph], price: Floats, discount: Floats, robots: int
) -> tuple[Floats, list[Floats]]:
    """Optimise prices for one sample path that maximise the sum of the people's least costs (a subgradient method).

    Returns
    -------
    ahead : float array, shape (T + 2,)
        Contribution of all robots' attention from each step on.
    values : list of float arrays, shape (n,)
        Least cost of each person from each node of their graph on.
    """
    steps = len(discount) - 1
    surcharge, past = np.zeros(steps), np.full(steps, 1e-12)
    best, kept = -np.inf, (np.zeros(steps + 2), [np.zeros(len(graph.node)) for graph in graphs])
    for _ in range(60):  # rounds; any prices give a valid heuristic
        busy = np.zeros(steps)
        values = [np.zeros(len(graph.node)) for graph in graphs]
        for graph, value in zip(graphs, values, strict=True):
            _least(graph, surcharge * discount[:steps], value, busy)
        ahead = np.append(robots * np.cumsum((-surcharge * discount[:steps])[::-1])[::-1], [0.0, 0.0])
        total = ahead[0] + sum(float(value[0]) for value in values)
        if total > best:
            best, kept = total, (ahead, values)
        slope = busy - robots
        past += slope**2
        surcharge = np.maximum(-price[:steps], surcharge + 0.3 * slope / np.sqrt(past))
    return kept


@njit(nogil=True)
def _least(graph: SampleGraph, surcharge: Floats, value: Floats, busy: Floats) -> None:
    """Fill in the least costs from each node on, and count the steps with attention on the best path."""
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
    """Copy a row; an array assignment takes seconds to compile."""
    for c in range(len(to)):
        to[c] = row[c]


@njit()
def _advance(
    state: Ints, total: float, estimate: float, edge: Ints, row: Floats, team: _Team
) -> tuple[float, float]:  # fmt: skip
    """Move every person to their next node along an edge, in place.

    Return `total` plus the costs, and `estimate` plus the lower bounds of the nodes. `row` receives the rows of the
    nodes, averaged over what is not yet known.
    """
    for i in range(len(state)):
        if state[i] < 0:
            _copy(row[i], team.row[state[i]])
            continue
        does = edge[i]
        total += team.cost[does]
        state[i] = team.to[does]
        _copy(row[i], team.mean[does])
        if state[i] >= 0:
            estimate += team.heuristic[state[i]]
    return total, estimate


@njit()
def _code(t: int, state: Ints, radix: Ints, team: _Team) -> int:
    """Return a number for the nodes of all people at a step."""
    code = t
    for k in range(len(state)):
        code = code * radix[k] + (state[k] - team.first[k] + 2 if state[k] >= 0 else state[k] - LEFT)
    return code


@njit()
def _next_attending(edge: int, node: int, team: _Team) -> int:
    """Return the next edge of a node after this one that takes attention, `END` if there is none."""
    for e in range(edge + 1, team.edge[node + 1]):
        if team.attends[e]:
            return e
    return END


@njit()
def _first_actions(state: Ints, idle: Ints, edge: Ints, team: _Team) -> int:
    """Fill in each person's edge without attention, `END` if there is none; return the number of the latter.

    A robot on its way to a person continues, so that the person receives attention. `edge` receives the first joint
    action: attention only to them.
    """
    attended = 0
    for k in range(len(state)):
        idle[k] = edge[k] = END
        if state[k] < 0:
            continue
        for e in range(team.edge[state[k]], team.edge[state[k] + 1]):
            if not team.attends[e]:
                idle[k] = edge[k] = e
                break
        if idle[k] == END:
            edge[k] = _next_attending(team.edge[state[k]] - 1, state[k], team)
            attended += 1
    return attended


@njit()
def _next_actions(state: Ints, idle: Ints, edge: Ints, attended: int, robots: int, team: _Team) -> int:
    """Change `edge` to the next joint action that takes at most so many robots, of which `attended` are taken.

    Return the number of people who receive attention, -1 if there are no more actions. The actions are counted like a
    number whose first digit is that of the first person.
    """
    for k in range(len(state)):
        if state[k] < 0:
            continue
        without = edge[k] == idle[k]
        if not without or attended < robots:
            more = _next_attending(team.edge[state[k]] - 1 if without else edge[k], state[k], team)
            if more != END:
                edge[k] = more
                return attended + without
        if not without and idle[k] != END:
            attended -= 1
        edge[k] = idle[k] if idle[k] != END else _next_attending(team.edge[state[k]] - 1, state[k], team)
    return -1


@njit(nogil=True)
def _astar(
    team: _Team, ahead: Floats, price: Floats, alpha: float, scale: Scale, steps: int, most: int
) -> float:  # fmt: skip
    """Return the least sum of D on one sample path by A*, or a lower bound after `most` expansions.

    Prices are discounted.
    """
    people, robots = len(team.first) - 1, len(scale.idle)
    start, estimate = team.first[:-1].copy(), ahead[0]
    for k in range(people):
        estimate += team.heuristic[start[k]]
    states, costs, times = [start], [0.0], [0]
    heap = [(estimate, 0)]
    radix = np.diff(team.first) + 2
    product = float(steps + 2)
    for k in range(people):
        product *= radix[k]
    exact = product < 2.0**62  # otherwise repeated states are not detected, which only takes longer
    seen = Dict.empty(numba.types.int64, numba.types.float64)
    here, next_ = np.ones((people, team.row.shape[1])), np.ones((people, team.row.shape[1]))
    idle, edge = np.empty(people, np.int64), np.empty(people, np.int64)
    expanded = 0
    while len(heap):
        estimate, number = heapq.heappop(heap)
        state, cost, t = states[number], costs[number], times[number]
        if t < 0:
            return estimate
        if exact:
            code = _code(t, state, radix, team)
            if code in seen and seen[code] <= cost:
                continue
            seen[code] = cost
        expanded += 1
        if expanded > most:
            return estimate
        finished, refund = True, robots  # prices are refunded to robots without a person, except one for each who left
        for k in range(people):
            _copy(here[k], team.row[state[k]])
            finished = finished and state[k] < 0
            if state[k] == LEFT and refund:
                refund -= 1
        loss = alpha * lost(t, here, scale)
        if finished or t == steps:  # the end: the remaining return is bounded by V
            total = cost - loss + (refund * price[t:].sum() if finished else 0.0)
            states.append(state)
            costs.append(total)
            times.append(-1)
            heapq.heappush(heap, (total, len(states) - 1))
            continue
        attended = _first_actions(state, idle, edge, team)
        while attended >= 0:
            total = cost - loss
            if attended < refund:
                total += (refund - attended) * price[t]
            then = state.copy()
            total, estimate = _advance(then, total, ahead[t + 1], edge, next_, team)
            total += alpha * lost(t + 1, next_, scale)
            states.append(then)
            costs.append(total)
            times.append(t + 1)
            heapq.heappush(heap, (total + estimate, len(states) - 1))
            attended = _next_actions(state, idle, edge, attended, robots, team)
    return np.inf
