"""One person's subproblem relaxed to finitely many beliefs, and the graph of one sample path.

Claim. A solution's upper bound at a belief b is a mixture of its bounds at stored beliefs b_i, including the beliefs
of single types (the corners): b = sum_i w_i b_i. If a b_i is drawn with probability w_i and revealed to the robot, its
optimal value does not decrease. Proof. The type has the distribution b before and after the draw, and the robot may
ignore what is revealed.

The result is a problem with finitely many nodes, each a state with one of its stored beliefs (Lovejoy, "Computationally
feasible bounds for partially observed Markov decision processes", 1991, for a fixed grid). The edges of a node are
computed when it is first visited.

A sample path is one number in [0, 1) for each step. It determines the outcome of every robot action, so that each
action leads from a node to one other node. The reachable nodes form a `SampleGraph`, layer by layer, because many paths
of the robot meet again. Choices that lead to a low cost-to-go come first in the order of outcomes. So the same number
has a similar effect after different robot actions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.system.jit import njit

from ...people.decision import Floats
from ...person.attention_subproblem import AttentionSubproblem
from ...person.belief_filter import posterior
from ...person.convex_bound import PIVOTS, weigh
from ...person.problem_arrays import ProblemArrays
from ...person.solver import Solution
from ...person.truncated_bound import OuterRelaxation
from ...person.upper_hull import new_program

COMPILED_FOR = "bounds from sample paths: about twenty seconds"

Ints = NDArray[np.int64]

END = -1
"""The node of a person who has reached the goal."""

LEFT = -2
"""The node of a person who has left a truncated task at its frontier.

