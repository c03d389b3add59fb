"""Weakly coupled problems: Markov decision processes of single agents that share a resource."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from planner.system.arrays import outline, read_only

from ...people.arguments import number, positive
from ...person.rounding import rounding

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TOLERANCE = 1e-9
"""Largest rounding error of what is given: of a sum of probabilities, by which they are divided, and below 0."""


def units(resources: float) -> float:
    """Return the checked units of the resource at each step, 0 or more."""
    return 0.0 if resources == 0 else positive("resources", resources)


@dataclass(frozen=True, init=False, eq=False)
class Agents:
    """Agents that act at the same time and share a resource.

    Each agent is a Markov decision process with observed state. Agents of one kind have the same arrays, so that a
    large team of few kinds takes little memory. K is the number of kinds, N of agents, A of actions, S of states.

    Parameters
    ----------
    P : array_like, shape (K, A, S, S), or a list
        Transition probabilities of each kind. A list has an array of shape (A, S_k, S_k) for each kind, or A sparse
        matrices of shape (S_k, S_k). Missing states are filled with states that are never reached.
    R : array_like, shape (K, A, S), or a list of arrays of shape (A, S_k)
        Rewards, in the unit of the caller (for example minus the costs).
    uses : array_like, shape (K, A) or (K, A, S), optional
        Units of the resource that an action uses. Default: 0 for action 0, else 1.
    initial : array_like, shape (N,) or (N, S), optional
        Initial states of the agents, or distributions over them. Default: state 0.
    gamma : float
        Discount factor per step, at least 0 and below 1.
    allowed : array_like of bool, shape (K, A, S), optional
        Actions that are allowed. Default: all. In every state an action that uses nothing has to be allowed.
    kind : array_like of int, shape (N,), optional
        Kind of each agent. Default: one agent of each kind.

    Attributes
    ----------
    P : scipy.sparse.csr_array, shape (A * K * S, K * S)
        Transition probabilities; the row of action a in state s of kind k is (a K + k) S + s.
    R, uses : float arrays, shape (K, A, S)
    allowed : bool array, shape (K, A, S)
    initial : float array, shape (N, S)
        Distributions over initial states.
    kind : int array, shape (N,)

    Raises
    ------
    ValueError
        A shape is wrong, a row of P does not sum to one, or another value is invalid.
    """

    P: sparse.csr_array
    R: Floats
    uses: Floats
    initial: Floats
    gamma: float
    allowed: NDArray[np.bool_]
    kind: Ints

    __repr__ = outline

    def __init__(
        self, P: ArrayLike | Sequence[Any], R: ArrayLike | Sequence[Any], uses: ArrayLike | None = None,
        initial: ArrayLike | None = None, gamma: float = 0.99, allowed: ArrayLike | None = None,
        kind: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        factor = number("gamma", gamma)
        if not 0 <= factor < 1:
            raise ValueError(f"gamma {gamma!r}: expected at least 0 and below 1")
        blocks = [_matrices(k, one) for k, one in enumerate(P)]  # type: ignore[arg-type]
        if not blocks:
            raise ValueError("P: expected at least one agent")
        actions = {len(one) for one in blocks}
        if len(actions) > 1:
            raise ValueError(f"P: agents with {', '.join(map(str, sorted(actions)))} actions; expected the same number")
        (A,) = actions
        sizes = [one[0].shape[0] for one in blocks]
        K, S = len(blocks), max(sizes)
        rewards = np.zeros((K, A, S))
        given = list(R)  # type: ignore[arg-type]
        if len(given) != K:
            raise ValueError(f"R: {len(given)} agents, but P has {K}; expected the same number")
        for k, (one, size) in enumerate(zip(given, sizes, strict=True)):
            rewards[k, :, :size] = _shaped(f"R of agent {k}", one, (A, size))
        use = _uses(uses, (K, A, S))
        may = np.ones((K, A, S), dtype=bool) if allowed is None else np.asarray(allowed)
        if may.shape != (K, A, S) or may.dtype != bool:
            raise ValueError(f"allowed: {may.dtype} array of shape {may.shape}; expected bool and {(K, A, S)}")
        stuck = np.argwhere(~(may & (use == 0)).any(axis=1))
        if len(stuck):
            k, s = stuck[0]
            raise ValueError(f"uses: agent {k}, state {s}: expected an allowed action that uses nothing")
        kinds = np.arange(K) if kind is None else np.asarray(kind)
        if kinds.ndim != 1 or kinds.dtype.kind not in "iu" or (kinds < 0).any() or (kinds >= K).any():
            raise ValueError(f"kind: expected one whole number from 0 to {K - 1} for each agent")
        begin = _initial(initial, np.array(sizes)[kinds], S)
        values = (_stacked(blocks, S), rewards, use, begin, factor, may.copy(), kinds.astype(np.int64))
        for name, value in zip(("P", "R", "uses", "initial", "gamma", "allowed", "kind"), values, strict=True):
            object.__setattr__(self, name, value)
        for part in (self.P.data, self.P.indices, self.P.indptr):
            part.flags.writeable = False
        read_only(self)

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def shape(self) -> tuple[int, int, int]:
        """The numbers of kinds, actions and states."""
        kinds, actions, states = self.R.shape
        return kinds, actions, states

    @cached_property
    def weight(self) -> Floats:
        """Expected number of agents in each state at the first step, shape (K * S,)."""
        found = np.zeros((self.shape[0], self.shape[2]))
        np.add.at(found, self.kind, self.initial)
        return found.ravel()

    @cached_property
    def flat(self) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Rewards, uses and allowed actions, each of shape (A, K * S)."""
        A = self.shape[1]
        reward, use, may = (x.transpose(1, 0, 2).reshape(A, -1) for x in (self.R, self.uses, self.allowed))
        return np.ascontiguousarray(reward), np.ascontiguousarray(use), np.ascontiguousarray(may)

    def room(self, resources: float) -> float:
        """Return the units that a sum of uses may have in a step: `resources`, and what rounding may add to the sum."""
        return resources + rounding(len(self)) * (resources + float(self.uses.max()))

    def look_ahead(self, values: Floats) -> Floats:
        """Return R + gamma P V for values of shape (K * S,); shape (A, K * S), minus infinity where not allowed."""
        reward, _, may = self.flat
        q: Floats = np.where(may, reward + self.gamma * (self.P @ values).reshape(reward.shape), -np.inf)
        return q

    def successors(self, worth: Floats | None = None) -> tuple[Floats, Ints]:
        """Return cumulative probabilities and successor states, shapes (A * K * S, B), for B successors at most.

        With the worth of states, shape (K * S,), better successors come first. Then the same uniform number has a
        similar effect after different actions.
        """
        count, target = np.diff(self.P.indptr), self.P.indices
        row = np.repeat(np.arange(len(count)), count)
        order = slice(None) if worth is None else np.lexsort((-worth[target], row))
        column = np.arange(len(row)) - np.repeat(self.P.indptr[:-1], count)
        chance, state = np.zeros((len(count), count.max())), np.zeros((len(count), count.max()), dtype=np.int64)
        chance[row, column], state[row, column] = self.P.data[order], target[order] % self.shape[2]
        cumulative = np.cumsum(chance, axis=1)
        # The last successor takes what rounding errors leave.
        cumulative[np.arange(cumulative.shape[1]) >= count[:, None] - 1] = np.inf
        return cumulative, state

    def finished(self) -> NDArray[np.bool_]:
        """Return whether each state is left by no action and has no rewards, shape (K * S,)."""
        reward, _, may = self.flat
        A, n = reward.shape
        stays = np.stack([self.P[a * n : (a + 1) * n].diagonal() for a in range(A)]) >= 1 - TOLERANCE
        whole: NDArray[np.bool_] = ((stays & (reward == 0)) | ~may).all(axis=0)
        return whole

    def save(self, file: Path | str) -> None:
        """Write the problem as a NumPy archive (`.npz`)."""
        np.savez_compressed(
            file, data=self.P.data, indices=self.P.indices, indptr=self.P.indptr, R=self.R, uses=self.uses,
            initial=self.initial, gamma=self.gamma, allowed=self.allowed, kind=self.kind,
        )  # fmt: skip

    @classmethod
    def load(cls, file: Path | str) -> Agents:
        """Read a problem that `save` wrote.

        Raises
        ------
        ValueError
            The file is no such archive.
        """
        try:
            with np.load(file, allow_pickle=False) as found:
                parts = dict(found)
            K, A, S = parts["R"].shape
            n = K * S
            whole = sparse.csr_array((parts["data"], parts["indices"], parts["indptr"]), shape=(A * n, n))
            matrices = [
                [whole[a * n + k * S : a * n + (k + 1) * S, k * S : (k + 1) * S] for a in range(A)] for k in range(K)
            ]
            return cls(
                matrices, parts["R"], uses=parts["uses"], initial=parts["initial"], gamma=float(parts["gamma"]),
                allowed=parts["allowed"], kind=parts["kind"],
            )  # fmt: skip
        except (KeyError, EOFError) as error:
            raise ValueError(f"{file}: expected a file that Agents.save wrote ({error})") from None


