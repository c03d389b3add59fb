"""The expected loss when more people need a robot at the same time than there are robots.

Let each person be served by a robot of their own that acts optimally at the prices of the bound. Let G_k be the value
of attention to person k in a step, and lambda its price. With all these robots, the step contributes M lambda + sum_k
(G_k - lambda)^+ to the bound. M robots, which attend to at most M people, yield at most the sum of the M largest G_k^+.
Let N(g) be the number of people with G_k > g. Then this sum is the integral of min(M, N(g)) over g >= 0, so that the
step loses at least

    M lambda + sum_k (G_k - lambda)^+ - integral over g of min(M, N(g)).

The expected discounted loss from a state in step t on, with robots of their own until then, is

    U = sum_s w_s gamma^(t+s) ( M lambda + sum_k E (G_k - lambda)^+ - integral over g of E min(M, N(g)) )

with lambda and G of step t + s and all w_s = 1. As people are independent, N(g) has a Poisson binomial distribution,
and E min(M, N) = M - sum_{n < M} (M - n) P(N = n). With one robot this is 1 - prod_k P(G_k <= g). With M robots, people
who receive no attention need it later, so that this prediction is not exact. Therefore later steps have a smaller
weight w_s = fading^s (`RelaxationOptions`), which rises to 1 as the step approaches. Steps late in an episode never get
the full weight (`Scale.counts`).

For each node of a person, `Congestion` needs the distribution of G at each later step, on a few levels g. U is linear
in each person's distribution. So the mean of U over the outcomes of an action is U of the mean distributions. This
makes it a penalty whose conditional mean can be computed for any number of people.

Within an interval between two levels, U uses the mean of P(G_k <= g). Claim. The term of the present step is still
at most the loss. Proof. For known G_k and g uniform in the interval, the events G_k > g are nested, and U treats them
as independent events of the same probabilities. The function min(M, .) is concave. Nested events have the sum that is
largest in the convex order, hence the smallest mean of min(M, N). So U subtracts at least the integral.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from .belief_nodes import LEFT, BeliefNodes, Ints, NodeTable, Relaxed, SampleGraph, expand_node, state_of
from .options import RelaxationOptions

COMPILED_FOR = "bounds from sample paths: about twenty seconds"

LEVELS = np.array([0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0])
"""Levels of G minus the price at which its distribution is known, in units of the cheapest action's cost.

