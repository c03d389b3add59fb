"""One episode with what the robot expected of each person, step by step: why it went where it went.

The gain of a person is what the best suggestion to them is worth by the robot's belief, less its cost and that of the
way: the score of Algorithm 1. The attention policy goes to the person with the largest positive gain. For other
policies it is the same quantity, by which they can be judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.system.results import Result

from ...live.trace_reasons import TraceReasons
from ...people.arguments import Seed, entropy, whole
from ...people.choices import Choices
from ...people.decision import Floats
from ...team.attention import AttentionSwitching
from ...team.belief_trace import Watched
from ...team.episodes import Episode
from ...team.policies import by_name
from ...team.pool import Pool, require_pool
from ...team.simulate import simulate
from ...team.state import TeamPolicy, TeamState
from ...team.trace import Trace, robot_is_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class WatchedEpisode(Result):
    """One episode, with the gain that the robot expected from going to each person at each step.

    Attributes
    ----------
    episode : Episode
    trace : list of dict
        Every action of every person, with the reason for each suggestion as `explanation`.
    alone : list of dict
        The same episode without a robot.
    gain : float array, shape (steps, K)
        Expected gain in cost units of going to each person, by the robot that gains most. It is NaN for people to whom
        no suggestion is worth its cost or who are not at work, and while the policy does not choose.
    """

    episode: Episode
    trace: Trace
    alone: Trace
    gain: Floats

    def __repr__(self) -> str:
        people = ", ".join(self.episode.people)
        return f"<episode {self.episode.episode} of {people}, policy {self.episode.policy}: {len(self.gain)} steps>"

    def records(self) -> list[dict[str, Any]]:
        """Return a row for each person and step: the expected gain, the robot's place, and what was said and done."""
        return [
            {
                "step": row["step"], "person": row["person"], "cost_to_go": row["cost_to_go"],
                "gain": float(self.gain[row["step"], row["place"]]), "robot_here": robot_is_at(row, row["place"]),
                "suggestion": row["suggestion"], "action": row["action"], "reason": _reason(row),
            }
            for row in self.trace
        ]  # fmt: skip

    def reasons(self) -> str:
        """Return a paragraph for each suggestion: the step, from 0 as in the table, the person, and why."""
        said = [row for row in self.trace if _reason(row)]
        return "\n".join(f"Step {row['step']}, {row['person']}: {_reason(row)}" for row in said) or self._silence()

    def _silence(self) -> str:
        """Return why the robot suggested nothing in the whole episode."""
        told = "There was no suggestion in this episode."
        if not np.isfinite(self.gain).any():
            return f"{told} By Algorithm 1, none was worth its cost to anybody."
        step, place = divmod(int(np.nanargmax(self.gain)), self.gain.shape[1])
        where = f"{self.gain[step, place]:.2g} at step {step}, for {self.episode.people[place]}"
        return f"{told} The largest gain that Algorithm 1 expected was {where}."

    def figure(self) -> Figure:
        """Return the figure: for each person the expected gain and the cost-to-go over time, and where the robot was.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed (extra `plots`).
        """
        from ...drawing.plots.watched import watched_figure

        return watched_figure(self)


def _gains(team: TeamState) -> Floats:
    """Return the gain that a robot expects from each person of one team, shape (K,)."""
    best = AttentionSwitching().scores(team)[1][0].max(axis=0)
    return np.where(team.active[0] & np.isfinite(best), best, np.nan)


def watch(
    pool: Pool, policy: str | TeamPolicy = "attention", *, humans: int | Sequence[str] | Sequence[int] = 3,
    episode: int = 0, seed: Seed = 0, **options: Any,
) -> WatchedEpisode:  # fmt: skip
    """Simulate one episode, and return what the robot expected, did and gave as reasons.

    It has no limit of time, as an episode ends after `max_steps` steps, and a part of one would mislead.

    Parameters
    ----------
    pool : Pool
    policy : str or callable
        A team policy, or the name of one.
    humans : int, or sequence of str or int
        Number of people, their names, or their places in the pool from 0.
    episode : int
        Number of the episode; that of `simulate` with the same arguments.
    seed : int or Generator
    **options
        Further arguments of `simulate`, such as `travel` or `world`.

    Raises
    ------
    TypeError
        `pool` is no pool.
    ValueError
        A parameter is out of its range.
    """
    require_pool(pool)
    if isinstance(policy, list | tuple):
        raise TypeError(f"policy {policy!r}: expected one policy, whose episode is watched")
    number, seed_number = whole("episode", episode), entropy(seed)
    ((name, given),) = by_name(policy).items()
    chosen = pool.policy(given) if isinstance(given, str) else given
    watching, trace, alone = Watched(chosen, _gains), Trace(), Trace()
    reasons = TraceReasons(pool.policies, None if isinstance(pool.known, Choices) else pool.known)
    shared: dict[str, Any] = {"humans": humans, "episodes": [number], "seed": seed_number, **options}
    runs = simulate(pool, watching, name=name, trace=trace, reasons=reasons, progress=False, **shared)
    simulate(pool, "none", trace=alone, progress=False, **shared)
    steps = 1 + max(row["step"] for row in trace)
    nothing = np.full(runs.people.shape[1], np.nan)
    gain = np.array([watching.seen.get(step, nothing) for step in range(steps)])
    return WatchedEpisode(runs[0], trace, alone, gain)


def _reason(row: Mapping[str, Any]) -> str:
    return str(row.get("explanation", {}).get("text", ""))
