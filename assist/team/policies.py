"""Team policies by name: those that come with the package, and one's own in a file.

`named` makes the paper's and ours. `OwnPolicy` is a function in a Python file, written `FILE.py:FUNCTION`; what goes
wrong in it is reported as a `PolicyError` with its file and line, since it is not the caller's to mend.
"""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from ..person.pomdp import Policy
from .attention import AttentionSwitching, NoAssistance, Reactive
from .priority import Priority
from .state import PolicyError, TeamAction, TeamPolicy, TeamState
from .travel import Travel

POLICIES = ("none", "reactive", "attention", "attention-never", "priority")
"""The names that `named` knows."""


def named(name: str, policies: Sequence[Policy], travel: Travel) -> TeamPolicy:
    """Make a team policy by its name.

    Parameters
    ----------
    name : str
        The paper's "none", "reactive" and "attention", "attention-never" for the other reading of its
        Algorithm 1, and our own "priority".
    policies : sequence of Policy
        For the people by themselves.
    travel : Travel
        The way between them.

    Raises
    ------
    ValueError
        Another name.
    """
    if name == "none":
        return NoAssistance()
    if name == "reactive":
        return Reactive()
    if name == "attention":
        return AttentionSwitching()
    if name == "attention-never":
        return AttentionSwitching.against_never(policies)
    if name == "priority":
        return Priority.of(policies, travel)
    raise ValueError(f"unknown policy {name!r}; expected one of {', '.join(POLICIES)}, or a function")


@dataclass(frozen=True)
class OwnPolicy:
    """A team policy of the user's own.

    Attributes
    ----------
    file : Path
    name : str
        Of the function in that file.
    function : callable
    """

    file: Path
    name: str
    function: TeamPolicy

    @classmethod
    def load(cls, file: Path, name: str) -> OwnPolicy:
        """Load a function from a Python file.

        Raises
        ------
        PolicyError
            There is no such file or function, or the file cannot be run.
        """
        if not file.is_file():
            raise PolicyError(f"{file}: no such file")
        # A name of its own for each file, under which its classes find their module.
        module_name = f"_own_policy_{sha256(str(file.resolve()).encode()).hexdigest()[:12]}"
        spec = importlib.util.spec_from_file_location(module_name, file)
        if spec is None or spec.loader is None:
            raise PolicyError(f"{file}: expected a Python file, whose name ends in .py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        try:
            spec.loader.exec_module(module)
        except (Exception, SystemExit) as error:
            raise PolicyError(_described(error, file)) from error
        function = getattr(module, name, None)
        if not callable(function):
            raise PolicyError(f"{file}: has no function '{name}'")
        return cls(file, name, function)

    @property
    def uses_belief(self) -> bool:
        """Whether it wants beliefs; yes unless the function says no."""
        return bool(getattr(self.function, "uses_belief", True))

    @property
    def place(self) -> str:
        """File and line in which the function begins."""
        code = getattr(self.function, "__code__", None)
        return f"{self.file}:{code.co_firstlineno}" if code else f"{self.file}:{self.name}"

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Choose as the function does."""
        try:
            return self.function(team)
        except (Exception, SystemExit) as error:
            raise PolicyError(_described(error, self.file)) from error


def parse(text: str, folder: Path | None = None) -> tuple[Path, str] | None:
    """Take FILE.py:FUNCTION apart, FILE being sought in a folder; None for what has no such form."""
    path, colon, function = text.rpartition(":")
    return ((folder or Path()) / path, function) if colon else None


def _described(error: Exception | SystemExit, file: Path) -> str:
    """Say in one line what went wrong, and where in the user's file."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if Path(frame.filename) == file or Path(frame.filename).resolve() == file.resolve():
            line = frame.lineno
    text = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    what = type(error).__name__ + (f": {text}" if text else "")
    return f"{file}:{line}: {what}" if line else f"{file}: {what}"
