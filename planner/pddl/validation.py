"""The second reader: unified-planning reads files and validates plans, in a process of its own.

unified-planning checks types and the whole language. It validates plans independently of all that is computed here. It
is not used to expand states. It also refuses some valid files: it requires distinct names where Fast Downward does not.
The translator therefore decides.

A `SecondReader` works beside everything else, and nothing waits for it before all else is done. Its internal errors,
memory and time are confined to the process, which is reused for the next instance. The process never outlives the one
that started it.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
import types
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from ..system.errors import MismatchError
from ..system.limits import NO_LIMITS, Limits, limit_process
from ..system.processes import guarded_group, python
from .compilation import domain_text, problem_text
from .reader import Reading

if TYPE_CHECKING:
    from concurrent.futures import Future
    from multiprocessing.connection import Connection

    from unified_planning.model import Problem

LATE = "it had not answered when all else was done"

ANNOTATIONS = {"ConfigSpace": "ConfigurationSpace", "networkx": "DiGraph"}
"""Packages that unified-planning's reader and validator use for annotations only, and the names used. The process has
stand-ins for them: it starts in 0.16 s of processor time, instead of 1.05 s.
"""


class SecondReader:
    """unified-planning reading one instance, from the constructor on. Use it as a context manager."""

    def __init__(self, reading: Reading, limits: Limits = NO_LIMITS) -> None:
        from concurrent.futures import Future  # slow to import, and only `solve` needs it

        self._process: _Process | None = None
        self._plan: Future[list[str] | None] = Future()
        self._said: Future[str | None] = Future()
        try:
            self._process = _Process.idle(limits)
        except OSError as error:
            self._said.set_result(f"it cannot be started ({error.strerror})")
        else:
            threading.Thread(target=self._converse, args=(self._process, reading), daemon=True).start()

    def __enter__(self) -> SecondReader:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self.ask(None)
            self._process.release(reusable=self._said.done())

    def ask(self, plan: Sequence[str] | None) -> None:
        """Ask whether a plan solves the instance. This does not wait for the answer."""
        if not self._plan.done():
            self._plan.set_result(None if plan is None else list(plan))

    def answer(self, seconds: float) -> str | None:
        """Return why the instance or its plan is not checked; None if both are valid. No plan can be asked afterwards.

        This waits at most for so many seconds. A plan that unified-planning rejects raises a `MismatchError`.
        """
        self.ask(None)
        try:
            return self._said.result(max(0.0, min(seconds, threading.TIMEOUT_MAX)))
        except TimeoutError:
            return LATE

    def _converse(self, process: _Process, reading: Reading) -> None:
        """Ask about the files, then about the plan; this is done in a thread, as the process reads when it can."""
        try:
            said = process.asked("files", domain_text(reading, list_object=True), problem_text(reading))
            plan = self._plan.result()
            if said is None and plan is not None:
                said = process.asked("plan", plan)
        except MismatchError as error:
            self._said.set_exception(error)
        except (EOFError, OSError):
            process.left = 0
            self._said.set_result("its process died")
        else:
            self._said.set_result(said)


@dataclass
class _Process:
    """A process that answers one question after another."""

    popen: subprocess.Popen[bytes]
    connection: Connection
    owner: int
    """Id of the process that started it; a fork does not use it."""
    left: int
    """Number of further instances that it may read, since the library keeps what it has read in memory."""

    @classmethod
    def idle(cls, limits: Limits) -> _Process:
        """Return an idle process, or start one. A process with a memory limit is a new one, and reads one instance."""
        while _idle and limits.memory_mb is None:
            process = _idle.pop()
            if process.owner != os.getpid():
                process.popen.returncode = 0  # it is no child of this fork, of which Popen would warn
            elif process.popen.poll() is None:
                return process
        from multiprocessing import Pipe  # slow to import

        connection, other = Pipe()
        with other:
            popen = subprocess.Popen(
                python("planner.pddl.validation", str(other.fileno())),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
                process_group=guarded_group(),
            )
        if limits.memory_mb is None:
            return cls(popen, connection, os.getpid(), left=100)
        mapped_mb = 1000.0  # megabytes that imported libraries map without using them, added to the limit of memory
        limit_process(popen.pid, limits.memory_mb + mapped_mb)
        return cls(popen, connection, os.getpid(), left=1)

    def asked(self, *question: Any) -> str | None:
        """Return the answer to a question: None if all is well, or why there is no result."""
        self.connection.send(question)
        said, rejected = self.connection.recv()
        if rejected:
            raise MismatchError(said)
        return said

    def release(self, *, reusable: bool) -> None:
        """Keep the process for the next instance, or end it if it is busy or not needed."""
        self.left -= 1
        if reusable and self.left > 0 and not _idle:
            _idle.append(self)
            return
        self.popen.kill()
        self.popen.wait()


_idle: list[_Process] = []


@atexit.register
def _end_idle() -> None:
    """End the processes that wait for a next instance."""
    while _idle:
        process = _idle.pop()
        if process.owner == os.getpid():
            process.release(reusable=False)


def validate(problem: Problem, plan: Sequence[str]) -> None:
    """Check a plan, a sequence of ground actions `(name arg ...)`, with unified-planning's own validator.

    If it does not lead to the goal, or an action of it is not applicable, this raises a `MismatchError`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from unified_planning.engines import SequentialPlanValidator, ValidationResultStatus
        from unified_planning.io import PDDLReader

        parsed = PDDLReader(problem.environment).parse_plan_string(problem, "\n".join(plan))
        validator = SequentialPlanValidator(environment=problem.environment)
        # It supports functions without a value for some arguments, although its list of features does not say so.
        validator.skip_checks = True
        result = validator.validate(problem, parsed)
    if result.status != ValidationResultStatus.VALID:
        raise MismatchError(f"unified-planning's validator rejects the plan: {result.reason}")


