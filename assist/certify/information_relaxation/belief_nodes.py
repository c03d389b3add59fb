"""One person's problem with finitely many beliefs, and what of it can come about with a given luck.

A solution's upper bound at a belief is a mixture of its bounds at beliefs that it knows: b = sum_i w_i b_i, those of
single types (the corners) included. To tell the robot which b_i was drawn is to tell it more than it can know, so that
no policy gets less: what comes of that is a problem of finitely many nodes, a state with one of its beliefs each
(Lovejoy, "Computationally feasible bounds for partially observed Markov decision processes", 1991, has it for a fixed
grid). Nodes are worked out when they are first met.

With a person's luck given, one number in [0, 1) for each step, every robot action leads from a node to one other: what
can be reached is a `SampleGraph`, layer by layer, since many ways meet again. Choices that lead to cheap places come
first, so that the same number means much the same whatever the robot does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ...large_tasks.truncated_bound import OuterRelaxation
from ...people.decision import Floats
from ...people.influence_kernels import answer
from ...person.problem_arrays import ProblemArrays
from ...person.solver import Solution
from ...person.upper_hull import PIVOTS, weigh
from ...team.attention_subproblem import AttentionSubproblem

Ints = NDArray[np.int64]

END = -1
"""The node of a person who has reached the goal."""

LEFT = -2
"""The node of a person who has left a truncated task at its frontier. From there on the leaf's upper bound stands for
their return. It assumes a robot of their own, for which they pay the prices
(`assist.certify.information_relaxation.sampled_bound`)."""

SLIGHT = 1e-5
"""A belief that could lower the bound by less than this, in cost units, gets no part."""

FULL = -3
"""What compiled code returns where the arrays of nodes are full."""


class Known(NamedTuple):
    """Beliefs with bounds, as `Solution` has them, flat: H = B * T. Node n is belief n, or a corner after these."""

    corner: Floats
    point: Floats
    drop: Floats
    first: Ints
    state: Ints


class NodeTable(NamedTuple):
    """What has been worked out: each robot action of a node is an edge.

    Attributes
    ----------
    first : int array, shape (nodes,)
        The number of each node's first edge; -1 where nothing has been worked out.
    regret : float array
        Of each edge: the node's bound less what the action promises by the bounds of what follows.
    begin : int array
        Of each edge: its outcomes are `begin[e]` up to `begin[e + 1]`.
    share : float array; to : int array
        Of each outcome: the cumulated chance, and the node that it leads to, `END` or `LEFT`.
    used : int array, shape (2,)
        Edges and outcomes so far.
    """

    first: Ints
    regret: Floats
    begin: Ints
    share: Floats
    to: Ints
    used: Ints


class SampleGraph(NamedTuple):
    """What can come about with one luck, n nodes in layers, one for each step.

    Attributes
    ----------
    layer : int array, shape (layers + 1,)
        The nodes of step t are those from `layer[t]` to `layer[t + 1]`.
    node : int array, shape (n,)
        Which of the lattice's each is.
    edge : int array, shape (n + 1,)
        The robot actions of node j are the edges from `edge[j]` to `edge[j + 1]`; none in the last layer.
    to : int array, shape (e,)
        The number of the node in this graph that each leads to, `END` or `LEFT`.
    cost : float array, shape (e,)
        Its regret, discounted to step 0.
    attends : bool array, shape (e,)
        Whether it takes the robot's attention.
    """

    layer: Ints
    node: Ints
    edge: Ints
    to: Ints
    cost: Floats
    attends: NDArray[np.bool_]


class BeliefNodes:
    """The nodes of one person's problem, as far as they have been met.

    Attributes
    ----------
    visits : AttentionSubproblem
    known : Known
    nodes : NodeTable
    root : int array, shape (r,); chance : float array, shape (r,)
        The nodes among which the prior is divided.
    value : float
        Their mean bound.
    """

    def __init__(self, visits: AttentionSubproblem, solution: Solution, outer: OuterRelaxation | None = None) -> None:
        if outer is not None:
            visits, solution = outer.visits, _embedded(visits, solution, outer)
        pomdp, choices = visits.pomdp, visits.pomdp.model.choices
        size, states = pomdp.prior.size, len(pomdp.robot_actions)
        self.visits, self.arrays, self.attended = visits, ProblemArrays.of(pomdp), visits.attended()
        self.known = Known(
            np.ascontiguousarray(solution.corner).reshape(states, size),
            np.ascontiguousarray(solution.point).reshape(-1, size), solution.drop, solution.first,
            np.repeat(np.arange(states), np.diff(solution.first)),
        )  # fmt: skip
        promise = np.where(choices.applicable, choices.costs + pomdp.gamma * choices.h[choices.targets], np.inf)
        self.order = np.argsort(promise, axis=1, kind="stable")
        count = len(solution.drop) + states * size
        self.nodes = NodeTable(
            np.full(count, -1), np.empty(1 << 12), np.zeros((1 << 12) + 1, dtype=np.int64), np.empty(1 << 16),
            np.empty(1 << 16, dtype=np.int64), np.zeros(2, dtype=np.int64),
        )  # fmt: skip
        self._stamp, self._stamps = np.zeros(count, dtype=np.int64), 0
        part, node = np.empty(2 * size), np.empty(2 * size, dtype=np.int64)
        found = divide(pomdp.prior.reshape(-1), choices.initial, self.known, part, node)
        self.root, self.chance = node[:found].copy(), part[:found] / part[:found].sum()
        bounds = [worth(n, self.known) for n in self.root.tolist()]
        self.value = float(self.chance @ bounds)

    def graph(self, luck: Floats) -> SampleGraph:
        """Give what can come about with a person's luck: who they are, then one number for each step but the last."""
        start = int(np.searchsorted(self.chance.cumsum(), luck[0], side="right"))
        room = 1 << 12
        while True:
            graph = SampleGraph(
                np.zeros(len(luck) + 1, dtype=np.int64), np.empty(room, dtype=np.int64),
                np.zeros(room + 1, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty(room),
                np.empty(room, dtype=np.bool_),
            )  # fmt: skip
            self._stamps += 1
            found = _unfold(
                int(self.root[min(start, len(self.root) - 1)]), luck[1:], graph, self._stamp, self._stamps * (1 << 32),
                self.nodes, self.known, self.arrays, self.order, self.attended,
            )  # fmt: skip
            if found > 0:
                n = graph.layer[found]
                e = graph.edge[n]
                return SampleGraph(
                    graph.layer[: found + 1], graph.node[:n], graph.edge[: n + 1], graph.to[:e], graph.cost[:e],
                    graph.attends[:e],
                )  # fmt: skip
            if found == FULL:
                self.grow()
            else:
                room *= 2

    def grow(self) -> None:
        """Double the room for edges and outcomes."""
        longer = {
            name: np.concatenate([getattr(self.nodes, name), np.zeros_like(getattr(self.nodes, name))])
            for name in ("regret", "begin", "share", "to")
        }
        self.nodes = self.nodes._replace(**longer)


def _embedded(visits: AttentionSubproblem, solution: Solution, outer: OuterRelaxation) -> Solution:
    """Give a part's solution as one of the region around it, where corners are all that is known."""
    inner = visits.layout
    here = outer.visits.layout.number(0, inner.position, outer.place[inner.x])
    inside = np.flatnonzero(~visits.pomdp.final)
    corner = outer.value.copy()
    corner[here[inside]] = solution.corner[inside]  # what drops are against
    state = here[np.repeat(np.arange(len(here)), np.diff(solution.first))]
    order = np.argsort(state, kind="stable")
    first = np.searchsorted(state[order], np.arange(len(corner) + 1))
    return replace(solution, corner=corner, point=solution.point[order], drop=solution.drop[order], first=first)


@njit()
def at(node: int, known: Known) -> int:
    """Give the state of a node."""
    points = len(known.drop)
    return known.state[node] if node < points else (node - points) // known.corner.shape[1]


@njit()
def worth(node: int, known: Known) -> float:
    """Give the bound at a node."""
    points, size = len(known.drop), known.corner.shape[1]
    if node >= points:
        return known.corner[(node - points) // size, (node - points) % size]
    value = known.drop[node]
    for h in range(size):
        value += known.corner[known.state[node], h] * known.point[node, h]
    return value


@njit()
def divide(belief: Floats, x: int, known: Known, part: Floats, node: Ints) -> int:
    """Divide an unnormalised belief of a state among its nodes; return how many get a part.

    As the solution's bound does, at most one node for each type and its corner; `part` and `node` have room for twice
    as many.
    """
    size, base = len(belief), 0.0
    left, mass = belief.copy(), belief.sum()
    for h in range(size):
        base += known.corner[x, h] * belief[h]
    found = weigh(part, node, belief, base, known.point, known.drop, known.first[x], known.first[x + 1], PIVOTS)
    count = 0
    for j in range(found):
        if part[j] * known.drop[node[j]] < -SLIGHT * mass:
            part[count], node[count] = part[j], node[j]
            for h in range(size):
                left[h] = max(0.0, left[h] - part[count] * known.point[node[count], h])
            count += 1
    for h in range(size):
        if left[h] > 1e-14 * mass:
            part[count], node[count] = left[h], len(known.drop) + x * size + h
            count += 1
    return count


@njit()
def _believe(belief: Floats, after: Floats, x: int, r: int, a: int, m: ProblemArrays) -> None:
    """Fill in the belief after a choice, times its chance."""
    betas, thetas = m.chosen.shape[2], len(m.theta)
    place, suggestion = m.afterstate[x, r], m.suggested[x, r]
    uniform = m.lapse / m.counts[place]
    after[:] = 0.0
    for b in range(betas):
        p = m.chosen[place, a, b]
        for t in range(thetas):
            mass = belief[b * thetas + t]
            if mass == 0.0:
                continue
            if suggestion < 0:
                after[b * thetas + t] = mass * ((1.0 - m.lapse) * p + uniform)
                continue
            followed, others = answer(m.theta[t], m.chosen[x, suggestion, b], m.unsuggested[x, r, b])
            mass *= (1.0 - m.lapse) * p * (followed if a == suggestion else others) + uniform
            low, up = m.low[x, r, t], m.weight[x, r, t]
            after[b * thetas + low] += mass * (1.0 - up)
            after[b * thetas + low + 1] += mass * up


@njit()
def work_out(node: int, nodes: NodeTable, known: Known, m: ProblemArrays, order: Ints) -> bool:
    """Work the edges of a node out, unless they are known; tell whether there was room."""
    if nodes.first[node] >= 0:
        return True
    points, size, x = len(known.drop), known.corner.shape[1], at(node, known)
    e, k = nodes.used[0], nodes.used[1]
    robots = m.robot_actions[x]
    if e + robots >= len(nodes.regret) or k + robots * order.shape[1] * 2 * size >= len(nodes.to):
        return False
    belief, after = np.zeros(size), np.empty(size)
    if node < points:
        mass = known.point[node].sum()
        for h in range(size):  # arrays as wholes take seconds to compile
            belief[h] = known.point[node, h] / mass
    else:
        belief[(node - points) % size] = 1.0
    part, piece = np.empty(2 * size), np.empty(2 * size, np.int64)
    bound = worth(node, known)
    nodes.first[node] = e
    for r in range(robots):
        place, promise, cumulated = m.afterstate[x, r], -m.robot_costs[x, r], 0.0
        nodes.begin[e] = k
        if m.goal[place]:
            nodes.share[k], nodes.to[k] = 1.0, END
            k += 1
        else:
            for i in range(m.counts[place]):
                a = order[place, i]
                _believe(belief, after, x, r, a, m)
                y, mass = m.targets[place, a], after.sum()
                if mass <= 0.0:
                    continue  # without lapses some choices have probability 0
                promise -= mass * m.costs[place, a]
                if m.final[y]:  # at the frontier the bound is a mean over types, so that the belief is not divided
                    for h in range(size):
                        promise += m.gamma * after[h] * known.corner[y, h]
                    cumulated += mass
                    nodes.share[k], nodes.to[k] = cumulated, END if m.goal[y] else LEFT
                    k += 1
                    continue
                found = divide(after, y, known, part, piece)
                scale = mass / part[:found].sum()
                for j in range(found):
                    cumulated += scale * part[j]
                    promise += m.gamma * scale * part[j] * worth(piece[j], known)
                    nodes.share[k], nodes.to[k] = cumulated, piece[j]
                    k += 1
        nodes.share[k - 1] = 1.0
        nodes.regret[e] = bound - promise
        e += 1
        nodes.begin[e] = k
    nodes.used[0], nodes.used[1] = e, k
    return True


@njit()
def outcome(edge: int, luck: float, nodes: NodeTable) -> int:
    """Give the node to which an edge leads with some luck."""
    low, high = nodes.begin[edge], nodes.begin[edge + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if nodes.share[middle] > luck:
            high = middle
        else:
            low = middle + 1
    return nodes.to[low]


@njit(nogil=True)
def _unfold(
    root: int, luck: Floats, graph: SampleGraph, stamp: Ints, mark: int, nodes: NodeTable, known: Known,
    m: ProblemArrays, order: Ints,
    attended: NDArray[np.bool_],
) -> int:  # fmt: skip
    """Fill a graph; return how many layers it has, `FULL` if the lattice has no room, or 0 if the graph has none."""
    graph.node[0], graph.layer[1] = root, 1
    n, e, discount = 1, 0, 1.0
    for t in range(len(luck)):
        for j in range(graph.layer[t], graph.layer[t + 1]):
            graph.edge[j] = e
            node = graph.node[j]
            if not work_out(node, nodes, known, m, order):
                return FULL
            x = at(node, known)
            if max(e, n) + m.robot_actions[x] >= len(graph.to):
                return 0
            for r in range(m.robot_actions[x]):
                to = outcome(nodes.first[node] + r, luck[t], nodes)
                if to < 0:
                    graph.to[e] = to
                else:
                    if stamp[to] < mark + graph.layer[t + 1]:  # not met in this layer
                        stamp[to] = mark + n
                        graph.node[n] = to
                        n += 1
                    graph.to[e] = stamp[to] - mark
                graph.cost[e], graph.attends[e] = discount * nodes.regret[nodes.first[node] + r], attended[x, r]
                e += 1
        graph.edge[graph.layer[t + 1]] = e
        graph.layer[t + 2] = n
        discount *= m.gamma
        if n == graph.layer[t + 1]:
            return t + 1
    for j in range(graph.layer[len(luck)], n + 1):
        graph.edge[j] = e
    return len(luck) + 1
