"""Actions of real people that were seen with some doubt, and what they tell of the person's task state and type."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from ..declare.refusals import InapplicableError, Refusal
from ..people.arguments import number
from ..people.belief import ImpossibleObservationError
from ..people.choices import Choices
from ..people.decision import NOTHING
from ..person.beliefs import PersonModel
from ..person.evidence import Evidence
from ..person.joint_belief import JointBelief
from ..person.observation_model import ObservationModel
from ..person.settings import Setting
from ..person.uncertain_states import Glimpse, PerhapsMissed, Reported
from .live_task import LiveTask
from .roster import RosterEntry, Step


def allows_uncertain(setting: Setting) -> bool:
    """Return whether actions may be reported that were not seen as they were."""
    return setting.observation is not None or setting.suggestions == "all"


def seen_of(
    problem: LiveTask,
    setting: Setting,
    action: str | None,
    likelihoods: Mapping[str, float] | None,
    missed: float | None,
) -> dict[str, Any] | None:
    """Return what was seen of an uncertain action, for `Step.seen`; None if the action itself was seen.

    Parameters
    ----------
    problem : LiveTask
    setting : Setting
    action, likelihoods, missed
        As in `Assistant.observe`.

    Raises
    ------
    Refusal
        Not one of the three is given, the numbers are no likelihoods, or the setting or the task has no uncertain
        actions.
    Refusal
        The task has no such action.
    """
    if sum(given is not None for given in (action, likelihoods, missed)) != 1:
        why = "observe: expected an action, its likelihoods, or the probability that one was missed"
        raise Refusal("other", why=why)
    if action is not None:
        return None
    if not allows_uncertain(setting):
        why = "an uncertain action: expected a setting with an observation model, or suggestions 'all'"
        raise Refusal("other", why=why)
    each: dict[str, float] = {}
    try:
        if missed is not None:
            missed = number("missed", missed)
        for one, p in (likelihoods or {}).items():
            name = problem.named(one)
            each[name] = each.get(name, 0.0) + number(f"likelihood of {one}", p)
    except Refusal:
        raise
    except ValueError as error:
        raise Refusal("other", why=str(error)) from None
    if missed is not None:
        if not 0 <= missed <= 1:
            raise Refusal("other", why=f"missed {missed:g}: expected a probability")
        return {"missed": missed}
    if not all(0 <= p < np.inf for p in each.values()) or not any(each.values()):
        raise Refusal("other", why="likelihoods: expected finite numbers of 0 or more, one of them positive")
    most = max(each.values())  # so that sums and products of large numbers stay finite, and small ones positive
    return {"likelihoods": {name: p / most for name, p in each.items()}}


def prepare_uncertain(problem: LiveTask) -> None:
    """Update a belief over task states once, so that nobody waits later for what is compiled for it."""
    situation = problem.situation(problem.row(problem.initial))
    at_first = JointBelief.at(situation, problem.policy.pomdp.prior)
    with suppress(ImpossibleObservationError):  # who has reached the goal already does nothing
        at_first.after(Evidence.none(problem.choices), NOTHING, problem.policy)


def glimpse_of(problem: LiveTask, choices: Choices, step: Step, model: ObservationModel | None) -> Glimpse:
    """Return what was seen of a step, for `UncertainStates.update_by`.

    Parameters
    ----------
    problem : LiveTask
    choices : Choices
        Those of the problem.
    step : Step
    model : ObservationModel or None
        How actions are seen; None if they are, apart from this one, seen as they are.
    """
    if "missed" in (step.seen or {}):
        return PerhapsMissed((step.seen or {})["missed"])
    return Reported(_evidence(problem, choices, step, model), 0.0 if model is None else model.miss)


def update_by(record: RosterEntry, step: Step, model: ObservationModel | None) -> None:
    """Update the belief in a person by a step of which not all was seen as it was; `model` as in `glimpse_of`.

    Raises
    ------
    InapplicableError
        The action is not applicable in any state in which the person probably is. Nothing has changed.
    """
    problem, beliefs, place = record.problem, record.team.beliefs, np.array([record.place])
    policy, row = problem.policy, problem.row(step.situation)
    choices, said = problem.choices, NOTHING if step.suggestion is None else problem.ground(step.suggestion)
    glimpse = glimpse_of(problem, choices, step, model)
    try:
        beliefs.update_by(place, np.array([said]), [glimpse], PersonModel.of(policy))
    except ImpossibleObservationError:
        names = [choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))]
        raise InapplicableError(
            "improbable", action=step.action, person=record.name, actions=", ".join(names)
        ) from None


def _evidence(problem: LiveTask, choices: Choices, step: Step, model: ObservationModel | None) -> Evidence:
    """Return what was seen of an action that was seen at all."""
    if model is not None and step.action is not None and step.seen is None:
        return model.evidence(choices, problem.ground(step.action))
    likelihoods = (step.seen or {}).get("likelihoods", {step.action: 1.0})
    return Evidence.of(choices, {problem.ground(one): p for one, p in likelihoods.items()})


def after_answers(record: RosterEntry, model: ObservationModel | None) -> dict[str, JointBelief]:
    """Return the belief after each answer of a person to what they did last, by the action in PDDL notation.

    The field `evidence` of a belief is proportional to the probability of the answer. There are none if perhaps nothing
    was done last. Answers about the goal since then are not included.
    """
    last, problem, earlier = record.steps[-1], record.problem, record.earlier
    if "missed" in (last.seen or {}) or earlier is None:
        return {}
    choices = problem.choices
    evidence, miss = _evidence(problem, choices, last, model), 0.0 if model is None else model.miss
    said = NOTHING if last.suggestion is None else problem.ground(last.suggestion)
    each = earlier.after_each(evidence, said, problem.policy, miss=miss)
    return {choices.action_name(action): belief for action, belief in each.items()}
