"""What the robot believes about a person of a live team after actions and answers, certain or not.

The belief is in the person's goal, beta and theta. After uncertain actions it is over task states, too
(`assist.person.JointBelief`). Whatever is taken back or corrected, the belief is that of the actions and answers that
remain, in their order.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np

from ..declare.refusals import InapplicableError
from ..people.belief import ImpossibleObservationError
from ..people.decision import NOTHING, Floats
from ..people.spread import Spread
from ..person.beliefs import PersonModel
from ..person.joint_belief import JointBelief, expected_answers
from ..person.observation_model import ObservationModel
from ..person.problem_arrays import Acts
from ..person.settings import Setting
from ..person.ties import first_best
from ..team.questions import GoalQuestion
from ..team.state import worth_of_actions
from .advice import Reason
from .roster import News, Offer, Roster, RosterEntry, Step
from .uncertain_actions import after_answers, update_by


def is_uncertain(record: RosterEntry, model: ObservationModel | None) -> bool:
    """Return whether the state of a person's task is uncertain."""
    return record.joint is not None or model is not None


def begin_task(team: Roster, record: RosterEntry) -> None:
    """Keep the belief in a person who begins a task, but for the goal, which each task has of its own."""
    belief, hidden = team.belief[record.place], record.problem.policy.pomdp.hidden
    belief[:] = hidden.with_goals(hidden.of_people(belief))
    record.before, record.joint, record.earlier = belief.copy(), None, None


def believe(team: Roster, record: RosterEntry, step: Step, setting: Setting) -> bool:
    """Update the belief in a person by a step, and return whether it was (probably) a mistake.

    Raises
    ------
    InapplicableError
        The action is not applicable in any state in which the person probably is. Nothing has changed.
    """
    k, beliefs, policy, row = record.place, team.beliefs, record.problem.policy, record.problem.row(step.situation)
    if step.seen is not None or is_uncertain(record, setting.observation):
        if record.joint is None:
            beliefs.x[k] = row
        earlier = beliefs.joint(k, policy)
        update_by(record, step, setting.observation)
        record.earlier = earlier
        return bool(beliefs.erred[k])
    acts = Acts(np.array([row]), np.array([step.said]), np.array([step.slot]), np.array([False]))
    policy.problem.effects(acts.x, acts.heard)
    with suppress(ImpossibleObservationError):  # in a model without lapses; the action says nothing about the person
        beliefs.update(np.array([k]), acts, PersonModel.of(policy))
    return bool(beliefs.erred[k])


@dataclass(frozen=True)
class Told(News):
    """A person's answer to "is this your goal?"."""

    goal: str
    yes: bool

    def likelihood(self, record: RosterEntry, setting: Setting) -> Floats:
        """Return the likelihood of the answer under each type of a person."""
        hidden = record.problem.policy.pomdp.hidden
        return GoalQuestion(list(hidden.goals).index(self.goal), hidden, setting.ask_error).likelihood(self.yes)

    def tell(self, team: Roster, record: RosterEntry, setting: Setting) -> None:
        """Update the belief in the person; errors as in `News`."""
        try:
            team.beliefs.answered(record.place, self.likelihood(record, setting), record.problem.policy)
        except ImpossibleObservationError:
            key = "impossible_yes" if self.yes else "impossible_no"
            raise InapplicableError(key, person=record.name, goal=self.goal) from None


def answers(record: RosterEntry) -> list[Told]:
    """Return a person's answers about the goal of their task."""
    return [one for one in record.news if isinstance(one, Told)]


@contextmanager
def unchanged_if_refused(team: Roster, record: RosterEntry) -> Iterator[None]:
    """Restore what was known of a person, if what is told contradicts it."""
    k, beliefs = record.place, team.beliefs
    known = beliefs.x[k], beliefs.belief[k].copy(), beliefs.erred[k], record.joint, record.earlier
    try:
        yield
    except InapplicableError:
        beliefs.x[k], beliefs.belief[k], beliefs.erred[k], record.joint, record.earlier = known
        raise


def hear(team: Roster, record: RosterEntry, told: Told, setting: Setting) -> None:
    """Record an answer of a person about their goal; errors as in `News`."""
    told.tell(team, record, setting)
    record.news.append(told)
    team.put(record, team.row(record), erred=bool(team.erred[record.place]), offer=record.offer)


