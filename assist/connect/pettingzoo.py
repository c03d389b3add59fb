"""PettingZoo's parallel environment with one agent for each robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from planner.system.errors import MissingExtraError

from ..team.pool import Pool
from ..team.state import TeamAction, TeamState
from .gymnasium import TeamEnv

if TYPE_CHECKING:
    from planner import AnyTask

try:
    import gymnasium
    import pettingzoo
except ImportError as error:
    raise MissingExtraError("environments need", str(error.name), "gym") from None


class RobotsEnv(pettingzoo.ParallelEnv):
    """M robots that move between K people and decide at the same time: `TeamEnv` with one agent for each robot.

    An agent's action is a number as in `TeamEnv`, for its robot. Its observation is that of the team, with the mask of
    its own actions. In `location` and `ready`, its own entry is the first, and others follow in their order. A robot
    that is sent to a person with whom another one is at work, or to whom one with a lower number goes, stays where it
    is; its `info["illegal"]` says so. One without a task makes room. Every agent receives the team's reward.
    All terminate when all people have finished, and are truncated after `setting.max_steps` steps.

    Parameters
    ----------
    instance : Pool, cost-to-go, or whatever `planner.load` takes
        The task, such as a file or a table, or an existing pool.
    humans : int
        K, the number of people.
    **options
        Further arguments of `TeamEnv`. M is `setting.robots`.

    Raises
    ------
    ValueError
        As from `TeamEnv`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "kitassist_robots_v0",
        "render_modes": TeamEnv.metadata["render_modes"],
        "is_parallelizable": True,
    }

    def __init__(self, instance: AnyTask | Pool, humans: int = 2, **options: Any) -> None:
        self._env = TeamEnv(instance, humans, **options)
        self.render_mode = self._env.render_mode
        self._robots, self._robot_actions = len(self.pool.setting.robots), self._env.actions
        self.possible_agents = [f"robot_{number}" for number in range(self._robots)]
        self.agents: list[str] = []
        self.observation_spaces = {agent: self._space() for agent in self.possible_agents}
        self.action_spaces = {agent: gymnasium.spaces.Discrete(self._robot_actions) for agent in self.possible_agents}

    def _space(self) -> Any:
        spaces = gymnasium.spaces
        return spaces.Dict(
            {
                **self._env.observation_space.spaces,
                "action_mask": spaces.MultiBinary(self._robot_actions),
            }
        )

    def observation_space(self, agent: str) -> Any:
        """Return an agent's observation space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return an agent's action space, always the same object."""
        return self.action_spaces[agent]

    @property
    def pool(self) -> Pool:
        """The pool from which teams are drawn."""
        return self._env.pool

    @property
    def team(self) -> TeamState:
        """The state of the team as team policies read it."""
        return self._env.team

    def encode(self, action: TeamAction) -> dict[str, int]:
        """Return the agents' actions for a team policy's action."""
        return dict(zip(self.possible_agents, np.ravel(self._env.encode(action)).tolist(), strict=True))

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the next episode, or the first one if a seed is given.

        Parameters
        ----------
        seed : int, optional
        options : dict, optional
            As in `TeamEnv.reset`.
        """
        seen, info = self._env.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        return self._each(seen), self._informed(info)

    def step(self, actions: dict[str, int]) -> tuple[dict[str, Any], ...]:
        """Apply the robots' actions, then let each person who has not finished act once.

        Raises
        ------
        ValueError
            The action of a robot is missing, or no whole number in the range.
        """
        if missing := [agent for agent in self.agents if agent not in actions]:
            raise ValueError(f"actions: expected one of {missing[0]}")
        if not self.agents:
            return {}, {}, {}, {}, {}
        numbers = np.array([actions[agent] for agent in self.agents])
        seen, reward, terminated, truncated, info = self._env.step(numbers)
        agents = self.agents
        if terminated or truncated:
            self.agents = []
        same = (dict.fromkeys(agents, value) for value in (reward, terminated, truncated))
        return self._each(seen), *same, self._informed(info)

    def _each(self, seen: dict[str, Any]) -> dict[str, Any]:
        mask = seen["action_mask"].reshape(self._robots, -1)
        there, ready = seen["location"], seen["ready"]
        found = {}
        for number, agent in enumerate(self.possible_agents):
            own = [number, *(other for other in range(self._robots) if other != number)]
            changed = {"action_mask": mask[number], "ready": ready[own], "location": there[own]}
            found[agent] = {name: np.array(value) for name, value in (seen | changed).items()}
        return found

    def _informed(self, info: dict[str, Any]) -> dict[str, Any]:
        mask, illegal = info["action_mask"].reshape(self._robots, -1), info["illegal"].tolist()
        return {
            agent: {**info, "action_mask": mask[number], "illegal": illegal[number]}
            for number, agent in enumerate(self.possible_agents)
        }

    def render(self) -> Any:
        """Return a picture of all tasks, as `TeamEnv.render` does."""
        return self._env.render()

    def close(self) -> None:
        """Do nothing; the environment holds no resources."""


parallel_env = RobotsEnv
"""The name that PettingZoo gives what makes a parallel environment."""