The leaf's upper bound then stands for the rest of their return. It assumes a robot of their own, for which the prices
are paid (`assist.certify.information_relaxation.sampled_bound`).
"""

FULL = -3
"""Return value of compiled code if the arrays of nodes are full."""


class Known(NamedTuple):
    """The stored beliefs of a `Solution` with their bounds, flat: H = B * T.

    Node n is belief n, or a corner if n is larger.
    """

    corner: Floats
    point: Floats
    drop: Floats
    first: Ints
    state: Ints


class Relaxed(NamedTuple):
    """The relaxed problem, from which the edges of nodes follow.

    Attributes
    ----------
    known : Known
    m : ProblemArrays
        The subproblem.
    order : int array, shape (n, A)
        Choices in each state, those that lead to a low cost-to-go first.
    attended : bool array, shape (n, R)
        Which robot actions take the robot's attention.
    """

    known: Known
    m: ProblemArrays
    order: Ints
    attended: NDArray[np.bool_]


class NodeTable(NamedTuple):
    """The computed edges of nodes, one for each robot action.

    Attributes
    ----------
    first : int array, shape (nodes,)
        First edge of each node; -1 if its edges have not been computed.
    regret : float array
        For each edge: the bound of the node minus the Q-value of the action, computed from the bounds of the
        successors.
    begin : int array
        The outcomes of edge e are `begin[e]` up to `begin[e + 1]`.
    share : float array; to : int array
        For each outcome: the cumulative probability, and the successor node, `END` or `LEFT`.
    used : int array, shape (2,)
        Number of edges and of outcomes so far.
    """

    first: Ints
    regret: Floats
    begin: Ints
    share: Floats
    to: Ints
    used: Ints


class SampleGraph(NamedTuple):
    """The nodes that are reachable on one sample path: n nodes in layers, one layer for each step.

    Attributes
    ----------
    layer : int array, shape (layers + 1,)
        The nodes of step t are `layer[t]` up to `layer[t + 1]`.
    node : int array, shape (n,)
        Number of each node in `BeliefNodes`.
    edge : int array, shape (n + 1,)
        The robot actions of node j are the edges `edge[j]` up to `edge[j + 1]`; the last layer has none.
    to : int array, shape (e,)
        Successor of each edge: a node of this graph, `END` or `LEFT`.
    cost : float array, shape (e,)
        Regret of each edge, discounted to step 0.
    attends : bool array, shape (e,)
        Whether the action takes the robot's attention.
    """

    layer: Ints
    node: Ints
    edge: Ints
    to: Ints
    cost: Floats
    attends: NDArray[np.bool_]


class BeliefNodes:
    """The nodes of one person's subproblem that have been visited so far.

    Attributes
    ----------
    visits : AttentionSubproblem
    relaxed : Relaxed
    nodes : NodeTable
    root : int array, shape (r,); chance : float array, shape (r,)
        The nodes whose mixture is the prior, with their weights.
    value : float
        Mean bound of these nodes.
    """

    def __init__(self, visits: AttentionSubproblem, solution: Solution, outer: OuterRelaxation | None = None) -> None:
        if outer is not None:
            visits, solution = outer.visits, _embedded(visits, solution, outer)
        pomdp, choices = visits.pomdp, visits.pomdp.model.choices
        size, states = pomdp.prior.size, len(pomdp.robot_actions)
        self.visits = visits
        self.known = Known(
            np.ascontiguousarray(solution.corner).reshape(states, size),
            np.ascontiguousarray(solution.point).reshape(-1, size), solution.drop, solution.first,
            np.repeat(np.arange(states), np.diff(solution.first)),
        )  # fmt: skip
        q = np.where(choices.applicable, choices.costs + pomdp.gamma * choices.h[choices.targets], np.inf)
        order = np.argsort(q, axis=1, kind="stable")
        self.relaxed = Relaxed(self.known, ProblemArrays.of(pomdp), order, visits.attended())
        count = len(solution.drop) + states * size
        self.nodes = NodeTable(
            np.full(count, -1), np.empty(1 << 12), np.zeros((1 << 12) + 1, dtype=np.int64), np.empty(1 << 16),
            np.empty(1 << 16, dtype=np.int64), np.zeros(2, dtype=np.int64),
        )  # fmt: skip
        self._stamp, self._stamps = np.zeros(count, dtype=np.int64), 0
        part, node = np.empty(2 * size), np.empty(2 * size, dtype=np.int64)
        found = decompose(pomdp.prior.flatten(), choices.initial, self.known, part, node)
        self.root, self.chance = node[:found].copy(), part[:found] / part[:found].sum()
        bounds = [bound_at(n, self.known) for n in self.root.tolist()]
        self.value = float(self.chance @ bounds)

    def graph(self, uniforms: Floats) -> SampleGraph:
        """Return the graph of one sample path: a number that selects the root, then one for each step but the last."""
        start = int(np.searchsorted(self.chance.cumsum(), uniforms[0], side="right"))
        room = 1 << 12
        while True:
            graph = SampleGraph(
                np.zeros(len(uniforms) + 1, dtype=np.int64), np.empty(room, dtype=np.int64),
                np.zeros(room + 1, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty(room),
                np.empty(room, dtype=np.bool_),
            )  # fmt: skip
            self._stamps += 1
            found = _unfold(
                int(self.root[min(start, len(self.root) - 1)]), uniforms[1:], graph, self._stamp,
                self._stamps * (1 << 32), self.nodes, self.relaxed,
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
        """Double the capacity for edges and outcomes."""
        longer = {
            name: np.concatenate([getattr(self.nodes, name), np.zeros_like(getattr(self.nodes, name))])
            for name in ("regret", "begin", "share", "to")
        }
        self.nodes = self.nodes._replace(**longer)


def _embedded(visits: AttentionSubproblem, solution: Solution, outer: OuterRelaxation) -> Solution:
    """Return the solution on a truncated task as one on the outer relaxation, where only corners are known."""
    inner = visits.layout
    here = outer.visits.layout.number(0, inner.position, outer.index[inner.x])
    inside = np.flatnonzero(~visits.pomdp.ends)
    corner = outer.value.copy()
    corner[here[inside]] = solution.corner[inside]  # the corners that `drop` refers to
    state = here[np.repeat(np.arange(len(here)), np.diff(solution.first))]
    order = np.argsort(state, kind="stable")
    first = np.searchsorted(state[order], np.arange(len(corner) + 1))
    return replace(solution, corner=corner, point=solution.point[order], drop=solution.drop[order], first=first)


@njit()
def state_of(node: int, known: Known) -> int:
    """Return the task state of a node."""
    points = len(known.drop)
    return known.state[node] if node < points else (node - points) // known.corner.shape[1]


@njit()
def bound_at(node: int, known: Known) -> float:
    """Return the upper bound at a node."""
    points, size = len(known.drop), known.corner.shape[1]
    if node >= points:
        return known.corner[(node - points) // size, (node - points) % size]
    value = known.drop[node]
    for h in range(size):
        value += known.corner[known.state[node], h] * known.point[node, h]
    return value


@njit()
def decompose(belief: Floats, x: int, known: Known, part: Floats, node: Ints) -> int:
    """Express an unnormalised belief of a state as a mixture of its nodes; return the number of nodes.

    The mixture is that of the solution's bound: at most H stored beliefs and the corners. `part` and `node`, shape (2
    H,), receive weights and nodes. Stored beliefs that would lower the bound by less than 1e-5 cost units are replaced
    by corners, which saves nodes.
    """
    size, base = len(belief), 0.0
    left, mass = belief.copy(), belief.sum()
    for h in range(size):
        base += known.corner[x, h] * belief[h]
    begin, end = known.first[x], known.first[x + 1]
    program, count = new_program(size, end - begin), 0
    for j in range(weigh(belief, base, known.point, known.drop, begin, end, PIVOTS, program)):
        if program.weight[j] * known.drop[program.used[j]] < -1e-5 * mass:
            part[count], node[count] = program.weight[j], program.used[j]
            for h in range(size):
                left[h] = max(0.0, left[h] - part[count] * known.point[node[count], h])
            count += 1
    for h in range(size):
        if left[h] > 1e-14 * mass:
            part[count], node[count] = left[h], len(known.drop) + x * size + h
            count += 1
    return count


@njit(inner=True)
def expand_node(node: int, nodes: NodeTable, relaxed: Relaxed) -> bool:
    """Compute the edges of a node, unless they are known; return whether the capacity was sufficient."""
    if nodes.first[node] >= 0:
        return True
    known, m, order = relaxed.known, relaxed.m, relaxed.order
    points, size, x = len(known.drop), known.corner.shape[1], state_of(node, known)
    e, k = nodes.used[0], nodes.used[1]
    actions = m.robot_actions[x]
    if e + actions >= len(nodes.regret) or k + actions * order.shape[1] * 2 * size >= len(nodes.to):
        return False
    belief, after = np.zeros(size), np.empty(size)
    if node < points:
        mass = known.point[node].sum()
        for h in range(size):  # array expressions take seconds to compile
            belief[h] = known.point[node, h] / mass
    else:
        belief[(node - points) % size] = 1.0
    part, piece = np.empty(2 * size), np.empty(2 * size, np.int64)
    bound = bound_at(node, known)
    nodes.first[node] = e
    for r in range(actions):
        acting, q, cumulated = m.afterstate[x, r], -m.robot_costs[x, r], 0.0
        nodes.begin[e] = k
        if m.goal[0, acting]:  # the goal is known
            nodes.share[k], nodes.to[k] = 1.0, END
            k += 1
        else:
            for i in range(m.counts[acting]):
                a = order[acting, i]
                posterior(belief, after, x, r, a, m)
                y, mass = m.targets[acting, a], after.sum()
                if mass <= 0.0:
                    continue  # without lapses some choices have probability 0
                q -= mass * m.costs[acting, a]
                if m.ends[y]:  # at the frontier the bound is a mean over types, so that the belief is not divided
                    for h in range(size):
                        q += m.gamma * after[h] * known.corner[y, h]
                    cumulated += mass
                    nodes.share[k], nodes.to[k] = cumulated, END if m.goal[0, y] else LEFT
                    k += 1
                    continue
                found = decompose(after, y, known, part, piece)
                scale = mass / part[:found].sum()
                for j in range(found):
                    cumulated += scale * part[j]
                    q += m.gamma * scale * part[j] * bound_at(piece[j], known)
                    nodes.share[k], nodes.to[k] = cumulated, piece[j]
                    k += 1
        nodes.share[k - 1] = 1.0
        nodes.regret[e] = bound - q
        e += 1
        nodes.begin[e] = k
    nodes.used[0], nodes.used[1] = e, k
    return True


@njit(inner=True)
def outcome(edge: int, uniforms: float, nodes: NodeTable) -> int:
    """Return the node to which an edge leads for a number in [0, 1)."""
    low, high = nodes.begin[edge], nodes.begin[edge + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if nodes.share[middle] > uniforms:
            high = middle
        else:
            low = middle + 1
    return nodes.to[low]


@njit(nogil=True)
def _unfold(
    root: int, uniforms: Floats, graph: SampleGraph, stamp: Ints, mark: int, nodes: NodeTable, relaxed: Relaxed
) -> int:
    """Fill a sample graph; return the number of its layers.

    Return `FULL` if the node table lacks capacity, or 0 if the graph does.
    """
    known, m = relaxed.known, relaxed.m
    graph.node[0], graph.layer[1] = root, 1
    n, e, discount = 1, 0, 1.0
    for t in range(len(uniforms)):
        for j in range(graph.layer[t], graph.layer[t + 1]):
            graph.edge[j] = e
            node = graph.node[j]
            if not expand_node(node, nodes, relaxed):
                return FULL
            x = state_of(node, known)
            if max(e, n) + m.robot_actions[x] >= len(graph.to):
                return 0
            for r in range(m.robot_actions[x]):
                to = outcome(nodes.first[node] + r, uniforms[t], nodes)
                if to < 0:
                    graph.to[e] = to
                else:
                    if stamp[to] < mark + graph.layer[t + 1]:  # not yet visited in this layer
                        stamp[to] = mark + n
                        graph.node[n] = to
                        n += 1
                    graph.to[e] = stamp[to] - mark
                graph.cost[e], graph.attends[e] = discount * nodes.regret[nodes.first[node] + r], relaxed.attended[x, r]
                e += 1
        graph.edge[graph.layer[t + 1]] = e
        graph.layer[t + 2] = n
        discount *= m.gamma
        if n == graph.layer[t + 1]:
            return t + 1
    for j in range(graph.layer[len(uniforms)], n + 1):
        graph.edge[j] = e
    return len(uniforms) + 1