def _matrices(k: int, one: Any) -> list[sparse.csr_array]:
    """Return an agent's transition matrices, one for each action."""
    found = [sparse.csr_array(p) for p in one]
    if not found:
        raise ValueError(f"P of agent {k}: expected at least one action")
    size = found[0].shape[0]
    for a, p in enumerate(found):
        if p.shape != (size, size) or not size:
            raise ValueError(f"P of agent {k}, action {a}: shape {p.shape}; expected {(size, size)}")
        total = np.asarray(p.sum(axis=1)).ravel()
        if not (np.isfinite(p.data).all() and (p.data >= -TOLERANCE).all()):
            raise ValueError(f"P of agent {k}, action {a}: expected probabilities from 0 to 1")
        p.data = np.maximum(p.data, 0)
        wrong = np.flatnonzero(abs(total - 1) > TOLERANCE)
        if len(wrong):
            raise ValueError(
                f"P of agent {k}, action {a}, state {wrong[0]}: the row sums to {total[wrong[0]]:.9g}; expected 1"
            )
    return found


def _stacked(blocks: list[list[sparse.csr_array]], S: int) -> sparse.csr_array:
    """Return all matrices as one, with rows by action, kind and state, divided by their sums."""
    K, A = len(blocks), len(blocks[0])
    data, columns, counts = list[Floats](), list[Ints](), list[Ints]()
    for a in range(A):
        for k in range(K):
            p = blocks[k][a]
            missing = S - p.shape[0]
            data += [p.data, np.ones(missing)]
            columns += [p.indices.astype(np.int64) + k * S, np.arange(p.shape[0], S) + k * S]
            counts += [np.diff(p.indptr).astype(np.int64), np.ones(missing, dtype=np.int64)]
    begin = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    values = np.concatenate(data).astype(float)
    values /= np.repeat(np.add.reduceat(values, begin[:-1]), np.diff(begin))
    whole = sparse.csr_array((values, np.concatenate(columns).astype(np.int64), begin), shape=(A * K * S, K * S))
    whole.eliminate_zeros()
    return whole


