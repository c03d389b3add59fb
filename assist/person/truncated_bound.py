"""Upper bounds on one person's problem that are computed on a truncated task and hold for the whole task.

A solver for hidden (beta, theta) handles some thousand states. At its frontier it needs an upper bound on the value,
and its own bound is only as tight as that. So four relaxations are nested, from the inside to the outside:

1. the inner truncated task, on which beta and theta are hidden, for the solver;
2. a larger truncated task, on which the robot observes beta and theta. Its values are optimal (`person.qmdp`), with the
   person's misconceptions, the effects of suggestions on choices and trust, and the costs of suggestions and of coming;
3. a still larger set of states, on which the robot observes beta and people comply
   (`person.compliance_relaxation`). It needs one number per state and beta, so that a million states fit into
   memory;
4. all other states, in which people never err (`frontier_bounds.never_erring`).

Definition. W(x, p, beta, theta) is the optimal discounted return in the whole task from state x, with observed beta and
theta. The robot is at position p, away or here. It comes at once, and its attention is free. Waiting is free, too, if
coming takes time in the inner problem.

Assumptions.

1. The costs of people's actions, of a robot's suggestions, executions and waiting, of coming and of attention are at
   least 0.
2. The choice model is local. The choice probabilities of a state, and V(x) of equation 7, depend only on the choices in
   that state: their costs, their perceived costs, and the h*, goal flags and keys of their successors. A model that
   looks further may give other numbers on a truncated task, and no bound holds for it.
3. A robot that executes actions does so for a person whose goal is known.
4. The robot knows the goal. If there are several, it may still suggest what is optimal for another one
   (`Choices.offered`), and the compliance relaxation allows all suggestions.

Claim. All frontier values computed here are at least W. A robot on its way has at most the value W of one that is
here. Hence an upper bound on the inner problem, which ends at its frontier with these values, is an upper bound on the
whole task.

Proof, from the outside to the inside.

- Relaxation 4: `never_erring` bounds the value for all people and robots that execute nothing, and
  `never_erring_with_help` for others.
- Relaxation 3: `compliance_bounds` bounds the value for all theta, hence for every trust update. It is used only for
  people who choose by cost-to-go alone, and robots that execute nothing. For others, the bound of relaxation 4 takes
  its place.
- Relaxation 2: value iteration starts at values that are at least W, and applies the Bellman operator T of this
  truncated task. T is monotone. By assumption 2, a choice has the same probability, cost and successor as in the whole
  task. The trust rule changes theta after a suggestion depending on the choices in x and on V of the suggested
  successor. Frontier states have no choices in the truncated task, so that V is computed from their choices in the
  whole task (`closed_problem.value_beyond`). Hence T agrees with the Bellman operator of the whole task at all states
  but the frontier, and it maps values of at least W to values of at least W. With another V at the frontier, such as
  minus h* for people who consider other things, theta would change differently, and T would be the operator of another
  problem.
  An execution that leads to the frontier, after which the person acts at once, has the bound of relaxation 4 of the
  state there (`TruncatedTask.for_robot`), whatever the robot pays from then on.
- Relaxation 1: beta and theta are hidden. The robot has less information than in the definition of W, so that its value
  is at most the mean of W.
- Prices of attention and costs of waiting are at least 0, so that a bound without them is one with them. Travel time is
  replaced by 0: a robot that could arrive at once can also set out later, pays no earlier, and receives no less.
- A robot on its way has paid for coming. One that is here can wait until the other one arrives, and then do the same.
  That is free in W; it would not be if waiting had its cost.

After a few steps the robot's belief is concentrated, because people's choices are informative. So most of the value of
observing beta and theta lies in the first steps, inside the inner truncated task.

`OuterRelaxation` follows people who leave the inner task. It neglects the time of travel, so that sample paths of a
robot that needs time do without it (`certify.sample_paths`). If attention has a price at each step, the problem has a
copy of every state for each step. Then only the likeliest pairs of state and step are enumerated (`likely`), and the
frontier values are computed for each step (`OuterRelaxation.beyond`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, Table

from ..people.choice_model import boltzmann
from ..people.decision import Bools, Floats, Ints
from ..people.goals import Goals
from .assumptions import Assumptions
from .attention_subproblem import AttentionSubproblem
from .backups import bellman_backup
from .closed_problem import value_beyond
from .compliance_relaxation import breadth_first, compliance_bounds, mistaken_about_states
from .each_goal import NO_LIMITS, BoundLimits, Outer, TruncatedProblem
from .leaf_bounds import LeafBounds
from .mdp_values import initial_upper_bounds, value_iteration
from .memory_needed import first_bounds_bytes, require_room
from .pomdp import AssistPOMDP
from .time_expansion import AWAY, HERE
from .truncated_task import TruncatedTask


@dataclass(frozen=True, kw_only=True)
class BoundSizes:
    """Sizes of the four relaxations, and the precision of the second; any sizes give valid bounds.

    The measurements below were made on kitting tasks of 3.7 and 7.2 million states. Values are in cost units.

    Attributes
    ----------
    hidden : int
        Largest number of states on which beta and theta are hidden. With 10,000 instead of 3,000 a person's bound
        became tighter by 0.1 to 0.16 and took two minutes. With 20,000 it gained another 0.01 and took three.
    hidden_least : int
        Number of these states whatever the time and memory, and the largest number if states are solved on demand.
    seen : int
        Largest number of states on which the robot observes beta and theta; none if states are solved on demand. With
        20,000 instead of 5,000 a bound of -40.1 became -42.0; with 50,000 it gained 0.04.
    pairs : int
        Largest number of pairs of state and step, if attention has a price at each step. With prices at 18 steps, the
        likeliest 10,000 pairs gave a bound of -26.24 in 100 seconds, and 20,000 gave -26.25 in 180.
    pairs_least : int
        Number of these pairs whatever the time and memory.
    price_states : int
        Number of states on which prices are optimised. Each round does value iteration at every step.
    complying : int
        Largest number of states of the compliance relaxation. It is used for tables only, which need no search.
    tolerance : float
        Largest error of a value with observed beta and theta, in cost units. All values are bounds in any case. Errors
        of probable states are much smaller: in the last sweep no value changes by more than 1 - gamma times this.
    sweeps : int
        Largest number of sweeps of the same value iteration. On a task of 654,610 states a bound was -22.224 after 16
        sweeps, and -22.225 after 60. Later sweeps change the values of people who move in circles.
    """

    hidden: int = 10_000
    hidden_least: int = 3_000
    seen: int = 20_000
    pairs: int = 20_000
    pairs_least: int = 3_000
    price_states: int = 5_000
    complying: int = 600_000
    tolerance: float = 0.5
    sweeps: int = 20


SIZES = BoundSizes()
"""The sizes in use."""


@dataclass(frozen=True)
class OuterRelaxation:
    """The larger truncated task around the inner one, with observed beta and theta.

    Attributes
    ----------
    visits : AttentionSubproblem
        The person's problem on it, with a robot that comes at once and goes.
    value : float array, shape (m, H, T)
        Upper bound on the value in each of its states, in cost units.
    index : int array, shape (n,)
        Index of each state of the inner truncated task in the outer one; -1 if it is not contained.
    """

    visits: AttentionSubproblem
    value: Floats
    index: Ints

    @property
    def nbytes(self) -> int:
        """The approximate memory in bytes."""
        return self.value.nbytes + sum(array.nbytes for array in _arrays(self.visits.pomdp))

    def priced(self, price: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield each step and upper bounds, shape (m, H, T), with prices of attention; from the last step to the first.

        `price` holds the prices of the steps from 0 on. After the last of them, the first to be yielded, attention is
        free.
        """
        found = self.value.copy()  # code is compiled for arrays that may be written to
        yield len(price), found
        for step in range(len(price) - 1, -1, -1):
            found = bellman_backup(self.visits.at_price(float(price[step])), found)
            np.minimum(found, self.value, out=found)  # a price of at least 0 cannot raise the value
            yield step, found

    def beyond(self, visits: AttentionSubproblem, free: Floats) -> AttentionSubproblem:
        """Return the inner subproblem with prices, with the values of this relaxation at its frontier.

        A robot on its way has at most the value of one that is present. Free attention is an upper bound, too: `free`,
        shape (P * n, H, T), by position and state.
        """
        layout, frontier = visits.layout, visits.pomdp.frontier
        assert frontier is not None
        states = frontier.states
        upper = np.minimum(frontier.upper, free[layout.position[states] * layout.states + layout.x[states]])
        position = np.minimum(layout.position[states], HERE)
        own = self.visits.layout.number(0, position, self.index[layout.x[states]])
        for step, most in self.priced(visits.price):
            at = np.flatnonzero(layout.step[states] == step)
            upper[at] = np.minimum(upper[at], most[own[at]])
        return replace(visits, pomdp=replace(visits.pomdp, frontier=LeafBounds(states, upper, upper)))


