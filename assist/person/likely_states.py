"""The states of a task that a person is most likely to visit, found by a best-first expansion."""

from __future__ import annotations

import heapq

import numpy as np

from planner import CostToGo

from ..people.decision import Floats, Ints, choice
from ..people.goals import each_of, first_of, prior_of
from ..people.human import Human
from ..people.misconception import Misconception
from ..people.state_keys import keys_of
from .state_cache import StateCache


def perceived_of_states(human: Human, known: CostToGo, states: Ints, h: Floats) -> Floats:
    """Return what a person takes for the cost-to-go of states, shape (N,), where `h` is the exact cost-to-go.

    It is the exact one for misconceptions about actions, which do not define a perceived cost-to-go of a state.
    """
    if not isinstance(human.h, Misconception) or human.h.noise == "action":
        return h
    return human.h.of_states(h, known.is_goal(states), keys_of(known, states))


class Growth:
    """The best-first expansion of a task by the probability of the best path.

    The probability of a path is a vector: that of the goal and of the person's choices, for each goal.

    Parameters
    ----------
    seen : StateCache
        The task, of which nothing has been seen; it receives the states.
    betas : float array, shape (B,)
        Expertise of people, over which their choices are averaged.
    start : int
        Number of the first state.
    human : Human, optional
        The person, if their misconceptions are known.
    """

    def __init__(self, seen: StateCache, betas: Floats, start: int, human: Human | None) -> None:
        self.seen, self.betas, self.human = seen, betas, human
        self.cost = first_of(seen.known).task.action_costs
        self.queue: list[tuple[float, int, int]] = []  # minus the probability, index, and number of the path
        self.paths: list[Floats] = []
        self.expanded: set[int] = set()
        shares = np.array(list(prior_of(seen.known).values()))
        self.possible = shares > 0
        self._reach(seen.add(np.array([start])), shares[None])

    def _reach(self, index: Ints, weights: Floats) -> None:
        """Add paths of probability `weights`, shape (N, G), to those of some states that are not expanded."""
        unexpanded = np.flatnonzero(~self.seen.is_expanded(index))
        here = index[unexpanded]
        open_goals = ~self.seen.goal[here]
        going = weights[unexpanded] * open_goals
        sizes, goes_on = going.sum(axis=1).tolist(), (self.possible & open_goals).any(axis=1).tolist()
        for at, path, size, further in zip(here.tolist(), going, sizes, goes_on, strict=True):
            if further:
                heapq.heappush(self.queue, (-size, at, len(self.paths)))
                self.paths.append(path)

    def step(self, most: int) -> int:
        """Expand the most likely states, at most `most` of them; return their number."""
        batch: dict[int, Floats] = {}
        while self.queue and len(batch) < most:
            _, at, path = heapq.heappop(self.queue)
            if at not in batch and at not in self.expanded:
                batch[at] = self.paths[path]
        if not batch:
            return 0
        offsets, targets, actions, _ = self.seen.choices(self.seen.expand(np.array(list(batch))))
        counts = np.diff(offsets)
        source = np.repeat(np.arange(len(batch)), counts)
        slot = np.arange(len(targets)) - offsets[source]
        weight = np.array(list(batch.values()))[source]
        applicable = np.zeros((len(batch), int(counts.max(initial=1))), dtype=bool)
        applicable[source, slot] = True
        for number, (known, after) in enumerate(zip(each_of(self.seen.known), self.seen.h[targets].T, strict=True)):
            q = np.full(applicable.shape, np.inf)
            q[source, slot] = self.cost[actions] + after
            best = q == q.min(axis=1, keepdims=True)
            if self.human is not None:
                perceived = perceived_of_states(self.human, known, self.seen.states(targets), after)
                q[source, slot] = self.cost[actions] + perceived
            alone = np.mean([choice(q, applicable, beta) for beta in self.betas], axis=0)
            # An optimal choice is likely, since the robot may suggest it.
            weight[:, number] *= np.where(best, 0.9, alone)[source, slot]
        self._reach(targets, weight)
        self.expanded.update(batch)
        return len(batch)