def believe_again(
    team: Roster, record: RosterEntry, setting: Setting, *, situation: int | None = None, offer: Offer | None = None
) -> None:
    """Compute the belief in a person from the beginning of the task, after which a suggestion may be open.

    They are in their most probable situation unless one is given.
    """
    team.belief[record.place], record.joint, record.earlier, erred = record.before, None, None, False
    for count in range(len(record.steps) + 1):
        for one in record.news:
            if one.steps == count:
                one.tell(team, record, setting)
        if count < len(record.steps):
            erred = believe(team, record, record.steps[count], setting)
    row = team.row(record) if situation is None else record.problem.row(situation)
    team.put(record, row, erred=erred, offer=offer)


def correct(team: Roster, record: RosterEntry, action: str, setting: Setting) -> None:
    """Put what a person says that their last action was in the place of what was seen.

    Raises
    ------
    InapplicableError
        The action is not applicable in any state in which the person probably was, or contradicts an answer about the
        goal. Nothing has changed.
    """
    seen = record.steps[-1]
    known = {"likelihoods": {action: 1.0}}
    record.steps[-1] = seen._replace(action=action, seen=known, slot=NOTHING, doubtful=False)
    try:
        with unchanged_if_refused(team, record):
            believe_again(team, record, setting, offer=record.offer)
    except InapplicableError:
        record.steps[-1] = seen
        raise


def worth_of_asking(record: RosterEntry, setting: Setting) -> tuple[float, dict[str, float]]:
    """Return what it is worth to know a person's last action, and the probabilities of what it may have been.

    The worth is the expected increase of the QMDP value of the person's own problem, in cost units.
    """
    if record.joint is None or not record.steps:
        return 0.0, {}
    policy = record.problem.policy
    found = dict[str, JointBelief]()
    for name, after in after_answers(record, setting.observation).items():
        with suppress(ImpossibleObservationError):
            for told in answers(record):
                if told.steps == len(record.steps):
                    then = after.answered(told.likelihood(record, setting))
                    after = replace(then, evidence=then.evidence * after.evidence)
            found[name] = after
    if not found:
        return 0.0, {}
    joint = [record.joint, *found.values()]
    likeliest = policy.rows(np.array([one.likeliest for one in joint]))
    value = expected_answers(worth_of_actions, policy, likeliest, joint).max(axis=1)
    share = np.array([after.evidence for after in found.values()])
    share /= share.sum()
    return max(0.0, float(share @ value[1:] - value[0])), dict(zip(found, share.tolist(), strict=True))


def likeliest_cost_to_go(team: Roster, record: RosterEntry) -> float:
    """Return the cost-to-go of a person's present state, in cost units, for the most probable goal."""
    pomdp = record.problem.policy.pomdp
    share = pomdp.hidden.marginal(team.belief[record.place], "goal")
    return float(pomdp.model.choices.goals.h[share.argmax(), team.row(record)])


def reason_of(team: Roster, k: int, said: int, moving: float, extra: float = 0.0) -> Reason:
    """Return the reason for a robot action towards the person at a place, or for going there (0), in numbers.

    `extra` is what a suggestion by this robot costs more than in the person's problem, if robots differ.
    """
    policy, belief = team.problems[k].policy, team.belief[k]
    q = team.answers_about(worth_of_actions, int(team.model[k]), np.array([k]))[0]
    saving = float((q[said] if said else q[1:].max(initial=q[0])) - q[0]) - extra
    beta, theta = policy.pomdp.grid.spreads(belief, policy.pomdp.hidden)
    follow = _follow(team, k, said or 1 + int(first_best(q[1:])))
    steps = team.records[k].steps
    answered = [step for step in steps if step.suggestion is not None and step.action is not None]
    return Reason(
        saving, moving, saving - moving, beta.mean, (beta.low, beta.high), theta.mean, (theta.low, theta.high),
        len(answered), sum(step.suggestion == step.action for step in answered), follow.mean,
        (follow.low, follow.high), policy.pomdp.hidden.goals_shown(belief),
    )  # fmt: skip


def _follow(team: Roster, k: int, said: int) -> Spread:
    """Return the mean and interval of the probability that a person follows a suggestion, under the belief."""
    pomdp, x = team.problems[k].policy.pomdp, team.x[k : k + 1]
    slot = pomdp.suggested[x, said]
    if slot[0] == NOTHING:
        return Spread(0.0, 0.0, 0.0)
    chance = pomdp.likelihood(x, np.array([said]), slot)[0].reshape(-1)
    order = np.argsort(chance)
    values, inverse = np.unique(chance[order], return_inverse=True)
    weights = np.bincount(inverse, team.belief[k].reshape(-1)[order]).astype(float)
    return Spread.of(values, weights, limits=(0.0, 1.0))