def bounded(
    known: CostToGo,
    assumed: Assumptions,
    *,
    entry: float,
    entry_steps: int = 0,
    size: int,
    outer: Outer = "frontier",
    limits: BoundLimits = NO_LIMITS,
    among: CostToGo | Goals | None = None,
) -> TruncatedProblem:
    """Return a person's problem on an inner truncated task, with upper bounds of the whole task at its frontier.

    The robot of this problem is always present.

    Parameters
    ----------
    known : CostToGo
    assumed : Assumptions
        What the robot assumes of the person.
    entry : float
        Smallest cost of coming to the person, in cost units.
    entry_steps : int
        Smallest number of steps of coming.
    size : int
        Number of states on which policies are solved; the inner truncated task is not larger.
    outer : Outer
        Whether there is an outer relaxation, in which theta moves by the person's own suggestions only, and whether it
        is returned as well.
    limits : BoundLimits
    among : CostToGo or Goals, optional
        As in `TruncatedTask.of`.

    Raises
    ------
    LimitError
        The computation would exceed the memory limit.
    """
    in_time = 200 * limits.left  # pairs: the solver's time grows with their number
    person = _Person(known, assumed, entry, entry_steps, limits, known if among is None else among)
    inner, problem, hidden = person.inner(size)
    left = limits.left / 2  # for the expansion of the outer task; the rest is for its values
    seen = 0 if known.searches or outer == "none" else SIZES.seen
    if not (seen > hidden and len(inner.frontier) and left > 0):
        return TruncatedProblem(person.within(inner, problem, None))
    around, around_it = person.outer(seen, hidden, None if left == math.inf else left)
    visits, value = person.values(around_it, person.complying(around, around_it.hidden.expertise))
    found = OuterRelaxation(visits, value, around.local(inner.states))
    problem = person.within(inner, problem, found)
    if outer != "kept" or (found.index < 0).any():
        return TruncatedProblem(problem)
    # Half of the memory is for the pairs, at two positions of the robot each. A pair needs about 3.3 stored states,
    # since its successors on the frontier are stored as well.
    room = 0.5 * limits.kept_mb * 1e6 / (2 * 3.3 * _bytes_of_a_state(problem))
    pairs = int(max(SIZES.pairs_least, min(SIZES.pairs, in_time, room)))
    return TruncatedProblem(problem, found, person.between(inner, around, found), pairs)


