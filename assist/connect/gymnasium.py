"""The team problem as a Gymnasium environment: one agent chooses which person the robot visits and what it does there.

Importing this module registers `kitassist/Team-v0`. Gymnasium imports the module if its name precedes the id:

    import gymnasium

    env = gymnasium.make("assist.connect.gymnasium:kitassist/Team-v0", instance="kitting/tiny", humans=2)
    many = gymnasium.make_vec("kitassist/Team-v0", num_envs=1024, instance="kitting/tiny", humans=2)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner import task_of
from planner.system.errors import MissingExtraError, nearest

from ..drawing.picture import Artist
from ..people.arguments import whole
from ..people.choices import Choices
from ..people.decision import Floats
from ..people.goals import Goals
from ..people.ranges import Population
from ..person.settings import Setting
from ..team.beginning import World
from ..team.common_random_numbers import CommonRandomNumbers
from ..team.pool import Pool
from ..team.state import BASE, NOBODY, TeamAction, TeamState
from .rendering import draw_team
from .teams import PoolSource, Sight, Teams

if TYPE_CHECKING:
    from planner import AnyTask

try:
    import gymnasium
except ImportError:
    raise MissingExtraError("environments need", "gymnasium", "gym") from None

ID = "kitassist/Team-v0"

OPTIONS = ("episode", "team")
"""Options with which an episode of one team begins."""

Observation = dict[str, Any]


class _Desk:
    """The teams, observations and numbering of actions that `TeamEnv` and `TeamVectorEnv` share."""

    def __init__(
        self, pool: Pool, teams: int, humans: int, *, beliefs: bool, distance: ArrayLike | None, world: World,
        filters: bool = True,
    ) -> None:  # fmt: skip
        self.teams = Teams(pool, teams, humans, distance=distance, world=world, filters=filters)
        self.sight = Sight(self.teams, beliefs=beliefs)
        self.actions = 1 + humans * self.sight.actions
        robots = len(self.teams.fleet)
        self.axis = () if robots == 1 else (robots,)  # of actions: that of one robot is a number, without an axis

    def spaces(self) -> tuple[gymnasium.spaces.Dict, gymnasium.spaces.Space[Any]]:
        """Return the observation space and the action space of one team."""
        spaces, sight, humans = gymnasium.spaces, self.sight, self.teams.x.shape[1]
        robots = len(self.teams.fleet)
        seen: dict[str, gymnasium.spaces.Space[Any]] = {
            "action_mask": spaces.MultiBinary([*self.axis, self.actions]),
            "active": spaces.MultiBinary(humans),
            "alone": spaces.Box(0.0, 1.0, (humans, sight.actions), np.float32),
            "cost_to_go": spaces.Box(0.0, sight.largest, (humans,), np.float32),
            "erred": spaces.MultiBinary(humans),
            "ready": spaces.MultiBinary(robots),
            "location": spaces.MultiDiscrete([humans + 1] * robots),
            "model": spaces.MultiDiscrete([sight.models] * humans),
            "state": spaces.MultiDiscrete([sight.states] * humans),
        }
        if sight.beliefs:
            seen["belief"] = spaces.Box(0.0, 1.0, (humans, *sight.hidden), np.float32)
        one = spaces.Discrete(self.actions)
        return spaces.Dict(seen), spaces.MultiDiscrete([self.actions] * robots) if self.axis else one

    def mask(self) -> NDArray[np.int8]:
        """Return the mask of possible actions of each robot, shape (N, M, actions).

        Action 0 (do nothing) is always possible. It is the only one while the robot is under way.
        """
        teams, team = self.teams, self.teams.state()
        possible = self.sight.mask()[:, None] * team.reachable()[..., None]
        possible[..., 1:] *= (teams.travel.steps_from(teams.location) == 0)[..., None]  # the robot acts on arrival
        able = np.isfinite(team.extra_costs(self.sight.actions))  # not all can execute
        possible *= able[:, teams.fleet.kinds[1]]
        flat = possible.reshape(*possible.shape[:-2], -1).astype(np.int8)
        return np.concatenate([np.ones((*flat.shape[:-1], 1), dtype=np.int8), flat], axis=-1)

    def shown_mask(self) -> NDArray[np.int8]:
        """Return the mask for the action space, shape (N, actions) for one robot, otherwise (N, M, actions)."""
        mask = self.mask()
        return mask.reshape(len(mask), *self.axis, -1)

    def observe(self) -> Observation:
        """Return the observation of all teams; the first axis of each array is the team, N."""
        return {
            "action_mask": self.shown_mask(),
            "ready": self.teams.ready().astype(np.int8),
            "location": self.teams.location + 1,
            **self.sight.seen(),
        }

    def decode(self, numbers: NDArray[np.int64]) -> TeamAction:
        """Return the team actions that numbers of shape (N, M) stand for.

        0 does nothing; 1 + k R + r sends the robot to person k and does robot action r there.
        """
        person, does = np.divmod(numbers - 1, self.sight.actions)
        stays = numbers == 0
        return TeamAction(np.where(stays, NOBODY, person), np.where(stays, 0, does))

    def are_actions(self, numbers: NDArray[Any]) -> bool:
        """Return whether all are numbers of actions."""
        return numbers.dtype.kind in "iu" and bool(((numbers >= 0) & (numbers < self.actions)).all())

    def encode(self, action: TeamAction) -> NDArray[np.int64]:
        """Return the numbers of team actions as in the action space, shape (N,) for one robot, otherwise (N, M)."""
        numbers = np.where(action.person == NOBODY, 0, 1 + action.person * self.sight.actions + action.action)
        return numbers.reshape(len(numbers), *self.axis)

    def step(self, rows: NDArray[np.int64], numbers: NDArray[np.int64]) -> tuple[Any, Any, Any]:
        """Advance some teams by one step.

        Returns
        -------
        illegal : bool array, shape (N, M)
            Whether the action was impossible and did nothing.
        done : pair of int arrays, shape (N, K)
            The robot action on each person, and the slot of each person's action.
        reward : float array, shape (N,)
            In cost units.
        """
        teams = self.teams
        illegal = np.take_along_axis(self.mask(), numbers[..., None], axis=-1)[..., 0] == 0
        illegal |= teams.collisions(self.decode(np.where(illegal, 0, numbers)).person)
        moved = np.zeros(numbers.shape, dtype=bool)
        moved[rows] = ~illegal[rows]
        taken = teams.step(rows, self.decode(np.where(moved, numbers, 0)))
        return illegal, (taken.heard, taken.slot), taken.reward.sum(axis=1)


class TeamEnv(gymnasium.Env):
    """A robot and a team of K people, as an environment with one agent.

    Action 0 does nothing. Action 1 + k R + r sends the robot to person k, where it does robot action r: 0 says nothing,
    the others suggest. `action_mask`, in the observation and in `info`, marks the possible actions. An impossible one
    does nothing and sets `info["illegal"]`. The reward is minus the cost of the step, in cost units, undiscounted. An
    episode terminates when all people have finished and is truncated after `setting.max_steps` steps.

    With M robots, M > 1 (`setting.robots`), an action is M such numbers, one for each robot, and `action_mask` has the
    shape (M, actions). `location`, `ready` and `illegal` always have the shape (M,). A robot that is sent to a person
    with whom another one is at work, or to whom one with a lower number goes, stays where it is; one without a task
    makes room.

    After `reset(seed=s)` the episodes are episodes 0, 1, ... of `simulate(pool, ..., humans=K, episodes=n, seed=s)`,
    with the same random numbers. The same actions therefore have the same outcome. The first `reset(seed=s)` draws the
    pool of `kitassist simulate --seed s`, and later ones keep it, unless a pool is given. `team` is the state that team
    policies read.

    Parameters
    ----------
    instance : Pool, cost-to-go, or whatever `planner.load` takes
        The task, such as a file or a table, or an existing pool.
    humans : int
        K, the number of people in a team.
    beliefs : bool
        Whether the observation holds the belief over (beta, theta). Otherwise it holds the states of the task only.
    setting, population
        As in `Pool.sample`; not together with a pool. Teams are drawn from 12 people, or from K if that is more.
    distance : array, shape (K + 1, K + 1), optional
        As in `Travel.of`.
    world : "people" or "model"
        As in `simulate`.
    render_mode : "rgb_array" or "svg", optional
        The type of the picture of all tasks: an array of shape (height, width, 3), or the text of an SVG document.

    Raises
    ------
    ValueError
        `render_mode` is unknown, `humans` is not between 1 and the size of the pool, or a parameter has no effect.
    TypeError
        `instance` is something else, such as a list of tasks.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array", "svg"], "render_fps": 1}

    def __init__(
        self, instance: AnyTask | Pool, humans: int = 2, *, beliefs: bool = True, setting: Setting | None = None,
        population: Population | None = None, distance: ArrayLike | None = None, world: World = "people",
        render_mode: str | None = None,
    ) -> None:  # fmt: skip
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r}: expected {' or '.join(self.metadata['render_modes'])}")
        self._instance, self.render_mode = instance, render_mode
        self._source = PoolSource(instance, humans, setting, population)
        self._made = partial(_Desk, teams=1, humans=humans, beliefs=beliefs, distance=distance, world=world)
        self._desk = self._made(self._source.pool)
        self.observation_space, self.action_space = self._desk.spaces()
        self._seed: int | None = None
        self._episode = -1
        self._draws: CommonRandomNumbers | None = None
        self._seen: list[tuple[int, str]] = []
        self._artist: Artist | None = None

    @property
    def pool(self) -> Pool:
        """The pool from which teams are drawn."""
        return self._desk.teams.pool

    @property
    def team(self) -> TeamState:
        """The state of the team as team policies read it."""
        return self._desk.teams.state()

    @property
    def is_free(self) -> bool:
        """Whether a robot has arrived and may act."""
        return bool(self._desk.teams.ready()[0].any())

    @property
    def actions(self) -> int:
        """The number of actions of a robot."""
        return self._desk.actions

    def encode(self, action: TeamAction) -> Any:
        """Return the number of a team policy's action, or an array of M > 1 numbers."""
        numbers = self._desk.encode(action)[0]
        return numbers if self._desk.axis else int(numbers)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of possible actions, shape (actions,), or (M * actions,): the interface of MaskablePPO."""
        return self._desk.mask()[0].astype(bool).reshape(-1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next episode, or the first one if a seed is given.

        Parameters
        ----------
        seed : int, optional
        options : dict, optional
            `episode` is the number of the episode to begin, instead of the next; `team` has its people, by name or by
            their numbers in the pool, shape (K,). Others are ignored, with a warning if it looks like a slip.

        Raises
        ------
        ValueError
            An option has an unsuitable value. The next call begins the same episode as without this one.
        """
        super().reset(seed=seed)
        options = options or {}
        _warn_of_others(options, OPTIONS)
        episode = whole("episode", options.get("episode", 0 if seed is not None else self._episode + 1))
        if self._source.drawn(seed):
            self._desk = self._made(self._source.pool)
        teams = self._desk.teams
        people = np.atleast_2d(teams.pool.numbers(options["team"])) if "team" in options else None
        if people is not None and people.shape != teams.x.shape:
            raise ValueError(f"team of {people.size}: expected {teams.x.shape[1]} people")
        if seed is not None or self._seed is None:
            self._seed = seed if seed is not None else int(self.np_random.integers(2**63))
        self._episode = episode
        draws = self._draws = CommonRandomNumbers(self._seed, np.array([episode]), teams.x.shape[1])
        teams.draw_from(draws)
        people = draws.team(len(teams.pool.people)) if people is None else people
        teams.begin(np.zeros(1, dtype=np.int64), people, lambda kind: draws.draw(kind, np.zeros(1, dtype=np.int64)))
        self._seen = []
        return self._observation(), self._info(np.zeros(teams.location.shape[1:], dtype=bool))

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Apply the robot's action, then let each person who has not finished act once.

        Raises
        ------
        gymnasium.error.ResetNeeded
            No episode has begun.
        ValueError
            The action is out of range.
        """
        if self._draws is None:
            raise gymnasium.error.ResetNeeded("step: expected reset before it")
        teams = self._desk.teams
        number, robots = np.asarray(action), len(teams.fleet)
        if number.size != robots or not self._desk.are_actions(number):
            each = f", for each of {robots} robots" * (robots > 1)
            raise ValueError(f"action {action!r}: expected a whole number from 0 to {self._desk.actions - 1}{each}")
        number, before = number.astype(np.int64).reshape(1, robots), teams.row[0].copy()
        illegal, (heard, slot), reward = self._desk.step(np.zeros(1, dtype=np.int64), number)
        if self.render_mode is not None:
            self._remember(before, heard[0], slot[0])
        terminated = bool(teams.finished.all())
        truncated = not terminated and bool(teams.clock[0] >= teams.pool.setting.max_steps)
        return self._observation(), float(reward[0]), terminated, truncated, self._info(illegal[0])

    def _observation(self) -> Observation:
        return {name: array[0] for name, array in self._desk.observe().items()}

    def _info(self, illegal: NDArray[np.bool_]) -> dict[str, Any]:
        teams = self._desk.teams
        return {
            "action_mask": self._desk.shown_mask()[0], "illegal": illegal, "episode_number": self._episode,
            "people": teams.people[0].copy(), "steps": int(teams.clock[0]),
        }  # fmt: skip

    def _remember(self, x: NDArray[np.int64], heard: NDArray[np.int64], slot: NDArray[np.int64]) -> None:
        """Record the actions of a step for later pictures."""
        for place, number in enumerate(self._desk.teams.people[0]):
            pomdp = self.pool.policies[self.pool.model[number]].pomdp
            executed = pomdp.executes(int(x[place]), int(heard[place]))
            after = int(pomdp.afterstate[x[place], heard[place]])
            done = [executed] if executed else []
            done += [pomdp.model.choices.name(after, int(slot[place]))] if slot[place] >= 0 else []
            self._seen += [(place, action) for action in done if action]

    def render(self) -> Any:
        """Return a picture of the current state of all tasks; None without a `render_mode`.

        Raises
        ------
        TypeError
            The environment was made from a pool that has no task to draw, such as a union of pools.
        MissingExtraError
            The mode is "rgb_array" and the extra `plots` is not installed.
        """
        if self.render_mode is None:
            return None
        if self._artist is None:
            task = self._instance.known if isinstance(self._instance, Pool) else self._instance
            if task is None or isinstance(task, Choices | Goals):
                raise TypeError("render: expected an environment of one task, and this pool has none to draw")
            self._artist = Artist(task_of(task))
        teams = self._desk.teams
        there = np.where(teams.ready()[0], teams.location[0], BASE).tolist()
        return draw_team(
            self._artist, self._seen, teams.finished[0], there, int(teams.clock[0]), as_svg=self.render_mode == "svg"
        )


class TeamVectorEnv(gymnasium.vector.VectorEnv):
    """A batch of N teams that advance in one compiled step, with actions, observations and rewards as in `TeamEnv`.

    A team whose episode has ended begins the next one in the following step (`AutoresetMode.NEXT_STEP`). The action of
    that step is ignored. After `reset(seed=s)` the first episode of team i is episode i of `simulate`.

    Parameters
    ----------
    instance : Pool, cost-to-go, or whatever `planner.load` takes
    num_envs : int
        N, the number of teams.
    humans, beliefs, setting, population, distance, world
        As in `TeamEnv`. Without `beliefs` no filters are run, and `team.belief` is None.
    """

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}

    def __init__(
        self, instance: AnyTask | Pool, num_envs: int = 1, humans: int = 2, *, beliefs: bool = True,
        setting: Setting | None = None, population: Population | None = None, distance: ArrayLike | None = None,
        world: World = "people",
    ) -> None:  # fmt: skip
        self.num_envs = num_envs
        self._source = PoolSource(instance, humans, setting, population)
        self._made = partial(
            _Desk, teams=num_envs, humans=humans, beliefs=beliefs, distance=distance, world=world, filters=beliefs
        )
        self._desk = self._made(self._source.pool)
        self.single_observation_space, self.single_action_space = self._desk.spaces()
        batch = gymnasium.vector.utils.batch_space
        self.observation_space = batch(self.single_observation_space, num_envs)
        self.action_space = batch(self.single_action_space, num_envs)
        self._draws: CommonRandomNumbers | None = None
        self._ended = np.zeros(num_envs, dtype=bool)

    @property
    def pool(self) -> Pool:
        """The pool from which teams are drawn."""
        return self._desk.teams.pool

    @property
    def team(self) -> TeamState:
        """The state of the teams as team policies read it."""
        return self._desk.teams.state()

    def encode(self, action: TeamAction) -> NDArray[np.int64]:
        """Return the numbers of a team policy's actions, shape (N,), or (N, M) with M robots."""
        return self._desk.encode(action)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the mask of possible actions, shape (N, actions), or (N, M, actions) with M robots."""
        return self._desk.mask().astype(bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in every team.

        Parameters
        ----------
        seed : int or sequence of int, optional
            A sequence is combined into one seed, since all teams use one random generator.
        options : dict, optional
            There are none.
        """
        _warn_of_others(options or {}, ())
        super().reset(
            seed=None if seed is None else seed if isinstance(seed, int) else _one_seed(seed), options=options
        )
        given = self.np_random_seed if seed is not None else None
        number = int(self.np_random.integers(2**63)) if given is None else int(given)
        if self._source.drawn(None if given is None else number):
            self._desk = self._made(self._source.pool)
        teams = self._desk.teams
        self._draws = CommonRandomNumbers(number, np.arange(self.num_envs), teams.x.shape[1])
        teams.draw_from(self._draws)
        self._begin(np.arange(self.num_envs), self._draws)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        return self._observed(np.zeros(teams.location.shape, dtype=bool))

    def _begin(self, rows: NDArray[np.int64], draws: CommonRandomNumbers) -> None:
        people = draws.team(len(self.pool.people))[rows]
        self._desk.teams.begin(rows, people, lambda kind: draws.draw(kind, rows))

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[Observation, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Let every robot act, and then everybody who has not finished."""
        if self._draws is None:
            raise gymnasium.error.ResetNeeded("step: expected reset before it")
        numbers = np.asarray(actions)
        teams, ended = self._desk.teams, self._ended
        shape = (self.num_envs, *self._desk.axis)
        if numbers.shape != shape or not self._desk.are_actions(numbers):
            raise ValueError(
                f"actions: expected whole numbers from 0 to {self._desk.actions - 1} in an array of shape {shape}"
            )
        each = numbers.astype(np.int64).reshape(teams.location.shape)
        illegal, _, reward = self._desk.step(np.flatnonzero(~ended), each)
        if ended.any():
            self._begin(np.flatnonzero(ended), self._draws)
        terminated = np.logical_and.reduce(teams.finished, axis=1)
        truncated = ~terminated & (teams.clock >= self.pool.setting.max_steps)
        self._ended = terminated | truncated
        seen, info = self._observed(illegal & ~ended[:, None])
        return seen, np.where(ended, 0.0, reward), terminated, truncated, info

    def _observed(self, illegal: NDArray[np.bool_]) -> tuple[Observation, dict[str, Any]]:
        seen = self._desk.observe()
        return seen, {"action_mask": seen["action_mask"].copy(), "illegal": illegal}


def _warn_of_others(options: dict[str, Any], known: tuple[str, ...]) -> None:
    """Warn of names that are like those of options, and are none here.

    Others are ignored, as Gymnasium's environments do: checks of libraries pass some.
    """
    for name in options.keys() - set(known):
        if (near := nearest(name, OPTIONS)) is not None:
            meant = f"did you mean {near!r}?" if near in known else "expected no options for a batch of teams"
            warnings.warn(f"options: {name!r} has no effect; {meant}", stacklevel=3)


def _one_seed(seeds: Sequence[int | None]) -> int:
    return int(np.random.SeedSequence([0 if seed is None else 1 + seed for seed in seeds]).generate_state(1)[0])


if ID not in gymnasium.registry:
    gymnasium.register(
        ID, entry_point=f"{__name__}:{TeamEnv.__name__}", vector_entry_point=f"{__name__}:{TeamVectorEnv.__name__}"
    )
