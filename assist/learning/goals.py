"""Which goal a person pursues: the exact posterior over goals, from recorded actions.

A person pursues one of G goals and chooses by the Boltzmann choice (equation 5) on the exact cost-to-go of that goal.
The hidden type is the pair of the goal and beta. Beta belongs to the person and takes the values of a grid. The belief
in it is carried over from each episode of a person to the next, in the order of `Recording`. The goal of each episode
is drawn from the prior. The posterior is then the normalised product of the prior and of the probabilities of all
actions, without any approximation.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, known_costs
from planner.system.arrays import outline, read_only

from ..people.belief import Grid
from ..people.choices import STAND_STILL
from ..people.decision import NOTHING, Floats, choice
from ..people.decision import lapse as lapses
from ..people.goals import prior_over
from ..people.human import Population
from .fit import LogError, require_actions
from .joint_states import JointStates
from .log import Fault, Log, log_of
from .observations import Ints
from .replay import Recording, replay

if TYPE_CHECKING:
    from planner import AnyTask


@dataclass(frozen=True)
class EpisodeGoals:
    """The posterior over goals in one episode of T actions.

    Attributes
    ----------
    person, episode : str
    step : int array, shape (T,)
        Step number in the log.
    actions : tuple of str
        The person's actions.
    posterior : float array, shape (T, G)
        Probability of each goal after each action.
    beta : float array, shape (T,)
        Mean of beta after each action.
    """

    person: str
    episode: str
    step: Ints
    actions: tuple[str, ...]
    posterior: Floats
    beta: Floats

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.step)


@dataclass(frozen=True)
class InferredGoals:
    """The posteriors over goals of all episodes of a log.

    Attributes
    ----------
    goals : tuple of str
        Names of the G goals.
    prior : float array, shape (G,)
        Probability of each goal before the first action of an episode.
    episodes : tuple of EpisodeGoals
        Sorted by person and episode.
    faults : tuple of Fault
        Unusable lines of the log.
    notes : tuple of str
        Remarks, such as why actions are left out.
    left_out : int
        Number of actions that are left out because the cost-to-go after them is unknown.
    """

    goals: tuple[str, ...]
    prior: Floats
    episodes: tuple[EpisodeGoals, ...]
    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: int = 0

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return the results as plain data: a record for each episode."""

        def named(posterior: Floats) -> dict[str, float]:
            return dict(zip(self.goals, posterior.tolist(), strict=True))

        return [
            {
                "person": one.person,
                "episode": one.episode,
                "goal": self.goals[int(one.posterior[-1].argmax())],
                "posterior": named(one.posterior[-1]),
                "beta": float(one.beta[-1]),
                "steps": [
                    {"step": step, "action": action, "posterior": named(posterior), "beta": beta}
                    for step, action, posterior, beta in zip(
                        one.step.tolist(), one.actions, one.posterior, one.beta.tolist(), strict=True
                    )
                ],
            }
            for one in self.episodes
        ]