@dataclass(frozen=True)
class _Person:
    """A person whose problem is truncated, and the limits of the computation; attributes as in `bounded`."""

    known: CostToGo
    assumed: Assumptions
    entry: float
    entry_steps: int
    limits: BoundLimits
    among: CostToGo | Goals

    def task(self, states: int, time_limit: float | None = None) -> TruncatedTask:
        """Return the truncated task of the likeliest states."""
        return TruncatedTask.of(
            self.known, states=states, population=self.assumed.population, human=self.assumed.human, among=self.among,
            time_limit=time_limit,
        ).for_robot(self.assumed.robot)  # fmt: skip

    def inner(self, size: int) -> tuple[TruncatedTask, AssistPOMDP, int]:
        """Return the task on which beta and theta are hidden, its problem, and its requested number of states."""
        hidden = min(size, SIZES.hidden, SIZES.hidden_least)
        inner = self.task(hidden)
        problem = self.seen(inner)
        more = int(min(size, SIZES.hidden, _affordable(problem, hidden, self.limits)))
        if more > hidden and len(inner.frontier) and not self.known.searches:
            hidden = more
            inner = self.task(hidden)
            problem = self.seen(inner)
        return inner, problem, hidden

    def outer(self, seen: int, least: int, time_limit: float | None) -> tuple[TruncatedTask, AssistPOMDP]:
        """Return the task on which beta and theta are observed and its problem, as large as the memory allows."""
        outer = self.task(seen, time_limit)
        problem = self.seen(outer)
        share = self.limits.memory_mb * 1e6 / _bytes(problem)
        if share < 1:  # half of the share, since smaller tasks have relatively larger frontiers
            few = int(share / 2 * (len(outer.states) - len(outer.frontier)))
            outer = self.task(max(least, few), time_limit)
            problem = self.seen(outer)
        return outer, problem

    def between(self, inner: TruncatedTask, outer: TruncatedTask, found: OuterRelaxation) -> OuterRelaxation:
        """Return the outer relaxation on a smaller task, on which prices are optimised."""
        middle = self.task(min(SIZES.price_states, len(outer.states) - len(outer.frontier)))
        index = outer.local(middle.states)
        if (index < 0).any():  # the time limit ended the expansion of the outer task
            return found
        problem = self.within(middle, self.seen(middle), replace(found, index=index))
        own = self.visited(problem)
        at = found.visits.layout.number(0, own.layout.position, index[own.layout.x])
        return OuterRelaxation(own, np.ascontiguousarray(found.value[at]), middle.local(inner.states))

    def seen(self, region: TruncatedTask) -> AssistPOMDP:
        """Return the problem on a truncated task, with `never_erring` and V(x) of the whole task at its frontier."""
        beyond = region.bounds_of_anybody(self.assumed)
        return self.assumed.problem(region.choices, replace(beyond, value=value_beyond(region, self.assumed)))

    def within(self, region: TruncatedTask, problem: AssistPOMDP, outer: OuterRelaxation | None) -> AssistPOMDP:
        """Return the problem of a truncated task with the best known bounds at its frontier.

        `outer.index` refers to the states of this truncated task.
        """
        assert problem.frontier is not None
        # The same bound holds for both positions of the robot, away and here.
        here = np.repeat(initial_upper_bounds(problem)[region.frontier][:, None], 2, axis=1)
        if outer is not None:
            at = outer.index[region.frontier]
            away, there = (outer.value[outer.visits.states(0, position)] for position in (AWAY, HERE))
            # Being here is never worse, since leaving is free.
            found = np.stack([np.minimum(away, there), there], axis=1)
            here = np.where((at >= 0)[:, None, None, None], np.minimum(here, found[at]), here)
        upper = np.ascontiguousarray(here[:, 1])
        frontier = replace(problem.frontier, upper=upper, lower=upper.copy(), away=np.ascontiguousarray(here[:, 0]))
        return self.assumed.problem(region.choices, frontier)

    def visited(self, problem: AssistPOMDP) -> AttentionSubproblem:
        """Return the subproblem of a robot that comes at once, and waits for free if it should take time to come."""
        return AttentionSubproblem.of(problem.unattended() if self.entry_steps else problem, self.entry)

    def values(self, problem: AssistPOMDP, comply: Floats | None) -> tuple[AttentionSubproblem, Floats]:
        """Return upper bounds for a robot that comes and goes and observes beta and theta, shape (m, H, T).

        `comply`, shape (n, H), holds the bounds of the compliance relaxation, if there are any.
        """
        what = f"bounding a person's value on {len(problem.robot_actions):,} states takes"
        require_room(what, _bytes(problem), self.limits.memory_mb, "a smaller region or a higher limit")
        visits = self.visited(problem)
        found = initial_upper_bounds(visits.pomdp)
        if comply is not None:
            found = np.minimum(found, comply[visits.layout.x][:, :, None])
        value_iteration(
            visits.pomdp, found, tolerance=SIZES.tolerance, max_sweeps=SIZES.sweeps, deadline=self.limits.until
        )
        return visits, found

    def complying(self, region: TruncatedTask, expertise: Floats) -> Floats | None:
        """Return upper bounds in the states of a truncated task, shape (n, H), by the compliance relaxation around it.

        `expertise` is that of each type, shape (H,).

        The result is None if the relaxation does not apply: the task is no table, the misconceptions concern actions,
        the robot executes actions, or there is another choice model than equation 5.
        """
        known, assumed, human, limits = self.known, self.assumed, self.assumed.human, self.limits
        by_cost = assumed.chooses is boltzmann and (human is None or mistaken_about_states(human))
        if not (by_cost and isinstance(known, Table)) or assumed.robot.execute:
            return None
        left = limits.left
        share = 0.6  # of the time left; the rest is for the values with observed theta
        # Half of the sweeps over many states give looser bounds than all sweeps over few: a bound was -20.3 with
        # 150,000 states in 4 seconds, -21.1 with 600,000 in 17, and -14.2 when these were cut off after 11.
        in_time = 20_000 * share * max(0.0, left)
        bytes_of_a_state = 600  # values and transitions, roughly
        most = int(min(SIZES.complying, limits.memory_mb * 1e6 / bytes_of_a_state, in_time))
        best_only = assumed.suggestions == "optimal" and self.among is self.known
        found = compliance_bounds(
            known, breadth_first(known, region.states, most), expertise, assumed, optimal=best_only,
            deadline=math.inf if left == math.inf else limits.until - (1 - share) * left,
        )  # fmt: skip
        return found.at(region.states)


