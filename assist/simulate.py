"""Episodes of a team: several people at work, one robot.

All episodes advance together, one step at a time. The random numbers of an episode depend on the seed and
the episode's number alone, so that policies meet the same people with the same luck (common random
numbers), and results do not depend on how episodes are divided.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .attention import (
    BASE,
    NOBODY,
    AttentionSwitching,
    NoAssistance,
    Reactive,
    TeamAction,
    TeamPolicy,
    TeamState,
    distances,
)
from .belief import Grid
from .choices import Choices
from .human import (
    NOTHING,
    Floats,
    Human,
    HumanModel,
    Mixture,
    Population,
    choice,
    influence,
    perceived_cost,
    perceived_value,
    trust,
)
from .mdp import qmdp
from .pomdp import AssistPOMDP, Policy, Suggestions

Knowledge = Literal["own", "exact"]
POLICIES = ("none", "reactive", "attention")
CHUNK = 4_000_000  # random numbers that are held at a time


@dataclass(frozen=True)
class Setting:
    """What a simulation takes for granted.

    Attributes
    ----------
    gamma : float
        Discount factor per step.
    c_suggest, c_move : float
        Cost of a suggestion, and of moving by a distance of 1, in cost units.
    eta : float
        Rate of the trust update.
    utility_scale : float
        The unit of value in the trust update, in cost units.
    lapse : float
        Weight of a uniform choice in the robot's model of people.
    knowledge : "own" or "exact"
        Whether the robot knows each person's perceived costs (as in the paper) or only h*.
    suggestions : "optimal" or "all"
    max_steps : int
        An episode is cut off after this many steps.
    """

    gamma: float = 0.99
    c_suggest: float = 0.5
    c_move: float = 0.5
    eta: float = 0.2
    utility_scale: float = 1.0
    lapse: float = 1e-3
    knowledge: Knowledge = "own"
    suggestions: Suggestions = "optimal"
    max_steps: int = 500

    def __post_init__(self) -> None:
        if self.c_move < 0 or not math.isfinite(self.c_move):
            raise ValueError(f"c_move {self.c_move:g}: expected 0 or more")
        if self.max_steps < 1:
            raise ValueError(f"max_steps {self.max_steps}: expected 1 or more")


@dataclass(frozen=True)
class Pool:
    """The people from whom teams are drawn, and what the robot has worked out about them.

    Attributes
    ----------
    choices : Choices
        The task that each of them works on.
    setting : Setting
    people : tuple of Human
    policies : tuple of Policy
        One for each person, or a single one that all share.
    """

    choices: Choices
    setting: Setting
    people: tuple[Human, ...]
    policies: tuple[Policy, ...]

    @classmethod
    def sample(
        cls,
        choices: Choices,
        size: int,
        seed: int,
        *,
        setting: Setting | None = None,
        population: Population | Mixture | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Pool:
        """Draw people from a population and solve the POMDP of each.

        Parameters
        ----------
        progress : callable, optional
            Called with how many POMDPs have been solved, and of how many.
        """
        setting = setting or Setting()
        population = population or Population()
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
        people = population.sample(choices, size, rng)
        known = {"eta": setting.eta, "lapse": setting.lapse, "utility_scale": setting.utility_scale}
        if setting.knowledge == "own":
            models = [HumanModel.own(choices, human, **known) for human in people]
        else:
            models = [HumanModel.exact(choices, **known)]
        grid = Grid.regular(population)
        policies = []
        for done, model in enumerate(models, start=1):
            pomdp = AssistPOMDP.of(
                model, grid=grid, population=population, gamma=setting.gamma,
                c_suggest=setting.c_suggest, suggestions=setting.suggestions,
            )  # fmt: skip
            policies.append(qmdp(pomdp))
            if progress is not None:
                progress(done, len(models))
        return cls(choices, setting, tuple(people), tuple(policies))

    def model(self, people: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give the number of the policy that models each person."""
        return people if len(self.policies) > 1 else np.zeros_like(people)

    def policy(self, name: str, humans: int) -> TeamPolicy:
        """Make one of the paper's three team policies for teams of `humans` people."""
        if name == "none":
            return NoAssistance()
        if name == "reactive":
            return Reactive(self.policies)
        if name == "attention":
            return AttentionSwitching(self.policies, self.setting.c_move, distances(humans))
        raise ValueError(f"unknown policy '{name}'; expected one of {', '.join(POLICIES)}")


