"""One person's assistance problem as a mixed-observability POMDP.

The task state x is observed; the person's type, that is their goal and their expertise beta, and theta are hidden
(`people.hidden_type`). In each step the robot does nothing, suggests an action, or executes an action of the task. Then
the person acts, and x changes. An `AssistPOMDP` holds the arrays of the model, and `likelihood` the probability of an
action. `update` is a belief filter by formula, for tests and for users; it keeps goals that are reached. Others use
`person.beliefs`. Every solver returns a `Policy` (`person.policy`).

The robot actions of a state are numbered from 0: nothing, then the suggestions, then the executions. What is optimal
for one of several goals may be suggested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import get_args

import numpy as np

from planner.system.arrays import outline, read_only

from ..people import belief as beliefs
from ..people.arguments import check_costs, one_of
from ..people.belief import Grid
from ..people.choice_model import ChoiceModel, chances
from ..people.decision import NOTHING, Bools, Floats, Ints
from ..people.hidden_type import HiddenType
from ..people.human import HumanModel
from ..people.ranges import Population, require_populations
from ..people.trust_rules import EquationSeven, counts_of, may_move
from .behaviour import PAPER, Behaviour
from .leaf_bounds import LeafBounds
from .robot_actions import RobotActions
from .robots import USUAL, OfRobots, Suggestions
from .trust_shares import trust_shares


@dataclass(frozen=True, kw_only=True)
class AssistPOMDP:
    """The problem of assisting one person.

    In the shapes, n is the number of states, R the largest number of robot actions in a state, A the largest number of
    choices of the person, H the number of types of G goals, and T the number of cells of theta.

    Attributes
    ----------
    model, hidden, grid : HumanModel, HiddenType, Grid
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
        Cost of each robot action, in cost units; in column 0, of a robot that is with the person and does nothing
        (`OfRobots.costs`: 0, unless a robot of one's own says otherwise).
    chosen : float array, shape (n, A, H)
        Probability of each choice without a suggestion and without lapses (equation 5); 0 where the goal is reached.
    unsuggested : float array, shape (n, R, H)
        Sum of `chosen` over all slots but the suggested one. It is stored because 1 - p loses precision for p close to
        1.
    moves : bool array, shape (n, R)
        Whether theta may move in a step after each robot action: `low` and `weight` leave it as it is in all others.
    low, weight : int and float arrays, shape (n, R, G, T)
        What becomes of each theta after a robot action, for each goal: `low` is the lower one of the two cells between
        which it lies, and `weight` the share of the cell above, `low + 1` (`Grid.shares`).
    followed_low, followed_weight : int and float arrays, shape (n, R, G, T), or None
        The same if the person does what was suggested, so that `low` and `weight` hold if not; None if the trust rule
        does not use the answer.
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
    robot_actions: Ints
    suggested: Ints
    afterstate: Ints
    robot_costs: Floats
    chosen: Floats
    unsuggested: Floats
    moves: Bools
    low: Ints
    weight: Floats
    frontier: LeafBounds | None = None
    order: Ints | None = None
    followed_low: Ints | None = None
    followed_weight: Floats | None = None
    alike: int = 1

    __repr__ = outline

    def __post_init__(self) -> None:
        read_only(self)

    @classmethod
    def of(
        cls,
        model: HumanModel,
        *,
        behaviour: Behaviour = PAPER,
        grid: Grid | None = None,
        population: Population | None = None,
        gamma: float = 0.99,
        robot: OfRobots = USUAL,
        suggestions: Suggestions = "optimal",
        frontier: LeafBounds | None = None,
    ) -> AssistPOMDP:
        """Build the problem for a person drawn from a population (by default, the paper's population).

        Parameters
        ----------
        model : HumanModel
        behaviour : Behaviour
            How people choose and trust; by default as in the paper.
        grid : Grid, optional
            Grid of hidden values; by default, a regular grid over the population's ranges.
        population : Population, optional
            Prior distribution of (beta, theta).
        gamma : float
        robot : OfRobots
            What the robot's actions cost, and whether it can also execute an action itself, before the person acts.
        suggestions : "optimal" or "all"
            Whether only optimal actions are suggested, or every applicable action.
        frontier : LeafBounds, optional
            Leaf bounds of a truncated problem.

        Raises
        ------
        ValueError
            A number is out of its range, or a robot that executes meets several goals or people who have a memory.
        """
        check_costs(gamma)
        require_populations(population)
        one_of("suggestions", suggestions, get_args(Suggestions))
        if robot.execute:
            model.choices.require_one_goal("execute")
        # On a task of any size every state has a memory, if people have terms.
        has_memory = model.choices.state is not None or (frontier is not None and model.choices.terms)
        if robot.execute and has_memory:
            raise ValueError("execute: expected people without memory, and terms look at what they did last")
        population = population or Population()
        robots = RobotActions.of(model.choices, suggestions, robot, frontier)
        rule = EquationSeven(model.eta, model.utility_scale) if behaviour.trust is None else behaviour.trust
        grid = (grid or Grid.regular(population)).with_counts(counts_of(rule))
        goals = model.choices.goals
        hidden = behaviour.types(goals.prior, grid.beta, goals.assume_likeliest, goals.sharpness)
        chosen, unsuggested = _choice_probabilities(model, behaviour.chooses, hidden, robots.suggested)
        shares = partial(trust_shares, model, behaviour.chooses, grid, rule, frontier, robots.suggested)
        low, weight = shares(followed=False)
        followed_low, followed_weight = shares(followed=True) if rule.uses_answer else (None, None)
        return cls(
            model=model, hidden=hidden, grid=grid, gamma=gamma, prior=hidden.prior(grid.prior(population)),
            robot_actions=robots.number, suggested=robots.suggested, afterstate=robots.afterstate,
            robot_costs=robots.costs, chosen=chosen, unsuggested=unsuggested,
            moves=may_move(rule, robots.suggested != NOTHING), low=low, weight=weight,
            frontier=None if frontier is None else frontier.of_types(hidden.goal_of),
            followed_low=followed_low, followed_weight=followed_weight,
        )  # fmt: skip

    @cached_property
    def final(self) -> Bools:
        """Whether the problem ends in each state for each goal, shape (G, n): at the goal, and at the frontier."""
        final = self.model.choices.goals.goal.copy()
        if self.frontier is not None:
            final[:, self.frontier.states] = True
        final.flags.writeable = False
        return final

    @cached_property
    def ends(self) -> Bools:
        """Whether the problem ends in each state, whatever the goal, shape (n,)."""
        ends = np.logical_and.reduce(self.final)
        ends.flags.writeable = False
        return ends

    def likelihood(self, x: Ints, action: Ints, slot: Ints) -> Floats:
        """Return the likelihood P(slot | x, action, type, theta), shape (N, H, T).

        It combines choice and influence (equations 5 and 6) with the model's lapse rate.

        Parameters
        ----------
        x, action, slot : int arrays, shape (N,)
            Row, robot action (0: nothing), and slot of the person's choice.
        """
        suggestion, acting = self.suggested[x, action], self.afterstate[x, action]
        p = self.chosen[acting, slot][:, :, None]
        followed = self.chosen[acting, np.maximum(suggestion, 0)][:, :, None]
        theta = self.grid.theta
        total = theta * followed + (1 - theta) * self.unsuggested[x, action][:, :, None]
        weight = np.where((slot == suggestion)[:, None, None], theta, 1 - theta)
        heard = (suggestion != NOTHING)[:, None, None] & (total > 0)
        influenced = np.divide(
            weight * p, total, out=np.zeros(np.broadcast_shapes(p.shape, total.shape)), where=total > 0
        )
        likelihood = np.where(heard, influenced, p)
        count = self.model.choices.applicable[acting].sum(axis=1)[:, None, None]
        return (1 - self.model.lapse) * likelihood + self.model.lapse / count

    def update(self, belief: Floats, x: Ints, action: Ints, slot: Ints) -> Floats:
        """Return the posterior beliefs, shape (N, H, T), after people's actions; arguments as in `likelihood`."""
        low, weight = self.low[x, action], self.weight[x, action]
        if self.followed_low is not None and self.followed_weight is not None:
            follows = (slot == self.suggested[x, action])[:, None, None]
            low = np.where(follows, self.followed_low[x, action], low)
            weight = np.where(follows, self.followed_weight[x, action], weight)
        of = self.hidden.goal_of
        return beliefs.update(belief, self.likelihood(x, action, slot), low[:, of], weight[:, of])

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
    def suggests_optimal(self) -> Bools:
        """Whether each robot action suggests an action that is optimal for each goal, shape (n, R, G)."""
        slot = np.maximum(self.suggested, 0)[:, :, None]
        optimal = np.take_along_axis(self.model.choices.goals.optimal, slot, axis=1)
        suggests = (self.suggested != NOTHING)[:, :, None] & optimal
        suggests.flags.writeable = False
        return suggests

    @cached_property
    def first_optimal(self) -> Ints:
        """The first robot action that suggests an optimal action for each goal, shape (n, G); 0 if there is none."""
        first = self.suggests_optimal.argmax(axis=1)
        first.flags.writeable = False
        return first

    def suggestion(self, x: int, action: int) -> str | None:
        """Return the suggested action of a robot action, in PDDL notation; None if it suggests nothing."""
        slot = int(self.suggested[x, action])
        return None if slot == NOTHING else self.model.choices.name(x, slot)

    def executes(self, x: int, action: int) -> str | None:
        """Return the action that a robot action executes, in PDDL notation; None if it executes nothing."""
        slot = int(self.executed(np.array([x]))[0, action])
        return None if slot == NOTHING else self.model.choices.name(x, slot)

    def executed(self, x: Ints) -> Ints:
        """Return the slot that each robot action executes in some states, shape (N, R); `NOTHING` for none."""
        number, suggested = np.arange(self.suggested.shape[1]), self.suggested[x]
        executes = (number > 0) & (number < self.robot_actions[x, None]) & (suggested == NOTHING)
        # Executions follow the suggestions in the same order.
        same = np.maximum(number - (self.robot_actions[x, None] - 1) // 2, 0)
        return np.where(executes, np.take_along_axis(suggested, same, axis=1), NOTHING)


def _choice_probabilities(
    model: HumanModel, chooses: ChoiceModel, hidden: HiddenType, suggested: Ints
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
