"""A tighter bound on team policies from samples: an information relaxation with a penalty.

The bound of `assist.certify.team_bound` enforces only on average that M robots attend to at most M people. Here this
holds in every step, but the robots know all sample paths in advance. They pay a penalty whose mean is 0 for every
policy without this knowledge (Brown, Smith and Sun, "Information relaxations and duality in stochastic dynamic
programs", 2010; for weakly coupled problems with Lagrangian penalties: Ye, Zhu and Zhou, arXiv 1405.3363, 2014).

Assumptions. W(s) is any bounded function of the team's state, and V(s) is an upper bound on the value of every policy
from s on, both discounted to step 0. T is the step by which all people have finished, or a fixed one if that is
earlier. Let r be the reward, discounted in the same way, and

    D(s, a) = W(s) - r(s, a) - E[W(s') | s, a].

Claim. The mean return of every policy without knowledge of the future is at most

    W(s_0) - E[ min over a_0, a_1, ...  of  sum_{t < T} D(s_t, a_t) - (V - W)(s_T) ].

Proof. Let Z be the sum over t < T of W(s_{t+1}) - E[W(s_{t+1}) | s_t, a_t]. Each term has the conditional mean 0
given the past, and whether t < T is part of the past, so that E[Z] = 0 for such a policy. Its mean return is therefore
at most the mean of r(s_0, a_0) + ... + r(s_{T-1}, a_{T-1}) + V(s_T) - Z. By the definition of D, this sum equals
W(s_0) - sum_{t < T} D(s_t, a_t) + (V - W)(s_T). On every sample path it is at most its value for the best actions on
that path.

**Choice of W.** V is the sum of the prices to be paid and of the upper bounds of the people. W = V - alpha U, with U of
`assist.certify.information_relaxation.congestion`. The state s consists of nodes of
`assist.certify.information_relaxation.belief_nodes`, which give the robots more information. For alpha = 0, D is D_V:
the regrets of all people, plus the price of the step for each robot that attends to no one. The bound is then that of
the prices, minus what is lost on each path. Every alpha gives a valid bound. It is chosen on separate sample paths.
Where all people have finished, V(s_T) is 0, while W contains the prices of later steps: these are refunded.

**People who leave a truncated task.** The upper bound u(t, y) of a leaf y is an upper bound on the person's return from
step t on with a robot of their own, whose attention has the price lambda_t. The claim needs rewards r of a process
whose value no policy of the team exceeds. Let a_k be 1 in a step in which a robot attends to person k, and 0
otherwise. Let c_k be the person's reward, let L people have left so far, and let

    r_t = sum over k still in the truncated task of (c_k - lambda_t a_k) + g_t,
    g_t = lambda_t min(M, L + sum over k still in the truncated task of a_k).

A person who leaves adds u(t, y) once.

Claim. The mean of the discounted sum of r is at least the mean return of every policy of the team.

Proof. The team's reward in a step is sum_k c_k = sum_k (c_k - lambda_t a_k) + lambda_t sum_k a_k. M robots attend to
at most M people, so that sum_k a_k <= M, and to at most L of those who have left. As prices are at least 0, the last
term is at most g_t in every step. For a person who has left, the mean of the discounted sum of c_k - lambda_t a_k,
given all observations until then, is at most u(t, y), because u bounds every way of attending to this person.

So D contains the term M lambda_t - g_t: a robot without a person costs the price of the step, except for as many robots
as people have left. The prices of the steps after all people have finished are refunded on the same condition. If they
were refunded although the bound of a leaf has paid them, they would be counted twice, and the result would not be a
bound.

The minimum on a sample path, or a lower bound on it, is found by `path_search`.

The mean over sample paths has a standard error, so that the bound holds with a confidence level. People and paths are
processed in parallel, which does not affect the result. The number of paths follows from the time that other paths, the
pilot, have taken. If it depended on the paths of the bound, those that take long, whose values differ from the others',
would be left out more often. If there is too little time for all of them, there is no sampled bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from ...people.decision import Floats
from .belief_nodes import BeliefNodes, SampleGraph
from .confidence import SampledBound
from .congestion import AttentionDemand, Congestion, Scale, lost
from .options import RelaxationOptions
from .path_search import SamplePath, least_sum

S = TypeVar("S")
T = TypeVar("T")


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
        distinct = {id(one): Congestion(one, self.scale, self._go_on, options.rows_per_check) for one in belief_nodes}
        self.distinct, self.people = list(distinct.values()), [distinct[id(one)] for one in belief_nodes]
        self.robots = robots
        self.discount: Floats = np.power(gamma, np.arange(self.steps + 1))
        # All prices are paid, including those of steps whose conflicts do not count in U.
        self.value = robots * float(self.price @ self.discount) + sum(one.value for one in belief_nodes)
        roots = dict(zip(distinct, self._each(Congestion.at_root, self.distinct), strict=True))
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

        def of(which: Congestion) -> list[list[tuple[SampleGraph, AttentionDemand]]]:
            own = [numbers_of_path[[person is which for person in self.people]] for numbers_of_path in uniforms]
            graphs = [[which.belief_nodes.graph(one) for one in numbers_of_path] for numbers_of_path in own]
            return [[(graph, which.of(graph)) for graph in of_path] for of_path in graphs]

        found = dict(zip(map(id, self.distinct), self._each(of, self.distinct), strict=True))
        return [
            SamplePath.of([found[id(person)][number].pop(0) for person in self.people])
            for number in range(len(uniforms))
        ]

    def bound(self, path: SamplePath, alpha: float) -> float:
        """Return the largest return, minus the penalty, of robots that know this sample path."""
        rows = [person.rows.row for person in self.people]
        most = self.options.max_expansions // len(self.people)
        least = least_sum(path, rows, self.price, self.discount, alpha, self.scale, self.steps, most)
        return self.value - alpha * self.lost - least

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

    def _draw(self, seed: int, purpose: int, numbers: Sequence[int]) -> list[SamplePath]:
        seeds = [np.random.SeedSequence(seed, spawn_key=(4, purpose, number)) for number in numbers]
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
