"""Trials of a user's own code: policies, choice models, rules by which theta moves, and terms.

`check` calls a function in the situations in which it will be called later: one person and three, one robot and two,
robots that differ, three possible goals, dead ends, people with habits, truncated tasks, actions that are missed. Each
trial that fails says in a sentence what is wrong. The small tasks of the trials come with the package.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from planner.system.progress import Wanted, adding, shows_progress

from ..people.arguments import one_of
from ..people.terms import Situation
from ..people.user_code import UserCodeError, described, object_of, parse
from ..people.user_code import load as load_function
from .own_code_trials import TRIALS, Place

Kind = Literal["policy", "people", "trust", "neighbours", "term"]


@dataclass(frozen=True)
class Trial:
    """One situation in which code was tried.

    Attributes
    ----------
    what : str
        The situation.
    fault : str or None
        What is wrong, in one sentence; None if nothing is.
    """

    what: str
    fault: str | None = None


@dataclass(frozen=True)
class Checked:
    """What was found when code was tried.

    Attributes
    ----------
    name : str
    kind : "policy", "people", "trust", "neighbours" or "term"
    trials : tuple of Trial
    """

    name: str
    kind: Kind
    trials: tuple[Trial, ...]

    @property
    def faults(self) -> tuple[Trial, ...]:
        """The trials that failed."""
        return tuple(trial for trial in self.trials if trial.fault is not None)

    def __str__(self) -> str:
        """Return a line for each kind of fault with its first situation, or one line if there is none."""
        if not self.faults:
            return f"{self.name} ({self.kind}): all {len(self.trials)} trials passed"
        where: dict[str, list[str]] = {}
        for one in self.faults:
            where.setdefault(str(one.fault), []).append(one.what)
        count = f" (and {{}} more of {len(self.trials)} trials)".format
        return "\n".join(
            f"{self.name} ({self.kind}), {what[0]}{count(len(what) - 1) if len(what) > 1 else ''}: {fault}"
            for fault, what in where.items()
        )

    __repr__ = __str__


@shows_progress
def check(code: Any, kind: Kind | None = None, *, progress: Wanted = None) -> Checked:
    """Try a policy, choice model, rule or term of one's own, and return what is wrong with it.

    Parameters
    ----------
    code : str, callable, TrustRule or SeenRule
        The function or rule itself, or `FILE.py:NAME`. A class without arguments stands for its object.
    kind : "policy", "people", "trust", "neighbours" or "term", optional
        What it is: a team policy, a choice model of people, a trust rule, a rule of what they see of neighbours, or a
        term of a choice. Unless given, it is a trust rule if it has a method `update`, one of neighbours if it has
        neither `uses_answer` nor `feedback` beside it, a choice model if it takes three arguments, a term if its
        argument is annotated as a `Situation`, and else a policy.
    progress : callable or bool, optional
        Receives progress reports, as `planner.system.progress` describes: the number of situations that were tried.

    Raises
    ------
    UserCodeError
        There is no such file or name, or the file cannot be run.
    ValueError
        There is no such kind.
    """
    name, place, code = _loaded(code)
    if kind is not None:
        one_of("kind", kind, get_args(Kind))
    kind = kind or kind_of(code)
    assert callable(progress)
    found, trials = list[Trial](), list(TRIALS[kind](code, place))
    advance = adding(progress, "trying situations", len(trials))
    for what, run in trials:
        try:
            fault = run()
        except (Exception, SystemExit) as error:  # noqa: BLE001 it is the user's, and is told
            fault = _told(error, place and place[0])
        found.append(Trial(what, fault))
        advance(1)
    return Checked(name, kind, tuple(found))


def kind_of(code: Any) -> Kind:
    """Return what code is, as far as its form tells; see `check`."""
    if hasattr(code, "update"):
        return "trust" if hasattr(code, "uses_answer") or hasattr(code, "feedback") else "neighbours"
    try:
        arguments = list(inspect.signature(code).parameters.values())
    except (TypeError, ValueError):
        return "policy"
    needed = [one for one in arguments if one.default is one.empty and one.kind in (0, 1)]
    if len(needed) == 3:
        return "people"
    first = str(needed[0].annotation) if needed else ""
    return "term" if first.rpartition(".")[2].rstrip("'>") == Situation.__name__ else "policy"


def _loaded(code: Any) -> tuple[str, Place, Any]:
    """Return the name of some code, its file and its name there if it was given as FILE.py:NAME, and the object."""
    name, place = str(getattr(code, "__name__", type(code).__name__)), None
    if isinstance(code, str):
        place = parse(code)
        if place is None:
            raise UserCodeError(f"{code!r}; expected FILE.py:NAME, a function or a trust rule")
        name, code = code, load_function(*place)
    if isinstance(code, type):
        code = object_of(code, name)
    if not callable(code) and not hasattr(code, "update"):
        raise UserCodeError(f"{name}: expected a function, or a trust rule with a method `update`")
    return name, place, code


def _told(error: BaseException, file: Path | None) -> str:
    """Return an error as one line; errors of the package already are sentences."""
    text = " ".join(str(error).split())
    if type(error).__module__.startswith(("assist.", "planner.")) or isinstance(error.__cause__, Exception):
        return text
    if file is not None and isinstance(error, Exception):
        return described(error, file)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
