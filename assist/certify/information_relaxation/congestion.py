"""What it costs, on average, that several people want the robot at the same time.

Let everybody's robot go on as it is best for them at the prices of the bound. A person for whom its attention is worth
G_k in a step wants it where that is above the price. Were all wishes granted the bound would be reached; as one is, at
most, a step loses at least

    lambda + sum_k (G_k - lambda)^+ - max_k G_k^+

and what is lost from a state in step t on, if people go on like that, is

    U = sum_s w_s gamma^(t+s) ( lambda + sum_k E (G_k - lambda)^+ - integral over g of (1 - prod_k P(G_k <= g)) )

with lambda and G of step t + s and all w_s = 1, since people's lucks are independent. They do not quite go on like
that: who is left alone wants something else later. So what is further ahead counts less, w_s = `FADING`^s, and counts
in full once it is there. What is late in an episode never does (`Scale.counts`).

For each node of a person `Congestion` needs the distribution of their G at each later step, on a few levels g; and as U
is linear in each person's distribution, its mean over what may follow is U of the mean distributions. That makes it a
penalty whose mean can be worked out for any number of people.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from ...person.problem_arrays import ProblemArrays
from .belief_nodes import LEFT, BeliefNodes, Ints, Known, NodeTable, SampleGraph, at, work_out

LEVELS = np.array([0.0, 0.15, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0])
"""Between these G less the price is told apart, and between 0 and the price, in units of the cheapest action's cost;
what is above the last counts as that."""

FADING = 0.9
"""What a conflict counts that is one step further ahead.

For four people on `kitting/paper` (c_suggest 0.5, gamma .99; the same 24 lucks) the mean was -54.55 +- 0.05 with 1 at
the best alpha, 0.6, and -54.42 +- 0.09 at 0.8; with 0.9 it was -54.55 +- 0.04 and -54.59 +- 0.05, in half of the time.
With 16 lucks 0.95 was .04 behind 0.9 at the best alpha, 0.8 as much, and 0.6 was .13 behind.
"""

AHEAD = 12
"""Steps ahead whose conflicts are looked at: farther ones do not count.

With 22 of them the four people below gain .001, for nearly twice the memory.
"""

LATE = 10
"""Conflicts of so many steps from the beginning count in full."""

DYING = 5.0
"""Later ones count less, by a factor of e in so many steps.

Where they count in full the search for one luck fails, and without them a robot that knows the luck comes off unharmed
where several are still at work late. For the same four people, 24 lucks, at the best alpha: -54.71 +- 0.04 without
conflicts after 12 steps, -54.80 +- 0.04 with those of 22 that count like that; at an alpha of 0.8 and a `FADING` of 0.7
all of 22 in full gave -53.7 +- 0.2.
"""

PAUSE = 1_000
"""Rows that are worked out before it is asked whether to go on; on tasks of millions of states about a second's."""


class OutOfTimeError(Exception):
    """What people will want takes longer to work out than there is time."""


class Scale(NamedTuple):
    """Steps and levels: a row has a block for each of A steps ahead, of 1 + L + 1 entries.

    One is of what is below the price, one of each level above, and one adds up. With the price between two levels, all
    that is lost in a step is at least 0, whatever the distributions.

    Attributes
    ----------
    price : float array, shape (W,)
    width : float array, shape (L,)
    level : float array, shape (L + 1,)
    discount : float array, shape (W + 1,)
    weight : float array, shape (A,)
        What counts of conflicts so many steps ahead.
    counts : float array, shape (W + 1,)
        What counts of those of a step from the beginning, at most; never more than of an earlier one.
    """

    price: Floats
    width: Floats
    level: Floats
    discount: Floats
    weight: Floats
    counts: Floats

    @classmethod
    def of(cls, price: Floats, gamma: float, unit: float) -> Scale:
        """Make the scale for W steps with these prices."""
        ahead = np.arange(len(price) + 1.0)
        counts = np.exp(-np.maximum(ahead - LATE, 0.0) / DYING)
        weight = FADING ** ahead[: min(AHEAD, len(price))]
        return cls(np.array(price), unit * np.diff(LEVELS), unit * LEVELS, gamma**ahead, weight, counts)

    @property
    def size(self) -> int:
        """How many entries a block has."""
        return len(self.width) + 2


