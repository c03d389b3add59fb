"""Actions of real people that were seen with some doubt, and what they tell of the person's task state and type."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ..people.arguments import number
from ..people.belief import ImpossibleObservationError
from ..people.choices import WAIT, Choices
from ..people.decision import NOTHING, Floats
from ..person.joint_belief import JointBelief
from ..person.observation_model import Evidence, ObservationModel
from ..team.settings import Setting
from .live_task import InapplicableError, LiveTask
from .roster import RosterEntry, Step


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
    ValueError
        Not one of the three is given, the numbers are no likelihoods, or the setting has no uncertain actions.
    """
    if sum(given is not None for given in (action, likelihoods, missed)) != 1:
        raise ValueError("observe: expected an action, its likelihoods, or the probability that one was missed")
    if action is not None:
        return None
    problem.policy.require_enumerated("an uncertain action")
    if setting.observation is None and setting.suggestions != "all":
        raise ValueError("an uncertain action: expected a setting with an observation model, or suggestions 'all'")
    if missed is not None:
        if not 0 <= (probability := number("missed", missed)) <= 1:
            raise ValueError(f"missed {missed:g}: expected a probability")
        return {"missed": probability}
    each = {problem.named(one): number(f"likelihood of {one}", p) for one, p in (likelihoods or {}).items()}
    if not (each and min(each.values()) >= 0 and 0 < max(each.values()) < np.inf):
        raise ValueError("likelihoods: expected finite numbers of 0 or more, one of them positive")
    return {"likelihoods": each}


def joint_after(record: RosterEntry, belief: Floats, step: Step, model: ObservationModel | None) -> JointBelief:
    """Return the belief over task states and types of a person after a step.

    Parameters
    ----------
    record : RosterEntry
        The person, who does not change.
    belief : float array, shape (G * B, T)
        The belief in the type of the person, whose task state was certain if `record.joint` is None.
    step : Step
    model : ObservationModel or None
        How actions are seen; None if they are, apart from this one, seen as they are.

    Raises
    ------
    InapplicableError
        The action is not applicable in any state in which the person probably is.
    """
    problem, seen = record.problem, step.seen or {}
    part, row = problem.at(step.place)
    joint = record.joint or JointBelief.at(row, belief)
    choices, said = part.choices, NOTHING if step.suggestion is None else problem.ground(step.suggestion)
    if "missed" in seen:
        acted = joint.after(Evidence.none(choices), said, choices, part.arrays)
        return joint.mixed(acted, seen["missed"]).without(1e-6)
    evidence = _evidence(problem, choices, step, model)
    try:
        return joint.after_some(evidence, said, choices, part.arrays, miss=0.0 if model is None else model.miss)
    except ImpossibleObservationError:
        names = [choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))]
        raise InapplicableError(
            f"{step.action} is applicable in no probable state of {record.name}; in the most probable one there are: "
            f"{', '.join(names)}"
        ) from None


def _evidence(problem: LiveTask, choices: Choices, step: Step, model: ObservationModel | None) -> Evidence:
    """Return what was seen of an action that was seen at all."""
    if model is not None and step.action is not None and step.seen is None:
        return model.evidence(choices, problem.ground(step.action))
    likelihoods = (step.seen or {}).get("likelihoods", {step.action: 1.0})
    return Evidence.of(choices, {problem.ground(one): p for one, p in likelihoods.items()})


def joint_before_last(record: RosterEntry, model: ObservationModel | None) -> JointBelief:
    """Return the belief over task states and types of a person before their last step; nothing changes."""
    then = replace(record, joint=JointBelief.at(record.problem.initial, record.before))
    for step in record.steps[:-1]:
        then.joint = joint_after(then, record.before, step, model)
    assert then.joint is not None
    return then.joint


def after_answers(record: RosterEntry, model: ObservationModel | None) -> list[JointBelief]:
    """Return the belief after each answer of a person to what they did last.

    The field `evidence` of a belief is proportional to the probability of the answer. There are none if perhaps nothing
    was done last.
    """
    last, problem = record.steps[-1], record.problem
    if "missed" in (last.seen or {}):
        return []
    part, _ = problem.at(problem.initial)
    choices, found = part.choices, list[JointBelief]()
    joint, evidence = joint_before_last(record, model), _evidence(problem, choices, last, model)
    said = NOTHING if last.suggestion is None else problem.ground(last.suggestion)
    for action in (*range(len(choices.names)), WAIT):
        with suppress(ImpossibleObservationError):
            only, miss = evidence._replace(only=action), 0.0 if model is None else model.miss
            found.append(joint.after_some(only, said, choices, part.arrays, miss=miss))
    return found
