"""PettingZoo parallel environments with one agent for each robot.

In `StationsEnv` each of K people has a robot of their own. In `RobotsEnv` M robots move between K people.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from planner.system.errors import MissingExtraError

from ..people.human import Population
from ..people.mixture import Mixture
from ..simulation.common_random_numbers import CommonRandomNumbers
from ..simulation.model_group import World
from ..simulation.pool import Pool
from ..team.robots import require_one_robot
from ..team.settings import Setting
from ..team.state import TeamAction, TeamState
from .gymnasium import TeamEnv
from .teams import PoolSource, Sight, Teams

try:
    import gymnasium
    import pettingzoo
except ImportError as error:
    raise MissingExtraError("environments need", str(error.name), "gym") from None


class StationsEnv(pettingzoo.ParallelEnv):
    """K stations with one person and one robot each; the robots do not move.

    An agent's actions are the robot actions of its person's problem: 0 says nothing, the others suggest.
    `action_mask`, in the observation and in `info`, marks the possible actions. An impossible one does nothing and
    sets `info["illegal"]`. The reward is minus the cost of the step at the station (of all stations if `shared`), in
    cost units. An agent terminates when its person has finished. All are truncated after `setting.max_steps` steps.

    After `reset(seed=s)` the episodes have the people and the random numbers of episodes 0, 1, ... of `simulate` with
    that seed. The pool is that of `TeamEnv`.

    Parameters
    ----------
    instance : str, Path or Pool
        The task, by its file or name, or an existing pool.
    humans : int
        K, the number of stations.
    beliefs : bool
        Whether the observations hold the beliefs over (beta, theta).
    shared : bool
        Whether each agent receives the sum of all rewards.
    people, pool_seed, setting, population
        As in `TeamEnv`.
    world : "people" or "model"
        As in `simulate`.

    Raises
    ------
    ValueError, TypeError
        As from `TeamEnv`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "kitassist_stations_v0",
        "render_modes": [],
        "is_parallelizable": True,
    }

    def __init__(
        self, instance: str | Path | Pool, humans: int = 2, *, beliefs: bool = True, shared: bool = False,
        people: int | None = None, pool_seed: int | None = None, setting: Setting | None = None,
        population: Population | Mixture | None = None, world: World = "people",
    ) -> None:  # fmt: skip
        self._source = PoolSource(
            instance, humans, people=people, seed=pool_seed, setting=setting, population=population
        )
        require_one_robot(self._source.pool.setting, "each station")
        self._made = partial(Teams, teams=1, places=humans, world=world)
        self._teams = self._made(self._source.pool)
        self._sight = Sight(self._teams, beliefs=beliefs)
        self._shared, self.render_mode = shared, None
        self.possible_agents = [f"robot_{place}" for place in range(humans)]
        self.agents: list[str] = []
        self.observation_spaces = {agent: self._space() for agent in self.possible_agents}
        self.action_spaces = {agent: gymnasium.spaces.Discrete(self._sight.robots) for agent in self.possible_agents}
        self._seed: int | None = None
        self._episode = -1

    def _space(self) -> Any:
        spaces, sight = gymnasium.spaces, self._sight
        seen = {
            "action_mask": spaces.MultiBinary(sight.robots),
            "active": spaces.Discrete(2),
            "alone": spaces.Box(0.0, 1.0, (sight.robots,), np.float32),
            "cost_to_go": spaces.Box(0.0, sight.largest, (), np.float32),
            "erred": spaces.Discrete(2),
            "model": spaces.Discrete(sight.models),
            "state": spaces.Discrete(sight.states),
        }
        if sight.beliefs:
            seen["belief"] = spaces.Box(0.0, 1.0, sight.hidden, np.float32)
        return spaces.Dict(seen)

    def observation_space(self, agent: str) -> Any:
        """Return an agent's observation space, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return an agent's action space, always the same object."""
        return self.action_spaces[agent]

    @property
    def pool(self) -> Pool:
        """The pool from which teams are drawn."""
        return self._teams.pool

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the next episode, or the first one if a seed is given.

        Parameters
        ----------
        seed : int, optional
        options : dict, optional
            `episode` is the number of the episode to begin, instead of the next.
        """
        if seed is not None or self._seed is None:
            self._seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            self._episode = -1
        if self._source.drawn(seed):
            self._teams = self._made(self._source.pool)
            self._sight = Sight(self._teams, beliefs=self._sight.beliefs)
        self._episode = int((options or {}).get("episode", self._episode + 1))
        teams, row = self._teams, np.zeros(1, dtype=np.int64)
        draws = self._draws = CommonRandomNumbers(self._seed, np.array([self._episode]), len(self.possible_agents))
        teams.begin(row, draws.team(len(teams.pool.people)), lambda: draws.draw(0, row))
        self.agents = list(self.possible_agents)
        return self._observed(dict.fromkeys(self.agents, False))

    def step(self, actions: dict[str, int]) -> tuple[dict[str, Any], ...]:
        """Apply the robots' actions, then let each person who has not finished act once.

        Raises
        ------
        ValueError
            The action of a robot is missing or out of range.
        """
        for agent in self.agents:
            if actions.get(agent) not in self.action_spaces[agent]:
                raise ValueError(f"action {actions.get(agent)} of {agent}: expected 0 to {self._sight.robots - 1}")
        teams, row = self._teams, np.zeros(1, dtype=np.int64)
        robot = np.zeros_like(teams.x)
        illegal = {}
        possible = self._sight.mask()[0]
        places = {agent: self.possible_agents.index(agent) for agent in self.agents}
        for agent, place in places.items():
            wanted = int(actions[agent])
            illegal[agent] = not possible[place, wanted]
            robot[0, place] = 0 if illegal[agent] else wanted
        draws = np.empty((*teams.x.shape, 2))
        for kind in (1, 2) if teams.on_grid else (1,):
            draws[..., kind - 1] = self._draws.draw(kind, row)
        _, cost = teams.step(row, robot, draws)
        rewards = {agent: -float(cost.sum() if self._shared else cost[0, place]) for agent, place in places.items()}
        terminated = {agent: bool(teams.finished[0, place]) for agent, place in places.items()}
        late = bool(teams.clock[0] >= teams.pool.setting.max_steps)
        truncated = {agent: late and not ended for agent, ended in terminated.items()}
        seen, info = self._observed(illegal)
        self.agents = [agent for agent in self.agents if not (terminated[agent] or truncated[agent])]
        return seen, rewards, terminated, truncated, info

    def _observed(self, illegal: dict[str, bool]) -> tuple[dict[str, Any], dict[str, Any]]:
        seen, possible = self._sight.seen(), self._sight.mask()[0]
        observations, infos = {}, {}
        for agent in self.agents:
            place = self.possible_agents.index(agent)
            own = {name: array[0, place] for name, array in seen.items()}
            own |= {name: np.int64(own[name]) for name in ("active", "erred")}
            own["cost_to_go"] = np.array(own["cost_to_go"], dtype=np.float32)
            observations[agent] = {"action_mask": possible[place].copy(), **own}
            infos[agent] = {"action_mask": possible[place].copy(), "illegal": illegal[agent]}
        return observations, infos

    def render(self) -> None:
        """Do nothing; this environment has no pictures (see `TeamEnv`)."""

    def close(self) -> None:
        """Do nothing; the environment holds no resources."""


class RobotsEnv(pettingzoo.ParallelEnv):
    """M robots that move between K people and decide at the same time: `TeamEnv` with one agent for each robot.

    An agent's action is a number as in `TeamEnv`, for its robot. Its observation is that of the team, with the mask of
    its own actions. In `location` and `free`, its own entry is the first, and the others follow in their order. A robot
    that is sent to a person with whom another one is, or to whom one with a lower number goes, stays where it is; its
    `info["illegal"]` says so. If robots differ, one without a task makes room. Every agent receives the team's reward.
    All terminate when all people have finished, and are truncated after `setting.max_steps` steps.

    Parameters
    ----------
    instance : str, Path or Pool
        The task, by its file or name, or an existing pool.
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

    def __init__(self, instance: str | Path | Pool, humans: int = 2, **options: Any) -> None:
        self._env = TeamEnv(instance, humans, **options)
        self.render_mode = self._env.render_mode
        self._robots, self._robot_actions = self.pool.setting.robot_count, self._env.actions
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
                "free": spaces.MultiBinary(self._robots),
                "location": spaces.MultiDiscrete([self._env.team.x.shape[1] + 1] * self._robots),
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
            The action of a robot is missing or out of range.
        """
        if missing := [agent for agent in self.agents if agent not in actions]:
            raise ValueError(f"actions: expected one of {missing[0]}")
        if not self.agents:
            return {}, {}, {}, {}, {}
        numbers = np.array([int(actions[agent]) for agent in self.agents])
        seen, reward, terminated, truncated, info = self._env.step(numbers if self._robots > 1 else numbers[0])
        agents = self.agents
        if terminated or truncated:
            self.agents = []
        same = (dict.fromkeys(agents, value) for value in (reward, terminated, truncated))
        return self._each(seen), *same, self._informed(info)

    def _each(self, seen: dict[str, Any]) -> dict[str, Any]:
        mask = seen["action_mask"].reshape(self._robots, -1)
        there, free = np.ravel(seen["location"]), np.ravel(seen["free"]).astype(np.int8)
        found = {}
        for number, agent in enumerate(self.possible_agents):
            own = [number, *(other for other in range(self._robots) if other != number)]
            changed = {"action_mask": mask[number], "free": free[own], "location": there[own]}
            found[agent] = {name: np.array(value) for name, value in (seen | changed).items()}
        return found

    def _informed(self, info: dict[str, Any]) -> dict[str, Any]:
        mask, illegal = info["action_mask"].reshape(self._robots, -1), np.ravel(info["illegal"]).tolist()
        return {
            agent: {**info, "action_mask": mask[number], "illegal": illegal[number]}
            for number, agent in enumerate(self.possible_agents)
        }

    def render(self) -> Any:
        """Return a picture of all tasks, as `TeamEnv.render` does."""
        return self._env.render()

    def close(self) -> None:
        """Do nothing; the environment holds no resources."""


def parallel_env(instance: str | Path | Pool, humans: int = 2, **options: Any) -> StationsEnv | RobotsEnv:
    """Return a parallel environment: `StationsEnv`, or `RobotsEnv` if the setting has several robots.

    Parameters
    ----------
    instance : str, Path or Pool
    humans : int
    **options
        Further arguments of the environment.
    """
    setting = instance.setting if isinstance(instance, Pool) else options.get("setting")
    several = setting is not None and setting.robot_count > 1
    return RobotsEnv(instance, humans, **options) if several else StationsEnv(instance, humans, **options)