class Rows(NamedTuple):
    """The rows of nodes. Row 0 stands for `END`, and row 1 for `LEFT`.

    A person at the goal wants nothing. A person who has left a truncated task may use the robot at its price in every
    step, so that their G is the price: a step that the robot spends with none of the others then loses nothing by
    itself, as the search counts it.

    What a node's block says is of so many steps later, so that one row serves a node at whatever step it is met.

    Attributes
    ----------
    of : int array, shape (nodes,)
        Each node's; -1 where it has not been worked out.
    depth : int array, shape (nodes,)
        How many of its blocks have been.
    row : float array, shape (rows, A * (L + 2))
        In each block P(G <= g), as a mean between two levels, and what adds up: the mean of (G - lambda)^+ and of what
        the bound is too high by.
    used : int array, shape (2,)
        Rows so far, and how many may be worked out until it is asked whether to go on.
    """

    of: Ints
    depth: Ints
    row: Floats
    used: Ints


class AttentionDemand(NamedTuple):
    """The rows of a graph's nodes, shape (n,), and edges, shape (e, A * (L + 2)).

    Attributes
    ----------
    of : int array
        Of each node.
    mean : float array
        Of each edge: the mean of the rows that may follow.
    fall : float array, shape (e,)
        By how much U, with the weights that it has before, can be lower in the mean after the edge than after the best
        one; and by how much the best is ahead of the node's bound, where parts too slight to count were left aside.
    """

    of: Ints
    mean: Floats
    fall: Floats


class Congestion:
    """The wishes of one person, as far as they have been worked out.

    Parameters
    ----------
    go_on : callable
        Called from time to time, where that takes long; what it raises leaves what has been worked out as it is.
    """

    def __init__(self, lattice: BeliefNodes, scale: Scale, go_on: Callable[[], None] = lambda: None) -> None:
        self.lattice, self.scale, self.go_on = lattice, scale, go_on
        count = len(lattice.nodes.first)
        self.rows = Rows(
            np.full(count, -1), np.zeros(count, dtype=np.int64), np.empty((1 << 10, len(scale.weight) * scale.size)),
            np.array([2, PAUSE]),
        )  # fmt: skip
        self.rows.row[0] = np.tile(np.append(np.ones(scale.size - 1), 0.0), len(scale.weight))
        self.rows.row[1] = self.rows.row[0]
        self.rows.row[1, :: scale.size] = 0.0  # P(G <= g) for g below the price
        layout, price = lattice.visits.layout, lattice.visits.price
        self.price = np.append(price, 0.0)[np.minimum(layout.step, len(price))]

    def of(self, graph: SampleGraph) -> AttentionDemand:
        """Give the rows of a graph."""
        wishes = AttentionDemand(
            np.zeros(len(graph.node), dtype=np.int64), np.empty((len(graph.to), self.rows.row.shape[1])),
            np.zeros(len(graph.to)),
        )  # fmt: skip
        while not _wishes(
            graph, wishes, self.rows, self.scale, self.price, self.lattice.attended, self.lattice.nodes,
            self.lattice.known, self.lattice.arrays, self.lattice.order,
        ):  # fmt: skip
            self._resume()
        return wishes

    def at_root(self) -> Floats:
        """Give the mean row at the beginning, shape (A * (L + 2),)."""
        for node in self.lattice.root.tolist():
            while not _row(
                node, len(self.scale.weight), self.rows, self.scale, self.price, self.lattice.attended,
                self.lattice.nodes, self.lattice.known, self.lattice.arrays, self.lattice.order,
            ):  # fmt: skip
                self._resume()
        return np.asarray(self.lattice.chance @ self.rows.row[self.rows.of[self.lattice.root]])

    def _resume(self) -> None:
        if self.rows.used[1] == 0:
            self.go_on()
            self.rows.used[1] = PAUSE
        elif self.rows.used[0] + 1 >= len(self.rows.row):
            self.rows = self.rows._replace(row=np.concatenate([self.rows.row, np.empty_like(self.rows.row)]))
        else:
            self.lattice.grow()


@njit()
def _wanted(
    node: int, x: int, price: float, top: float, nodes: NodeTable, attended: NDArray[np.bool_], robots: int
) -> float:
    """Give what attention is worth at a node, at most `top` more than its price."""
    with_it, without = np.inf, np.inf
    for r in range(robots):
        regret = nodes.regret[nodes.first[node] + r]
        if attended[x, r]:
            with_it = min(with_it, regret)
        else:
            without = min(without, regret)
    return 0.0 if with_it == np.inf else min(without - with_it, top) + price


