"""Questions to real people that are worth their cost: "is this your goal?", and "what did you do last?".

At each decision the robot may ask one person, for whom the answer is worth most. The question is open until that
person answers, declines or acts, and until then they get no suggestion, which the answer might change. Between two
actions of a person there is at most one question of each kind.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..person.policy import Policy
from ..person.settings import Setting
from ..person.ties import NEAR, first_best
from ..team.questions import Questions, worth_of_knowing
from .advice import Question
from .beliefs import worth_of_asking
from .roster import Roster, RosterEntry


class LiveQuestions:
    """Questions to the people of a live team.

    Parameters
    ----------
    setting : Setting
        It has a cost of questions, `c_ask`. Answers about what was done last are taken as true.
    policies : sequence of Policy
        The policies for the people of the team.
    """

    def __init__(self, setting: Setting, policies: Sequence[Policy]) -> None:
        assert setting.c_ask is not None
        self._setting, self._cost = setting, setting.c_ask
        self._goals = Questions(policies, self._cost, setting.ask_error)
        self._known: dict[int, tuple[tuple[int, float, int], Question | None]] = {}

    def best(self, team: Roster, active: NDArray[np.bool_]) -> Question | None:
        """Return the question that is worth most above its cost; None if there is none.

        Parameters
        ----------
        team : Roster
        active : bool array, shape (P,)
            The people who may be asked.
        """
        working = int((team.present & ~team.ended).sum())
        attention = float(self._setting.fleet.attention(working))
        found = [self._of(team, team.records[k], attention) for k in np.flatnonzero(active).tolist()]
        return _worth_most(found)

    def _of(self, team: Roster, record: RosterEntry, attention: float) -> Question | None:
        """Return the best question to one person; it is cached while nothing changes."""
        key = team.changes(record.place), attention, len(record.asked)
        known = self._known.get(record.place)
        if known is None or known[0] != key:
            asked = [self._about_goal(team, record, attention), self._about_action(record)]
            self._known[record.place] = known = key, _worth_most(asked)
        return known[1]

    def _about_goal(self, team: Roster, record: RosterEntry, attention: float) -> Question | None:
        policy = record.problem.policy
        if not policy.pomdp.hidden.distinguishes_goals or "goal" in record.asked:
            return None
        goal, worth = self._goals.best_of(policy, team.beliefs.joint(record.place, policy), attention)
        return Question(record.name, record.problem.choices.goals.names[goal], (), worth) if worth > NEAR else None

    def _about_action(self, record: RosterEntry, *, least: float = 0.01) -> Question | None:
        if record.joint is None or len(record.joint.situations) == 1 or "action" in record.asked:
            return None
        if worth_of_knowing(record.problem.policy, record.joint) <= self._cost:
            return None  # an answer is worth no more than to know all
        worth, chances = worth_of_asking(record, self._setting)
        if worth <= self._cost + NEAR:
            return None
        likely = sorted((name for name, share in chances.items() if share >= least), key=lambda name: -chances[name])
        return Question(record.name, None, tuple(likely), worth - self._cost)


def _worth_most(questions: Sequence[Question | None]) -> Question | None:
    """Return the question that is worth most, the first of those that are worth the same; None if there is none."""
    found = [one for one in questions if one is not None]
    return found[int(first_best(np.array([one.worth for one in found])))] if found else None