There is one more interval, between 0 and the price. Values above the last level count as that level.
"""


class Scale(NamedTuple):
    """The layout of a row, the distribution of G (see the module) in the following steps: A blocks of L + 2 entries.

    The entries are one for the interval below the price, one for each level above it, and one for sums. As the price is
    the boundary of two intervals, the loss of a step is at least 0 for all distributions.

    Attributes
    ----------
    price : float array, shape (W,)
    width : float array, shape (L,)
    level : float array, shape (L + 1,)
    discount : float array, shape (W + 1,)
    weight : float array, shape (A,)
        Weight of a conflict by the number of steps ahead.
    counts : float array, shape (W + 1,)
        Largest weight of a conflict by its step from the beginning; it does not increase.
    idle : float array, shape (M,)
        Number of robots without a person if 0, 1, ..., M - 1 people need one: M, M - 1, ..., 1.
    """

    price: Floats
    width: Floats
    level: Floats
    discount: Floats
    weight: Floats
    counts: Floats
    idle: Floats

    @classmethod
    def of(cls, price: Floats, gamma: float, unit: float, options: RelaxationOptions, robots: int = 1) -> Scale:
        """Return the scale for W steps with these prices; `unit` is the cost of the cheapest action."""
        ahead = np.arange(len(price) + 1.0)
        counts = np.exp(-np.maximum(ahead - options.full_weight_steps, 0.0) / options.decay_steps)
        weight = options.fading ** ahead[: min(options.steps_ahead, len(price))]
        return cls(
            np.array(price), unit * np.diff(LEVELS), unit * LEVELS, gamma**ahead, weight, counts,
            np.arange(robots, 0.0, -1.0),
        )  # fmt: skip

    @property
    def size(self) -> int:
        """The number of entries of a block."""
        return len(self.width) + 2


class Rows(NamedTuple):
    """A row for each node: the distribution of G in the following steps. Row 0 is that of `END`, row 1 of `LEFT`.

    A person at the goal needs nothing. A person who has left a truncated task may use a robot at its price in every
    step, so that their G is the price. Then a robot that attends to no one else loses nothing, as in the search.

    The blocks of a node refer to numbers of steps ahead, so that one row serves a node in every step.

    Attributes
    ----------
    of : int array, shape (nodes,)
        Row of each node; -1 if it has not been computed.
    depth : int array, shape (nodes,)
        Number of computed blocks of each node.
    row : float array, shape (rows, A * (L + 2))
        In each block, P(G <= g) as means over the intervals between levels, and the sum of the means of (G - lambda)^+
        and of the excess of the bound.
    used : int array, shape (2,)
        Number of rows, and number of rows that may be computed until the next call of `go_on`.
    """

    of: Ints
    depth: Ints
    row: Floats
    used: Ints


class AttentionDemand(NamedTuple):
    """The distribution of G after the nodes and edges of one sample path's graph, as rows (`Rows`).

    Attributes
    ----------
    of : int array, shape (n,)
        Row of each node.
    mean : float array, shape (e, A * (L + 2))
        For each edge, the mean of the rows of its outcomes.
    fall : float array, shape (e,)
        For each edge, an upper bound on the decrease of the mean of U, with the weights before the edge, compared with
        the best edge. It includes the excess of the best Q-value over the node's bound, which arises as very small
        parts of beliefs are replaced by corners.
    """

    of: Ints
    mean: Floats
    fall: Floats


class Congestion:
    """The demand of one person for attention, computed as needed.

    Parameters
    ----------
    belief_nodes : BeliefNodes
    scale : Scale
    go_on : callable
        Called from time to time in long computations. If it raises an error, all computed data remain valid.
    pause : int
        Number of rows that are computed between two calls of `go_on`: by default about a second on tasks of millions of
        states.
    """

    def __init__(
        self,
        belief_nodes: BeliefNodes,
        scale: Scale,
        go_on: Callable[[], None] = lambda: None,
        pause: int = RelaxationOptions.rows_per_check,
    ) -> None:
        self.belief_nodes, self.scale, self.go_on, self.pause = belief_nodes, scale, go_on, pause
        count = len(belief_nodes.nodes.first)
        self.rows = Rows(
            np.full(count, -1), np.zeros(count, dtype=np.int64), np.empty((1 << 10, len(scale.weight) * scale.size)),
            np.array([2, pause]),
        )  # fmt: skip
        self.rows.row[0] = np.tile(np.append(np.ones(scale.size - 1), 0.0), len(scale.weight))
        self.rows.row[1] = self.rows.row[0]
        self.rows.row[1, :: scale.size] = 0.0  # P(G <= g) for g below the price
        layout, price = belief_nodes.visits.layout, belief_nodes.visits.price
        self.price = np.append(price, 0.0)[np.minimum(layout.step, len(price))]

    def of(self, graph: SampleGraph) -> AttentionDemand:
        """Return the rows of a graph."""
        demand = AttentionDemand(
            np.zeros(len(graph.node), dtype=np.int64), np.empty((len(graph.to), self.rows.row.shape[1])),
            np.zeros(len(graph.to)),
        )  # fmt: skip
        while not _fill_demand(
            graph, demand, self.rows, self.scale, self.price, self.belief_nodes.nodes, self.belief_nodes.relaxed
        ):
            self._resume()
        return demand

    def at_root(self) -> Floats:
        """Return the mean row at the beginning, shape (A * (L + 2),)."""
        for node in self.belief_nodes.root.tolist():
            while not _row(
                node, len(self.scale.weight), self.rows, self.scale, self.price, self.belief_nodes.nodes,
                self.belief_nodes.relaxed,
            ):  # fmt: skip
                self._resume()
        return np.asarray(self.belief_nodes.chance @ self.rows.row[self.rows.of[self.belief_nodes.root]])

    def _resume(self) -> None:
        if self.rows.used[1] == 0:
            self.go_on()
            self.rows.used[1] = self.pause
        elif self.rows.used[0] + 1 >= len(self.rows.row):
            self.rows = self.rows._replace(row=np.concatenate([self.rows.row, np.empty_like(self.rows.row)]))
        else:
            self.belief_nodes.grow()


@njit(inner=True)
def _attention_value(
    node: int, x: int, price: float, top: float, nodes: NodeTable, attended: NDArray[np.bool_], actions: int
) -> float:
    """Return the value G of attention at a node, at most `top` above its price."""
    with_it, without = np.inf, np.inf
    for r in range(actions):
        regret = nodes.regret[nodes.first[node] + r]
        if attended[x, r]:
            with_it = min(with_it, regret)
        else:
            without = min(without, regret)
    return 0.0 if with_it == np.inf else min(without - with_it, top) + price


@njit(inner=True)
def _mean_after(edge: int, end: int, out: Floats, rows: Rows, nodes: NodeTable) -> None:
    """Fill in the mean of the rows after an edge, up to a column."""
    out[:end] = 0.0
    before = 0.0
    for k in range(nodes.begin[edge], nodes.begin[edge + 1]):
        chance = nodes.share[k] - before
        before = nodes.share[k]
        to = nodes.to[k]
        row = rows.row[rows.of[to] if to >= 0 else 1 if to == LEFT else 0]
        for c in range(end):
            out[c] += chance * row[c]


@njit(nogil=True)
def _row(node: int, depth: int, rows: Rows, scale: Scale, price: Floats, nodes: NodeTable, relaxed: Relaxed) -> bool:
    """Compute the first `depth` blocks of a node's row, and the rows of later nodes that this needs; return success."""
    levels, m, attended = len(scale.width), relaxed.m, relaxed.attended
    size = levels + 2
    stack, depths = [node], [depth]
    while len(stack):
        n, d = stack[-1], depths[-1]
        if rows.depth[n] >= d:
            stack.pop()
            depths.pop()
            continue
        if not expand_node(n, nodes, relaxed):
            return False
        x = state_of(n, relaxed.known)
        e, actions = nodes.first[n], m.robot_actions[x]
        best = e
        for r in range(e + 1, e + actions):
            if nodes.regret[r] < nodes.regret[best]:
                best = r
        ready = True
        for k in range(nodes.begin[best], nodes.begin[best + 1]):
            if nodes.to[k] >= 0 and rows.depth[nodes.to[k]] < d - 1:
                stack.append(nodes.to[k])
                depths.append(d - 1)
                ready = False
        if not ready:
            continue
        if rows.used[1] == 0:
            return False
        rows.used[1] -= 1
        if rows.of[n] < 0:
            if rows.used[0] + 1 >= len(rows.row):
                return False
            rows.of[n] = rows.used[0]
            rows.used[0] += 1
        row = rows.row[rows.of[n]]
        attention_value = _attention_value(n, x, price[x], scale.level[levels], nodes, attended, actions)
        excess = attention_value - price[x]
        row[0] = min(1.0, max(0.0, -excess / price[x])) if price[x] > 0.0 else 1.0
        for i in range(levels):
            row[i + 1] = min(1.0, max(0.0, (scale.level[i + 1] - excess) / scale.width[i]))
        row[size - 1] = max(0.0, nodes.regret[best]) + max(0.0, excess)
        _mean_after(best, (d - 1) * size, row[size:], rows, nodes)
        rows.depth[n] = d
        stack.pop()
        depths.pop()
    return True


