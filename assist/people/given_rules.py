"""Rules by which theta moves as users give them: names, tables, or their own, which are tried once.

A trial has events of all kinds, after which theta has to be a number from 0 to 1. Only the map itself is tried; `check`
also simulates people with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from hashlib import sha256
from typing import Any, TypeVar, get_args

from planner.system.errors import expected

from ..declare.declared import is_declared
from .trust_rules import RULES, Event, Feedback, TrustRule, counts_of, may_move, of_table
from .user_code import UserCodeError, UserRule, parse

R = TypeVar("R")

THETAS, EVENTS = SHAPE = 11, 16
GAINS = (-2.0, 0.0, 1.0)
MOST_COUNTS = 4
"""Counts of outcomes that are tried."""


def rule_given(rule: Any, least: float = 0.0) -> str | TrustRule | None:
    """Return a trust rule, its name or None; a table becomes its rule, and so does FILE.py:RULE.

    Parameters
    ----------
    rule : str, mapping or object
    least : float
        Least theta to which a rule of the user's own is applied, and one minus the largest.

    Raises
    ------
    UserCodeError
        It is a rule of the user's own, and as `possible` says.
    ValueError
        It is none of these.
    """
    form = "uses_answer, feedback and update"
    return None if rule is None else given_as(rule, RULES, lambda one: possible(one, least), form)


def given_as(rule: Any, shipped: Mapping[str, Callable[..., R]], tried: Callable[[Any], Any], form: str) -> str | R:
    """Return a rule of any kind, or its name; a table becomes its rule, and so does FILE.py:RULE.

    Parameters
    ----------
    rule : str, mapping or object
    shipped : mapping of str to callable
        The shipped rules of this kind, by name.
    tried : callable
        Receives a rule of the user's own; its errors are those of this function, too.
    form : str
        What an object has that is such a rule.

    Raises
    ------
    ValueError
        It is none of these.
    """
    if isinstance(rule, Mapping):
        return of_table(shipped, rule)
    if isinstance(rule, str):
        source = parse(rule)
        if source is None and rule not in shipped:
            raise ValueError(f"'{rule}'; {expected(rule, shipped, ', a rule, or FILE.py:RULE')}")
        if source is None:
            return rule
        rule = UserRule.load(*source)
    if not hasattr(rule, "update"):
        raise ValueError(f"{rule!r}; expected a name, or an object with {form}")
    if not is_declared(type(rule)):
        tried(rule)
    found: R = rule
    return found


def possible(rule: Any, least: float = 0.0) -> TrustRule:
    """Return a rule of the user's own that passes the trial.

    Parameters
    ----------
    rule : TrustRule
    least : float
        As in `rule_given`.

    Raises
    ------
    UserCodeError
        It fails, or returns what is impossible.
    """
    name = str(getattr(rule, "__name__", type(rule).__name__))
    if isinstance(rule, type):
        raise UserCodeError(f"{name} is a class; expected its object, such as {name}()")
    fault = fault_of_attributes(rule)
    if fault is None:
        fault = _once(rule, least)
    if fault is not None:
        told = fault.startswith(str(getattr(rule, "file", "\0")))
        raise UserCodeError(fault if told else f"{name}: {fault}")
    found: TrustRule = rule
    return found


@lru_cache(maxsize=64)
def _once(rule: Any, least: float) -> str | None:
    """Return what is wrong with a rule; an error in a file is told with it and the line."""
    try:
        return fault_of_updates(rule, least)
    except UserCodeError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 it is the user's, and is told
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def digest(rule: Any) -> str:
    """Return a hash of where a rule leads, which identifies it better than a name."""
    import numpy as np

    from .perceived_suggestions import moved

    content, theta = sha256(f"{rule.uses_answer} {rule.feedback} {counts_of(rule)}".encode()), _thetas(0.0)
    for gain in GAINS:
        for count in range(counts_of(rule) + 1):
            to, after = moved(rule, theta, np.full((THETAS, 1), count), _events(gain))
            content.update(np.broadcast_to(np.asarray(to, dtype=float), (THETAS, EVENTS)).tobytes())
            content.update(np.asarray(after, dtype=np.int64).tobytes())
    for to, after in _after_silence(rule, theta):
        content.update(np.broadcast_to(to, (THETAS, 1)).tobytes() + after.tobytes())
    return content.hexdigest()[:32]


def fault_of_attributes(rule: Any) -> str | None:
    """Return what is wrong with the attributes of a rule; None if nothing is."""
    if not isinstance(getattr(rule, "uses_answer", None), bool):
        return "has no attribute `uses_answer`; expected True if `followed` or `shown` matter, and False otherwise"
    if getattr(rule, "feedback", None) not in get_args(Feedback):
        wrong = f"has feedback {rule.feedback!r}" if hasattr(rule, "feedback") else "has no attribute `feedback`"
        return f"{wrong}; expected one of {', '.join(get_args(Feedback))}"
    try:
        hash(getattr(rule, "loaded", rule))
    except TypeError:
        return "cannot be hashed; expected a frozen object, such as @dataclass(frozen=True)"
    return None


def fault_of_updates(rule: Any, least: float = 0.0) -> str | None:
    """Return what is wrong with the thetas and counts to which a rule leads; None if nothing is."""
    import numpy as np

    from .perceived_suggestions import moved

    theta, most = _thetas(least), counts_of(rule)
    for gain in GAINS:
        for count in range(min(most, MOST_COUNTS) + 1):
            before, counts = theta.copy(), np.full((THETAS, 1), count)
            with np.errstate(all="ignore"):
                to, after = moved(rule, theta, counts, _events(gain))
            if not np.array_equal(theta, before):
                return "changes the array theta; expected a new array"
            found = np.asarray(to, dtype=float)
            fault = _fault_of_shape(found) or _out_of_range(found, np.asarray(after), most)
            if fault is not None:
                return fault
            if (fault := _fault_of_each(rule, np.broadcast_to(found, SHAPE), theta, gain, count)) is not None:
                return fault
    in_silence = (_out_of_range(to, counted, most, " in silence") for to, counted in _after_silence(rule, theta))
    return next(filter(None, in_silence), None)


def _fault_of_shape(to: Any) -> str | None:
    """Return what is wrong with the shape of the thetas after all events of a gain."""
    import numpy as np

    try:
        np.broadcast_to(to, SHAPE)
    except ValueError:
        return f"returns shape {to.shape} for {THETAS} thetas and {EVENTS} events; expected {SHAPE}, by broadcasting"
    return None


def _out_of_range(to: Any, counted: Any, most: int, when: str = "") -> str | None:
    """Return which of some thetas or counts is out of its range; `when` says after which steps they are."""
    inside = (to >= 0) & (to <= 1)
    if not inside.all():
        return f"leads to theta {to[~inside][0]:g}{when}; expected a number from 0 to 1"
    inside = (counted >= 0) & (counted <= most)
    return None if inside.all() else f"counts to {counted[~inside][0]:g}{when}; expected 0 to {most}"


def _after_silence(rule: Any, theta: Any) -> Iterator[tuple[Any, Any]]:
    """Yield theta and the count after a step without a suggestion, from each count, if the rule sees such steps."""
    import numpy as np

    from .perceived_suggestions import moved

    for count in range(min(counts_of(rule), MOST_COUNTS) + 1 if may_move(rule, False) else 0):
        to, after = moved(rule, theta.copy(), np.full((THETAS, 1), count), Event.silent())
        yield np.asarray(to, dtype=float), np.asarray(after, dtype=np.int64)


def _fault_of_each(rule: Any, to: Any, theta: Any, gain: float, count: int) -> str | None:
    """Return what is wrong with the thetas after all events of a gain beside each other, and beside those of one."""
    import numpy as np

    from .perceived_suggestions import moved

    agrees, _, _, right = _bits()
    if not rule.uses_answer:
        same = to[:, _same_answers(agrees, right)]
        if (same != same[:, :, :1]).any():
            return "depends on `followed` or `shown` though its `uses_answer` is False"
    for t, e in ((2, 5), (7, 12)):
        one = Event(np.array(gain), *(row[e] for row in _bits()))
        alone, _ = moved(rule, theta[t, 0], np.array(count), one)
        if not np.isclose(float(alone), to[t, e], 0, 1e-12):
            return "gives another theta for one event alone than among others; expected each by itself"
    return None


def _thetas(least: float) -> Any:
    import numpy as np

    return np.linspace(least, 1.0 - least, THETAS)[:, None]


def _bits() -> Any:
    """Return agrees, followed, shown and right of each event, shape (4, EVENTS)."""
    import numpy as np

    return np.array([[bool(number >> bit & 1) for number in range(EVENTS)] for bit in range(4)])


def _events(gain: float) -> Event:
    """Return events of all kinds with a gain, shape (1, EVENTS)."""
    import numpy as np

    return Event(np.full((1, EVENTS), gain), *(row[None, :] for row in _bits()))


def _same_answers(agrees: Any, right: Any) -> Any:
    """Return the events, shape (4, 4), that differ by the answer only, for each agreement and outcome."""
    import numpy as np

    return np.array([np.flatnonzero((agrees == a) & (right == r)) for a in (False, True) for r in (False, True)])
