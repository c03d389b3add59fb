"""One person's POMDP in the form that the file formats of other programs share.

All formats describe the same problem exactly:

- **Observations.** The other programs observe the next state, not the person's action. If two actions of a state have
  the same successor, the next state is less informative than the action. Such a successor is therefore written several
  times: as itself, and as *copies* that differ in name only. Most tasks need none.
- **Robot actions.** The formats have the same actions in all states. An action that a state lacks does the same as
  "nothing" and costs 1 more. No optimal policy takes it, and the value function is unchanged, as for any extra cost.
- **Goals.** Goal states are absorbing and free of cost, and theta does not change there.
- **Leaves.** A truncated problem ends at its frontier, whose states are absorbing, too. Each step there has the reward
  (1 - gamma) v, so that the return from there is v: the lower bound on the value in the whole task, or the upper one.
  So the optimal value of the file is a lower bound on that of the whole task, or an upper one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from planner import Table

from ..people.arguments import one_of
from ..people.decision import NOTHING, Floats
from ..person.pomdp import AssistPOMDP

Leaves = Literal["lower", "upper"]


@dataclass(frozen=True)
class Observed:
    """The observed variable of the formats: all states x, and copies of those that two actions of a state lead to.

    Attributes
    ----------
    pomdp : AssistPOMDP
    state : int array, shape (X,)
        The state of each observed value. The first n are the states themselves.
    targets : int array, shape (n, A)
        The observed value after the action in each slot.
    table : Table, optional
        The table of the task, whose facts name the states.
    leaves : "lower" or "upper"
        The bounds that are the values of leaves, if the problem is truncated.
    """

    pomdp: AssistPOMDP
    state: NDArray[np.int64]
    targets: NDArray[np.int64]
    table: Table | None = None
    leaves: Leaves = "lower"

    @classmethod
    def of(cls, pomdp: AssistPOMDP, table: Table | None = None, leaves: Leaves = "lower") -> Observed:
        """Return the observed values of a problem, with the copies that it needs.

        Parameters
        ----------
        pomdp : AssistPOMDP
        table : Table, optional
            The table of its task, whose facts name the states; `s0`, `s1`, ... unless given.
        leaves : "lower" or "upper"
            As in the attributes of the class.

        Raises
        ------
        ValueError
            There are several goals, or the trust rule depends on whether advice is followed.
        """
        pomdp.model.choices.require_one_goal("a problem with observed values")
        one_of("leaves", leaves, get_args(Leaves))
        if pomdp.followed_low is not None:
            raise ValueError("the trust rule depends on whether advice is followed; expected one that does not")
        choices = pomdp.model.choices
        targets = choices.targets.copy()
        state = list(range(len(choices)))
        copies: dict[tuple[int, int], int] = {}
        for x in np.flatnonzero(~choices.goal):
            row = choices.targets[x, : choices.applicable[x].sum()]
            for slot, y in enumerate(row):
                rank = int((row[:slot] == y).sum())
                if rank and not choices.goal[y]:  # the belief at a goal does not matter
                    if (y, rank) not in copies:
                        copies[y, rank] = len(state)
                        state.append(int(y))
                    targets[x, slot] = copies[y, rank]
        return cls(pomdp, np.array(state, dtype=np.int64), targets, table, leaves)

    @cached_property
    def _leaf(self) -> dict[int, Floats]:
        """The reward of each step in a leaf, shape (H or 1, T or 1)."""
        if (frontier := self.pomdp.frontier) is None:
            return {}
        value = (1 - self.pomdp.gamma) * getattr(frontier, self.leaves)
        return dict(zip(frontier.states.tolist(), value, strict=True))

    def stays(self, x: int) -> bool:
        """Return whether a state is absorbing: a goal, or a leaf."""
        return bool(self.pomdp.model.choices.goal[x]) or x in self._leaf

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name of each observed value: `s7`, or the facts of the state; equal names end in `_2`, `_3`, ..."""
        seen: dict[str, int] = {}
        names: list[str] = []
        for x in self.state.tolist():
            base = name = f"s{x}" if self.table is None else self._facts[x]
            while name in seen:
                seen[base] += 1
                name = f"{base}_{seen[base]}"
            seen[name] = 1
            names.append(name)
        return tuple(names)

    @cached_property
    def _facts(self) -> list[str]:
        """The facts of each state that differ from the initial state, in characters that the formats allow."""
        assert self.table is not None
        choices, variables = self.pomdp.model.choices, self.table.task.variables
        rows = self.table.values(choices.of_task(np.arange(len(self.table))))
        start = rows[choices.initial]
        own = [k for k, variable in enumerate(variables) if variable.axiom_layer < 0]  # not derived by axioms
        positive = [[_word(fact) for fact in variable.facts] for variable in variables]
        whole = [
            [word or f"not-{words[first]}" for word in words]
            for words, first in zip(positive, start.tolist(), strict=True)
        ]
        for named in (positive, whole):  # negative facts only where names would collide
            found = [
                "__".join(filter(None, (named[k][row[k]] for k in own if row[k] != start[k]))) for row in rows.tolist()
            ]
            if len(set(found)) == len(np.unique(rows, axis=0)):
                break
        return [name or "start" for name in found]

    def values(self) -> NDArray[np.int64]:
        """Return the numbers of all observed values."""
        return np.arange(len(self.state))

    def legend(self) -> Iterator[str]:
        """Yield one line per observed value that describes its robot actions; goals have none."""
        pomdp = self.pomdp
        for name, x in zip(self.names, self.state.tolist(), strict=True):
            if not pomdp.model.choices.goal[x] and pomdp.robot_actions[x] > 1:
                actions = action_names(pomdp)[1 : int(pomdp.robot_actions[x])]
                meant = [
                    f"{action} does {pomdp.executes(x, r)}"
                    if pomdp.suggestion(x, r) is None
                    else f"{action} suggests {pomdp.suggestion(x, r)}"
                    for r, action in enumerate(actions, start=1)
                ]
                yield f"{name}: {', '.join(meant)}"

    def step(self, x: int, r: int) -> list[tuple[int, Floats]]:
        """Return the successors of state x under robot action r: pairs (observed value, probability of shape (H, T)).

        Successors of probability 0 are omitted. A probability that does not depend on theta has shape (H, 1).
        """
        pomdp, choices = self.pomdp, self.pomdp.model.choices
        if self.stays(x):
            return [(x, np.ones((len(pomdp.hidden), 1)))]
        r = r if r < pomdp.robot_actions[x] else 0
        acting = int(pomdp.afterstate[x, r])
        if choices.goal[acting]:
            return [(acting, np.ones((len(pomdp.hidden), 1)))]
        slots = np.arange(int(choices.applicable[acting].sum()))
        chance = pomdp.likelihood(np.full(len(slots), x), np.full(len(slots), r), slots)
        if chance.shape[2] > 1 and pomdp.suggested[x, r] == NOTHING:
            chance = chance[:, :, :1]
        after: dict[int, Floats] = {}
        for y, p in zip(self.targets[acting, slots].tolist(), chance, strict=True):
            after[y] = after[y] + p if y in after else p
        return [(y, p) for y, p in after.items() if (p > 0).any()]

    def reward(self, x: int, r: int) -> Floats:
        """Return the expected reward of robot action r in state x, in cost units, shape (H, T), (H, 1) or (1, 1)."""
        pomdp, choices = self.pomdp, self.pomdp.model.choices
        if choices.goal[x]:
            return np.zeros((1, 1))
        if x in self._leaf:
            return self._leaf[x]
        forbidden = r >= pomdp.robot_actions[x]
        r = 0 if forbidden else r
        acting = int(pomdp.afterstate[x, r])
        charge = np.full((1, 1), float(pomdp.robot_costs[x, r]) + 1.0 * forbidden)
        if choices.goal[acting]:
            return -charge
        slots = np.arange(int(choices.applicable[acting].sum()))
        costs = choices.costs[acting, slots]
        if (costs == costs[0]).all():
            return -charge - costs[0]
        chance = pomdp.likelihood(np.full(len(slots), x), np.full(len(slots), r), slots)
        if pomdp.suggested[x, r] == NOTHING:
            chance = chance[:, :, :1]
        return np.asarray(-charge - np.tensordot(costs, chance, axes=1))

    def moves(self, x: int, r: int) -> Floats | None:
        """Return the transition matrix of theta for robot action r in state x, shape (T, T); None for the identity.

        An updated theta that lies between two grid points is split linearly between them.
        """
        pomdp = self.pomdp
        if not pomdp.moves[x, r]:
            return None
        thetas = np.arange(len(pomdp.grid.theta))
        matrix = np.zeros((len(thetas), len(thetas)))
        matrix[thetas, pomdp.low[x, r, 0]] = 1 - pomdp.weight[x, r, 0]
        matrix[thetas, pomdp.low[x, r, 0] + 1] += pomdp.weight[x, r, 0]
        return None if (matrix == np.eye(len(thetas))).all() else matrix