@njit(nogil=True)
def _fill_demand(
    graph: SampleGraph, demand: AttentionDemand, rows: Rows, scale: Scale, price: Floats, nodes: NodeTable,
    relaxed: Relaxed,
) -> bool:  # fmt: skip
    """Fill in the rows of a graph; return success."""
    levels, steps, ahead = len(scale.width), len(scale.price), len(scale.weight)
    size = levels + 2
    for t in range(min(steps, len(graph.layer) - 1)):
        depth, next_depth = min(ahead, steps - t), min(ahead, steps - t - 1)
        for j in range(graph.layer[t], graph.layer[t + 1]):
            node = graph.node[j]
            if not _row(node, depth, rows, scale, price, nodes, relaxed):
                return False
            demand.of[j] = rows.of[node]
            first = nodes.first[node]
            best, least = graph.edge[j], np.inf
            for e in range(graph.edge[j], graph.edge[j + 1]):
                number = first + e - graph.edge[j]
                for k in range(nodes.begin[number], nodes.begin[number + 1]):
                    if nodes.to[k] >= 0 and not _row(nodes.to[k], next_depth, rows, scale, price, nodes, relaxed):
                        return False
                _mean_after(number, next_depth * size, demand.mean[e], rows, nodes)
                if nodes.regret[number] < least:
                    best, least = e, nodes.regret[number]
            for e in range(graph.edge[j], graph.edge[j + 1]):
                fall = scale.discount[t] * max(0.0, -least)  # this excess is not part of the node's own row
                for s in range(depth - 1):
                    one = demand.mean[best, (s + 1) * size - 1] - demand.mean[e, (s + 1) * size - 1]
                    for i in range(levels + 1):
                        c, width = s * size + i, scale.width[i - 1] if i else scale.price[t + 1 + s]
                        one += width * max(0.0, demand.mean[best, c] - demand.mean[e, c])
                    fall += scale.weight[s + 1] * scale.counts[t + 1 + s] * scale.discount[t + 1 + s] * one
                demand.fall[e] = fall
    return True


@njit()
def lost(step: int, rows: Floats, scale: Scale) -> float:
    """Return U from a step on, discounted to step 0, for people with these rows, shape (K, A * (L + 2))."""
    levels = len(scale.width)
    size, robots = levels + 2, len(scale.idle)
    need = np.empty(robots)  # the probability that so many people need a robot, for fewer people than robots
    total = 0.0
    for s in range(min(len(scale.weight), len(scale.price) - step)):
        one = robots * scale.price[step + s]
        for k in range(len(rows)):
            one += rows[k, (s + 1) * size - 1]
        for i in range(levels + 1):
            need[0] = 1.0
            need[1:] = 0.0
            for k in range(len(rows)):
                below = rows[k, s * size + i]
                for n in range(robots - 1, 0, -1):
                    need[n] = need[n] * below + need[n - 1] * (1.0 - below)
                need[0] *= below
            attended = float(robots)
            for n in range(robots):
                attended -= scale.idle[n] * need[n]
            one -= (scale.width[i - 1] if i else scale.price[step + s]) * attended
        total += scale.weight[s] * scale.counts[step + s] * scale.discount[step + s] * one
    return total
