"""What a log says about people: its episodes, replayed in their task, with the cost-to-go of what could be done.

`replayed` reads a log in one task, or in the tasks of several goals, of which each episode has one. All estimates begin
with the observations that it returns.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import CostToGo, LimitError, Transitions, TransitionSystem, known_costs
from planner.system.arrays import read_only
from planner.system.errors import InputFileError, expected
from planner.system.results import ByContent

from ..declare.declared import sentences
from ..people.decision import Floats
from ..people.goals import prior_over
from ..people.terms import Term, features
from .log import Fault, Log, as_one_goal, log_of, selected
from .method import Method
from .observations import EvaluatedStates, Ints, Observations, UnknownGoals, observe
from .replay import Recording, replay, situation

if TYPE_CHECKING:
    from planner import AnyTask

Tasks: TypeAlias = "CostToGo | AnyTask | Mapping[str, CostToGo | AnyTask]"
Records: TypeAlias = Log | str | PathLike[str] | Iterable[Mapping[str, Any]]


class Reading(TypedDict, total=False):
    """Options of reading a log.

    Attributes
    ----------
    prior : mapping of str to float
        Probability of each goal at the beginning of an episode; all are equal unless given.
    drop, rename
        As in `replay`.
    columns, gaps
        As in `read_log`, for a log that was not read yet: `columns={"person": "participant"}`.
    strict : bool
        Whether a log that cannot be used completely is an error.
    """

    prior: Mapping[str, float] | None
    drop: Sequence[str]
    rename: Mapping[str, str] | None
    columns: Mapping[str, str] | None
    gaps: bool
    strict: bool


@dataclass(frozen=True, eq=False, repr=False)
class Evidence(ByContent):
    """A log that was replayed in the task of one goal, or of G goals.

    Attributes
    ----------
    log : Log
    costs : CostToGo
        Cost-to-go of the task, or of the first goal.
    goals : tuple of str
        Names of the goals; empty if the goal is known.
    prior : float array, shape (G,)
        Probability of each goal in an episode.
    recording : Recording
        N choices, without those of which the cost-to-go is unknown.
    known : tuple of EvaluatedStates
        Of each goal, or of the only one.
    reached : bool array, shape (G, N)
        Whether each goal holds before each choice.
    faults : tuple of Fault
        Unusable lines of the log.
    notes : tuple of str
        Why states were not evaluated.
    left_out : dict of str to int
        Number of choices of each person that are left out.
    """

    log: Log
    costs: CostToGo
    goals: tuple[str, ...]
    prior: Floats
    recording: Recording
    known: tuple[EvaluatedStates, ...]
    reached: NDArray[np.bool_]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    left_out: dict[str, int]

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def complete(self) -> bool:
        """Whether every line and every action was used."""
        return not self.faults and not self.left_out

    def observations(self, terms: Mapping[str, Term] | None = None) -> list[Observations]:
        """Return each person's observations, with the values of terms if they are given."""
        recording, none = self.recording, np.zeros(len(self.known[0].h), dtype=bool)
        if not self.goals:
            wanted = recording.wanted()
            none[wanted] = self.costs.is_goal(wanted)
            own = terms or {}
            values = features(situation(recording, self.costs), own) if own else None
            each = observe(recording, self.known[0], none, tuple(own), values)
            return [replace(one, simulated=self.log.simulated) for one in each]
        every = [observe(recording, known, none) for known in self.known]
        return [
            replace(
                each[0],
                simulated=self.log.simulated,
                unknown_goal=UnknownGoals(self.goals, self.prior, each, self.reached[:, recording.person == number]),
            )
            for number, each in enumerate(zip(*every, strict=True))
        ]


def is_carried(people: object, carry: bool | None) -> bool:
    """Return whether theta is carried from episode to episode: as given, or else unless a simulation wrote the log."""
    if carry is not None:
        return carry
    if isinstance(people, Evidence):
        return not people.log.simulated
    each = people if isinstance(people, Sequence) else ()
    return not any(isinstance(one, Observations) and one.simulated for one in each)


