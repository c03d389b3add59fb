"""Bounds on one person's problem, computed on a part of a task and valid for all of it.

A solver that keeps beliefs can look at some thousand states. Where these end, at the frontier, it needs an upper bound
on what follows, and a good one gives a good bound. So there are four parts, each around the one before:

- a region on which beta and theta are hidden, for the solver;
- a larger one, on which they are seen. Its values are those of the best policies (`person.qmdp`), with the person's
  own misconceptions, what a suggestion does to them and to their trust, what it costs, and what coming costs;
- a still larger one, on which beta is seen and people comply with every suggestion
  (`large_tasks.compliance_relaxation`). One number for each beta is kept of its states, so that there is room for a
  million;
- everything else, where people never err (`large_tasks.truncated_task.never_erring`).

Claim. Let W(x, p, beta, theta) be the best discounted return in the whole task from state x on, with the robot at
position p, beta and theta seen, and presence free. Each value computed here is at least W. So an upper bound on the
value of the first region's problem, which ends at its frontier with these values, is one of the whole task's.

Assumptions.

1. Costs, of people's actions, suggestions, coming and presence, are 0 or more.
2. A choice model is local: the chances in a state, and V(x) of eq. 7, follow from the state's own choices, which are
   their costs, their perceived costs, and the h*, goals and keys of the states they lead to. A function that looks
   further gives other numbers on a part than on all of a task, and no bound holds for it.
3. The robot executes nothing (`AssistPOMDP.of` refuses that where a problem ends at a frontier).

Proof, from the outside.

- Beyond the third part the value is `never_erring`'s, which holds whatever people do and however they choose.
- On the third, `compliance`'s, which holds for all theta, and so however trust moves. It is used for people who
  choose by cost-to-go alone; for others the value there is the outermost one.
- On the second, values start above W and each sweep applies the Bellman operator T of the part. T is monotone. A
  choice has in the part the chances, costs and targets that it has in the whole task, by assumption 2. A suggestion
  moves theta by V of the state it leads to less V(x). In frontier states no choices are seen, so that V is computed
  there from their choices in the whole task (`_expected`), for every choice model and whatever the robot knows. So T,
  with any values of at least W at the frontier, maps values of at least W to such values. With another V at the
  frontier, as that of minus h* for people who look at something else, theta would arrive elsewhere, and T would be
  another problem's.
- In the first, beta and theta are hidden, which can only cost the robot something.
- A price of presence is 0 or more, so that free presence is an upper bound. A way that takes time is taken to take
  none: a robot that sets out later, when there is something to say, pays no earlier and gets no less.

What is known about people soon hardly differs from all there is to know: what they do shows it. So most of what seeing
is worth is within a few steps of the beginning, in the innermost part.

People who leave that part can be followed on the larger region (`OuterRelaxation`); for a robot whose way takes time
that is left out, since there it takes none. Where attention has a price at each step, there is a state for every step;
so only the likeliest at each are looked at (`likely`), and the values at their frontier are computed step by step
(`OuterRelaxation.beyond`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import CostToGo, LimitError, Table

from ..people.belief import Grid
from ..people.choice_model import boltzmann, value
from ..people.decision import Floats
from ..people.human import Human, Mixture, Population
from ..person.pomdp import AssistPOMDP, LeafBounds
from ..person.qmdp import backward, highest, improve
from ..person.solver import first_bounds_bytes
from ..team.attention_subproblem import AWAY, HERE, AttentionSubproblem
from ..team.settings import Setting
from .compliance_relaxation import around, at_most, mistaken_about_states
from .state_cache import StateCache
from .truncated_task import TruncatedTask

HIDDEN = 10_000
"""States of the region on which beta and theta are hidden, if there are time and memory for so many.

On tasks of 7.2 and of 3.7 million states 10,000 gave bounds of a person lower by .16 and .1 than 3,000 did (-25.41 and
-42.18), in two minutes; 20,000 brought .01 in three.
"""

FEW = 3_000
"""So many in any case, and where it may take a search to look one up."""

PER_SECOND = 400
"""More than these for each second that there is for what is around them: the solver has more to do with them."""

FOR_HIDDEN = 0.3
"""The share of a person's memory that their problem may take for more than these."""

