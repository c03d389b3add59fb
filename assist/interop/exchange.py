"""Problems and policies in other programs' formats.

`write_pomdpx` writes one person's problem in the format of APPL's solvers (SARSOP), with the task's state observed and
(beta, theta) hidden; `read_policy` reads what they return. `write_pomdp` writes the flat format of Cassandra's
pomdp-solve, `to_pomdp_py` makes the objects of the library pomdp-py. All are the same problem, exactly:

- **Same target.** The other programs see the next state, not the person's action. Where two actions of a state lead to
  the same state they would learn less than the robot, so that such a target is written several times: as itself and
  as *copies* that differ in name only. Most tasks need none.
- **Same robot actions everywhere.** The formats give every state the same actions. One that a state does not have does
  there what "nothing" does and costs `FORBIDDEN` more, so that no best policy takes it and no value changes.
- **The end.** Goals stay where they are for ever, at no cost, and theta stays too.
"""

from __future__ import annotations

import importlib.util
import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from planner.errors import MissingExtraError
from planner.storage import atomic

from ..people.decision import NOTHING, Floats
from ..person.alpha_vectors import VectorPolicy
from ..person.pomdp import AssistPOMDP

FORBIDDEN = 1.0
"""What a robot action that a state does not have costs there, in cost units."""

FLAT_STATES = 20_000
"""The largest number of flat states, (x, beta, theta), that is written one by one."""


class PolicyFileError(ValueError):
    """A policy file that cannot be read or is of another problem: `FILE:LINE: what is wrong`."""