def likely(alone: AssistPOMDP, steps: int, most: int) -> Bools:
    """Return a mask of the `most` likeliest pairs of step and state, shape (steps + 1, n).

    The last row stands for all later steps. The probabilities are those of people who receive and follow an optimal
    suggestion in a share of the steps. All optimal actions are equally likely then. In other steps people choose
    without a suggestion. Visits are counted up to three times the number of steps.
    """
    choices, advised = alone.model.choices, 0.3
    row, slot = np.nonzero(choices.applicable & ~alone.ends[:, None])
    target, optimal = choices.targets[row, slot], choices.optimal[row, slot].astype(float)
    optimal /= np.maximum(np.bincount(row, optimal, len(choices)), 1)[row]
    chance = np.zeros((steps + 1, len(choices)))
    for chosen, share in zip(np.moveaxis(alone.chosen, 2, 0), alone.prior.sum(axis=1), strict=True):
        follows = (1 - advised) * chosen[row, slot] + advised * optimal
        there = np.zeros(len(choices))
        there[choices.initial] = share
        for step in range(3 * steps):
            chance[min(step, steps)] += there
            there = np.bincount(target, there[row] * follows, len(choices)).astype(float)
    chance[:, alone.ends] = 0.0
    kept, order = np.zeros(chance.size, dtype=bool), np.argsort(-chance, axis=None, kind="stable")[:most]
    kept[order] = chance.ravel()[order] > 0.0
    return kept.reshape(chance.shape)


