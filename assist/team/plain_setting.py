"""Settings as plain data, as they are saved."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from ..people.trust_rules import LogitSteps, Reliability
from .settings import RULES_OF, Setting


def plain_setting(setting: Setting) -> dict[str, Any]:
    """Return the fields of a setting as plain data, from which `Setting` makes an equal one.

    Trust rules, the observation model and the cost of questions are included only if they are given. So are the fields
    of each robot.

    Raises
    ------
    ValueError
        The trust rule is the user's own, which is not saved.
    """
    plain = asdict(replace(setting, observation=None))
    del plain["observation"]
    if setting.observation is not None:
        plain["observation"] = setting.observation.as_dict()
    plain["robots"] = [robot.as_dict() for robot in setting.robots]
    if setting.c_ask is None:
        del plain["c_ask"], plain["ask_error"]
    for name in RULES_OF:
        rule = getattr(setting, name)
        if rule is None:
            del plain[name]
        elif not isinstance(rule, str | LogitSteps | Reliability):
            raise ValueError(f"{name} {rule!r}: a rule that is not saved; expected a name, LogitSteps or Reliability")
    return plain