@dataclass(frozen=True)
class Episode:
    """What became of one episode.

    Attributes
    ----------
    policy : str
    episode : int
    people : tuple of str
        Who was in the team; each of the next tuples has one entry per person.
    beta, theta, sigma : tuple of float
        Who they were; theta at the beginning.
    actions : tuple of int
        Actions until the goal, or the cut-off.
    costs : tuple of float
        What these cost, in cost units.
    finished : tuple of bool
    interventions, moves, steps : int
        Suggestions made, changes of place, and steps until all had finished.
    discounted_return : float
        Sum over steps of gamma^t times the reward.
    """

    policy: str
    episode: int
    people: tuple[str, ...]
    beta: tuple[float, ...]
    theta: tuple[float, ...]
    sigma: tuple[float, ...]
    actions: tuple[int, ...]
    costs: tuple[float, ...]
    finished: tuple[bool, ...]
    interventions: int
    moves: int
    steps: int
    discounted_return: float

    def record(self) -> dict[str, Any]:
        """Give the fields as plain data."""
        return asdict(self)


Trace = list[dict[str, Any]]
"""One dictionary for each action of each person."""


def simulate(
    pool: Pool,
    policy: TeamPolicy,
    *,
    humans: int,
    episodes: Sequence[int] | int,
    seed: int,
    name: str = "policy",
    trace: Trace | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Episode]:
    """Simulate episodes of teams drawn from a pool.

    Parameters
    ----------
    pool : Pool
    policy : callable
        A team policy.
    humans : int
        People per team, drawn from the pool without replacement.
    episodes : int or sequence of int
        How many episodes, or their numbers.
    seed : int
    name : str
        What the policy is called in the records.
    trace : list, optional
        Every action of every person is appended to it, one dictionary each.
    progress : callable, optional
        Called with the number of episodes that have been finished since the last call.
    """
    if not 1 <= humans <= len(pool.people):
        raise ValueError(f"{humans} people per team: expected 1 to {len(pool.people)}, the size of the pool")
    numbers = np.arange(episodes) if isinstance(episodes, int) else np.asarray(episodes, dtype=np.int64)
    result: list[Episode] = []
    together = max(1, CHUNK // (pool.setting.max_steps * humans))
    for start in range(0, len(numbers), together):
        result += _Run(pool, policy, humans, numbers[start : start + together], seed, name, trace, progress).run()
    return result


class _Run:
    """A chunk of episodes in progress; all arrays have the episodes as their first axis."""

    def __init__(
        self,
        pool: Pool,
        policy: TeamPolicy,
        humans: int,
        numbers: NDArray[np.int64],
        seed: int,
        name: str,
        trace: Trace | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.pool, self.policy, self.numbers, self.name = pool, policy, numbers, name
        self.trace, self.progress = trace, progress
        choices, people, count = pool.choices, pool.people, len(numbers)
        streams = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, int(e)))) for e in numbers]
        self.people = np.array([rng.choice(len(people), humans, replace=False) for rng in streams], dtype=np.int64)
        self.luck = np.array([rng.random((pool.setting.max_steps, humans)) for rng in streams])
        self.model = pool.model(self.people)
        self.beta = np.array([human.beta for human in people])[self.people]
        self.theta = np.array([human.theta for human in people])[self.people]
        self.q = np.array([perceived_cost(choices, human.h) for human in people])
        self.value = np.array([perceived_value(choices, q) for q in self.q])
        self.distance = distances(humans)

        self.x = np.full((count, humans), choices.initial, dtype=np.int64)
        self.active = ~choices.goal[self.x]
        self.erred = np.zeros((count, humans), dtype=bool)
        self.location = np.full(count, BASE, dtype=np.int64)
        self.belief: Floats | None = None
        if getattr(policy, "uses_belief", True):
            self.belief = np.array([p.pomdp.prior for p in pool.policies])[self.model]
        self.actions = np.zeros((count, humans), dtype=np.int64)
        self.costs = np.zeros((count, humans))
        self.interventions = np.zeros(count, dtype=np.int64)
        self.moves = np.zeros(count, dtype=np.int64)
        self.steps = np.zeros(count, dtype=np.int64)
        self.discounted = np.zeros(count)

    def run(self) -> list[Episode]:
        """Step until all have finished or the limit is reached."""
        for step in range(self.pool.setting.max_steps):
            running = np.flatnonzero(self.active.any(axis=1))
            if not len(running):
                break
            self._step(step, running)
            if self.progress is not None:
                self.progress(len(running) - int(self.active[running].any(axis=1).sum()))
        if self.progress is not None:
            self.progress(int(self.active.any(axis=1).sum()))
        return [self._episode(row) for row in range(len(self.numbers))]

    def _step(self, step: int, running: NDArray[np.int64]) -> None:
        pool, choices, setting = self.pool, self.pool.choices, self.pool.setting
        action = self.policy(
            TeamState(
                self.x[running], self.active[running], self.erred[running], self.location[running],
                self.model[running], None if self.belief is None else self.belief[running],
            )
        )  # fmt: skip
        self._check(action, running, step)
        goes = action.person != NOBODY
        teams, to = running[goes], action.person[goes]
        before = self.location[teams]
        travel = setting.c_move * self.distance[before, to]
        self.location[teams] = to
        self.moves[teams] += before != to
        robot = np.zeros_like(self.x)
        robot[teams, to] = action.robot[goes]
        charged = np.zeros(self.x.shape)
        charged[teams, to] = travel + setting.c_suggest * (action.robot[goes] > 0)
        self.interventions[teams] += action.robot[goes] > 0

        e, k = np.nonzero(self.active)
        person, x = self.people[e, k], self.x[e, k]
        suggestion = np.full(len(e), NOTHING, dtype=np.int64)
        for group, solved in enumerate(pool.policies):
            rows = (self.model[e, k] == group) & (robot[e, k] > 0)
            suggestion[rows] = solved.pomdp.suggested[x[rows], robot[e, k][rows]]
        p = choice(self.q[person, x], choices.applicable[x], self.beta[e, k])
        p = influence(p, suggestion, self.theta[e, k])
        # The first slot whose cumulated probability exceeds the episode's random number.
        slot = (np.cumsum(p, axis=1) <= self.luck[e, step, k, None]).sum(axis=1)
        slot = np.minimum(slot, p.shape[1] - 1 - (p[:, ::-1] > 0).argmax(axis=1))
        y, cost = choices.targets[x, slot], choices.costs[x, slot]

        told = suggestion != NOTHING
        expected = choices.targets[x[told], suggestion[told]]
        values = self.value[person[told]]
        rows = np.arange(len(values))
        theta_before = self.theta[e, k]
        self.theta[e[told], k[told]] = trust(
            theta_before[told], values[rows, x[told]], values[rows, expected], setting.eta, setting.utility_scale
        )
        if self.belief is not None:
            for group, solved in enumerate(pool.policies):
                rows = np.flatnonzero(self.model[e, k] == group)
                if len(rows):
                    at = (e[rows], k[rows])
                    self.belief[at] = solved.pomdp.update(self.belief[at], x[rows], robot[at], slot[rows])

        reward = -charged
        reward[e, k] -= cost
        self.discounted += setting.gamma**step * reward.sum(axis=1)
        self.actions[e, k] += 1
        self.costs[e, k] += cost
        self.steps[running] += 1
        self.erred[e, k] = ~(choices.h[y] < choices.h[x])
        self.x[e, k] = y
        self.active[e, k] = ~choices.goal[y]
        if self.trace is not None:
            for i in range(len(e)):
                self.trace.append(
                    {
                        "person": f"human-{person[i] + 1}",
                        "episode": f"{self.name}-{self.numbers[e[i]]}",
                        "step": step,
                        "action": choices.name(int(x[i]), int(slot[i])),
                        "suggestion": choices.name(int(x[i]), int(suggestion[i])) if told[i] else None,
                        "policy": self.name,
                        "place": int(k[i]),
                        "robot_place": None if self.location[e[i]] == BASE else int(self.location[e[i]]),
                        "cost": float(cost[i]),
                        "cost_to_go": _finite(choices.h[x[i]]),
                        "cost_to_go_after": _finite(choices.h[y[i]]),
                        "theta": float(theta_before[i]),
                        "reward": float(reward[e[i], k[i]]),
                    }
                )

    def _check(self, action: TeamAction, running: NDArray[np.int64], step: int) -> None:
        """Refuse what no policy may do, instead of letting it silently do nothing."""
        humans = self.x.shape[1]
        wrong = (action.person < NOBODY) | (action.person >= humans)
        if wrong.any():
            raise ValueError(f"step {step}: the policy goes to person {action.person[wrong][0]} in a team of {humans}")
        goes = np.flatnonzero(action.person != NOBODY)
        teams, to, robot = running[goes], action.person[goes], action.robot[goes]
        if not self.active[teams, to].all():
            raise ValueError(f"step {step}: the policy goes to a person who has finished")
        for group, solved in enumerate(self.pool.policies):
            rows = (self.model[teams, to] == group) & (robot != 0)
            suggested = solved.pomdp.suggested
            if ((robot[rows] < 0) | (robot[rows] >= suggested.shape[1])).any() or (
                suggested[self.x[teams, to][rows], robot[rows]] == NOTHING
            ).any():
                raise ValueError(f"step {step}: the policy makes a suggestion that the person's state does not have")

    def _episode(self, row: int) -> Episode:
        people = [self.pool.people[i] for i in self.people[row]]
        return Episode(
            policy=self.name,
            episode=int(self.numbers[row]),
            people=tuple(f"human-{i + 1}" for i in self.people[row]),
            beta=tuple(human.beta for human in people),
            theta=tuple(human.theta for human in people),
            sigma=tuple(human.sigma for human in people),
            actions=tuple(self.actions[row].tolist()),
            costs=tuple(self.costs[row].tolist()),
            finished=tuple((~self.active[row]).tolist()),
            interventions=int(self.interventions[row]),
            moves=int(self.moves[row]),
            steps=int(self.steps[row]),
            discounted_return=float(self.discounted[row]),
        )


