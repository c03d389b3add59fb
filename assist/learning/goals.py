"""Which goal a person pursues: the exact posterior over goals, from recorded actions.

A person pursues one of G goals and chooses by the Boltzmann choice (equation 5) on the exact cost-to-go of that goal.
The hidden type is the pair of the goal and beta. Beta belongs to the person and takes the values of a grid. The belief
in it is carried over from each episode of a person to the next, in the order of `Recording`. The goal of each episode
is drawn from the prior. The posterior is then the normalised product of the prior and of the probabilities of all
actions, without any approximation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from planner import CostToGo
from planner.system.arrays import read_only
from planner.system.results import Result

from ..people.belief import Grid
from ..people.choices import STAND_STILL
from ..people.decision import NOTHING, Floats, choice
from ..people.decision import lapse as lapses
from ..people.ranges import Population
from .evidence import Evidence, Reading, Records, evidence
from .log import Fault
from .observations import Ints

if TYPE_CHECKING:
    from planner import AnyTask


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeGoals(Result):
    """The posterior over goals in one episode of T actions.

    Attributes
    ----------
    person, episode : str
    goals : tuple of str
        Names of the G goals.
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
    goals: tuple[str, ...]
    step: Ints
    actions: tuple[str, ...]
    posterior: Floats
    beta: Floats

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.step)

    def __repr__(self) -> str:
        return f"<goals of {self.person}, episode {self.episode}: {self._end()} after {len(self)} actions>"

    @property
    def goal(self) -> str:
        """The most probable goal after the last action."""
        return self.goals[int(self.posterior[-1].argmax())]

    def _end(self) -> str:
        return f"{self.goal} with probability {self.posterior[-1].max():.2f}"

    def named(self, action: int = -1) -> dict[str, float]:
        """Return the probability of each goal after an action, by default the last one."""
        return dict(zip(self.goals, self.posterior[action].tolist(), strict=True))

    def steps(self) -> list[dict[str, Any]]:
        """Return the step, the action, the probability of each goal, and the mean of beta, for each action."""
        rows = zip(self.step.tolist(), self.actions, self.beta.tolist(), strict=True)
        return [
            {"step": step, "action": action, "posterior": self.named(t), "beta": beta}
            for t, (step, action, beta) in enumerate(rows)
        ]

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each action, as `steps` does, with a column for each goal."""
        names = ("step", "action", *self.goals, "beta")
        return [{name: (row | row["posterior"])[name] for name in names} for row in self.steps()]


@dataclass(frozen=True, eq=False, repr=False)
class InferredGoals(Result):
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

    def __post_init__(self) -> None:
        read_only(self)

    def __repr__(self) -> str:
        faults = f"{len(self.faults)} faults of the log"
        return f"<goals of {len(self.episodes)} episodes: {', '.join(self.goals)}; {faults}>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each episode: its most probable goal, and the probability of each goal at its end."""
        return [
            {"person": one.person, "episode": one.episode, "actions": len(one), "goal": one.goal, **one.named()}
            for one in self.episodes
        ]

    def as_dicts(self) -> list[dict[str, Any]]:
        """Return the results as plain data: a record for each episode."""
        return [
            {
                "person": one.person, "episode": one.episode, "goal": one.goal, "posterior": one.named(),
                "beta": float(one.beta[-1]), "steps": one.steps(),
            }
            for one in self.episodes
        ]  # fmt: skip


def infer_goals(
    goals: Mapping[str, CostToGo | AnyTask] | Evidence, log: Records | None = None, *, beta: ArrayLike | None = None,
    lapse: float = 1e-3, **reading: Unpack[Reading],
) -> InferredGoals:  # fmt: skip
    """Return the exact posterior over goals after each recorded action.

    It has no limit of time of its own: what takes long is cost-to-go, and tables that `sweep_goals` computed within a
    limit can be given as goals.

    Parameters
    ----------
    goals, log, **reading
        As for `replayed`: the task of each goal by its name, and a log; or a log that was replayed. Suggestions in the
        log are ignored.
    beta : array_like, shape (B,), optional
        Values of beta, which are equally probable at first; by default a grid of six from 0.1 to 3 (`Grid.regular`).
    lapse : float
        Weight of a uniform choice, so that no action has probability zero; between 0 and 1.

    Raises
    ------
    InputFileError
        No part of the log can be used or, with `strict`, some part cannot.
    ValueError
        The tasks differ in more than their goals, a goal cannot be reached, or a parameter is invalid.
    LimitError
        With `strict`, the cost-to-go of a state took too long.

    Warns
    -----
    UserWarning
        Some lines cannot be used (`InferredGoals.faults`), or some states were not evaluated.

    Notes
    -----
    In a dead end of a goal all choices are equally probable, as in `people.decision.choice`. A person who has reached
    a goal would stop: an action after that is a lapse, of probability `lapse` divided by the number of choices. Once
    all goals are reached, actions are excluded as in `fit`.
    """
    grid = Grid.regular(Population()).beta if beta is None else np.asarray(beta, dtype=float)
    if grid.ndim != 1 or not len(grid) or not (np.isfinite(grid).all() and (grid >= 0).all()):
        raise ValueError(f"beta {grid}: expected one or more finite values from 0 upwards")
    if not 0 < lapse < 1:
        raise ValueError(f"lapse {lapse:g}: expected 0 < lapse < 1")
    if not isinstance(goals, Mapping | Evidence):
        raise TypeError(
            f"a {type(goals).__name__} where goals were expected: a dictionary, a task for each goal's name"
        )
    r = evidence(goals, log, reading)
    notes, left_out = list(r.notes), sum(r.left_out.values())
    if left_out:
        notes.append(f"{left_out} actions are left out, since the cost-to-go after them is unknown")
    if (r.recording.suggested != NOTHING).any():
        notes.append("suggestions are ignored, as if people chose by cost-to-go alone; `fit` with goals reads them")
    likelihood = np.log(_probabilities(r, grid, lapse))
    with np.errstate(divide="ignore"):
        episodes = _posteriors(r, likelihood, grid)
    return InferredGoals(r.goals, r.prior, episodes, r.faults, tuple(notes), left_out)


def _probabilities(seen: Evidence, beta: Floats, rate: float) -> Floats:
    """Return the probability of each recorded choice for each type, shape (N, G, B); `beta` has shape (B,)."""
    r = seen.recording
    rows, applicable = np.arange(len(r)), r.applicable[:, None]
    result = np.empty((len(r), len(seen.goals), len(beta)))
    for goal, known in enumerate(seen.known):
        q = np.where(r.applicable, r.costs + known.h[r.targets], np.inf)
        p = choice(q[:, None], applicable, beta)
        p[seen.reached[goal]] = 0.0  # the person would have stopped
        result[:, goal] = lapses(p, applicable, rate)[rows, :, r.chosen]
    return result


def _posteriors(seen: Evidence, likelihood: Floats, beta: Floats) -> tuple[EpisodeGoals, ...]:
    """Return the posteriors of all episodes; `likelihood` has the log of the probability of each choice, (N, G, B)."""
    r, actions, prior = seen.recording, seen.costs.task.actions, np.log(seen.prior)
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
                r.people[r.person[begin]], r.episodes[r.episode[begin]], seen.goals, r.step[begin:end],
                tuple(actions[action] if action >= 0 else STAND_STILL for action in chosen.tolist()),
                of_goal / of_goal.sum(axis=1, keepdims=True), every @ beta / every.sum(axis=1),
            )
        )  # fmt: skip
        of_beta = np.logaddexp.reduce(weights[-1], axis=0)
    return tuple(found)
