"""Bounds on the value of the states of a task that follow from the cost-to-go alone, with their proofs.

`never_erring` is an upper bound for every person and robot, `never_erring_with_help` one for robots that also execute
actions. `advised` is a lower one for a robot that suggests what is optimal, or nothing, in each step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo, Table

from ..people.decision import Floats, Ints
from .assumptions import Assumptions
from .robots import NOTHING_DONE, SUGGESTION

MOST_LEVELS = 10_000  # of h*, for which `never_erring_with_help` has a value
SURVEYED = 10_000_000  # states of a table up to which `Survey` scans all transitions, to limit its time


def never_erring(h: Floats, costs: ArrayLike, gamma: float) -> Floats:
    """Return an upper bound on the value of states for any person and any robot, shape (N,).

    Assumptions. Every choice, including a wait, costs between `cheap` and `dear`; the robot executes no action of the
    task. Let K = cheap / (1 - gamma) and F(h) = K (1 - gamma^(h / dear)).

    Claim. From a state with cost-to-go h, every sequence of choices has a discounted cost of at least F(h). So -F(h) is
    an upper bound on the value, for every person.

    Proof. A choice of cost c leads to h' >= h - c, and F increases. As K - gamma K = cheap,

        c + gamma F(h') - F(h) >= c - cheap + K gamma^(h / dear) (1 - gamma^(1 - c / dear)) >= 0,

    because cheap <= c <= dear. By induction over n, the discounted cost of the first n steps is at least F(h) - gamma^n
    F(h_n), where h_n is the cost-to-go after them. F is bounded and 0 at goals, so that the claim follows as n grows.
    In a dead end h is infinite, and F = K.

    If some action is free, then cheap = 0 and the bound is 0, since people may repeat free actions without end.

    Parameters
    ----------
    h : float array, shape (N,)
        Exact cost-to-go.
    costs : array
        Costs of the task's actions.
    gamma : float
    """
    each = np.append(costs, 1.0)  # a wait costs 1
    return np.asarray(each.min() * np.expm1(h / each.max() * np.log(gamma)) / (1 - gamma))


def never_erring_with_help(
    h: Floats, costs: ArrayLike, gamma: float, c_execute: float, step: float
) -> tuple[Floats, Floats]:
    """Return upper bounds on values for any person and any robot that may execute actions, both of shape (N,).

    The second is for states in which the person acts next, since the robot has executed an action in this step.

    Let Z = -cheap / (1 - gamma), where cheap is the least cost of an action or a wait, and dear the largest cost of an
    action. U is defined on multiples of a unit: U(0) = 0, and for h > 0, U(h) is the largest of Z, of
    gamma U(h - c) - c and gamma U(h - c - dear) - c - c_execute for each cost c of an action, and of -c_execute if
    h <= dear. In arguments of U, c and dear are rounded up to the unit, and arguments below 0 count as 0.

    Claim. U at h*, rounded down to the unit, is an upper bound on the value. The largest of Z and gamma U(h - c) - c is
    one where the person acts next.

    Proof. U falls, as each option at h is one at a smaller h, too, with at least the same value. In a dead end each
    step costs at least cheap, so that Z bounds the value. Elsewhere nobody waits. A choice of cost c leads to a
    cost-to-go of at least h - c, or to a dead end, where -c + gamma Z <= Z. Before it, the robot may execute an action,
    which leads to at least h - dear; if that is a goal, then h <= dear and the person does nothing. So U is at least
    its own Bellman backup, whatever the person and the robot do, and the claim follows by induction over the steps.
    Rounding arguments of U downwards only raises it.

    Parameters
    ----------
    h : float array, shape (N,)
        Exact cost-to-go.
    costs : array
        Costs of the task's actions.
    gamma : float
    c_execute : float
        Cost of an action that the robot executes.
    step : float
        All costs of actions are multiples of it. The unit is larger only where h* has more than 10,000 steps.
    """
    paid, finite = np.unique(costs), np.isfinite(h)
    least, highest = -paid.min(initial=1.0) / (1 - gamma), float(h[finite].max(initial=0.0))
    unit = max(step, highest / MOST_LEVELS)
    down = np.ceil(paid / unit - 1e-9).astype(np.int64)
    dear = int(down.max(initial=0))
    paid, down = np.append(paid, paid + c_execute), np.append(down, down + dear)
    value, acts = np.zeros((2, 1 + int(highest / unit + 1e-9)))
    for level in range(1, len(value)):
        each = gamma * value[np.maximum(level - down, 0)] - paid
        acts[level] = max(least, each[: len(each) // 2].max())
        value[level] = max(acts[level], each.max(), -c_execute if level <= dear else least)
    first, second = np.full((2, *h.shape), least)
    at = (h[finite] / unit + 1e-9).astype(np.int64)
    first[finite], second[finite] = value[at], acts[at]
    return first, second


@dataclass(frozen=True)
class CostLevels:
    """The different costs of a task's choices as whole numbers of levels, so that h* can index an array.

    Attributes
    ----------
    step : float
        Cost of one level, in cost units: all costs of actions are multiples of it.
    steps : int array, shape (C,)
        Levels of each cost, ascending. A wait, which costs 1, is rounded up.
    costs : float array, shape (C,)
        These costs, in cost units.
    """

    step: float
    steps: Ints
    costs: Floats

    @classmethod
    def of(cls, known: CostToGo) -> CostLevels:
        """Return the levels of a task's costs."""
        task = known.task
        whole = math.gcd(*task.costs) or 1
        steps = np.unique([*(cost // whole for cost in task.costs), math.ceil(1 / (whole * task.unit))])
        return cls(task.in_unit(float(whole)), steps, task.in_unit(steps * float(whole)))


@dataclass(frozen=True)
class Survey:
    """Quantities of a task that hold in all of its states.

    Attributes
    ----------
    highest : int
        Levels of the largest finite h*, among the known states if not all are known.
    actions : int
        Largest number of choices in a state.
    rise : float
        Levels of the largest increase of h* by one action; infinite if an action may lead to a dead end, or if it is
        unknown.
    """

    highest: int
    actions: int
    rise: float

    @classmethod
    def of(cls, known: CostToGo, own: Floats, *, rows_at_a_time: int = 1_000_000) -> Survey:
        """Scan all transitions of a table, in blocks to save memory; use safe values where that is too expensive.

        `own` is the cost-to-go of the truncated task's states.
        """
        step = CostLevels.of(known).step
        if not isinstance(known, Table):
            return cls(round(own[np.isfinite(own)].max(initial=0) / step), len(known.task.actions), np.inf)
        h = known.lookup(slice(None))
        finite = np.isfinite(h)
        highest = round(h[finite].max(initial=0) / step)
        if len(known) > SURVEYED:
            return cls(highest, len(known.task.actions), float(highest) if finite.all() else np.inf)
        rows = known.space.transitions
        counts = np.diff(rows.offsets)
        rise = 0.0
        for begin in range(0, len(known), rows_at_a_time):
            block = slice(begin, begin + rows_at_a_time)
            targets = rows.targets[rows.offsets[begin] : rows.offsets[min(begin + rows_at_a_time, len(known))]]
            with np.errstate(invalid="ignore"):  # a difference between two dead ends is no increase
                change = h[targets] - np.repeat(h[block], counts[block])
            rise = max(rise, float(np.nan_to_num(change, posinf=np.inf).max(initial=0.0)))
        return cls(highest, int(counts.max(initial=1)), float(np.rint(rise / step)))


def advised(survey: Survey, levels: CostLevels, floor: float, assumed: Assumptions, *, suggests: bool) -> Floats:
    """Return a lower bound on the value for each level of h* and each theta, shape (highest + 1, T).

    If the robot `suggests` nothing, step 1 has p in place of the probability of following, and
    theta does not move.

    Assumptions. The person chooses by equation 5 with the exact cost-to-go; theta lies on the grid and follows equation
    7. The robot suggests an optimal choice in every step.

    Claim. For each beta, whichever optimal choices are suggested, the value of this policy is at least the returned
    number. So the optimal value is.

    Proof. Let L(h, theta) be a lower bound for all states with cost-to-go h, and A the largest number of choices in a
    state.

    1. An optimal choice has the least perceived cost. So its probability without a suggestion is p >= 1 / A. The
       probability of following, `follows`, increases with p; its value at p = 1 / A is a lower bound. Lapses count as
       not following.
    2. An optimal choice of cost c leads from h to h - c and raises V by c. Hence `low` and `weight` describe the trust
       update.
    3. A person who does not follow pays at most `dear` and reaches at worst the lowest L up to level h + rise, or
       `floor` if the rise is unknown. This is at most the value of following. So replacing the probability of following
       by a lower bound lowers the mean.
    4. By 1 to 3, the minimum over c of the mean of both outcomes, minus the robot's cost, is again a lower bound. So
       every sweep maps lower bounds to lower bounds. They start at `floor`, the value of the largest cost in every
       step. Hence the bounds hold after any number of sweeps. Level 0 is 0 if all actions have a cost; otherwise a
       state with h* = 0 need not be a goal.

    At most 200 sweeps are done; they end earlier if no bound rises by 1e-6 cost units.
    """
    highest, grid, gamma = survey.highest, assumed.grid, assumed.gamma
    value = np.full((highest + 1, len(grid.theta)), floor)
    costs, charge = levels.costs, assumed.robot.costs[SUGGESTION if suggests else NOTHING_DONE]
    if costs[0] > 0:
        value[0] = 0.0
    p = 1 / survey.actions
    theta = grid.theta if suggests else np.full_like(grid.theta, 0.5)  # at 0.5 a suggestion changes nothing
    total = theta * p + (1 - theta) * (1 - p)
    follows = (1 - assumed.lapse) * np.divide(theta * p, total, out=np.full_like(total, p), where=total > 0)
    low, weight = grid.shares(grid.theta + assumed.eta * costs[:, None] / assumed.utility_scale)
    for _ in range(200):
        before = value.copy()
        for h in range(highest + 1):
            worst = np.full(len(grid.theta), floor)
            if np.isfinite(survey.rise):
                worst = value[: min(h + int(survey.rise), highest) + 1].min(axis=0)
            outcomes = []
            for level, c, at, up in zip(levels.steps, costs, low, weight, strict=True):
                if level <= h:
                    right = (1 - up) * value[h - level, at] + up * value[h - level, at + 1]
                    wrong = (1 - up) * worst[at] + up * worst[at + 1]
                    outcomes.append(follows * (gamma * right - c) + (1 - follows) * (gamma * wrong - costs[-1]))
            if outcomes:
                value[h] = np.maximum(value[h], np.min(outcomes, axis=0) - charge)
        if (value - before).max() < 1e-6:
            break
    return value
