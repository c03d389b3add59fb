"""Writer for the flat format of Cassandra's pomdp-solve, in which each triple (x, beta, theta) is one state."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from planner import Table
from planner.system.files import atomic

from ..person.pomdp import AssistPOMDP
from .observed import Leaves, Observed, action_names, numbers


def write_pomdp(
    pomdp: AssistPOMDP,
    path: Path | str,
    table: Table | None = None,
    *,
    max_states: int = 20_000,
    leaves: Leaves = "lower",
) -> None:
    """Write a small problem in Cassandra's flat format, one state per (x, beta, theta).

    The number of a state is `(x * H + beta) * T + theta`, where x is an observed value (see `Observed`). After each
    step x is observed. Robot actions and rewards are those of `write_pomdpx`.

    Parameters
    ----------
    pomdp : AssistPOMDP
    path : path
    table : Table, optional
        The table of the task, whose facts name the states in comments; `s0`, `s1`, ... unless given.
    max_states : int
        Largest number of states of the flat format. Larger problems fit POMDPX, which is factored.
    leaves : "lower" or "upper"
        As in `write_pomdpx`.

    Raises
    ------
    ValueError
        The problem has more than `max_states` flat states, there are several goals, or the trust rule depends on
        whether advice is followed.
    """
    observed = Observed.of(pomdp, table, leaves)
    require_size(observed, max_states)
    with atomic(Path(path)) as file, file.open("w", encoding="ascii") as stream:
        _flat(observed, stream)


def require_size(observed: Observed, max_states: int = 20_000) -> None:
    """Raise a `ValueError` if a problem has more flat states (x, beta, theta)."""
    types, thetas = observed.pomdp.prior.shape
    size = len(observed.state) * types * thetas
    if size > max_states:
        raise ValueError(
            f"{len(observed.state):,} observed values times {types * thetas} pairs (beta, theta) are {size:,} states; "
            f"expected at most {max_states:,}: write POMDPX"
        )


def _flat(observed: Observed, stream: TextIO) -> None:
    pomdp = observed.pomdp
    types, thetas = pomdp.prior.shape
    cells, actions = types * thetas, action_names(pomdp)
    size = len(observed.state) * cells
    stream.write(f"# state (x * {types} + beta) * {thetas} + theta; what is observed is x\n")
    stream.writelines(f"# x = {x}: {name}\n" for x, name in enumerate(observed.names))
    stream.writelines(f"# {line.encode('ascii', 'backslashreplace').decode()}\n" for line in observed.legend())
    stream.write(f"discount: {pomdp.gamma!r}\nvalues: reward\nstates: {size}\n")
    stream.write(f"actions: {' '.join(actions)}\nobservations: {len(observed.state)}\n")
    start = np.zeros((len(observed.state), cells))
    start[pomdp.model.choices.initial] = pomdp.prior.ravel()
    stream.write(f"start: {numbers(start)}\n")
    for x in range(len(observed.state)):
        stream.writelines(f"O: * : {x * cells + i} : {x} 1\n" for i in range(cells))
    stream.writelines(lines_of(observed, observed.values()))


def lines_of(observed: Observed, values: NDArray[np.int64]) -> Iterator[str]:
    """Yield the transitions and rewards of some observed values, given by their numbers: nearly all of a large file."""
    pomdp = observed.pomdp
    types, thetas = pomdp.prior.shape
    cells, actions, stay = types * thetas, action_names(pomdp), np.eye(thetas)
    for value, x in zip(values.tolist(), observed.state[values].tolist(), strict=True):
        if observed.stays(x):
            yield from (f"T: * : {value * cells + i} : {value * cells + i} 1\n" for i in range(cells))
            stay_for = np.broadcast_to(observed.reward(x, 0), (types, thetas)).ravel().tolist()
            yield from (f"R: * : {value * cells + i} : * : * {v!r}\n" for i, v in enumerate(stay_for) if v)
            continue
        for r, action in enumerate(actions):
            matrix = observed.moves(x, r)
            moves = stay if matrix is None else matrix
            for y, chance in observed.step(x, r):
                # P(y | beta, theta) P(theta' | theta), shape (H, T, T')
                joint = np.broadcast_to(chance, (types, thetas))[:, :, None] * moves
                for b, t, after in zip(*(i.tolist() for i in np.nonzero(joint)), strict=True):
                    start_state, end = value * cells + b * thetas + t, y * cells + b * thetas + after
                    yield f"T: {action} : {start_state} : {end} {float(joint[b, t, after])!r}\n"
            reward = np.broadcast_to(observed.reward(x, r), (types, thetas))
            yield from (
                f"R: {action} : {value * cells + i} : * : * {v!r}\n" for i, v in enumerate(reward.ravel().tolist())
            )
