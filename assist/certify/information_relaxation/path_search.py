"""The least sum of D on one sample path, for robots that know it.

It is found by A* on the product of all people's graphs. The terms are those of `sampled_bound`.

Assumptions. U is that of `congestion`, whose weights `Scale.counts` are at most 1 and do not increase.

Claim. The heuristic is admissible: in a state s of step t,

    D(s, a) >= (1 - alpha counts_t) D_V(s, a) - alpha sum_k fall_k(a).

Proof. D = D_V - alpha (U(s) - E[U(s') | s, a]). The term of step t in U(s) is counts_t times a lower bound on the
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
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numba.typed import Dict
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from .belief_nodes import END, LEFT, Ints, SampleGraph
from .congestion import AttentionDemand, Scale, lost

COMPILED_FOR = "bounds from sample paths: about twenty seconds"


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


def least_sum(
    path: SamplePath, rows: Sequence[Floats], price: Floats, discount: Floats, alpha: float, scale: Scale, steps: int,
    most: int,
) -> float:  # fmt: skip
    """Return the least sum of D on a sample path, or a lower bound on it after `most` expansions.

    Parameters
    ----------
    path : SamplePath
    rows : sequence of float arrays
        The rows of each person (`congestion.Rows.row`).
    price, discount : float arrays, shape (T + 1,)
        Price of attention at each step, and discount to step 0.
    alpha : float
        Share of U in the penalty.
    scale : Scale
    steps : int
        T, the largest number of steps.
    most : int
        Largest number of expansions.
    """
    counted = np.zeros(len(price))  # the part of D_V of each step that U contains
    counted[: len(scale.price)] = alpha * scale.counts[:-1]
    least = []
    for graph, single in zip(path.graphs, path.demand, strict=True):
        step = np.repeat(np.arange(len(graph.layer) - 1), np.diff(graph.edge[graph.layer]))
        least.append(graph._replace(cost=(1 - counted[step]) * graph.cost - alpha * single.fall))
    # Once people have left, as many robots without a person cost nothing.
    left = any((graph.to == LEFT).any() for graph in path.graphs)
    at_most = np.zeros_like(counted) if left else (1 - counted) * price
    ahead, heuristic = _path_prices(least, at_most, discount, len(scale.idle))
    return _astar(_Team.of(path, rows, heuristic), ahead, price * discount, alpha, scale, steps, most)


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


@njit(inner=True)
def _copy(to: Floats, row: Floats) -> None:
    """Copy a row; an array assignment takes seconds to compile."""
    for c in range(len(to)):
        to[c] = row[c]


@njit(inner=True)
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


@njit(inner=True)
def _code(t: int, state: Ints, radix: Ints, team: _Team) -> int:
    """Return a number for the nodes of all people at a step."""
    code = t
    for k in range(len(state)):
        code = code * radix[k] + (state[k] - team.first[k] + 2 if state[k] >= 0 else state[k] - LEFT)
    return code


@njit(inner=True)
def _next_attending(edge: int, node: int, team: _Team) -> int:
    """Return the next edge of a node after this one that takes attention, `END` if there is none."""
    for e in range(edge + 1, team.edge[node + 1]):
        if team.attends[e]:
            return e
    return END


@njit(inner=True)
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


@njit(inner=True)
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
    radix, product = np.empty(people, np.int64), float(steps + 2)
    for k in range(people):  # `np.diff` would take longer to compile than this function
        radix[k] = team.first[k + 1] - team.first[k] + 2
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