def replayed(
    task: Tasks, log: Records, *, evaluate: Callable[[Ints], EvaluatedStates] | None = None,
    tell: Callable[[Log, tuple[Fault, ...]], None] | None = None, **reading: Unpack[Reading],
) -> Evidence:  # fmt: skip
    """Replay a log in its task.

    Parameters
    ----------
    task : CostToGo, or whatever `planner.load` takes; or a mapping of names to these
        Cost-to-go of the task, as a table or on demand; only visited states and their successors are queried. A mapping
        has the task of each goal, such as the tables of `planner.sweep_goals`; these differ in their goals only.
    log : Log, path, list of dict, or data frame
        A log, as from `read_log`, or what `read_log` and `Log.of` take.
    evaluate : callable, optional
        Returns the data of states, given by their numbers, shape (M,), in place of the task's cost-to-go.
    tell : callable, optional
        Receives the log and its faults before anything is evaluated. They are warnings unless given.
    **reading
        See `Reading`.

    Raises
    ------
    InputFileError
        No part of the log can be used or, with `strict`, some part cannot; or it has lines of other tasks only.
    TypeError
        `task` is no task, or `log` is no log.
    ValueError
        A name in `drop` or `rename` does not exist, the tasks of goals differ in more than their goals, a goal cannot
        be reached, or the prior is no distribution.
    """
    _require_known(reading)
    several = isinstance(task, Mapping)
    tasks = (
        {name: known_costs(one) for name, one in task.items()} if isinstance(task, Mapping) else {"": known_costs(task)}
    )
    problems = [str(one.task.instance.problem) for one in tasks.values()]
    log = log_of(log, problems, gaps=reading.get("gaps", False), columns=reading.get("columns"))
    if tell is None:
        for question in log.questions:
            warnings.warn(f"{log.name}: {question}", stacklevel=_outside())
    strict = reading.get("strict", False)
    if tell is None and not several and (said := as_one_goal(log)) is not None:
        warnings.warn(f"{log.name}: {said}", stacklevel=_outside())
    prior = prior_over(tasks, reading.get("prior"))
    costs = next(iter(tasks.values()))
    states: CostToGo | JointStates = JointStates(tasks) if several else costs
    recording, found = replay(log, states, drop=reading.get("drop", ()), rename=reading.get("rename"))
    faults = tuple(sorted([*log.faults, *found], key=lambda fault: fault.line))
    if not log.people and tell is None:
        require_actions(log, recording, states)
    if faults and tell is not None:
        tell(log, faults)
    elif strict and faults:
        raise InputFileError(f"{log.name}:{faults[0].line}: {faults[0]}")
    elif faults:
        warned(log, faults)
    require_actions(log, recording, states, told=tell is not None)
    wanted, notes = recording.wanted(), list[str]()
    if isinstance(states, JointStates):
        known, notes = states.evaluated(wanted, strict=strict)
    elif evaluate is not None:
        known = [evaluate(wanted)]
    else:
        h, notes = looked_up(costs, wanted, strict=strict)
        known = [EvaluatedStates.of(costs, wanted, h, wanted, len(costs))]
    unknown = np.isnan([one.h for one in known]).any(axis=0)
    recording, left_out = recording.evaluated(np.where(unknown, np.nan, 0.0))
    if not len(recording):
        raise InputFileError(f"{log.name}: the states after every action took too long")
    if not several and not math.isfinite(known[0].h[recording.wanted()].min()):
        raise InputFileError(f"{log.name}: no visited state has a way to the goal, so that all actions are alike")
    reached = (
        states.reached(recording.state) if isinstance(states, JointStates) else np.zeros((0, len(recording)), bool)
    )
    return Evidence(
        log, costs, tuple(tasks) if several else (), prior, recording, tuple(known), reached, faults, tuple(notes),
        left_out,
    )  # fmt: skip


def observed(
    task: Tasks, log: Records, *, terms: Mapping[str, Term] | None = None, **reading: Unpack[Reading]
) -> list[Observations]:
    """Return each person's observations in a log, as estimates and comparisons take them.

    Parameters
    ----------
    task, log, **reading
        As in `replayed`.
    terms : mapping of str to callable, optional
        Terms whose values the observations also hold.
    """
    return evidence(task, log, reading).observations(terms)


def observations_of(
    people: Evidence | Sequence[Observations], terms: Mapping[str, Term] | None = None
) -> Sequence[Observations]:
    """Return each person's observations, which may be given as a replayed log."""
    if isinstance(people, Evidence):
        return people.observations(terms)
    if isinstance(people, Sequence) and all(isinstance(one, Observations) for one in people):
        return people
    raise TypeError(f"a {type(people).__name__} where observations were expected; `replayed(task, log)` returns them")


def evidence(task: Tasks | Evidence, log: Records | None, reading: Reading) -> Evidence:
    """Return a replayed log: `task` itself, or `log` replayed in it, with warnings about what was left out."""
    if isinstance(task, Evidence):
        if log is not None or reading:
            raise TypeError("a replayed log, and a log or options of reading one: expected one of them")
        return task
    found = replayed(task, log, **reading)  # type: ignore[arg-type]  # which says what is expected for None
    for note in found.notes:
        warnings.warn(f"{note}; actions that depend on them are left out", stacklevel=_outside())
    return found


def _require_known(reading: Reading) -> None:
    """Check that all options of reading a log exist."""
    for name in reading.keys() - Reading.__annotations__.keys():
        if name in sentences(Method):
            raise TypeError(f"{name}: expected method=Method({name}=...)")
        if name in ("influence", "trust", "rule"):
            raise TypeError(f"{name}: expected fit_influence(replayed(task, log), rule), which estimates a trust rule")
        raise TypeError(f"{name}: a log has no such option; {expected(name, Reading.__annotations__)}")


def warned(log: Log, faults: tuple[Fault, ...]) -> None:
    """Warn of the faults of a log."""
    others = f" (and {len(faults) - 1} more; see `faults`)" if len(faults) > 1 else ""
    lost = selected(log, faults)
    also = "" if lost is None else f"; {lost}"
    warnings.warn(f"{log.name}:{faults[0].line}: {faults[0]}{others}{also}", stacklevel=_outside())