def infer_goals(
    goals: Mapping[str, CostToGo | AnyTask],
    log: Log | str | PathLike[str] | Iterable[Mapping[str, Any]],
    *,
    prior: Mapping[str, float] | None = None,
    beta: ArrayLike | None = None,
    lapse: float = 1e-3,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    strict: bool = False,
) -> InferredGoals:
    """Return the exact posterior over goals after each recorded action.

    Parameters
    ----------
    goals : mapping of str to CostToGo, or to whatever `planner.load` takes
        Cost-to-go of each goal, by the goal's name, such as the tables of `planner.sweep_goals`. The tasks differ in
        their goals only.
    log : Log, path, list of dict, or data frame
        A log, as in `fit`. Suggestions in it are ignored.
    prior : mapping of str to float, optional
        Probability of each goal at the beginning of an episode; by default all are equal.
    beta : array_like, shape (B,), optional
        Values of beta, which are equally probable at first; by default a grid of six from 0.1 to 3 (`Grid.regular`).
    lapse : float
        Weight of a uniform choice, so that no action has probability zero; between 0 and 1.
    drop, rename
        As in `replay`.
    strict : bool
        Whether a log that cannot be used completely is an error.

    Raises
    ------
    LogError
        No part of the log can be used or, with `strict`, some part cannot.
    ValueError
        The tasks differ in more than their goals, a goal cannot be reached, or a parameter is invalid.
    LimitError
        With `strict`, the cost-to-go of a state took too long.

    Warns
    -----
    UserWarning
        Some lines cannot be used (`InferredGoals.faults`), or something else was left out (`InferredGoals.notes`).

    Notes
    -----
    In a dead end of a goal all choices are equally probable, as in `people.decision.choice`. A person who has reached
    a goal would stop: an action after that is a lapse, of probability `lapse` divided by the number of choices. Once
    all goals are reached, actions are excluded as in `fit`.
    """
    log = log_of(log)
    found = inferred(
        costs_of_goals(goals), log, prior=prior, beta=beta, lapse=lapse, drop=drop, rename=rename, strict=strict
    )
    if found.faults:
        others = f" (and {len(found.faults) - 1} more; see `faults`)" if len(found.faults) > 1 else ""
        warnings.warn(f"{log.name}:{found.faults[0].line}: {found.faults[0]}{others}", stacklevel=2)
    for note in found.notes:
        warnings.warn(note, stacklevel=2)
    return found


def costs_of_goals(goals: Mapping[str, CostToGo | AnyTask]) -> dict[str, CostToGo]:
    """Return the cost-to-go of each goal, whose task may be given in any form."""
    if not isinstance(goals, Mapping):
        raise TypeError(
            f"a {type(goals).__name__} where goals were expected: a dictionary, a task for each goal's name"
        )
    return {name: known_costs(task) for name, task in goals.items()}


def inferred(
    goals: Mapping[str, CostToGo],
    log: Log,
    *,
    prior: Mapping[str, float] | None = None,
    beta: ArrayLike | None = None,
    lapse: float = 1e-3,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    strict: bool = False,
) -> InferredGoals:
    """Return the result of `infer_goals`, without warnings about faults in the log."""
    first = prior_over(goals, prior)
    grid = Grid.regular(Population()).beta if beta is None else np.asarray(beta, dtype=float)
    if grid.ndim != 1 or not len(grid) or not (np.isfinite(grid).all() and (grid >= 0).all()):
        raise ValueError(f"beta {grid}: expected one or more finite values from 0 upwards")
    if not 0 < lapse < 1:
        raise ValueError(f"lapse {lapse:g}: expected 0 < lapse < 1")
    r = recorded(goals, log, drop=drop, rename=rename, strict=strict)
    notes, left_out = list(r.notes), sum(r.left_out.values())
    if left_out:
        notes.append(f"{left_out} actions are left out, since the cost-to-go after them is unknown")
    if (r.recording.suggested != NOTHING).any():
        notes.append("suggestions are ignored: people are taken to choose by cost-to-go alone")
    likelihood = np.log(_probabilities(r.recording, r.h, r.reached, grid, lapse))
    with np.errstate(divide="ignore"):
        episodes = _posteriors(r.recording, likelihood, np.log(first), grid, r.actions)
    return InferredGoals(tuple(goals), first, episodes, r.faults, tuple(notes), left_out)


class RecordedWithGoals(NamedTuple):
    """A log that was replayed for G goals.

    Attributes
    ----------
    recording : Recording
        N choices, without those of which the cost-to-go is unknown with some goal.
    h : float array, shape (G, states)
        Cost-to-go with each goal.
    reached : bool array, shape (G, N)
        Whether each goal holds before each choice.
    actions : sequence of str
        The task's actions.
    faults : tuple of Fault
    notes : tuple of str
    left_out : dict of str to int
        Number of choices of each person that are left out.
    """

    recording: Recording
    h: Floats
    reached: NDArray[np.bool_]
    actions: Sequence[str]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    left_out: dict[str, int]