@njit()
def _follow(edge: int, end: int, out: Floats, rows: Rows, nodes: NodeTable) -> None:
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
def _row(
    node: int, depth: int, rows: Rows, scale: Scale, price: Floats, attended: NDArray[np.bool_],
    nodes: NodeTable,
    known: Known, m: ProblemArrays, order: Ints,
) -> bool:  # fmt: skip
    """Work out so many blocks of the row of a node, and what of later nodes that takes; tell whether that is done."""
    levels = len(scale.width)
    size = levels + 2
    stack, depths = [node], [depth]
    while len(stack):
        n, d = stack[-1], depths[-1]
        if rows.depth[n] >= d:
            stack.pop()
            depths.pop()
            continue
        if not work_out(n, nodes, known, m, order):
            return False
        x = at(n, known)
        e, robots = nodes.first[n], m.robot_actions[x]
        best = e
        for r in range(e + 1, e + robots):
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
        wanted = _wanted(n, x, price[x], scale.level[levels], nodes, attended, robots)
        excess = wanted - price[x]
        row[0] = min(1.0, max(0.0, -excess / price[x])) if price[x] > 0.0 else 1.0
        for i in range(levels):
            row[i + 1] = min(1.0, max(0.0, (scale.level[i + 1] - excess) / scale.width[i]))
        row[size - 1] = max(0.0, nodes.regret[best]) + max(0.0, excess)
        _follow(best, (d - 1) * size, row[size:], rows, nodes)
        rows.depth[n] = d
        stack.pop()
        depths.pop()
    return True


@njit(nogil=True)
def _wishes(
    graph: SampleGraph, wishes: AttentionDemand, rows: Rows, scale: Scale, price: Floats, attended: NDArray[np.bool_],
    nodes: NodeTable,
    known: Known, m: ProblemArrays, order: Ints,
) -> bool:  # fmt: skip
    """Fill in the rows of a graph; tell whether that is done."""
    levels, steps, ahead = len(scale.width), len(scale.price), len(scale.weight)
    size = levels + 2
    for t in range(min(steps, len(graph.layer) - 1)):
        depth, then = min(ahead, steps - t), min(ahead, steps - t - 1)
        for j in range(graph.layer[t], graph.layer[t + 1]):
            node = graph.node[j]
            if not _row(node, depth, rows, scale, price, attended, nodes, known, m, order):
                return False
            wishes.of[j] = rows.of[node]
            first = nodes.first[node]
            best, least = graph.edge[j], np.inf
            for e in range(graph.edge[j], graph.edge[j + 1]):
                number = first + e - graph.edge[j]
                for k in range(nodes.begin[number], nodes.begin[number + 1]):
                    if nodes.to[k] >= 0 and not _row(
                        nodes.to[k], then, rows, scale, price, attended, nodes, known, m, order
                    ):
                        return False
                _follow(number, then * size, wishes.mean[e], rows, nodes)
                if nodes.regret[number] < least:
                    best, least = e, nodes.regret[number]
            for e in range(graph.edge[j], graph.edge[j + 1]):
                fall = scale.discount[t] * max(0.0, -least)  # which the node's own row does not have
                for s in range(depth - 1):
                    one = wishes.mean[best, (s + 1) * size - 1] - wishes.mean[e, (s + 1) * size - 1]
                    for i in range(levels + 1):
                        c, width = s * size + i, scale.width[i - 1] if i else scale.price[t + 1 + s]
                        one += width * max(0.0, wishes.mean[best, c] - wishes.mean[e, c])
                    fall += scale.weight[s + 1] * scale.counts[t + 1 + s] * scale.discount[t + 1 + s] * one
                wishes.fall[e] = fall
    return True


@njit()
def lost(step: int, rows: Floats, scale: Scale) -> float:
    """Give U from a step on, discounted to step 0, of people with these rows, shape (K, A * (L + 2))."""
    levels = len(scale.width)
    size = levels + 2
    total = 0.0
    for s in range(min(len(scale.weight), len(scale.price) - step)):
        one = scale.price[step + s]
        for k in range(len(rows)):
            one += rows[k, (s + 1) * size - 1]
        for i in range(levels + 1):
            below = 1.0
            for k in range(len(rows)):
                below *= rows[k, s * size + i]
            one -= (scale.width[i - 1] if i else scale.price[step + s]) * (1.0 - below)
        total += scale.weight[s] * scale.counts[step + s] * scale.discount[step + s] * one
    return total