def _shaped(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return finite values of the expected shape."""
    found = np.asarray(values, dtype=float)
    if found.shape != shape:
        raise ValueError(f"{name}: shape {found.shape}; expected {shape}")
    if not np.isfinite(found).all():
        raise ValueError(f"{name}: expected finite numbers")
    return found


def _uses(given: ArrayLike | None, shape: tuple[int, int, int]) -> Floats:
    """Return the uses of each kind, action and state."""
    if given is None:
        given = np.broadcast_to(np.arange(shape[1]) > 0, shape[:2])
    found = np.asarray(given, dtype=float)
    if found.ndim == 2:
        found = np.repeat(found[:, :, None], shape[2], axis=2)
    found = _shaped("uses", found, shape)
    if (found < -TOLERANCE).any():
        raise ValueError("uses: expected units of 0 or more")
    return np.where(abs(found) <= TOLERANCE, 0.0, found)


def _initial(given: ArrayLike | None, sizes: Ints, S: int) -> Floats:
    """Return the distributions over initial states."""
    N = len(sizes)
    found = np.zeros(N, dtype=np.int64) if given is None else np.asarray(given)
    if found.shape == (N,) and found.dtype.kind in "iu":
        if (found < 0).any() or (found >= sizes).any():
            raise ValueError("initial: expected states of each agent, from 0 to S - 1")
        return np.eye(S)[found] if N * S < 10**8 else np.asarray(found[:, None] == np.arange(S), dtype=float)
    if found.shape != (N, S):
        raise ValueError(f"initial: {found.dtype} array of shape {found.shape}; expected {N} states, or {(N, S)}")
    belief = _shaped("initial", found, (N, S))
    beyond = np.arange(S) >= sizes[:, None]
    wrong = (belief < -TOLERANCE).any() or (abs(belief.sum(axis=1) - 1) > TOLERANCE).any()
    if wrong or (abs(belief[beyond]) > TOLERANCE).any():
        raise ValueError("initial: expected distributions over each agent's states, which sum to one")
    belief = np.where(beyond, 0.0, np.maximum(belief, 0))
    return belief / belief.sum(axis=1, keepdims=True)