def recorded(
    goals: Mapping[str, CostToGo],
    log: Log,
    *,
    drop: Sequence[str] = (),
    rename: Mapping[str, str] | None = None,
    strict: bool = False,
) -> RecordedWithGoals:
    """Replay a log for several goals; parameters and errors as in `infer_goals`."""
    states = JointStates(goals)
    for name, costs in goals.items():
        if not np.isfinite(costs.lookup([costs.initial])[0]):
            raise ValueError(f"goal '{name}' cannot be reached from the initial state; expected goals that can")
    recording, found = replay(log, states, drop=drop, rename=rename)
    faults = tuple(sorted([*log.faults, *found], key=lambda fault: fault.line))
    if strict and faults:
        raise LogError(f"{log.name}:{faults[0].line}: {faults[0]}")
    require_actions(log, recording, states)
    h, notes = states.cost_to_go(recording, strict=strict)
    recording, left_out = recording.evaluated(np.where(np.isnan(h).any(axis=0), np.nan, 0.0))
    if not len(recording):
        raise LogError(f"{log.name}: the states after every action took too long")
    reached = states.reached(recording.state)
    return RecordedWithGoals(recording, h, reached, states.task.actions, faults, tuple(notes), left_out)


def _probabilities(recording: Recording, h: Floats, reached: NDArray[np.bool_], beta: Floats, rate: float) -> Floats:
    """Return the probability of each recorded choice for each type, shape (N, G, B).

    Parameters
    ----------
    recording : Recording
        N steps.
    h : float array, shape (G, states)
        Cost-to-go of each goal.
    reached : bool array, shape (G, N)
        Whether each goal holds before each choice.
    beta : float array, shape (B,)
    rate : float
        The lapse rate.
    """
    r = recording
    rows, applicable = np.arange(len(r)), r.applicable[:, None]
    result = np.empty((len(r), len(h), len(beta)))
    for goal in range(len(h)):
        q = np.where(r.applicable, r.costs + h[goal, r.targets], np.inf)
        p = choice(q[:, None], applicable, beta)
        p[reached[goal]] = 0.0  # the person would have stopped
        result[:, goal] = lapses(p, applicable, rate)[rows, :, r.chosen]
    return result


def _posteriors(
    recording: Recording, likelihood: Floats, prior: Floats, beta: Floats, actions: Sequence[str]
) -> tuple[EpisodeGoals, ...]:
    """Return the posteriors of all episodes.

    Parameters
    ----------
    recording : Recording
    likelihood : float array, shape (N, G, B)
        Logarithm of the probability of each choice.
    prior : float array, shape (G,)
        Logarithm of the prior.
    beta : float array, shape (B,)
    actions : sequence of str
        The task's actions.
    """
    r = recording
    ends = np.flatnonzero(np.diff(r.episode, append=-1))
    found = []
    for begin, end in zip([0, *(ends[:-1] + 1)], ends + 1, strict=True):
        if begin == 0 or r.person[begin] != r.person[begin - 1]:
            of_beta = np.zeros(len(beta))
        weights = prior[:, None] + of_beta + likelihood[begin:end].cumsum(axis=0)
        weights -= weights.max(axis=(1, 2), keepdims=True)
        types = np.exp(weights)
        of_goal, every = types.sum(axis=2), types.sum(axis=1)
        chosen = r.actions[np.arange(begin, end), r.chosen[begin:end]]
        found.append(
            EpisodeGoals(
                r.people[r.person[begin]], r.episodes[r.episode[begin]], r.step[begin:end],
                tuple(actions[action] if action >= 0 else STAND_STILL for action in chosen.tolist()),
                of_goal / of_goal.sum(axis=1, keepdims=True), every @ beta / every.sum(axis=1),
            )
        )  # fmt: skip
        of_beta = np.logaddexp.reduce(weights[-1], axis=0)
    return tuple(found)