SEEN = 20_000
"""States of that on which they are seen, if the memory does; none where it may take a search to look one up.

On the same tasks three times 5,000 brought .01 to a person's bound of -23 to -25; on one of 3.7 million states where
the goal is twice as far 20,000 gave -42.0 where 5,000 gave -40.1, and 50,000 brought .04.
"""

PAIRS = 20_000
"""States, each with one step, on which they are hidden where each is there once for every step, if time and memory do.

For a person on a task of 7.2 million states, with prices on 18 steps, 1,000 states at all steps gave -25.97 and 2,000
gave -26.12; the 10,000 likeliest of such pairs gave -26.24 in 100 seconds, and 20,000 -26.25 in 180.
"""

PAIRS_FEW = 3_000
"""So many of these in any case."""

PAIRS_PER_SECOND = 200
"""More than these for each second that there is for what is around them."""

FOR_PAIRS = 0.5
"""The share of a person's memory that their problem may take for more than these."""

NEXT_TO = 3.3
"""How many states there are to be stored for each of them, with those where they break off, roughly."""

ADVISED = 0.3
"""The share of people who are advised, in each step, of those by whose chances states are chosen."""

LATER = 3
"""States are chosen by what is met within so many times the steps that are told apart."""

BETWEEN = 5_000
"""States of that on which prices are looked for, which takes value iteration at each step in every round."""

COMPLYING = 600_000
"""States of that on which people comply, about; only a table's are known without asking for each."""

COMPLYING_PER_SECOND = 20_000
"""No more than these for each second that there is for them: half of the sweeps over many say less than all over few.

On a task of 654,610 states what follows on the frontier of a region of 20,000 was bounded by -20.3 on 150,000 states in
4 seconds and by -21.1 on 600,000 in 17; cut off after 11, these gave -14.2.
"""

STATE_BYTES = 600
"""What one of these states may take, roughly."""

FOR_REGIONS = 0.5
"""The share of the time there is that collecting the larger region may take."""

FOR_COMPLYING = 0.6
"""The share of what is left then that bounding those who comply may take."""

ERROR = 0.5
"""Largest error of a value on the larger region given those at its frontier, in cost units; all hold in any case.

Where it matters errors are far smaller: in the last sweep no value changes by more than this times 1 - gamma.
"""

SWEEPS = 20
"""Sweeps over that region at the most: later ones change what those get who go round in circles, hardly anything else.

On a task of 654,610 states a person's bound at its beginning was -22.224 after 16, and -22.225 after 60.
"""


@dataclass(frozen=True)
class OuterRelaxation:
    """The larger region around that on which beta and theta are hidden, where a robot sees them.

    Attributes
    ----------
    visits : AttentionSubproblem
        The person's problem on it, with a robot that comes and goes.
    value : float array, shape (m, B, T)
        What no robot exceeds in its states.
    place : int array, shape (n,)
        Which of the region's states each of the inner one's is; -1 where it is none of them.
    """

    visits: AttentionSubproblem
    value: Floats
    place: NDArray[np.int64]

    @property
    def nbytes(self) -> int:
        """How many bytes it takes, about."""
        return self.value.nbytes + sum(array.nbytes for array in _arrays(self.visits.pomdp))

    def priced(self, price: Floats) -> Iterator[tuple[int, Floats]]:
        """Bound what a robot gets at each step, where attention has a price, shape (m, B, T): backwards, with the step.

        Prices are of the steps from 0 on; after the last, which comes first, it is free.
        """
        found = self.value
        yield len(price), found
        for step in range(len(price) - 1, -1, -1):
            found = backward(self.visits.at_price(float(price[step])), found)
            np.minimum(found, self.value, out=found)  # prices make nobody better off
            yield step, found

    def beyond(self, visits: AttentionSubproblem, free: Floats) -> AttentionSubproblem:
        """Give the problem of visits of the inner region, with prices, with what follows where that breaks off.

        A robot on its way gets no more than one that is there, and is paid for as well. Nor does anybody get more than
        where attention costs nothing: `free`, shape (P * n, B, T), by position and state.
        """
        layout, frontier = visits.layout, visits.pomdp.frontier
        assert frontier is not None
        states = frontier.states
        upper = np.minimum(frontier.upper, free[layout.position[states] * layout.states + layout.x[states]])
        position = np.minimum(layout.position[states], HERE)
        own = self.visits.layout.number(0, position, self.place[layout.x[states]])
        for step, most in self.priced(visits.price):
            at = np.flatnonzero(layout.step[states] == step)
            upper[at] = np.minimum(upper[at], most[own[at]])
        return replace(visits, pomdp=replace(visits.pomdp, frontier=LeafBounds(states, upper, upper)))


