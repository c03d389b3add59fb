"""One person's problem on the rows in which people have been, in a task of any size.

A `GrowingProblem` computes what is known of a situation when it is asked for its row: the choices there, their
probabilities and the robot's actions. Two things take more, and are computed when they are first used:

- What a suggestion does to trust depends on the value of its successor, so that one more state has to be looked up.
  So it is with an action that the robot executes, after which the person acts in another state.
- The Q-values of the robot's actions are one exact Bellman backup of estimated values of the successors.

All of it follows from a problem of one step, the truncated task that ends after it (`TruncatedTask.around`). Once
Q-values have been asked for, a new row gets its own from the same problem.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from planner import CostToGo

from ..people.choices import WAIT
from ..people.decision import NOTHING, Floats, Ints
from ..people.goals import each_of, first_of, prior_of
from ..people.memory_on_demand import memory_of
from .assumptions import Assumptions
from .each_goal import NO_LIMITS, BoundLimits, Outer, TruncatedProblem
from .expected_values import expected
from .pomdp import AssistPOMDP
from .problem_arrays import ProblemArrays, read_only
from .problem_rows import Extent, ProblemRows, Snapshot
from .rows import NONE, OWN, Rows
from .shared_task import SharedTask
from .truncated_bound import bounded
from .truncated_task import TruncatedTask

OF_PLACES = {"h": np.inf, "goal": False, "key": 0}
"""What is known of a situation that was only looked up, as the successor of a choice."""

OF_CHOICES = {
    "known": False, "applicable": False, "actions": WAIT, "targets": OWN, "costs": 0.0, "best": False,
    "optimal": False, "features": 0.0, "q": np.inf, "robot_actions": 1, "suggested": NOTHING, "afterstate": OWN,
    "robot_costs": 0.0, "chosen": 0.0, "unsuggested": 0.0, "moves": False, "effect_known": False, "low": 0,
    "weight": 0.0, "followed_low": 0, "followed_weight": 0.0,
}  # fmt: skip
"""What is known where somebody has been; without it a row has no choices. The effects of a robot action on trust, `low`
and so on, are known if `effect_known` says so.
"""

TRUST = ("low", "weight", "followed_low", "followed_weight")

MOST_TABLES = 8
"""Number of tables of Q-values that are kept, as prices of attention may differ at each step."""

Backup = Callable[[AssistPOMDP, TruncatedTask, int], tuple[Floats, Ints]]
"""Returns Q-values in the first rows of a problem of one step, shape (count, P, R, H, T), and the number of robot
actions, shape (count, P), at each of P positions of the robot.
"""


class _Step(NamedTuple):
    """A problem of one step from some rows, and whether it has the effects of all suggestions on trust."""

    rows: Ints
    region: TruncatedTask
    pomdp: AssistPOMDP
    ahead: bool


class GrowingProblem(ProblemRows):
    """One person's problem on the rows in which people have been. All methods are thread-safe.

    Parameters
    ----------
    ground : SharedTask
        The task. Above its number of rows, those that nobody holds are evicted.
    assumed : Assumptions
        What the robot assumes of the person.
    """

    lasting = NONE

    def __init__(self, ground: SharedTask, assumed: Assumptions) -> None:
        self.ground, self.assumed, self.region, self._limit = ground, assumed, ground.size, ground.rows
        self.task = known = first_of(ground.known)
        self.searches, costs = known.searches, known.task.action_costs
        self.cheapest = float(costs[costs > 0].min()) if costs.any() else 1.0
        self.dearest = float(costs.max(initial=1.0))
        self._rows = Rows(OF_PLACES | OF_CHOICES)
        self._tables = OrderedDict[str, None]()  # the last used last
        self._bounds = dict[tuple[float, bool, Outer], list[tuple[float, TruncatedProblem]]]()
        self._lock = threading.RLock()
        self._step = self._learn(np.array([known.initial]))  # it has row 0
        self.first = self._step.pomdp
        self._snapshot, self._version = self._taken(), self._rows.version

    def task_of(self, goal: int) -> CostToGo:
        """Return the cost-to-go of the whole task for one of the goals."""
        return each_of(self.ground.known)[goal]

    @cached_property
    def extent(self) -> Extent:
        """The largest numbers that occur anywhere in the task."""
        return self.ground.extent(self.assumed)

    def states(self, situations: Ints) -> Ints:
        """Return the task state of each situation, shape (N,)."""
        return memory_of(self.ground.known).state_of(situations)

    def bounded(
        self, entry: float, entry_steps: int = 0, *, outer: Outer = "frontier", limits: BoundLimits = NO_LIMITS
    ) -> list[tuple[float, TruncatedProblem]]:
        """Return each goal's probability and its problem on a truncated task, computed once; `limits` are of all."""
        for use in (outer, "kept") if outer != "none" else (outer,):  # what is kept includes everything
            if (entry, entry_steps > 0, use) in self._bounds:
                return self._bounds[entry, entry_steps > 0, use]
        found, each = list[tuple[float, TruncatedProblem]](), each_of(self.ground.known)
        possible = [
            (known, share) for known, share in zip(each, prior_of(self.ground.known).values(), strict=True) if share
        ]
        for done, (known, share) in enumerate(possible):
            own = replace(limits.shared(len(possible) - done), kept_mb=limits.kept_mb / len(possible))
            problem = bounded(
                known, self.assumed, entry=entry, entry_steps=entry_steps, size=self.ground.size, outer=outer,
                limits=own, among=self.ground.known,
            )  # fmt: skip
            found.append((share, problem))
        self._bounds[entry, entry_steps > 0, outer] = found
        return found

    def on(self, region: TruncatedTask) -> AssistPOMDP:
        """Return the problem on a truncated task, with frontier bounds that hold for the whole task."""
        return self.assumed.problem(region.choices, region.bounds_of_anybody(self.assumed))

    def rows(self, situations: Ints, holder: object = None) -> Ints:
        """Return the row of each situation, shape (N,), and compute what is not known of it.

        Parameters
        ----------
        situations : int array, shape (N,)
            States of the task.
        holder : object, optional
            It holds these rows from now on, in place of those that it held before.
        """
        with self._lock:
            wanted, inverse = np.unique(situations, return_inverse=True)
            rows = self._rows.find(wanted)
            missing = rows < 0
            missing[~missing] = ~self._rows["known"][rows[~missing]]
            if self._rows.used + missing.sum() > self._limit:
                self._evict(np.union1d(self._rows.held(holder), rows[rows >= 0]))
                most = self.ground.rows  # where many are held, not each time
                self._limit = max(most, self._rows.used + most // 4)
            if missing.any():
                self._learn(wanted[missing])
                rows = self._rows.find(wanted)
            if holder is not None:
                self._rows.hold(holder, rows)
            return np.asarray(rows[inverse.reshape(-1)])

    def hold(self, holder: object, rows: Ints) -> None:
        """Let a holder hold these rows in place of those that it held before."""
        with self._lock:
            self._rows.hold(holder, rows)

    def situations(self, rows: Ints) -> Ints:
        """Return the situation of each row, shape (N,)."""
        with self._lock:
            return np.asarray(self._rows.situation_of[rows])

    @property
    def now(self) -> Snapshot:
        """The problem on all rows so far."""
        with self._lock:
            if self._version != self._rows.version:
                self._snapshot, self._version = self._taken(), self._rows.version
            return self._snapshot

    def effects(self, x: Ints, action: Ints) -> tuple[Ints, Ints]:
        """Compute the effects of robot actions on trust in some rows, both of shape (N,), and what their targets need.

        The rows are held. What is returned is described in `ProblemRows`.
        """
        said = np.flatnonzero(action)
        with self._lock:
            then = self._then(x[said])[np.arange(len(said)), action[said]]
            silent = ~self._rows["effect_known"][x[said], action[said]]
            if silent.any():
                situations = self._rows.situation_of
                self._learn(np.unique(situations[x[said][silent]]), then=situations[then[silent]])
            return np.concatenate([np.arange(len(x)), said]), np.concatenate([x, then])

    def q_values(self, name: str, backup: Backup, position: int, x: Ints, belief: Floats) -> Floats:
        """Return the Q-values of robot actions, shape (N, R), for people in some rows; minus infinity in padding.

        Parameters
        ----------
        name : str
            Name of what the backup computes.
        backup : callable
        position : int
            Position of the robot.
        x : int array, shape (N,)
        belief : float array, shape (N, H, T)
        """
        table, counts = self.values(name, backup, x)
        positions, hidden = table.shape[1], self.first.hidden
        flat = table.reshape(len(table) * positions, *table.shape[2:])
        return expected(flat, counts.reshape(-1), x * positions + position, hidden.acted_on(belief))

    def values(self, name: str, backup: Backup, x: Ints) -> tuple[Floats, Ints]:
        """Return Q-values of all rows so far, shape (n, P, R, H, T), known in those of `x`, and numbers of actions."""
        with self._lock:
            q, count = f"q {name}", f"count {name}"
            if name not in self._tables:
                self._tables[name] = None
                self._rows.declare({q: -np.inf, count: 0})
                if len(self._tables) > MOST_TABLES:
                    last, _ = self._tables.popitem(last=False)
                    self._rows.forget([f"q {last}", f"count {last}"])
            self._tables.move_to_end(name)
            silent = np.unique(x if count not in self._rows else x[self._rows[count][x, 0] == 0])
            if len(silent):
                step = self._step
                if not (step.ahead and np.isin(silent, step.rows).all()):
                    step = self._learn(self._rows.situation_of[silent])
                for one, values in zip((q, count), backup(step.pomdp, step.region, len(step.rows)), strict=True):
                    self._rows.put(one, step.rows, values)
            return self._rows[q], self._rows[count]

    def _evict(self, held: Ints) -> None:
        """Evict all rows but those that are held; of the successors of these, only what was looked up stays."""
        held = np.union1d(held, [0])
        successors = np.unique(self._rows["targets"][held])
        self._rows.evict(np.union1d(held, successors))
        tables = [f"{what} {name}" for name in self._tables for what in ("q", "count")]
        forgotten = np.setdiff1d(successors, held)
        self._rows.clear([*OF_CHOICES, *tables], forgotten)
        # What a robot action does is to be found out again where the choices after it are forgotten.
        self._rows["effect_known"][held] &= ~np.isin(self._then(held), forgotten)

    def _then(self, rows: Ints) -> Ints:
        """Return the row whose choices decide what each robot action does, shape (N, R); the row itself for nothing.

        It is the target of a suggestion, as the trust update looks at it, and where the person acts after an execution.
        """
        suggested = self._rows["suggested"][rows]
        then = np.take_along_axis(self._rows["targets"][rows], np.maximum(suggested, 0), axis=1)
        return np.where(suggested == NOTHING, self._rows["afterstate"][rows], then)

    def _learn(self, situations: Ints, then: Ints = NONE) -> _Step:
        """Compute what is known of different situations, and return their problem of one step.

        `then` are successors to which suggestions lead.
        """
        # Where looking up a state is slow, the effects of suggestions on trust are computed when they are first used.
        ahead, optimal = not self.searches or bool(self._tables), self.assumed.suggestions == "optimal"
        region = TruncatedTask.around(
            self.ground.visited, situations, then=then, ahead=ahead, advice_is_optimal=optimal
        )
        pomdp, rows, inside = self.on(region), self._rows, np.ones(len(region.states), dtype=bool)
        inside[region.frontier] = False
        at = np.sort(np.unique(region.states, return_index=True)[1])  # each situation once; those asked for come first
        at = at[rows.find(region.states[at]) < 0]
        own, goals = rows.add(region.states[at]), region.choices.goals
        rows.put("h", own, goals.h[:, at].T)
        rows.put("goal", own, goals.goal[:, at].T)
        rows.put("key", own, region.choices.keys[at])
        row = rows.find(region.states)
        self._put_choices(region, pomdp, row, inside, len(situations))
        self._put_trust(pomdp, row, inside)
        self._step = _Step(row[: len(situations)], region, pomdp, ahead)
        return self._step

    def _put_choices(self, region: TruncatedTask, pomdp: AssistPOMDP, row: Ints, inside: Any, count: int) -> None:
        """Store the choices and probabilities of rows of a region in which they are not known yet."""
        choices, rows = region.choices, self._rows
        fresh = inside & (choices.applicable.any(axis=1) | (np.arange(len(row)) < count))
        if "known" in rows:
            fresh &= ~rows["known"][row]
        at = np.flatnonzero(fresh)
        at = at[np.unique(row[at], return_index=True)[1]]  # a situation may be both one of those and a successor
        own, executed = row[at], pomdp.executed(at)
        afterstate = np.take_along_axis(row[choices.targets[at]], np.maximum(executed, 0), axis=1)
        afterstate = np.where(executed == NOTHING, own[:, None], afterstate)
        columns = {
            "applicable": choices.applicable, "actions": choices.actions, "targets": row[choices.targets],
            "costs": choices.costs, "best": choices.optimal, "optimal": choices.goals.optimal,
            "features": choices.features, "q": pomdp.model.q,
            "robot_actions": pomdp.robot_actions, "suggested": pomdp.suggested,
            "robot_costs": pomdp.robot_costs, "chosen": pomdp.chosen, "unsuggested": pomdp.unsuggested,
            "moves": pomdp.moves,
            "low": pomdp.low, "weight": pomdp.weight,
            "followed_low": pomdp.followed_low, "followed_weight": pomdp.followed_weight,
        }  # fmt: skip
        for name, values in columns.items():
            if values is not None:
                rows.put(name, own, values[at])
        rows.put("afterstate", own, afterstate)
        rows.put("effect_known", own, (pomdp.suggested[at] == NOTHING) & (executed == NOTHING))
        rows.put("known", own, np.ones(len(own), dtype=bool))

    def _put_trust(self, pomdp: AssistPOMDP, row: Ints, inside: Any) -> None:
        """Store the effects on trust of those robot actions whose successors are no leaves."""
        slot = np.maximum(pomdp.suggested, pomdp.executed(np.arange(len(row))))
        targets = np.take_along_axis(pomdp.model.choices.targets, np.maximum(slot, 0), axis=1)
        at, action = np.nonzero((slot != NOTHING) & inside[targets] & inside[:, None])
        new = ~self._rows["effect_known"][row[at], action]
        at, action = at[new], action[new]
        for name in TRUST:
            values = getattr(pomdp, name)
            if values is not None:
                self._rows[name][row[at], action] = values[at, action]
        self._rows["effect_known"][row[at], action] = True

    def _taken(self) -> Snapshot:
        rows, pomdp = self._rows, self.first
        choices, uses_answer = pomdp.model.choices, pomdp.followed_low is not None
        h, goal = (np.ascontiguousarray(rows[name].T) for name in ("h", "goal"))
        choices = choices.with_goals(
            h, goal, rows["optimal"], applicable=rows["applicable"], actions=rows["actions"], targets=rows["targets"],
            costs=rows["costs"], optimal=rows["best"], key=rows["key"],
            features=None if choices.features is None else rows["features"],
        )  # fmt: skip
        own: dict[str, Any] = {
            name: rows[name]
            for name in (
                "robot_actions", "suggested", "afterstate", "robot_costs", "chosen", "unsuggested",
                "moves", *(TRUST if uses_answer else TRUST[:2]),
            )
        }  # fmt: skip
        model = replace(pomdp.model, choices=choices, q=read_only(rows["q"]))
        found = replace(pomdp, model=model, frontier=None, **own)
        return Snapshot(found, ProblemArrays.of(found), read_only(rows.born.copy()))
