"""Writer for POMDPX, the format of SARSOP: the state of the task is observed, (beta, theta) is hidden."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from planner import Table
from planner.system.files import atomic

from ..people.decision import Floats
from ..person.pomdp import AssistPOMDP
from .observed import Leaves, Observed, action_names, numbers


def write_pomdpx(pomdp: AssistPOMDP, path: Path | str, table: Table | None = None, *, leaves: Leaves = "lower") -> None:
    """Write a problem in POMDPX 1.0, with mixed observability.

    The state variable `x` is observed; `beta` and `theta` are hidden, in this order. Where types have further parts,
    `beta` numbers the types. Given (x, beta, theta) and the
    robot action, the next values of x, beta and theta are independent, so that the file is small. The prior is written
    as P(beta) and P(theta), or as P(beta) and P(theta | beta) if they are dependent.

    A state's name lists the facts in which it differs from the initial state `start`, such as
    `on-platform.box-a__not-in-storage.box-a`; other characters become `-`, and a second state of a name gets `_2`.
    A robot action that a state does not have has the effect of `nothing` and costs 1 more, so that no value changes.
    An observation is the next state; if two actions lead to it, it has copies `_2`, `_3`. Goals are absorbing,
    without cost.

    Parameters
    ----------
    pomdp : AssistPOMDP
    path : path
    table : Table, optional
        The table of the task, whose facts name the states; `s0`, `s1`, ... unless given.
    leaves : "lower" or "upper"
        The bounds that a truncated problem has at its frontier. The optimal value of the file is then a lower bound on
        that of the whole task, or an upper one.

    Raises
    ------
    ValueError
        There are several goals, or the trust rule depends on whether advice is followed.
    """
    observed = Observed.of(pomdp, table, leaves)
    with atomic(Path(path)) as file, file.open("w", encoding="ascii") as stream:
        _pomdpx(observed, stream)


def _pomdpx(observed: Observed, stream: TextIO) -> None:
    pomdp = observed.pomdp
    types, thetas = pomdp.prior.shape
    actions = action_names(pomdp)
    hidden = {"beta": types, "theta": thetas}
    stream.write('<?xml version="1.0" encoding="ISO-8859-1"?>\n<pomdpx version="1.0" id="kitassist">\n')
    stream.write("<Description>Assistance of one person: x is the task's state, beta their expertise, theta the ")
    stream.write("influence of the robot.\n")
    stream.write(f"beta {numbers(pomdp.hidden.expertise)}\ntheta {numbers(pomdp.grid.theta)}\n")
    stream.writelines(f"{escape(line).encode('ascii', 'xmlcharrefreplace').decode()}\n" for line in observed.legend())
    stream.write("</Description>\n")
    stream.write(f"<Discount>{pomdp.gamma!r}</Discount>\n<Variable>\n")
    stream.write(f'<StateVar vnamePrev="x_0" vnameCurr="x_1" fullyObs="true"><ValueEnum>{" ".join(observed.names)}')
    stream.write("</ValueEnum></StateVar>\n")
    for name, size in hidden.items():
        values = " ".join(f"{name[0]}{i}" for i in range(size))
        stream.write(f'<StateVar vnamePrev="{name}_0" vnameCurr="{name}_1" fullyObs="false"><ValueEnum>{values}')
        stream.write("</ValueEnum></StateVar>\n")
    stream.write(f'<ActionVar vname="action"><ValueEnum>{" ".join(actions)}</ValueEnum></ActionVar>\n')
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
        given = np.divide(pomdp.prior, beta[:, None], out=np.tile(theta, (types, 1)), where=beta[:, None] > 0)
        stream.writelines(_function("theta_0", "beta_0", [("- -", given)]))
    stream.write("</InitialStateBelief>\n<StateTransitionFunction>\n")
    every = observed.values()
    stream.writelines(_function("x_1", "action x_0 beta_0 theta_0", _transitions(observed, actions, every)))
    stream.writelines(_function("beta_1", "beta_0", [("- -", "identity")]))
    stream.writelines(_function("theta_1", "action x_0 theta_0", _theta_moves(observed, actions, every)))
    stream.write("</StateTransitionFunction>\n<RewardFunction>\n")
    rewards = _rewards(observed, actions, every)
    stream.writelines(_function("reward", "action x_0 beta_0 theta_0", rewards, "Func", "ValueTable"))
    stream.write("</RewardFunction>\n</pomdpx>\n")


Entries = Iterator[tuple[str, Floats | str]]


def _function(
    variable: str, parents: str, entries: Any, tag: str = "CondProb", table: str = "ProbTable"
) -> Iterator[str]:
    yield f'<{tag}><Var>{variable}</Var><Parent>{parents}</Parent><Parameter type="TBL">\n'
    for instance, values in entries:
        text = values if isinstance(values, str) else numbers(values)
        yield f"<Entry><Instance>{instance}</Instance><{table}>{text}</{table}></Entry>\n"
    yield f"</Parameter></{tag}>\n"


def lines_of(observed: Observed, values: NDArray[np.int64]) -> Iterator[str]:
    """Yield the lines about some observed values, given by their numbers: nearly all of a large file."""
    actions = action_names(observed.pomdp)
    for entries in (_transitions, _theta_moves, _rewards):
        yield from _function("", "", entries(observed, actions, values))


def _over(array: Floats) -> str:
    """Return the POMDPX index of an array of shape (B or 1, T or 1): `-` per axis that varies, `*` per constant one."""
    return " ".join("-" if size > 1 else "*" for size in array.shape)


def _transitions(observed: Observed, actions: list[str], values: NDArray[np.int64]) -> Entries:
    for value, x in zip(values.tolist(), observed.state[values].tolist(), strict=True):
        here = observed.names[value]
        if observed.stays(x):
            yield f"* {here} * * {here}", "1"
            continue
        for r, action in enumerate(actions):
            for y, chance in observed.step(x, r):
                yield f"{action} {here} {_over(chance)} {observed.names[y]}", chance


def _theta_moves(observed: Observed, actions: list[str], values: NDArray[np.int64]) -> Entries:
    yield "nothing * - -", "identity"
    for r, action in enumerate(actions[1:], start=1):
        for value, x in zip(values.tolist(), observed.state[values].tolist(), strict=True):
            matrix = observed.moves(x, r)
            yield f"{action} {observed.names[value]} - -", "identity" if matrix is None else matrix


def _rewards(observed: Observed, actions: list[str], values: NDArray[np.int64]) -> Entries:
    for value, x in zip(values.tolist(), observed.state[values].tolist(), strict=True):
        if observed.stays(x):
            reward = observed.reward(x, 0)
            yield f"* {observed.names[value]} {_over(reward)}", reward
            continue
        for r, action in enumerate(actions):
            reward = observed.reward(x, r)
            yield f"{action} {observed.names[value]} {_over(reward)}", reward