@dataclass(frozen=True)
class TruncatedProblem:
    """One person's problem, of which a bound is one of the whole task.

    Attributes
    ----------
    problem : AssistPOMDP
        With a robot that is always there, on the region where beta and theta are hidden.
    outer : OuterRelaxation or None
        What is known around it, if that has been asked for and anything is.
    between : OuterRelaxation or None
        The same on a smaller region: prices are looked for on it.
    pairs : int
        On how many states, each with one step, they are hidden where each is there once for every step.
    """

    problem: AssistPOMDP
    outer: OuterRelaxation | None = None
    between: OuterRelaxation | None = None
    pairs: int = 0


def bounded(
    known: CostToGo,
    setting: Setting,
    human: Human | None,
    prior: Population | Mixture,
    *,
    entry: float,
    size: int,
    around: bool = False,
    until: float = math.inf,
    memory_limit_mb: float = math.inf,
    kept_mb: float = math.inf,
) -> TruncatedProblem:
    """Set up a person's problem with a robot that is always there, on a region with bounds of the whole task beyond.

    Parameters
    ----------
    known : CostToGo
    setting : Setting
    human : Human or None
        The person, as far as the robot knows what they are mistaken about.
    prior : Population or Mixture
        Whom the robot takes them for.
    entry : float
        What coming costs at least, in cost units.
    size : int
        States that policies are worked out on: beta and theta are hidden on no more.
    around : bool
        Whether what is around that region is wanted, too.
    until : float
        A time on `time.perf_counter()`'s clock: states that are met later are not looked at, and no sweep begins then.
    memory_limit_mb : float
        What it may take while it is worked out.
    kept_mb : float
        What it may take then.

    Raises
    ------
    LimitError
        It would take more memory than is allowed.
    """
    who = {"population": prior, "human": human}
    in_time = PAIRS_PER_SECOND * (until - time.perf_counter())
    hidden, seen = min(size, HIDDEN, FEW), 0 if known.searches else SEEN
    inner = TruncatedTask.of(known, states=hidden, **who)  # type: ignore[arg-type]
    problem = _seen(inner, setting, human, prior)
    more = int(min(size, HIDDEN, _affordable(problem, hidden, until, kept_mb)))
    if more > hidden and len(inner.frontier) and not known.searches:
        hidden = more
        inner = TruncatedTask.of(known, states=hidden, **who)  # type: ignore[arg-type]
        problem = _seen(inner, setting, human, prior)
    assert problem.frontier is not None
    left = (until - time.perf_counter()) * FOR_REGIONS
    if not (seen > hidden and len(inner.frontier) and left > 0):
        return TruncatedProblem(_within(inner, problem, None, setting, human, prior))
    limit = None if left == math.inf else left
    outer = TruncatedTask.of(known, states=seen, time_limit=limit, **who)  # type: ignore[arg-type]
    around_it = _seen(outer, setting, human, prior)
    if (share := memory_limit_mb * 1e6 / _bytes(around_it)) < 1:  # half of it, as small ones have larger frontiers
        few = int(share / 2 * (len(outer.states) - len(outer.frontier)))
        outer = TruncatedTask.of(known, states=max(hidden, few), time_limit=limit, **who)  # type: ignore[arg-type]
        around_it = _seen(outer, setting, human, prior)
    comply = _complying(outer, setting, human, prior, until, memory_limit_mb)
    visits, value = _values(around_it, comply, entry, until, memory_limit_mb)
    found = OuterRelaxation(visits, value, outer.local(inner.states))
    problem = _within(inner, problem, found, setting, human, prior)
    if not around or (found.place < 0).any():
        return TruncatedProblem(problem)
    room = FOR_PAIRS * kept_mb * 1e6 / (2 * NEXT_TO * _bytes_of_a_state(problem))
    pairs = int(max(PAIRS_FEW, min(PAIRS, in_time, room)))
    middle = TruncatedTask.of(known, states=min(BETWEEN, len(outer.states) - len(outer.frontier)), **who)  # type: ignore[arg-type]
    place = outer.local(middle.states)
    if (place < 0).any():  # time was over before
        return TruncatedProblem(problem, found, found, pairs)
    between = _within(middle, _seen(middle, setting, human, prior), replace(found, place=place), setting, human, prior)
    own = AttentionSubproblem.of(between, entry)
    values = np.ascontiguousarray(value[visits.layout.number(0, own.layout.position, place[own.layout.x])])
    return TruncatedProblem(problem, found, OuterRelaxation(own, values, middle.local(inner.states)), pairs)