def _word(fact: str) -> str:
    """Return a fact as one word of letters, digits, `_`, `-` and `.`; the empty text for a negated fact."""
    if not fact.startswith("Atom "):
        return ""
    atom, _, number = fact.removeprefix("Atom ").partition(" = ")
    words = [re.sub(r"[^A-Za-z0-9_-]", "-", word) for word in re.findall(r"[^\s(),]+", atom)]
    return ".".join([*words, *filter(None, [re.sub(r"[^A-Za-z0-9_.-]", "-", number.replace("/", "of"))])])


def action_names(pomdp: AssistPOMDP) -> list[str]:
    """Return the names of robot actions: `nothing`, `robot1`, `robot2`, ...; each state numbers its own."""
    return ["nothing", *(f"robot{r}" for r in range(1, int(pomdp.robot_actions.max(initial=1))))]


def bytes_needed(observed: Observed, lines_of: Callable[[Observed, NDArray[np.int64]], Iterator[str]]) -> float:
    """Return about how many bytes a file takes, by the lines of up to a hundred observed values."""
    every = observed.values()
    some = every[:: max(1, len(every) // 100)]
    return sum(map(len, lines_of(observed, some))) * len(every) / len(some)


def numbers(array: Floats) -> str:
    """Return numbers as text, each with the fewest digits from which the same float is read."""
    return " ".join("0" if v == 0 else "1" if v == 1 else repr(v) for v in array.ravel().tolist())
