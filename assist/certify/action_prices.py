"""Prices of actions in a bound for robots that differ, in addition to the price of their attention.

In people's problems every robot has the best ability and the lowest costs of any (`person.fleet`). Other robots of the
team pay more. Prices of suggestions and of executions bring that back into the bound. Let e_m(a) be what an action of
class a costs robot m more than the best robot: infinite if it cannot execute.

Assumptions. Those of `team_bound`.

Claim. For all prices lambda_t >= 0 of attention and mu_t(a) >= 0 of the two classes of actions, the optimal value J* of
a team of robots 1, ..., M is at most

    sum_t gamma^t sum_m (lambda_t + max(0, max_a (mu_t(a) - e_m(a))))  +  sum_k V_k(lambda, mu),

where V_k is the optimal value of person k's subproblem with the best robot, at these prices: each step of attention has
the price lambda_t, and an action of class a the price mu_t(a) in addition.

Proof. Consider any policy of the team. An action of class a costs robot m what it costs the best robot, plus e_m(a). In
a step, a robot attends to no person, or to a person without an action, or takes one action, of some class a. In its
part of the first sum the robot has at least as much as the prices of what it does, minus e_m(a): nothing, lambda_t, or
lambda_t + mu_t(a). So the return increases or stays the same if the first sum is added, and the prices are subtracted
and the costs e_m(a) added back. The result is the first sum plus, for each person, a return with the best robot's costs
at these prices. What the robots do to person k is a policy of their subproblem with the best robot
(`assist.person.fleet`), so that its mean is at most V_k.

With mu = 0 it is the bound of the best robots, as e_m(a) >= 0.
"""

from __future__ import annotations

import numpy as np

from ..people.decision import Floats
from ..person.robots import EXECUTION, SUGGESTION
from ..person.settings import Setting


def paid(price: Floats, setting: Setting) -> float:
    """Return the discounted sum that all robots pay at most, in cost units.

    Parameters
    ----------
    price : float array, shape (3, W)
        Prices of attention, and of a suggestion and of an execution, at each step.
    setting : Setting
    """
    discount = setting.gamma ** np.arange(price.shape[1])
    attention = len(setting.robots) * float(price[0] @ discount)
    return attention + float(np.maximum(*_worth(price, setting.fleet.extra)).clip(0).sum(axis=0) @ discount)


def supply(price: Floats, extra: Floats) -> Floats:
    """Return how many robots attend, suggest and execute at most if prices rise slightly, shape (3, W).

    These are the derivatives of what robots pay, as in `paid`, in the prices of each step.
    """
    suggesting, executing = _worth(price, extra)
    every = np.full(price.shape[1], len(extra))
    suggest, execute = suggesting >= executing.clip(0), executing >= suggesting.clip(0)
    return np.array([every, suggest.sum(axis=0), execute.sum(axis=0)], dtype=float)


def _worth(price: Floats, extra: Floats) -> tuple[Floats, Floats]:
    """Return the price of each action minus what it costs each robot more, both of shape (M, W)."""
    return price[1] - extra[:, SUGGESTION, None], price[2] - extra[:, EXECUTION, None]
