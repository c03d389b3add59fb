"""The objects of the library pomdp-py."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from planner.system.errors import MissingExtraError

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from .observed import Observed, action_names


@dataclass(frozen=True)
class PomdpPy:
    """A problem as objects of pomdp-py; `agent()` puts them together.

    States are `SimpleState((x, beta, theta))` with an observed value (see `Observed`) and two places in the grid,
    actions `SimpleAction` with the names of `action_names`, observations `SimpleObservation(x)`.

    Attributes
    ----------
    belief : pomdp_py.Histogram
        The prior, in the initial state.
    policy, transition, observation, reward : models of pomdp_py
    """

    belief: Any
    policy: Any
    transition: Any
    observation: Any
    reward: Any

    def agent(self) -> Any:
        """Make a `pomdp_py.Agent`."""
        import pomdp_py

        return pomdp_py.Agent(self.belief, self.policy, self.transition, self.observation, self.reward)


def to_pomdp_py(pomdp: AssistPOMDP, rng: np.random.Generator) -> PomdpPy:
    """Make the classes and models of the library pomdp-py (extra `pomdp-py`).

    The actions are those that the state has; where the library does not give the state they are all, and one that a
    state does not have does what `write_pomdpx` says. The reward is the expected one of state and action. In
    rollouts the robot does nothing, so that they estimate the return of never helping again. The library leaves
    gamma to its planners (`discount_factor`).

    Parameters
    ----------
    pomdp : AssistPOMDP
    rng : numpy.random.Generator
        Of the transition model's samples; the library's planners draw from `random` besides.

    Raises
    ------
    MissingExtraError
        pomdp-py is not installed.
    ValueError
        The problem breaks off at a frontier.
    """
    if importlib.util.find_spec("pomdp_py") is None:
        raise MissingExtraError("this conversion needs", "pomdp-py", "pomdp-py")
    import pomdp_py
    from pomdp_py.utils.templates import SimpleAction, SimpleObservation, SimpleState

    observed = Observed.of(pomdp)
    betas, thetas = pomdp.grid.shape
    goal = pomdp.model.choices.goal
    actions = [SimpleAction(name) for name in action_names(pomdp)]
    number = {action.name: r for r, action in enumerate(actions)}
    observations = [SimpleObservation(x) for x in range(len(observed.state))]

    @cache
    def rows(value: int, r: int) -> tuple[list[int], Floats, Floats | None, Floats]:
        """Give, from an observed value: those after it, their chances (Y, B, T), the theta matrix and the reward."""
        x = int(observed.state[value])
        if goal[x]:
            return [value], np.ones((1, betas, thetas)), None, np.zeros((betas, thetas))
        steps = observed.step(x, r)
        chances = np.array([np.broadcast_to(chance, (betas, thetas)) for _, chance in steps])
        reward = np.broadcast_to(observed.reward(x, r), (betas, thetas))
        return [y for y, _ in steps], chances, observed.moves(x, r), reward

    class Transition(pomdp_py.TransitionModel):
        def probability(self, next_state: Any, state: Any, action: Any) -> float:
            (x, b, t), (y, b_after, t_after) = state.data, next_state.data
            after, chances, moves, _ = rows(x, number[action.name])
            if b_after != b or y not in after:
                return 0.0
            moved = float(t_after == t) if moves is None else moves[t, t_after]
            return float(chances[after.index(y), b, t] * moved)

        def sample(self, state: Any, action: Any) -> Any:
            x, b, t = state.data
            after, chances, moves, _ = rows(x, number[action.name])
            y = after[_draw(chances[:, b, t], rng)]
            return SimpleState((y, b, t if moves is None else _draw(moves[t], rng)))

        def get_all_states(self) -> list[Any]:
            grid = product(range(len(observed.state)), range(betas), range(thetas))
            return [SimpleState(cell) for cell in grid]

    class Observation(pomdp_py.ObservationModel):
        def probability(self, observation: Any, next_state: Any, action: Any) -> float:
            return float(observation.data == next_state.data[0])

        def sample(self, next_state: Any, action: Any) -> Any:
            return observations[next_state.data[0]]

        def get_all_observations(self) -> list[Any]:
            return observations

    class Reward(pomdp_py.RewardModel):
        def sample(self, state: Any, action: Any, next_state: Any) -> float:
            x, b, t = state.data
            return float(rows(x, number[action.name])[3][b, t])

    class Actions(pomdp_py.RolloutPolicy):
        def get_all_actions(self, state: Any = None, history: Any = None) -> list[Any]:
            return actions if state is None else actions[: pomdp.robot_actions[observed.state[state.data[0]]]]

        def sample(self, state: Any) -> Any:
            offered = self.get_all_actions(state)
            return offered[rng.integers(len(offered))]

        def rollout(self, state: Any, history: Any = None) -> Any:
            return actions[0]

    x = pomdp.model.choices.initial
    belief = {
        SimpleState((x, b, t)): float(pomdp.prior[b, t])
        for b, t in zip(*(i.tolist() for i in np.nonzero(pomdp.prior)), strict=True)
    }
    return PomdpPy(pomdp_py.Histogram(belief), Actions(), Transition(), Observation(), Reward())


def _draw(chances: Floats, rng: np.random.Generator) -> int:
    total = np.cumsum(chances)
    return int(np.searchsorted(total, rng.random() * total[-1], side="right"))
