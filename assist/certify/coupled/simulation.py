"""Simulated policies of weakly coupled problems, and their distance from the bound."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner.system.arrays import outline, read_only
from planner.system.limits import Deadline

from ...people.arguments import Seed, entropy, whole
from .agents import Agents, Floats, Ints
from .policies import CoupledPolicy, policy
from .price_bound import PriceBound, bound_for, horizon

BLOCK = 2_000_000
"""Number of agents in all runs that are simulated at once; each takes about 100 bytes."""


@dataclass(frozen=True, eq=False)
class CoupledRuns:
    """Simulated runs of a policy.

    Attributes
    ----------
    rewards : float array, shape (runs,)
        Discounted sum of the rewards of all agents in each run.
    corrected : float array, shape (runs,)
        The same minus a control variate of mean 0, if a bound was given; else equal to `rewards`.
    steps : int
        Number of simulated steps.
    rest : float
        Largest possible discounted reward, in absolute value, after the last step.
    """

    rewards: Floats
    corrected: Floats
    steps: int
    rest: float

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def value(self) -> float:
        """Mean discounted reward, with the control variate if there is one."""
        return float(self.corrected.mean())

    @property
    def stderr(self) -> float:
        """Standard error of `value`; NaN for one run."""
        runs = len(self.corrected)
        return float(self.corrected.std(ddof=1) / math.sqrt(runs)) if runs > 1 else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the expected discounted reward, including what may come after the last step."""
        half = 1.96 * self.stderr + self.rest
        return self.value - half, self.value + half


@dataclass(frozen=True, eq=False)
class CoupledCertificate:
    """The distance of a policy from the best one, at most.

    Attributes
    ----------
    runs : CoupledRuns
        The simulated policy.
    bound : PriceBound
        Upper bound on the value of every policy.
    """

    runs: CoupledRuns
    bound: PriceBound

    __repr__ = outline

    @property
    def gap_percent(self) -> float:
        """100 (upper - value) / abs(value); infinite if the value is 0 and the bound is not."""
        value, difference = self.runs.value, self.bound.upper - self.runs.value
        return 100 * difference / abs(value) if value else math.inf if difference > 0 else 0.0


def simulate(
    agents: Agents, act: CoupledPolicy | str, resources: float, *, runs: int = 500, seed: Seed = 0,
    steps: int | None = None, control: PriceBound | None = None, time_limit: float | None = None,
) -> CoupledRuns:  # fmt: skip
    """Simulate a policy.

    Random numbers belong to a run, a step and an agent. With one seed, different policies meet the same ones. More runs
    add to the first ones without changing them.

    Parameters
    ----------
    agents, resources
        As in `bound`.
    act : callable or str
        A policy, or its name (`policy`).
    runs : int
        Number of runs.
    seed : int or numpy.random.Generator
    steps : int, optional
        Number of steps at most. Default: until 1e-6 of the largest possible reward may remain. A simulation ends
        earlier if all agents are in states that no action leaves and that have no rewards.
    control : PriceBound, optional
        Bound whose values are a control variate: the discounted differences between the value of each next state and
        its expectation are subtracted. Their mean is 0, and they explain most of the variance.
    time_limit : float, optional
        Seconds after which no further block of runs begins; those that were simulated by then are returned.

    Raises
    ------
    ValueError
        An argument is invalid, or the policy takes an action that is not allowed or uses more than the resource.
    """
    key = entropy(seed)
    number = whole("runs", runs, 1)
    last = horizon(agents.gamma) if steps is None else whole("steps", steps, 1)
    act = policy(agents, act, resources, solved=control)
    size = max(1, BLOCK // len(agents))
    ends, parts = Deadline.after(time_limit), list[tuple[Floats, Floats, int, float]]()
    for begin in range(0, number, size):
        if parts and ends.passed:
            break
        numbers = np.arange(begin, min(begin + size, number))
        parts.append(_block(agents, act, resources, numbers, key, last, control))
    taken = max(part[2] for part in parts)
    rest = max(part[3] for part in parts)
    return CoupledRuns(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]), taken, rest)


def certify(
    agents: Agents, act: CoupledPolicy | str, resources: float, *, runs: int = 500, seed: Seed = 0,
    solved: PriceBound | None = None, time_limit: float | None = None,
) -> CoupledCertificate:  # fmt: skip
    """Simulate a policy and compare it with the bound, whose values are the control variate.

    Parameters
    ----------
    agents, act, resources, runs, seed
        As in `simulate`.
    solved : PriceBound, optional
        The bound. Default: it is computed.
    time_limit : float, optional
        Seconds, half of which the bound may take; as in `bound` and `simulate`.

    Raises
    ------
    ValueError
        As from `simulate`, or the bound is for other units of the resource.
    """
    half = None if time_limit is None else time_limit / 2
    upper = bound_for(agents, resources, solved, time_limit=half)
    found = simulate(agents, act, resources, runs=runs, seed=seed, control=upper, time_limit=half)
    return CoupledCertificate(found, upper)


def _block(
    agents: Agents, act: CoupledPolicy, resources: float, numbers: Ints, key: int, last: int,
    control: PriceBound | None,
) -> tuple[Floats, Floats, int, float]:  # fmt: skip
    """Simulate consecutive runs; return rewards, corrected rewards, the number of steps, and what may remain."""
    K, _, S = agents.shape
    n, N = K * S, len(agents)
    reward, use, may = agents.flat
    cumulative, successor = agents.successors()
    finished = agents.finished()
    offset = agents.kind * S
    total, varied, discount = np.zeros(len(numbers)), np.zeros(len(numbers)), 1.0

    def uniform(step: int) -> Floats:
        """Return the numbers of these runs, which follow those of the runs before."""
        bits = np.random.Philox(key=[key & (2**64 - 1), step])
        before = int(numbers[0]) * N
        bits.advance(before // 4)  # four numbers are drawn at once
        drawn: Floats = np.random.Generator(bits).random(before % 4 + len(numbers) * N)
        return drawn[before % 4 :].reshape(len(numbers), N)

    begin = np.cumsum(agents.initial, axis=1)
    begin[:, -1] = np.inf
    first = uniform(0)
    states = np.stack([np.searchsorted(c, first[:, k], side="right") for k, c in enumerate(begin)], axis=1)
    if control is not None:
        varied += control.at(0)[states + offset].sum(axis=1) - agents.weight @ control.at(0)
    most = agents.room(resources)
    step = 0
    while step < last and not finished[column := states + offset].all():
        action = np.asarray(act(step, states))
        if action.shape != states.shape or action.dtype.kind not in "iu":
            raise ValueError(f"policy: {action.dtype} array of shape {action.shape}; expected actions, {states.shape}")
        if (action < 0).any() or (action >= len(reward)).any() or not may[action, column].all():
            raise ValueError(f"policy: an action at step {step} is not allowed")
        if (use[action, column].sum(axis=1) > most).any():
            raise ValueError(f"policy: the actions at step {step} use more than {resources:g} units")
        row = action * n + column
        total += discount * reward[action, column].sum(axis=1)
        u = uniform(step + 1)
        which = (cumulative[row] <= u[:, :, None]).sum(axis=2)
        states = successor[row, which]
        step += 1
        discount *= agents.gamma
        if control is not None:
            ahead = control.at(step)
            varied += discount * (ahead[states + offset] - (agents.P @ ahead)[row]).sum(axis=1)
    left = (~finished[states + offset]).sum(axis=1).max()
    rest = float(discount * left * abs(agents.R).max() / (1 - agents.gamma))
    return total, total - varied, step, rest
