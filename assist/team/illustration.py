"""One episode for illustration, with help and without."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..people.neighbourhood import Neighbourhood
from ..person.travel import Travel
from .episodes import Episode, Episodes
from .goal_knowledge import GoalKnowledge
from .pool import Pool
from .simulate import simulate
from .state import TeamPolicy
from .trace import Link, Trace


@dataclass(frozen=True)
class Illustration:
    """An episode with all actions of all people.

    Attributes
    ----------
    episode : Episode
    trace : list
        Trace of `simulate`.
    alone : list
        Trace of the same episode without a robot.
    links : tuple of Link
        Who saw which suggestion to somebody else.
    """

    episode: Episode
    trace: Trace
    alone: Trace
    links: tuple[Link, ...] = ()

    @classmethod
    def of(
        cls,
        pool: Pool,
        policy: TeamPolicy | str,
        helped: Episodes,
        *,
        humans: int | Sequence[int],
        seed: int,
        travel: Travel | None = None,
        goals: GoalKnowledge = "inferred",
    ) -> Illustration:
        """Select one of a policy's episodes and simulate it with a trace; other parameters as in `simulate`."""
        alone = simulate(pool, "none", humans=humans, episodes=helped.episode, seed=seed, travel=travel)
        shown = typical(helped, alone)
        traces: tuple[Trace, Trace] = ([], [])
        for one, trace in zip((policy, "none"), traces, strict=True):
            simulate(
                pool, one, humans=humans, episodes=[shown.episode], seed=seed, travel=travel, goals=goals, trace=trace
            )
        return cls(shown, *traces, tuple(sights(traces[0], pool.setting.neighbourhood(len(shown.people)))))


def sights(trace: Trace, neighbours: Neighbourhood) -> Iterator[Link]:
    """Yield a link from each suggestion in an episode's trace to each person who saw it and went on."""
    last = {row["place"]: row["step"] for row in trace}
    for row in trace:
        for place in last if row["suggestion"] else ():
            weight = neighbours.seen_from(place).get(row["place"], 0.0)
            if weight > 0 and last[place] > row["step"]:
                yield Link(row["step"], row["place"], place, weight)


def typical(helped: Episodes, alone: Episodes) -> Episode:
    """Return the episode with the median saving among those in which help saved actions.

    Parameters
    ----------
    helped, alone : Episodes
        The same episodes with and without a robot.
    """
    saved = (alone.actions.sum(axis=1) - helped.actions.sum(axis=1)).tolist()
    better = sorted((number, i) for i, number in enumerate(saved) if number > 0)
    return helped[better[(len(better) - 1) // 2][1]] if better else helped[0]
