"""What another action costs compared with a step, and the shortest consequence that shows it.

For a step a and another action b in a state x, with cost c and successor succ,

    difference = c(b) + h*(succ(x, b)) - c(a) - h*(succ(x, a)).

A consequence is an action that the best ways on after b need, and that they need less often after a. "Need" refers to
the optimal continuations, never to all ways to the goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from planner import CostToGo

from ..declare.declared import AnyNumber, AnyText, Truth, View, declared
from ..people.action_names import Matcher, words_of
from ..people.choices import Choices
from ..people.same_costs import same_cost
from .continuations import (
    OptimalContinuations,
    action_name,
    cost_to_go,
    costs_are_one,
    edges,
    one_continuation,
)

Unit = Literal["actions", "cost"]
"""Unit of a difference: actions if every action of the task costs 1, cost units otherwise."""

Kind = Literal["needed", "possible", "same", "no-closer", "further", "longer", "dead-end"]


@declared
class Consequence(View):
    """Consequences of an action taken instead of a step."""

    kind: Annotated[
        Kind,
        Field(
            description=(
                '"needed": every optimal continuation after the alternative has `action`, more often than some '
                'optimal continuation after the step (the step included). "possible": some optimal continuation '
                'after the alternative has `action`, and the given one after the step has it less often. "same": '
                'both lead to the same state, at different costs. "no-closer", "further": h* is equal, or larger,'
                ' after the alternative than before it. "longer": the alternative costs no more, but a cheapest '
                'plan that begins with it has more actions. "dead-end": the goal cannot be reached after the '
                "alternative."
            )
        ),
    ]
    action: Annotated[AnyText | None, Field(description="In PDDL notation; None for all other kinds.")] = None
    again: Annotated[
        Truth,
        Field(
            description=(
                "Whether the action also occurs in all that is done otherwise, less often: as the alternative "
                "itself, as the step, or in `instead`."
            )
        ),
    ] = False
    after: Annotated[
        tuple[AnyText, ...],
        Field(description="An optimal continuation after the alternative. It has `action` as early as possible."),
    ] = ()
    instead: Annotated[
        tuple[AnyText, ...],
        Field(description="An optimal continuation after the step. It has `action` as rarely as possible."),
    ] = ()


@declared
class Contrast(View):
    """A step compared with another action in the same state."""

    step: Annotated[AnyText, Field(description="In PDDL notation.")]
    alternative: Annotated[AnyText, Field(description="In PDDL notation.")]
    difference: Annotated[
        AnyNumber,
        Field(
            description=(
                "By how much the best plan that begins with the alternative costs more than the best one that "
                "begins with the step. Negative if it costs less; infinite if the goal cannot be reached after "
                "the alternative."
            )
        ),
    ]
    unit: Annotated[Unit, Field(description="Actions if every action of the task costs 1.")]
    consequence: Annotated[
        Consequence | None,
        Field(
            description=(
                "None if the alternative is as good or better, or if no consequence is simpler than the "
                "difference itself."
            )
        ),
    ]
    probability: Annotated[
        AnyNumber | None,
        Field(description="How likely the person is to choose the alternative without a suggestion, if that is known."),
    ] = None


Say = Callable[[str], str]
"""Returns a ground action in words."""


def contrast(
    known: Choices | CostToGo,
    state: int,
    step: str,
    alternative: str,
    *,
    probability: float | None = None,
    say: Say = str,
    largest: int = 5_000,
) -> Contrast:
    """Return the comparison of a step with another action that is applicable in the same state.

    Parameters
    ----------
    known : Choices or CostToGo
        The task.
    state : int
        A row of the choices, or a state of the cost-to-go.
    step, alternative : str
        As `people.action_names` reads them.
    probability : float, optional
        See `Contrast`.
    say : callable, optional
        The domain's words, which may omit arguments. An action in the same words as the step is no consequence, since
        a reader could not tell them apart.
    largest : int
        Largest number of states of a graph of optimal continuations; with more, two plans are compared. The default
        takes about 50 ms. Where each state is looked up, which takes 5 ms, at most 200 states are allowed.

    Raises
    ------
    ValueError
        An action is unknown or not applicable in the state, both are the same, or the goal cannot be reached from it.
    """
    if not math.isfinite(cost_to_go(known, [state])[0]):
        raise ValueError("the goal can no longer be reached from this state, whatever is done")
    here = edges(known, [state])
    matcher = Matcher(known.names if isinstance(known, Choices) else known.task.actions)
    a, b = (matcher.slot(words_of(action), here.action.astype(np.int32)) for action in (step, alternative))
    names = [action_name(known, int(here.action[slot])) for slot in (a, b)]
    if a == b:
        raise ValueError(f"{names[0]} is the step itself; expected another action to compare it with")
    h_a, h_b = cost_to_go(known, here.target[[a, b]]).tolist()
    in_all = float(here.cost[a]) + h_a, float(here.cost[b]) + h_b
    # From a state with finite h*, two actions into dead ends are equally bad.
    same = in_all[0] == in_all[1] or same_cost(np.array(in_all[0]), np.array(in_all[1]))
    difference = 0.0 if same else in_all[1] - in_all[0]
    consequence = None
    if difference == math.inf:
        consequence = Consequence("dead-end")
    elif difference == 0 and here.optimal[a] and not here.optimal[b]:  # as there are actions of cost 0
        consequence = Consequence("longer")
    elif difference > 0:
        consequence = _consequence(known, state, a, b, say, largest)
    unit: Unit = "actions" if costs_are_one(known) else "cost"
    return Contrast(names[0], names[1], difference, unit, consequence, probability)


def _consequence(known: Choices | CostToGo, state: int, a: int, b: int, say: Say, largest: int) -> Consequence | None:
    """Return the consequence of the choice in slot `b`, which is worse than that in slot `a` and no dead end."""
    here = edges(known, [state])
    step, alternative = (action_name(known, int(here.action[slot])) for slot in (a, b))
    to_a, to_b = int(here.target[a]), int(here.target[b])
    if to_a == to_b:
        return Consequence("same")
    if not isinstance(known, Choices):  # a search for each state would take too long; two plans are two searches
        largest = 0 if known.searches else min(largest, 200)
    graph_a = OptimalContinuations.of(known, to_a, largest) if largest else None
    graph_b = OptimalContinuations.of(known, to_b, largest) if graph_a is not None else None
    if graph_a is None or graph_b is None:
        found = _of_plans(one_continuation(known, to_a), one_continuation(known, to_b), step, alternative, say)
    else:
        found = _of_graphs(known, graph_a, graph_b, step, alternative, say)
    if found is not None and found.kind == "needed":
        return found
    h, h_b = cost_to_go(known, [state, to_b])
    if h_b == h:  # nothing has to be undone
        return Consequence("no-closer")
    return Consequence("further") if found is None and h_b > h else found


def _of_graphs(
    known: Choices | CostToGo,
    graph_a: OptimalContinuations,
    graph_b: OptimalContinuations,
    step: str,
    alternative: str,
    say: Say,
) -> Consequence | None:
    """Return the earliest action that is needed after the alternative, or may be, from all optimal continuations."""
    actions = np.unique(graph_b.action)
    names = [action_name(known, one) for one in actions.tolist()]
    is_step = np.array([name == step for name in names], dtype=np.int32)
    told_apart = np.array([say(name) != say(step) for name in names], dtype=bool)
    fewest_b = graph_b.counts(actions)[0]
    fewest_a = graph_a.counts(actions)[0] + is_step
    most_a = graph_a.counts(actions, most=True)[0] + is_step
    # An action that would not be done otherwise says more than one that would be done less often.
    fresh = (most_a == 0) & np.array([name != alternative for name in names], dtype=bool)
    needed = (fewest_b > fewest_a) & told_apart
    some = needed if needed.any() else fresh & told_apart
    if not some.any():
        return None
    best = int(np.lexsort((actions, graph_b.earliest(actions), ~fresh, ~some))[0])
    action = int(actions[best])
    return Consequence(
        "needed" if needed[best] else "possible",
        names[best],
        again=bool(fewest_a[best] > 0) or say(names[best]) == say(alternative),
        after=tuple(action_name(known, one) for one in graph_b.with_action(action)),
        instead=tuple(action_name(known, one) for one in graph_a.with_fewest(action)),
    )


def _of_plans(instead: list[str], after: list[str], step: str, alternative: str, say: Say) -> Consequence | None:
    """Return the first action that one plan after the alternative has more often than one plan with the step."""
    otherwise = [step, *instead]
    more = [one for one in after if after.count(one) > otherwise.count(one) and say(one) != say(step)]
    more.sort(key=lambda one: one in otherwise or one == alternative)
    for action in more[:1]:
        again = action in otherwise or say(action) == say(alternative)
        return Consequence("possible", action, again, tuple(after), tuple(instead))
    return None
