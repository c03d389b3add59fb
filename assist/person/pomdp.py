"""One person's assistance problem as a mixed-observability POMDP.

The task state x is observed; the person's type, that is their goal and their expertise beta, and theta are hidden
(`people.hidden_type`). In each step the robot does nothing, suggests an action, or executes an action of the task. Then
the person acts, and x changes. An `AssistPOMDP` holds the arrays of the model. It also has the two functions of a
belief filter: the likelihood of a person's action, and the posterior belief. Every solver returns a `Policy`
(`person.policy`).

The robot actions of a state are numbered from 0: nothing, then the suggestions, then the executions. What is optimal
for one of several goals may be suggested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from planner.system.arrays import outline

from ..people import belief as beliefs
from ..people.arguments import check_costs, one_of
from ..people.belief import Grid
from ..people.choice_model import ChoiceModel, boltzmann, chances, value
from ..people.choices import Choices
from ..people.decision import NOTHING, Floats
from ..people.hidden_type import KNOWN, HiddenType
from ..people.human import HumanModel
from ..people.perceived_suggestions import PerceivedSuggestions, moved
from ..people.ranges import Population
from ..people.trust_rules import EquationSeven, TrustRule, counts_of
from .leaf_bounds import LeafBounds
from .robots import USUAL, OfRobots, Suggestions


@dataclass(frozen=True, kw_only=True)
class AssistPOMDP:
    """The problem of assisting one person.

    In the shapes, n is the number of states, R the largest number of robot actions in a state, A the largest number of
    choices of the person, H the number of types of G goals, and T the number of cells of theta.

    Attributes
    ----------
    model : HumanModel
    hidden : HiddenType
        The H types of a person.
    grid : Grid
        The values of beta and theta.
    gamma : float
        Discount factor per step, in (0, 1).
    prior : float array, shape (H, T)
    robot_actions : int array, shape (n,)
        Number of robot actions in each state.
    suggested : int array, shape (n, R)
        Slot of the choice that each robot action suggests; `NOTHING` in column 0, for executions, and in padding.
    afterstate : int array, shape (n, R)
        State in which the person then acts: the successor after an execution, otherwise the state itself.
    robot_costs : float array, shape (n, R)
        Cost of each robot action, in cost units; in column 0, of a robot that is with the person and does nothing.
    chosen : float array, shape (n, A, H)
        Probability of each choice without a suggestion and without lapses (equation 5); 0 where the goal is reached.
    unsuggested : float array, shape (n, R, H)
        Sum of `chosen` over all slots but the suggested one. It is stored because 1 - p loses precision for p close to
        1.
    low, weight : int and float arrays, shape (n, R, G, T)
        Interpolation of theta after each robot action, as returned by `Grid.shares`, for each goal.
    followed_low, followed_weight : int and float arrays, shape (n, R, G, T), or None
        The same if the person does what was suggested; None if the trust rule does not use the answer.
    frontier : LeafBounds or None
        Frontier states and their bounds, if the problem is truncated.
    order : int array, shape (G, n), or None
        All states in the order of a value-iteration sweep for each goal; ascending cost-to-go by default.
    alike : int
        Number of people whose problems of this size are solved one after another. Where they are many, code is compiled
        for them.
    """

    model: HumanModel
    hidden: HiddenType
    grid: Grid
    gamma: float
    prior: Floats
    robot_actions: NDArray[np.int64]
    suggested: NDArray[np.int64]
    afterstate: NDArray[np.int64]
    robot_costs: Floats
    chosen: Floats
    unsuggested: Floats
    low: NDArray[np.int64]
    weight: Floats
    frontier: LeafBounds | None = None
    order: NDArray[np.int64] | None = None
    followed_low: NDArray[np.int64] | None = None
    followed_weight: Floats | None = None
    alike: int = 1

    __repr__ = outline

    def __post_init__(self) -> None:
        for array in (
            self.prior, self.robot_actions, self.suggested, self.afterstate, self.robot_costs, self.chosen,
            self.unsuggested, self.low, self.weight, self.order, self.followed_low, self.followed_weight,
        ):  # fmt: skip
            if array is not None:
                array.flags.writeable = False

    @classmethod
    def of(
        cls,
        model: HumanModel,
        *,
        chooses: ChoiceModel = boltzmann,
        grid: Grid | None = None,
        population: Population | None = None,
        gamma: float = 0.99,
        robot: OfRobots = USUAL,
        suggestions: Suggestions = "optimal",
        frontier: LeafBounds | None = None,
        trust: TrustRule | None = None,
        types: type[HiddenType] = HiddenType,
    ) -> AssistPOMDP:
        """Build the problem for a person drawn from a population (by default, the paper's population).

        Parameters
        ----------
        model : HumanModel
        chooses : ChoiceModel
            Model of people's choices, with beta as the person's type; equation 5 by default.
        grid : Grid, optional
            Grid of hidden values; by default, a regular grid over the population's ranges.
        population : Population, optional
            Prior distribution of (beta, theta).
        gamma : float
            As in the attributes of the class.
        robot : OfRobots
            What the robot's actions cost, and whether it can also execute an action itself, before the person acts.
        suggestions : "optimal" or "all"
            Whether only optimal actions are suggested, or every applicable action.
        frontier : LeafBounds, optional
            Leaf bounds of a truncated problem. In it, the execution of an action that leads to the frontier has no
            effect.
        trust : TrustRule, optional
            How theta moves; by default equation (7) with the model's rate and unit of utility.
        types : type of HiddenType
            What is hidden about the person.

        Raises
        ------
        ValueError
            A number is out of its range, or a robot that executes meets several goals or people who have a memory.
        """
        check_costs(gamma)
        one_of("suggestions", suggestions, get_args(Suggestions))
        if robot.execute:
            model.choices.require_one_goal("execute")
        # On a task of any size every state has a memory, if people have terms.
        has_memory = model.choices.state is not None or (frontier is not None and model.choices.terms)
        if robot.execute and has_memory:
            raise ValueError("execute: expected people without memory, and terms look at what they did last")
        population = population or Population()
        robots = _RobotActions.of(model.choices, suggestions, robot, None if frontier is None else frontier.states)
        rule = EquationSeven(model.eta, model.utility_scale) if trust is None else trust
        grid = (grid or Grid.regular(population)).with_counts(counts_of(rule))
        goals = model.choices.goals
        hidden = types(goals.prior, grid.beta, goals.assume_likeliest, goals.sharpness)
        chosen, unsuggested = _choice_probabilities(model, chooses, hidden, robots.suggested)
        low, weight = _trust_shares(model, chooses, grid, rule, frontier, robots.suggested, followed=False)
        followed_low = followed_weight = None
        if rule.uses_answer:
            followed_low, followed_weight = _trust_shares(
                model, chooses, grid, rule, frontier, robots.suggested, followed=True
            )
        return cls(
            model=model, hidden=hidden, grid=grid, gamma=gamma, prior=hidden.prior(grid.prior(population)),
            robot_actions=robots.number, suggested=robots.suggested, afterstate=robots.afterstate,
            robot_costs=robots.costs, chosen=chosen, unsuggested=unsuggested, low=low, weight=weight,
            frontier=None if frontier is None else frontier.of_types(hidden.goal_of),
            followed_low=followed_low, followed_weight=followed_weight,
        )  # fmt: skip

    def given_goals(self) -> list[tuple[float, AssistPOMDP]]:
        """Return each possible goal's prior probability, and the problem of a person of whom that goal is known.

        The robot actions are those of this problem, so that some suggestions may be useless to that person.
        """
        goals, found = self.model.choices.goals, list[tuple[float, AssistPOMDP]]()
        if self.model.choices.unknown_goal is None:
            return [(1.0, self)]
        for g, ((choices, q), share) in enumerate(zip(self.model.of_each_goal, goals.prior.values(), strict=True)):
            if share == 0:
                continue
            own, of, followed, by = self.hidden.goal_of == g, slice(g, g + 1), self.followed_low, self.followed_weight
            found.append((share, replace(
                self, model=replace(self.model, choices=choices, q=q),
                hidden=replace(self.hidden, goals={KNOWN: 1.0}, assume_likeliest=False, sharpness=1.0),
                prior=self.prior[own] / share, chosen=self.chosen[:, :, own], unsuggested=self.unsuggested[:, :, own],
                low=self.low[:, :, of], weight=self.weight[:, :, of],
                robot_actions=np.where(choices.goal, 1, self.robot_actions),
                suggested=np.where(choices.goal[:, None], NOTHING, self.suggested),
                followed_low=None if followed is None else followed[:, :, of],
                followed_weight=None if by is None else by[:, :, of],
                order=None if self.order is None else self.order[of],
            )))  # fmt: skip
        return found

    @cached_property
    def final(self) -> NDArray[np.bool_]:
        """Whether the problem ends in each state for each goal, shape (G, n): at the goal, and at the frontier."""
        final = self.model.choices.goals.goal.copy()
        if self.frontier is not None:
            final[:, self.frontier.states] = True
        final.flags.writeable = False
        return final

    @cached_property
    def ends(self) -> NDArray[np.bool_]:
        """Whether the problem ends in each state, whatever the goal, shape (n,)."""
        ends = np.logical_and.reduce(self.final)
        ends.flags.writeable = False
        return ends

    def likelihood(self, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]) -> Floats:
        """Return the likelihood P(action | x, robot, type, theta), shape (N, H, T).

        It combines choice and influence (equations 5 and 6) with the model's lapse rate.

        Parameters
        ----------
        x, robot, action : int arrays, shape (N,)
            Task state, robot action (0: nothing), and slot of the person's choice.
        """
        suggestion, acting = self.suggested[x, robot], self.afterstate[x, robot]
        p = self.chosen[acting, action][:, :, None]
        followed = self.chosen[acting, np.maximum(suggestion, 0)][:, :, None]
        theta = self.grid.theta
        total = theta * followed + (1 - theta) * self.unsuggested[x, robot][:, :, None]
        weight = np.where((action == suggestion)[:, None, None], theta, 1 - theta)
        heard = (suggestion != NOTHING)[:, None, None] & (total > 0)
        influenced = np.divide(
            weight * p, total, out=np.zeros(np.broadcast_shapes(p.shape, total.shape)), where=total > 0
        )
        likelihood = np.where(heard, influenced, p)
        count = self.model.choices.applicable[acting].sum(axis=1)[:, None, None]
        return (1 - self.model.lapse) * likelihood + self.model.lapse / count

    def update(
        self, belief: Floats, x: NDArray[np.int64], robot: NDArray[np.int64], action: NDArray[np.int64]
    ) -> Floats:
        """Return the posterior beliefs, shape (N, H, T), after people's actions; arguments as in `likelihood`."""
        low, weight = self.low[x, robot], self.weight[x, robot]
        if self.followed_low is not None and self.followed_weight is not None:
            follows = (action == self.suggested[x, robot])[:, None, None]
            low = np.where(follows, self.followed_low[x, robot], low)
            weight = np.where(follows, self.followed_weight[x, robot], weight)
        of = self.hidden.goal_of
        return beliefs.update(belief, self.likelihood(x, robot, action), low[:, of], weight[:, of])

    @cached_property
    def waits_for_free(self) -> bool:
        """Whether a robot that is with the person and does nothing pays nothing, in every state."""
        return not self.robot_costs[:, 0].any()

    def unattended(self) -> AssistPOMDP:
        """Return the problem with a robot that is not with the person while it does nothing, so that this is free."""
        if self.waits_for_free:
            return self
        costs = self.robot_costs.copy()
        costs[:, 0] = 0.0
        return replace(self, robot_costs=costs)

    @cached_property
    def suggests_optimal(self) -> NDArray[np.bool_]:
        """Whether each robot action suggests an action that is optimal for each goal, shape (n, R, G)."""
        slot = np.maximum(self.suggested, 0)[:, :, None]
        optimal = np.take_along_axis(self.model.choices.goals.optimal, slot, axis=1)
        suggests = (self.suggested != NOTHING)[:, :, None] & optimal
        suggests.flags.writeable = False
        return suggests

    @cached_property
    def first_optimal(self) -> NDArray[np.int64]:
        """The first robot action that suggests an optimal action for each goal, shape (n, G); 0 if there is none."""
        first = self.suggests_optimal.argmax(axis=1)
        first.flags.writeable = False
        return first

    def suggestion(self, x: int, robot: int) -> str | None:
        """Return the suggested action of a robot action, in PDDL notation; None if it suggests nothing."""
        slot = int(self.suggested[x, robot])
        return None if slot == NOTHING else self.model.choices.name(x, slot)

    def executes(self, x: int, robot: int) -> str | None:
        """Return the action that a robot action executes, in PDDL notation; None if it executes nothing."""
        slot = int(self.executed(np.array([x]))[0, robot])
        return None if slot == NOTHING else self.model.choices.name(x, slot)

    def executed(self, x: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the slot that each robot action executes in some states, shape (N, R); `NOTHING` for none."""
        number, suggested = np.arange(self.suggested.shape[1]), self.suggested[x]
        executes = (number > 0) & (number < self.robot_actions[x, None]) & (suggested == NOTHING)
        # Executions follow the suggestions in the same order.
        same = np.maximum(number - (self.robot_actions[x, None] - 1) // 2, 0)
        return np.where(executes, np.take_along_axis(suggested, same, axis=1), NOTHING)


class _RobotActions(NamedTuple):
    """The robot actions of each state; attributes as in `AssistPOMDP`."""

    number: NDArray[np.int64]
    suggested: NDArray[np.int64]
    afterstate: NDArray[np.int64]
    costs: Floats

    @classmethod
    def of(
        cls, choices: Choices, suggestions: Suggestions, robot: OfRobots, leaves: NDArray[np.int64] | None
    ) -> _RobotActions:
        """Number the robot actions of each state: nothing, the suggestions, and the executions if it executes."""
        nothing, suggestion, execution = robot.costs
        best = choices.optimal if choices.offered is None else choices.offered
        offered = best if suggestions == "optimal" else choices.applicable & (choices.actions >= 0)
        offered = offered & ~choices.goal[:, None]
        count = offered.sum(axis=1)
        robot_actions = 1 + count * (1 + robot.execute)
        shape = (len(choices), int(robot_actions.max(initial=1)))
        suggested = np.full(shape, NOTHING, dtype=np.int64)
        afterstate = np.repeat(np.arange(len(choices))[:, None], shape[1], axis=1)
        costs = np.zeros(shape)
        costs[~choices.goal, 0] = nothing
        state, slot = np.nonzero(offered)
        column = np.cumsum(offered, axis=1)[state, slot]
        suggested[state, column] = slot
        costs[state, column] = suggestion
        if robot.execute:
            there = choices.targets[state, slot]
            known = np.ones(len(there), dtype=bool) if leaves is None else ~np.isin(there, leaves)
            afterstate[state, column + count[state]] = np.where(known, there, state)
            costs[state, column + count[state]] = execution
        return cls(robot_actions, suggested, afterstate, costs)


def _choice_probabilities(
    model: HumanModel, chooses: ChoiceModel, hidden: HiddenType, suggested: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return `AssistPOMDP.chosen` and `AssistPOMDP.unsuggested`."""
    each: list[Floats] = []
    for goal, (choices, q) in enumerate(model.of_each_goal):
        found = chances(chooses, choices, q, hidden.expertise[hidden.goal_of == goal])
        each += list(np.where(choices.goal[:, None], 0.0, found))  # who has reached the goal acts by a lapse only
    chosen = np.stack(each, axis=-1)
    # Such probabilities count as 0: the influence (equation 6) at theta = 0 or 1 divides by them.
    chosen[chosen < 1e-290] = 0.0
    slots = np.arange(chosen.shape[1])
    columns = [np.einsum("na,nab->nb", slots != column[:, None], chosen) for column in suggested.T]
    return chosen, np.stack(columns, axis=1)


def _trust_shares(
    model: HumanModel, chooses: ChoiceModel, grid: Grid, rule: TrustRule, frontier: LeafBounds | None,
    suggested: NDArray[np.int64], *, followed: bool,
) -> tuple[NDArray[np.int64], Floats]:  # fmt: skip
    """Return the grid's shares of theta after each robot action, for each goal, both of shape (n, R, G, T)."""
    slot, silent = np.maximum(suggested, 0), suggested[:, :, None] == NOTHING  # then theta does not move
    each = []
    for goal, (choices, q) in enumerate(model.of_each_goal):
        v = value(chooses, choices, q)
        if frontier is not None:  # no choices are known at the leaves, hence no value of the next state
            leaves = frontier.states
            v[leaves] = -choices.h[leaves] if frontier.value is None else frontier.value[:, goal]
        perceived = PerceivedSuggestions.of(
            np.take_along_axis(q, slot, axis=1)[:, :, None], q.min(axis=1)[:, None, None],
            v[:, None, None], v[np.take_along_axis(choices.targets, slot, axis=1)][:, :, None],
            np.take_along_axis(choices.optimal, slot, axis=1)[:, :, None],
        )  # fmt: skip
        theta, count = moved(rule, grid.theta, grid.count, perceived.event(followed, rule.feedback))
        each.append(grid.shares(np.where(silent, grid.theta, theta), np.where(silent, grid.count, count)))
    return np.stack([low for low, _ in each], axis=2), np.stack([weight for _, weight in each], axis=2)
