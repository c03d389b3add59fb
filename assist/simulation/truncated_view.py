"""The view of a truncated task in one step of a simulation: the people's states and their successors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..large_tasks.truncated_policy import LocalProblem, TruncatedPolicy
from ..people.decision import NOTHING
from ..team.state import by_model
from .pool import Pool
from .task_view import Ints, ModelGroup, StepView, World


class TruncatedTaskView:
    """The view of tasks that are not enumerated.

    Local problems are cached in `kept`, and are used again while all people are in their states. In a small task,
    people soon visit no new states. A local problem is rebuilt with more states if these are not many more than are
    needed, or if as many have been built for single steps since.

    Parameters
    ----------
    pool : Pool
    world : World
    kept : dict
        Cached problems by the index of the policy; empty at first, and shared by all chunks of one policy's episodes.
    model, people, mind : int arrays, shape (N, K)
        As in `WholeTaskView`.
    """

    def __init__(
        self, pool: Pool, world: World, kept: dict[int, CachedProblem], model: Ints, people: Ints, mind: Ints
    ) -> None:
        self.pool, self.world, self.kept = pool, world, kept
        self.policies = [policy for policy in pool.policies if isinstance(policy, TruncatedPolicy)]
        self.model, self.people, self.mind = model, people, mind
        self.initial = np.array([policy.ground.known.initial for policy in self.policies])[model]

    def view(self, x: Ints, active: Ints, *, deep: bool) -> StepView:
        """Return the view with a local problem for the states of all active people."""
        local_problems: list[LocalProblem] = []
        groups: dict[int, ModelGroup] = {}
        rows, models, who = np.zeros((3, x.size), dtype=np.int64)
        for number, flat in by_model(self.model.reshape(-1), active, len(self.policies)):
            states, people = x.reshape(-1)[flat], self.people.reshape(-1)[flat]
            part = self._part(number, np.unique(states), np.unique(people), deep)
            rows[flat] = part.rows(states)
            models[flat] = len(local_problems)
            who[flat] = self.mind.reshape(-1)[flat] if self.world == "model" else part.group.row[people]
            groups[len(local_problems)] = part.group
            local_problems.append(part.around)
        return StepView(local_problems, groups, rows.reshape(x.shape), models.reshape(x.shape), who.reshape(x.shape))

    def _part(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedProblem:
        """Return a local problem for some states, in ascending order, and some of the people of a policy.

        A rebuilt problem has at most four times the needed number of states, unless many were built for single steps.
        All cached problems together have about 20,000 rows, of some kilobytes each.
        """
        kept = self.kept.get(number)
        if kept is None:
            return self.kept.setdefault(number, self._made(number, states, people, deep))
        if kept.has(states, people, deep):
            return kept
        more, everybody = np.union1d(kept.states, states), np.union1d(kept.group.people, people)
        if len(more) <= max(4 * len(states), kept.spent) and kept.size * len(more) <= (
            20_000 // len(self.policies) * len(kept.states)
        ):
            self.kept[number] = self._made(number, more, everybody, deep)
            return self.kept[number]
        kept.spent += len(states)
        return self._made(number, states, people, deep)

    def _made(self, number: int, states: Ints, people: Ints, deep: bool) -> CachedProblem:
        # A table answers at once, so that the states after suggestions are included from the beginning.
        deep = deep or not self.policies[number].ground.known.searches
        around = self.policies[number].around(states, deep=deep)
        return CachedProblem(around, ModelGroup.of(self.pool, around.pomdp, people, self.world, around.region.states))

    def after_suggestions(self, view: StepView, robot: Ints) -> StepView:
        """Return the view with the states to which suggestions lead."""
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
    """A local problem for some states, with the choices of some people there.

    Attributes
    ----------
    around : LocalProblem
    group : ModelGroup
    spent : int
        Number of other states for which problems have been built since, for one step each.
    """

    around: LocalProblem
    group: ModelGroup
    spent: int = 0

    @property
    def states(self) -> Ints:
        """The states in which people may be, in ascending order."""
        return self.around.region.states[: self.around.count]

    @property
    def size(self) -> int:
        """The number of rows, including those of successors."""
        return len(self.around.region.states)

    def has(self, states: Ints, people: Ints, deep: bool) -> bool:
        """Return whether the problem covers these states and people."""
        if deep and not self.around.deep:
            return False
        place = np.minimum(np.searchsorted(self.states, states), self.around.count - 1)
        return bool((self.states[place] == states).all()) and bool(np.isin(people, self.group.people).all())

    def rows(self, states: Ints) -> Ints:
        """Return the rows of states, shape (N,), that it covers."""
        return np.searchsorted(self.states, states)