def likely(alone: AssistPOMDP, steps: int, most: int) -> NDArray[np.bool_]:
    """Tell which states are met most likely at each of so many steps, and later, shape (steps + 1, n): `most` in all.

    By people who are advised in a share of steps (`ADVISED`), each optimal action alike, and follow; else they choose
    as they do by themselves.
    """
    choices = alone.model.choices
    row, slot = np.nonzero(choices.applicable & ~alone.final[:, None])
    target, advised = choices.targets[row, slot], choices.optimal[row, slot].astype(float)
    advised /= np.maximum(np.bincount(row, advised, len(choices)), 1)[row]
    chance = np.zeros((steps + 1, len(choices)))
    for chosen, share in zip(np.moveaxis(alone.chosen, 2, 0), alone.prior.sum(axis=1), strict=True):
        goes = (1 - ADVISED) * chosen[row, slot] + ADVISED * advised
        there = np.zeros(len(choices))
        there[choices.initial] = share
        for step in range(LATER * steps):
            chance[min(step, steps)] += there
            there = np.bincount(target, there[row] * goes, len(choices)).astype(float)
    chance[:, alone.final] = 0.0
    kept, order = np.zeros(chance.size, dtype=bool), np.argsort(-chance, axis=None, kind="stable")[:most]
    kept[order] = chance.ravel()[order] > 0.0
    return kept.reshape(chance.shape)


def _affordable(problem: AssistPOMDP, hidden: int, until: float, kept_mb: float) -> float:
    """Give on how many states beta and theta can be hidden, with as much memory for each as a problem takes on some."""
    states, robots = problem.suggested.shape
    values = 8 * states * problem.prior.size * (robots + 2)  # of each robot action, one more than these, and the best
    needed = 2 * (sum(array.nbytes for array in _arrays(problem)) + values)  # away, and here
    return min(PER_SECOND * (until - time.perf_counter()), FOR_HIDDEN * kept_mb * 1e6 / needed * hidden)


def _within(
    region: TruncatedTask, problem: AssistPOMDP, outer: OuterRelaxation | None, setting: Setting, human: Human | None,
    prior: Population | Mixture,
) -> AssistPOMDP:  # fmt: skip
    """Give a region's problem with what is known where it breaks off; `outer.place` is of the region's states."""
    assert problem.frontier is not None
    here = np.repeat(highest(problem)[region.frontier][:, None], 2, axis=1)  # nobody gets more, away or here
    if outer is not None:
        at = outer.place[region.frontier]
        away, there = (outer.value[outer.visits.states(0, position)] for position in (AWAY, HERE))
        found = np.stack([np.minimum(away, there), there], axis=1)  # to be here is never worse, as leaving is free
        here = np.where((at >= 0)[:, None, None, None], np.minimum(here, found[at]), here)
    upper = np.ascontiguousarray(here[:, 1])
    frontier = replace(problem.frontier, upper=upper, lower=upper.copy(), away=np.ascontiguousarray(here[:, 0]))
    return setting.problem(region.choices, human, prior, frontier=frontier)