@dataclass(frozen=True)
class Observed:
    """What the formats observe: every state x, and copies of those that two actions of a state lead to.

    Attributes
    ----------
    pomdp : AssistPOMDP
    state : int array, shape (X,)
        The state of each observed value. The first n are the states themselves.
    targets : int array, shape (n, A)
        The observed value after the action in each slot.
    """

    pomdp: AssistPOMDP
    state: NDArray[np.int64]
    targets: NDArray[np.int64]

    @classmethod
    def of(cls, pomdp: AssistPOMDP) -> Observed:
        """Find the copies that a problem needs.

        Raises
        ------
        ValueError
            The problem breaks off at a frontier.
        """
        if pomdp.frontier is not None:
            raise ValueError("the problem breaks off at a frontier; expected one of all states of the task")
        choices = pomdp.model.choices
        targets = choices.targets.copy()
        state = list(range(len(choices)))
        copies: dict[tuple[int, int], int] = {}
        for x in np.flatnonzero(~choices.goal):
            row = choices.targets[x, : choices.applicable[x].sum()]
            for slot, y in enumerate(row):
                rank = int((row[:slot] == y).sum())
                if rank and not choices.goal[y]:  # what led to a goal does not matter any more
                    if (y, rank) not in copies:
                        copies[y, rank] = len(state)
                        state.append(int(y))
                    targets[x, slot] = copies[y, rank]
        return cls(pomdp, np.array(state, dtype=np.int64), targets)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Give a name to each observed value: `s7`, and `s7_2` for the second copy of it."""
        seen: dict[int, int] = {}
        names = []
        for x in self.state.tolist():
            seen[x] = seen.get(x, 0) + 1
            names.append(f"s{x}" if seen[x] == 1 else f"s{x}_{seen[x]}")
        return tuple(names)

    def step(self, x: int, r: int) -> list[tuple[int, Floats]]:
        """Give where robot action r leads from state x: pairs of an observed value and its chance, shape (B, T).

        Chances of 0 are left out; where a chance does not depend on theta its shape is (B, 1).
        """
        pomdp, choices = self.pomdp, self.pomdp.model.choices
        r = r if r < pomdp.robot_actions[x] else 0
        place = int(pomdp.afterstate[x, r])
        if choices.goal[place]:
            return [(place, np.ones((len(pomdp.grid.beta), 1)))]
        slots = np.arange(int(choices.applicable[place].sum()))
        chance = pomdp.likelihood(np.full(len(slots), x), np.full(len(slots), r), slots)
        if chance.shape[2] > 1 and pomdp.suggested[x, r] == NOTHING:
            chance = chance[:, :, :1]
        after: dict[int, Floats] = {}
        for y, p in zip(self.targets[place, slots].tolist(), chance, strict=True):
            after[y] = after[y] + p if y in after else p
        return [(y, p) for y, p in after.items() if (p > 0).any()]

    def reward(self, x: int, r: int) -> Floats:
        """Give the expected reward of robot action r in state x, shape (B, T), (B, 1) or (1, 1)."""
        pomdp, choices = self.pomdp, self.pomdp.model.choices
        if choices.goal[x]:
            return np.zeros((1, 1))
        forbidden = r >= pomdp.robot_actions[x]
        r = 0 if forbidden else r
        place = int(pomdp.afterstate[x, r])
        charge = np.full((1, 1), float(pomdp.robot_costs[x, r]) + FORBIDDEN * forbidden)
        if choices.goal[place]:
            return -charge
        slots = np.arange(int(choices.applicable[place].sum()))
        costs = choices.costs[place, slots]
        if (costs == costs[0]).all():
            return -charge - costs[0]
        chance = pomdp.likelihood(np.full(len(slots), x), np.full(len(slots), r), slots)
        if pomdp.suggested[x, r] == NOTHING:
            chance = chance[:, :, :1]
        return np.asarray(-charge - np.tensordot(costs, chance, axes=1))

    def moves(self, x: int, r: int) -> Floats | None:
        """Give where robot action r in state x moves theta, shape (T, T); None where it stays."""
        pomdp = self.pomdp
        if r >= pomdp.robot_actions[x] or pomdp.suggested[x, r] == NOTHING:
            return None
        thetas = np.arange(len(pomdp.grid.theta))
        matrix = np.zeros((len(thetas), len(thetas)))
        matrix[thetas, pomdp.low[x, r]] = 1 - pomdp.weight[x, r]
        matrix[thetas, pomdp.low[x, r] + 1] += pomdp.weight[x, r]
        return None if (matrix == np.eye(len(thetas))).all() else matrix


def action_names(pomdp: AssistPOMDP) -> list[str]:
    """Name the robot actions: `nothing`, then `robot1`, `robot2`, ... as each state numbers them."""
    return ["nothing", *(f"robot{r}" for r in range(1, int(pomdp.robot_actions.max(initial=1))))]


def _numbers(array: Floats) -> str:
    # The shortest digits that read back as the same number.
    return " ".join("0" if v == 0 else "1" if v == 1 else repr(v) for v in array.ravel().tolist())


def write_pomdpx(pomdp: AssistPOMDP, path: Path | str) -> None:
    """Write a problem in POMDPX 1.0, with mixed observability.

    The state variable `x` is observed; `beta` and `theta` are hidden, in this order. Given a step's beginning, beta,
    theta and x after it are independent of each other, which is what keeps the file small. The prior is written
    as that of beta and that of theta, or of theta given beta where they are not independent.

    Raises
    ------
    ValueError
        The problem breaks off at a frontier.
    """
    observed = Observed.of(pomdp)
    with atomic(Path(path)) as file, file.open("w", encoding="ascii") as stream:
        _pomdpx(observed, stream)


def _pomdpx(observed: Observed, stream: TextIO) -> None:
    pomdp = observed.pomdp
    betas, thetas = pomdp.grid.shape
    robots = action_names(pomdp)
    hidden = {"beta": betas, "theta": thetas}
    stream.write('<?xml version="1.0" encoding="ISO-8859-1"?>\n<pomdpx version="1.0" id="kitassist">\n')
    stream.write("<Description>Assistance of one person: x is the task's state, beta their expertise, theta the ")
    stream.write("influence of the robot.\n")
    stream.write(f"beta {_numbers(pomdp.grid.beta)}\ntheta {_numbers(pomdp.grid.theta)}</Description>\n")
    stream.write(f"<Discount>{pomdp.gamma!r}</Discount>\n<Variable>\n")
    stream.write(f'<StateVar vnamePrev="x_0" vnameCurr="x_1" fullyObs="true"><ValueEnum>{" ".join(observed.names)}')
    stream.write("</ValueEnum></StateVar>\n")
    for name, size in hidden.items():
        values = " ".join(f"{name[0]}{i}" for i in range(size))
        stream.write(f'<StateVar vnamePrev="{name}_0" vnameCurr="{name}_1" fullyObs="false"><ValueEnum>{values}')
        stream.write("</ValueEnum></StateVar>\n")
    stream.write(f'<ActionVar vname="robot"><ValueEnum>{" ".join(robots)}</ValueEnum></ActionVar>\n')
    stream.write('<RewardVar vname="reward"/>\n</Variable>\n')

    initial = np.zeros(len(observed.names))
    initial[pomdp.model.choices.initial] = 1
    beta = pomdp.prior.sum(axis=1)
    theta = pomdp.prior.sum(axis=0)
    stream.write("<InitialStateBelief>\n")
    stream.writelines(_function("x_0", "null", [("-", initial)]))
    stream.writelines(_function("beta_0", "null", [("-", beta)]))
    if np.allclose(np.outer(beta, theta), pomdp.prior, rtol=0, atol=1e-15):
        stream.writelines(_function("theta_0", "null", [("-", theta)]))
    else:
        given = np.divide(pomdp.prior, beta[:, None], out=np.tile(theta, (betas, 1)), where=beta[:, None] > 0)
        stream.writelines(_function("theta_0", "beta_0", [("- -", given)]))
    stream.write("</InitialStateBelief>\n<StateTransitionFunction>\n")
    stream.writelines(_function("x_1", "robot x_0 beta_0 theta_0", _transitions(observed, robots)))
    stream.writelines(_function("beta_1", "beta_0", [("- -", "identity")]))
    stream.writelines(_function("theta_1", "robot x_0 theta_0", _theta_moves(observed, robots)))
    stream.write("</StateTransitionFunction>\n<RewardFunction>\n")
    stream.writelines(_function("reward", "robot x_0 beta_0 theta_0", _rewards(observed, robots), "Func", "ValueTable"))
    stream.write("</RewardFunction>\n</pomdpx>\n")


Entries = Iterator[tuple[str, Floats | str]]


def _function(
    variable: str, parents: str, entries: Any, tag: str = "CondProb", table: str = "ProbTable"
) -> Iterator[str]:
    yield f'<{tag}><Var>{variable}</Var><Parent>{parents}</Parent><Parameter type="TBL">\n'
    for instance, values in entries:
        numbers = values if isinstance(values, str) else _numbers(values)
        yield f"<Entry><Instance>{instance}</Instance><{table}>{numbers}</{table}></Entry>\n"
    yield f"</Parameter></{tag}>\n"


def _over(array: Floats) -> str:
    """Say over which of beta and theta an array, shape (B or 1, T or 1), runs."""
    return " ".join("-" if size > 1 else "*" for size in array.shape)


def _transitions(observed: Observed, robots: list[str]) -> Entries:
    for value, x in enumerate(observed.state.tolist()):
        here = observed.names[value]
        if observed.pomdp.model.choices.goal[x]:
            yield f"* {here} * * {here}", "1"
            continue
        for r, robot in enumerate(robots):
            for y, chance in observed.step(x, r):
                yield f"{robot} {here} {_over(chance)} {observed.names[y]}", chance


def _theta_moves(observed: Observed, robots: list[str]) -> Entries:
    yield "nothing * - -", "identity"
    for r, robot in enumerate(robots[1:], start=1):
        for value, x in enumerate(observed.state.tolist()):
            matrix = observed.moves(x, r)
            yield f"{robot} {observed.names[value]} - -", "identity" if matrix is None else matrix


def _rewards(observed: Observed, robots: list[str]) -> Entries:
    for value, x in enumerate(observed.state.tolist()):
        if observed.pomdp.model.choices.goal[x]:
            yield f"* {observed.names[value]} * *", "0"
            continue
        for r, robot in enumerate(robots):
            reward = observed.reward(x, r)
            yield f"{robot} {observed.names[value]} {_over(reward)}", reward


def write_pomdp(pomdp: AssistPOMDP, path: Path | str) -> None:
    """Write a small problem in Cassandra's flat format, one state per (x, beta, theta).

    State `(x * B + beta) * T + theta`, with x an observed value (see `Observed`), which is also what is observed
    after each step. Values of robot actions and rewards are as in `write_pomdpx`.

    Raises
    ------
    ValueError
        The problem has more than `FLAT_STATES` flat states, or breaks off at a frontier.
    """
    observed = Observed.of(pomdp)
    betas, thetas = pomdp.grid.shape
    size = len(observed.state) * betas * thetas
    if size > FLAT_STATES:
        raise ValueError(
            f"{len(observed.state):,} states of the task times {betas * thetas} hidden ones are {size:,} flat states; "
            f"expected at most {FLAT_STATES:,}: write POMDPX"
        )
    with atomic(Path(path)) as file, file.open("w", encoding="ascii") as stream:
        _flat(observed, stream)


def _flat(observed: Observed, stream: TextIO) -> None:
    pomdp = observed.pomdp
    betas, thetas = pomdp.grid.shape
    cells, robots = betas * thetas, action_names(pomdp)
    size = len(observed.state) * cells
    stream.write(f"# state (x * {betas} + beta) * {thetas} + theta; what is observed is x\n")
    stream.write(f"discount: {pomdp.gamma!r}\nvalues: reward\nstates: {size}\n")
    stream.write(f"actions: {' '.join(robots)}\nobservations: {len(observed.state)}\n")
    start = np.zeros((len(observed.state), cells))
    start[pomdp.model.choices.initial] = pomdp.prior.ravel()
    stream.write(f"start: {_numbers(start)}\n")
    for x in range(len(observed.state)):
        stream.writelines(f"O: * : {x * cells + i} : {x} 1\n" for i in range(cells))
    stay = np.eye(thetas)
    for value, x in enumerate(observed.state.tolist()):
        if pomdp.model.choices.goal[x]:
            stream.writelines(f"T: * : {value * cells + i} : {value * cells + i} 1\n" for i in range(cells))
            continue
        for r, robot in enumerate(robots):
            matrix = observed.moves(x, r)
            moves = stay if matrix is None else matrix
            for y, chance in observed.step(x, r):
                # P(y | beta, theta) P(theta' | theta), shape (B, T, T')
                joint = np.broadcast_to(chance, (betas, thetas))[:, :, None] * moves
                for b, t, after in zip(*(i.tolist() for i in np.nonzero(joint)), strict=True):
                    start_state, end = value * cells + b * thetas + t, y * cells + b * thetas + after
                    stream.write(f"T: {robot} : {start_state} : {end} {float(joint[b, t, after])!r}\n")
            reward = np.broadcast_to(observed.reward(x, r), (betas, thetas))
            stream.writelines(
                f"R: {robot} : {value * cells + i} : * : * {v!r}\n" for i, v in enumerate(reward.ravel().tolist())
            )


def read_policy(path: Path | str, pomdp: AssistPOMDP) -> VectorPolicy:
    """Read the policy that SARSOP wrote for a problem exported by `write_pomdpx`.

    SARSOP numbers the observed values and the hidden pairs as the file that it read does: x first to last, and
    beta * T + theta. It writes six significant digits. The vectors of a state's copies are vectors of the state; an
    action that a state does not have reads as nothing. Goals get no vectors, whose values are 0.

    Raises
    ------
    PolicyFileError
        The file is malformed, or of another problem.
    """
    observed = Observed.of(pomdp)
    reader = _PolicyReader(str(path), observed)
    reader.read(Path(path))
    choices = pomdp.model.choices
    state = observed.state[np.array(reader.value, dtype=np.int64)]
    keep = np.flatnonzero(~choices.goal[state])
    keep = keep[np.argsort(state[keep], kind="stable")]
    missing = ~choices.goal.copy()
    missing[state[keep]] = False
    if missing.any():
        raise PolicyFileError(f"{path}:{reader.end}: no alpha vector for state {int(missing.argmax())}")
    vectors = np.array([reader.vectors[i] for i in keep]).reshape(len(keep), *pomdp.grid.shape)
    robot = np.array(reader.action, dtype=np.int64)[keep]
    robot = np.where(robot < pomdp.robot_actions[state[keep]], robot, 0)
    first = np.searchsorted(state[keep], np.arange(len(choices) + 1)).astype(np.int64)
    return VectorPolicy(pomdp, vectors, robot, first)


class _PolicyReader:
    """Reads a policy as a stream of XML elements, so that every complaint has its line."""

    def __init__(self, name: str, observed: Observed) -> None:
        self.name, self.observed = name, observed
        self.value: list[int] = []
        self.action: list[int] = []
        self.vectors: list[list[float]] = []
        self.end = 1
        self.text: list[str] | None = None
        self.declared: int | None = None
        self.parser = xml.parsers.expat.ParserCreate()
        self.parser.StartElementHandler = self.begin
        self.parser.CharacterDataHandler = self.characters
        self.parser.EndElementHandler = self.finish

    def fail(self, message: str) -> PolicyFileError:
        return PolicyFileError(f"{self.name}:{self.parser.CurrentLineNumber}: {message}")

    def read(self, path: Path) -> None:
        try:
            with path.open("rb") as stream:
                self.parser.ParseFile(stream)
        except xml.parsers.expat.ExpatError as error:
            message = xml.parsers.expat.ErrorString(error.code)
            raise PolicyFileError(f"{self.name}:{error.lineno}: not a policy in XML: {message}") from None
        self.end = self.parser.CurrentLineNumber
        if self.declared is None:
            raise self.fail("no <AlphaVector> element; expected a policy of SARSOP")
        if self.declared != len(self.vectors):
            raise self.fail(f"{len(self.vectors)} vectors, although {self.declared} are announced")

    def number(self, attributes: dict[str, str], name: str, limit: int | None = None) -> int:
        try:
            number = int(attributes[name])
        except (KeyError, ValueError):
            raise self.fail(f"attribute {name}: expected a whole number") from None
        if number < 0 or (limit is not None and number >= limit):
            raise self.fail(
                f"attribute {name} is {number}; expected 0 to {(limit or 0) - 1}: another problem's policy?"
            )
        return number

    def begin(self, tag: str, attributes: dict[str, str]) -> None:
        pomdp = self.observed.pomdp
        if tag == "AlphaVector":
            for name, expected, what in (
                ("vectorLength", pomdp.prior.size, "hidden pairs"),
                ("numObsValue", len(self.observed.state), "states"),
            ):
                if self.number(attributes, name) != expected:
                    raise self.fail(f"{name} is {attributes[name]}, but the problem has {expected} {what}")
            self.declared = self.number(attributes, "numVectors")
        elif tag == "Vector":
            if self.declared is None:
                raise self.fail("<Vector> outside of <AlphaVector>")
            self.action.append(self.number(attributes, "action", int(pomdp.robot_actions.max(initial=1))))
            self.value.append(self.number(attributes, "obsValue", len(self.observed.state)))
            self.text = []
        elif tag != "Policy":
            raise self.fail(f"<{tag}>: expected <Policy>, <AlphaVector> or <Vector>")

    def characters(self, text: str) -> None:
        if self.text is not None:
            self.text.append(text)

    def finish(self, tag: str) -> None:
        if tag != "Vector" or self.text is None:
            return
        try:
            numbers = [float(word) for word in "".join(self.text).split()]
        except ValueError as error:
            raise self.fail(str(error)) from None
        if len(numbers) != self.observed.pomdp.prior.size or not np.isfinite(numbers).all():
            raise self.fail(
                f"a vector of {len(numbers)} numbers; expected {self.observed.pomdp.prior.size} finite ones"
            )
        self.vectors.append(numbers)
        self.text = None


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