def _outside() -> int:
    """Return the stack level, for the calling function's warnings, of the first caller outside of the packages."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals["__name__"].startswith(("assist.", "planner.")):
        frame, level = frame.f_back, level + 1
    return level


def require_actions(log: Log, recording: Recording, states: TransitionSystem, *, told: bool = False) -> None:
    """Check that some episode of a log can be used; what is wrong is said, unless the faults were `told` already."""
    if len(recording):
        return
    if not log.people and log.faults:
        raise InputFileError(f"{log.name}: no line can be used" if told else f"{log.name}:{_first(log)}")
    if not log.people:
        raise InputFileError(f"{log.name}: no recorded actions; expected a line for each, as JSON or in a table")
    if not log.entries:
        why = f"; line {_first(log)}" if log.faults and not told else ""
        raise InputFileError(f"{log.name}: no episode can be used{why}")
    place = states.task.instance
    raise InputFileError(f"{log.name}: no episode can be followed through {place}; is it the log of another instance?")


def _first(log: Log) -> str:
    """Return the first fault of a log, behind its line."""
    return f"{log.faults[0].line}: {log.faults[0]}"


class JointStates:
    """The states of several goals' tasks at once, numbered in the order of their first use: a `TransitionSystem`.

    Goals on one enumeration share its state numbers. A joint state has a number for each enumeration.
    """

    def __init__(self, goals: Mapping[str, CostToGo]) -> None:
        self._goals = tuple(goals.values())
        self.task = self._goals[0].task
        places: dict[int, int] = {}
        heads: list[CostToGo] = []
        self._place = []
        for name, costs in goals.items():
            same = costs.task.actions == self.task.actions
            if not same or not np.array_equal(costs.task.action_costs, self.task.action_costs):
                raise ValueError(
                    f"goal '{name}' has other actions than the first; expected the same domain and objects"
                )
            if not np.isfinite(costs.lookup([costs.initial])[0]):
                raise ValueError(f"goal '{name}' cannot be reached from the initial state; expected goals that can")
            place = places.setdefault(id(_enumeration(costs)), len(heads))
            heads += [costs] * (place == len(heads))
            self._place.append(place)
        self._heads = tuple(heads)
        self.initial = 0
        start = tuple(head.initial for head in heads)
        self._states, self._numbers = [start], {start: 0}

    def __len__(self) -> int:
        return len(self._states)

    def _own(self, states: ArrayLike) -> list[Ints]:
        """Return the number of joint states, shape (N,), in each enumeration."""
        joint = [self._states[state] for state in np.asarray(states).tolist()]
        return list(np.array(joint, dtype=np.int64).reshape(len(joint), len(self._heads)).T)

    def choices(self, states: ArrayLike) -> Transitions:
        """Return the transitions of states, shape (N,), as compressed rows."""
        rows = [head.choices(own) for head, own in zip(self._heads, self._own(states), strict=True)]
        first = rows[0]
        if any(not np.array_equal(first.actions, other.actions) for other in rows):
            raise ValueError(f"{self.task.instance}: other actions apply with another goal; expected one domain")
        targets = []
        for target in zip(*(row.targets.tolist() for row in rows), strict=True):
            if target not in self._numbers:
                self._numbers[target] = len(self._states)
                self._states.append(target)
            targets.append(self._numbers[target])
        return Transitions(first.offsets, first.actions, np.array(targets, dtype=np.int64))

    def reached(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each goal holds in each state, shape (G, N)."""
        own = self._own(states)
        return np.stack([costs.is_goal(own[place]) for costs, place in zip(self._goals, self._place, strict=True)])

    def is_goal(self, states: ArrayLike) -> NDArray[np.bool_]:
        """Return whether all goals hold in each state, shape (N,)."""
        return np.logical_and.reduce(self.reached(states), axis=0)

    def evaluated(self, states: Ints, *, strict: bool) -> tuple[list[EvaluatedStates], list[str]]:
        """Return the data of joint states with each goal, and notes; NaN in other states, and where h* is unknown.

        Plan lengths only concern which of several cheapest plans a person should prefer, so that they are left out.
        """
        own, notes, found = self._own(states), list[str](), list[EvaluatedStates]()
        for costs, place in zip(self._goals, self._place, strict=True):
            h = np.full(len(self), np.nan)
            h[states], more = looked_up(costs, own[place], strict=strict)
            notes += more
            found.append(EvaluatedStates(h, None))
        return found, notes


def looked_up(costs: CostToGo, states: Ints, *, strict: bool) -> tuple[Floats, list[str]]:
    """Return h* of states, NaN if it took too long, and a note then; with `strict`, that is an error."""
    try:
        return costs.lookup(states), []
    except LimitError as error:
        known = getattr(costs, "known", None)
        if strict or known is None:
            raise
        return known(states), [str(error)]


def _enumeration(costs: CostToGo) -> object:
    """Return the object that numbers the states: tables with the same one give a state the same number."""
    space = getattr(costs, "space", None)
    return costs if space is None else space.numbering