def _seen(region: TruncatedTask, setting: Setting, human: Human | None, prior: Population | Mixture) -> AssistPOMDP:
    """Return the problem on a region beyond which people never err, with V(x) of the whole task at its frontier."""
    beyond = region.bounds_of_anybody(setting.gamma, 1)
    expected = -region.choices.h[region.frontier]
    if human is not None or hasattr(setting.chooses(human, prior), "value"):  # else V(x) is minus the cost-to-go
        choices = region.choices
        advised = choices.optimal if setting.suggestions == "optimal" else choices.applicable
        at = np.flatnonzero(np.isin(region.frontier, choices.targets[advised]))
        expected[at] = _expected(region.known, region.states[region.frontier[at]], setting, human, prior)
    return setting.problem(region.choices, human, prior, frontier=replace(beyond, value=expected))


def _expected(
    known: CostToGo, states: NDArray[np.int64], setting: Setting, human: Human | None, prior: Population | Mixture
) -> Floats:
    """Return V(x) of eq. 7 in some states, shape (N,), from their choices in the whole task."""
    if not len(states):
        return np.empty(0)
    around = StateCache(known).around(states)
    model = setting.problem(around.choices, human, prior, frontier=around.bounds_of_anybody(setting.gamma, 1)).model
    return value(setting.chooses(human, prior), around.choices, model.q)[: len(states)]


def _complying(
    region: TruncatedTask, setting: Setting, human: Human | None, prior: Population | Mixture, until: float,
    memory_limit_mb: float,
) -> Floats | None:  # fmt: skip
    """Bound what anybody gets in a region's states, shape (n, B), with a part around it where people comply.

    None where that is not known: of tasks that are no table, people who are mistaken about actions or choose in a way
    of their own, and a robot that acts itself.
    """
    known = region.known
    by_cost = setting.chooses(human, prior) is boltzmann and (human is None or mistaken_about_states(human))
    if not (by_cost and isinstance(known, Table)) or setting.execute:
        return None
    left = until - time.perf_counter()
    in_time = COMPLYING_PER_SECOND * FOR_COMPLYING * max(0.0, left)
    most = int(min(COMPLYING, memory_limit_mb * 1e6 / STATE_BYTES, in_time))
    found = at_most(
        known, human, Grid.regular(prior).beta, around(known, region.states, most), gamma=setting.gamma,
        c_suggest=setting.c_suggest, lapse=setting.lapse, optimal=setting.suggestions == "optimal",
        deadline=until if until == math.inf else until - (1 - FOR_COMPLYING) * left,
    )  # fmt: skip
    return found.at(region.states)


def _values(
    problem: AssistPOMDP, comply: Floats | None, entry: float, until: float, memory_limit_mb: float
) -> tuple[AttentionSubproblem, Floats]:
    """Bound what a robot that comes and goes gets on a region where it sees beta and theta, shape (m, B, T).

    Nobody gets more there than `comply`, shape (n, B), if that is known.
    """
    needed = _bytes(problem) / 1e6
    if needed > memory_limit_mb:
        raise LimitError(
            f"bounding what somebody gets on {len(problem.robot_actions):,} states takes about {needed:,.0f} MB of "
            f"memory, and {memory_limit_mb:,.0f} MB are allowed; expected a smaller region or a higher limit"
        )
    visits = AttentionSubproblem.of(problem, entry)
    found = highest(visits.pomdp)
    if comply is not None:
        found = np.minimum(found, comply[visits.layout.x][:, :, None])
    improve(visits.pomdp, found, tolerance=ERROR, max_sweeps=SWEEPS, deadline=until)
    return visits, found


def _bytes(problem: AssistPOMDP) -> int:
    """Give about how many bytes `_values` takes beside a problem: one of visits, values, and copies of both."""
    values = 8 * len(problem.robot_actions) * problem.prior.size
    return 3 * sum(array.nbytes for array in _arrays(problem)) + 4 * values


def _bytes_of_a_state(problem: AssistPOMDP) -> float:
    """Give about how many bytes a solver takes before its search begins, and the problem, for one of its states."""
    return (sum(array.nbytes for array in _arrays(problem)) + first_bounds_bytes(problem)) / len(problem.robot_actions)


def _arrays(problem: AssistPOMDP) -> tuple[NDArray[Any], ...]:
    """Give the largest arrays of a problem."""
    return (
        problem.suggested, problem.afterstate, problem.robot_costs, problem.chosen, problem.unsuggested, problem.low,
        problem.weight, problem.model.q, problem.model.choices.targets,
    )  # fmt: skip