def parsed(domain: str, problem: str) -> tuple[Problem | None, str | None]:
    """Return an instance's texts as a problem of unified-planning; or None, and why it refuses them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unified-planning and pyparsing warn of their own internals
        from unified_planning.io import PDDLReader

        try:
            return PDDLReader().parse_problem_string(domain, problem), None
        except Exception as fault:  # noqa: BLE001  it raises any exception, internal errors included
            clear_walkers()
            # Further lines give places in the rewritten text, and further sentences name options of the library.
            said = str(fault).partition("\n")[0].partition("! ")[0]
            return None, f"it says '{said}'" if said else f"it fails at it ({type(fault).__name__})"


def clear_walkers() -> None:
    """Reset the walkers of the shared environment after an error, which would otherwise affect their next use."""
    from unified_planning.environment import get_environment

    for walker in vars(get_environment()).values():
        if isinstance(stack := getattr(walker, "stack", None), list):
            stack.clear()


def _serve(connection: Connection) -> None:
    """Answer questions about files, and about plans for the latest instance, until the connection is closed."""
    for package, name in ANNOTATIONS.items():
        stand_in = types.ModuleType(package)
        setattr(stand_in, name, object)
        sys.modules.setdefault(package, stand_in)

    problem, known = None, lru_cache(8)(parsed)  # the same few instances are often loaded again
    with suppress(EOFError):
        while True:
            what, *given = connection.recv()
            said, rejected = None, False
            try:
                if what == "files":
                    problem, said = known(*given)
                else:
                    validate(problem, *given)
            except MismatchError as error:
                said, rejected = str(error), True
            except Exception as error:  # noqa: BLE001  the library's own internal errors
                said = f"it fails at it ({type(error).__name__})"
            connection.send((said, rejected))


if __name__ == "__main__":
    from multiprocessing.connection import Connection

    _serve(Connection(int(sys.argv[1])))