def _finite(value: float) -> float | None:
    """A number that JSON can hold: a dead end's cost-to-go is null."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class Summary:
    """Mean and standard error over the episodes of one policy.

    Attributes
    ----------
    actions, interventions, moves, discounted_return : tuple of float
        Mean and standard error: human actions per person, and suggestions, changes of place and
        return per episode.
    cut_off : int
        Episodes in which somebody had not finished at the step limit.
    """

    policy: str
    episodes: int
    actions: tuple[float, float]
    interventions: tuple[float, float]
    moves: tuple[float, float]
    discounted_return: tuple[float, float]
    cut_off: int


def summarise(episodes: Sequence[Episode]) -> Summary:
    """Summarise the episodes of one policy."""

    def mean_and_error(values: Sequence[float]) -> tuple[float, float]:
        array = np.asarray(values, dtype=float)
        error = array.std(ddof=1) / math.sqrt(len(array)) if len(array) > 1 else math.nan
        return float(array.mean()), float(error)

    return Summary(
        policy=episodes[0].policy,
        episodes=len(episodes),
        actions=mean_and_error([float(np.mean(episode.actions)) for episode in episodes]),
        interventions=mean_and_error([episode.interventions for episode in episodes]),
        moves=mean_and_error([episode.moves for episode in episodes]),
        discounted_return=mean_and_error([episode.discounted_return for episode in episodes]),
        cut_off=sum(not all(episode.finished) for episode in episodes),
    )


def illustrative(helped: Sequence[Episode], alone: Sequence[Episode]) -> Episode:
    """Choose an episode to look at: of those in which help saved actions, the one of median saving.

    Parameters
    ----------
    helped, alone : sequences of Episode
        The same episodes with and without a robot.
    """
    saved = [sum(a.actions) - sum(h.actions) for h, a in zip(helped, alone, strict=True)]
    better = sorted((number, i) for i, number in enumerate(saved) if number > 0)
    return helped[better[(len(better) - 1) // 2][1]] if better else helped[0]
