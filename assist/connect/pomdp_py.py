"""Conversion of a problem to objects of the library pomdp-py."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from planner.system.errors import require_package

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from .observed import Observed, action_names


@dataclass(frozen=True)
class PomdpPy:
    """A problem as objects of pomdp-py; `agent()` combines them.

    A state is `SimpleState((x, beta, theta))`, with an observed value (see `Observed`) and two grid indices. An action
    is a `SimpleAction` with a name of `action_names`, and an observation is `SimpleObservation(x)`.

    Attributes
    ----------
    belief : pomdp_py.Histogram
        The prior over (beta, theta) in the initial state.
    policy, transition, observation, reward : models of pomdp_py
    """

    belief: Any
    policy: Any
    transition: Any
    observation: Any
    reward: Any

    def agent(self) -> Any:
        """Return a `pomdp_py.Agent`."""
        import pomdp_py

        return pomdp_py.Agent(self.belief, self.policy, self.transition, self.observation, self.reward)


def to_pomdp_py(pomdp: AssistPOMDP, rng: np.random.Generator) -> PomdpPy:
    """Return a problem as models of the library pomdp-py (extra `pomdp-py`).

    The actions of a state are its own robot actions. If the library asks without a state, all actions are returned; one
    that the state lacks has the effect described in `assist.connect.observed`. The reward is the expected reward of
    state and action, in cost units. The rollout policy does nothing, so that rollouts estimate the return without
    further assistance. The discount factor gamma is an argument of the library's planners (`discount_factor`).

    Parameters
    ----------
    pomdp : AssistPOMDP
    rng : numpy.random.Generator
        Draws the samples of the transition model; the library's planners also use the module `random`.

    Raises
    ------
    MissingExtraError
        pomdp-py is not installed.
    ValueError
        There are several goals, or the trust rule depends on whether advice is followed.
    """
    require_package("this conversion needs", "pomdp-py", "pomdp-py", "pomdp_py")
    import pomdp_py
    from pomdp_py.utils.templates import SimpleAction, SimpleObservation, SimpleState

    observed = Observed.of(pomdp)
    types, thetas = pomdp.prior.shape
    actions = [SimpleAction(name) for name in action_names(pomdp)]
    number = {action.name: r for r, action in enumerate(actions)}
    observations = [SimpleObservation(x) for x in range(len(observed.state))]

    @cache
    def rows(value: int, r: int) -> tuple[list[int], Floats, Floats | None, Floats]:
        """Return the successors of an observed value, their probabilities (Y, H, T), theta's matrix and the reward."""
        x = int(observed.state[value])
        if observed.stays(x):
            reward = np.broadcast_to(observed.reward(x, 0), (types, thetas))
            return [value], np.ones((1, types, thetas)), None, reward
        steps = observed.step(x, r)
        chances = np.array([np.broadcast_to(chance, (types, thetas)) for _, chance in steps])
        reward = np.broadcast_to(observed.reward(x, r), (types, thetas))
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
            grid = product(range(len(observed.state)), range(types), range(thetas))
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