def _affordable(problem: AssistPOMDP, hidden: int, limits: BoundLimits) -> float:
    """Return the number of states on which beta and theta can be hidden, by the time and the memory that are left."""
    states, actions = problem.suggested.shape
    values = 8 * states * problem.prior.size * (actions + 2)  # Q-values of one more robot action, and values
    needed = 2 * (sum(array.nbytes for array in _arrays(problem)) + values)  # two positions of the robot: away and here
    in_time = 400 * limits.left  # the solver's time grows with the number of states
    return min(in_time, 0.3 * limits.kept_mb * 1e6 / needed * hidden)  # the rest of the memory is for the other parts


def _bytes(problem: AssistPOMDP) -> int:
    """Return the approximate memory of `_Person.values` in bytes: a subproblem, its values, and copies of both."""
    values = 8 * len(problem.robot_actions) * problem.prior.size
    return 3 * sum(array.nbytes for array in _arrays(problem)) + 4 * values


def _bytes_of_a_state(problem: AssistPOMDP) -> float:
    """Return the approximate memory per state, in bytes, of a problem and of a solver before its search begins."""
    return (sum(array.nbytes for array in _arrays(problem)) + first_bounds_bytes(problem)) / len(problem.robot_actions)


def _arrays(problem: AssistPOMDP) -> tuple[NDArray[Any], ...]:
    """Return the largest arrays of a problem."""
    return (
        problem.suggested, problem.afterstate, problem.robot_costs, problem.chosen, problem.unsuggested, problem.low,
        problem.weight, problem.model.q, problem.model.choices.targets,
    )  # fmt: skip
