"""A task of any size as a step of a simulation sees it: the states in which people are, and the next ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..large_tasks.truncated_policy import LocalProblem, TruncatedPolicy
from ..people.decision import NOTHING
from ..team.state import by_model
from .pool import Pool
from .task_view import Ints, ModelGroup, StepView, World

MORE = 4
"""Problems are made around at most so many times the states that are wanted, to be kept."""

LARGEST = 20_000
"""Rows of all problems that are kept, about: each takes some kilobytes."""


class TruncatedTaskView:
    """Tasks that are not looked at whole.

    What has been made around some states is kept in `kept` and serves again where nobody is elsewhere: in a small task
    people soon come to no others. It is made anew with more states where they are not many more than are wanted, or as
    much has been made for once meanwhile.

    Parameters
    ----------
    pool : Pool
    world : World
    kept : dict
        By the policy's number: empty at first, and for all chunks of one policy's episodes the same.
    model, people, mind : int arrays, shape (N, K)
        As of `WholeTaskView`.
    """

    def __init__(
        self, pool: Pool, world: World, kept: dict[int, CachedProblem], model: Ints, people: Ints, mind: Ints
    ) -> None:
        self.pool, self.world, self.kept = pool, world, kept
        self.policies = [policy for policy in pool.policies if isinstance(policy, TruncatedPolicy)]
        self.model, self.people, self.mind = model, people, mind
        self.initial = np.array([policy.ground.known.initial for policy in self.policies])[model]

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Look at the problem around everybody who acts."""
        arounds: list[LocalProblem] = []
        groups: dict[int, ModelGroup] = {}
        rows, models, who = np.zeros((3, x.size), dtype=np.int64)
        for number, flat in by_model(self.model.reshape(-1), active, len(self.policies)):
            states, people = x.reshape(-1)[flat], self.people.reshape(-1)[flat]
            part = self._part(number, np.unique(states), np.unique(people), deep)
            rows[flat] = part.rows(states)
            models[flat] = len(arounds)
            who[flat] = self.mind.reshape(-1)[flat] if self.world == "model" else part.group.row[people]
            groups[len(arounds)] = part.group
            arounds.append(part.around)
        return StepView(arounds, groups, rows.reshape(x.shape), models.reshape(x.shape), who.reshape(x.shape))

    def _part(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedProblem:
        """Give the problem around some states, ascending, for some of the people of a policy."""
        kept = self.kept.get(number)
        if kept is None:
            return self.kept.setdefault(number, self._made(number, states, people, deep))
        if kept.has(states, people, deep):
            return kept
        more, everybody = np.union1d(kept.states, states), np.union1d(kept.group.people, people)
        if len(more) <= max(MORE * len(states), kept.spent) and kept.size * len(more) <= (
            LARGEST // len(self.policies) * len(kept.states)
        ):
            self.kept[number] = self._made(number, more, everybody, deep)
            return self.kept[number]
        kept.spent += len(states)
        return self._made(number, states, people, deep)

    def _made(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedProblem:
        # What is looked up is there at once, so that it need not be asked for again for those who are advised.
        deep = deep or not self.policies[number].ground.known.searches
        around = self.policies[number].around(states, deep=deep)
        return CachedProblem(around, ModelGroup.of(self.pool, around.pomdp, people, self.world, around.region.states))

    def heard(self, view: StepView, robot: Ints) -> StepView:
        """Look at the states to which people are advised to go."""
        groups, policies = dict(view.groups), list(view.policies)
        for number, flat in by_model(view.model.reshape(-1), np.flatnonzero(robot), len(policies)):
            around = policies[number]
            if not isinstance(around, LocalProblem) or around.deep:
                continue
            x, choices = view.x.reshape(-1)[flat], around.pomdp.model.choices
            slot = around.pomdp.suggested[x, robot.reshape(-1)[flat]]
            then = around.region.states[choices.targets[x, slot][slot != NOTHING]]
            again = around.source.around(around.region.states[: around.count], then=then)
            own = groups[number].people
            groups[number] = ModelGroup.of(self.pool, again.pomdp, own, self.world, again.region.states)
            policies[number] = again
        return replace(view, groups=groups, policies=policies)


@dataclass(eq=False)
class CachedProblem:
    """The problem around some states, and how some people choose there.

    Attributes
    ----------
    around : LocalProblem
    group : ModelGroup
    spent : int
        Around how many other states problems have been made since, for a step each.
    """

    around: LocalProblem
    group: ModelGroup
    spent: int = 0

    @property
    def states(self) -> Ints:
        """Those in which people may be, ascending."""
        return self.around.region.states[: self.around.count]

    @property
    def size(self) -> int:
        """How many rows it has, those of next states included."""
        return len(self.around.region.states)

    def has(self, states: Ints, people: Ints, deep: bool) -> bool:
        """Tell whether it serves people in these states."""
        if deep and not self.around.deep:
            return False
        place = np.minimum(np.searchsorted(self.states, states), self.around.count - 1)
        return bool((self.states[place] == states).all()) and bool(np.isin(people, self.group.people).all())

    def rows(self, states: Ints) -> Ints:
        """Give the rows of states, shape (N,), that it has."""
        return np.searchsorted(self.states, states)
