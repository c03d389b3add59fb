"""The second reader: unified-planning reads an instance and validates its plan, in a separate process.

A `SecondReader` works beside everything else. Nothing waits for it before all else is done, since the library may need
longer to read a file than all other work together. Its internal errors, memory and time are confined to the process.
The process is reused for the next instance, and ends with the process that started it.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from math import inf
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from ..system.limits import NO_LIMITS, Limits, limit_process
from ..system.machine import processor_seconds
from ..system.processes import guarded_group, python
from . import writer
from .reader import Reading
from .validation import InstanceRefusedError, InvalidPlanError, parsed, validate

LATE = "it had not answered when all else was done"

ANNOTATIONS = {"ConfigSpace": "ConfigurationSpace", "networkx": "DiGraph"}
"""Packages that unified-planning's reader and validator use for annotations only, and the names used. Importing them
takes 1.4 s of 1.7 s.
"""


class SecondReader:
    """unified-planning reading one instance, from the constructor on. Use it as a context manager."""

    def __init__(self, reading: Reading, limits: Limits = NO_LIMITS) -> None:
        self._process: _Process | None = None
        self._unread: str | None = None
        if rules := reading.domain.rules:  # without the file's path, since records of copies are compared
            self._unread = f"it knows no derived predicates (line {rules[0].head.place.line} of the domain)"
            return
        try:
            self._process = _Process.idle(limits)
        except OSError as error:
            self._unread = f"it cannot be started ({error.strerror})"
        else:
            self._process.ask(
                lambda: {"domain": writer.domain(reading, list_object=True), "problem": writer.problem(reading)}
            )

    def __enter__(self) -> SecondReader:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.release()

    def ask(self, plan: Sequence[str]) -> None:
        """Ask whether a plan solves the instance. This does not wait for the answer."""
        if self._process is not None:
            self._process.ask(lambda: {"plan": list(plan)})

    def answer(self, processor: float, seconds: float = inf) -> str | None:
        """Return why the instance or its plan is not checked; None if both are valid.

        This waits at most for so many seconds of the process's processor time, and so many seconds on the clock; a
        process that hardly gets a processor is waited for twelve times the former. A plan that unified-planning rejects
        raises an `InvalidPlanError`.
        """
        end, said = time.monotonic() + min(seconds, 12 * processor), self._unread
        most = processor if self._process is None else processor + self._process.used()
        while self._process is not None and self._process.asked:
            answer = self._process.answer(end, most)
            if isinstance(answer, InvalidPlanError):
                raise answer
            said = said or answer
        return said


class _Process:
    """A process that answers questions in order, over a connection."""

    waiting: tuple[int, list[_Process]] = (0, [])  # process id, since a fork inherits this, and its idle processes

    def __init__(self, limits: Limits) -> None:
        mapped_mb = 1000.0  # megabytes that imported libraries map without using them, added to the limit of memory
        self._connection, other = Pipe()
        with other:
            self._popen = subprocess.Popen(
                python("planner.pddl.validation_process", str(other.fileno())),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
                process_group=guarded_group(),
            )
        self._limited = limits.memory_mb is not None
        limit_process(self._popen.pid, None if limits.memory_mb is None else limits.memory_mb + mapped_mb)
        self.asked = 0  # questions without an answer
        self._instances = 0
        self._questions: SimpleQueue[Callable[[], Mapping[str, Any]] | None] = SimpleQueue()
        self._sender = threading.Thread(target=self._send, daemon=True)
        self._sender.start()

    @classmethod
    def idle(cls, limits: Limits) -> _Process:
        """Return an idle process, or start one. A process with a memory limit is always a new one."""
        owner, waiting = cls.waiting
        if owner != os.getpid():
            waiting = []
            cls.waiting = os.getpid(), waiting
            atexit.register(cls._end_all)
        process = waiting.pop() if waiting and limits.memory_mb is None else cls(limits)
        process._instances += 1
        return process

    @classmethod
    def _end_all(cls) -> None:
        owner, waiting = cls.waiting
        while owner == os.getpid() and waiting:
            waiting.pop()._close()

    def release(self) -> None:
        """Keep the process for the next instance, or end it if it is busy, limited, or not needed."""
        # Instances that one process reads before it is replaced, since the library keeps what it has read in memory.
        instances = 100
        waiting = self.waiting[1]
        alive = self._popen.poll() is None
        if alive and not self.asked and not self._limited and not waiting and self._instances < instances:
            waiting.append(self)
        else:
            self._close()

    def _close(self) -> None:
        self._popen.kill()
        self._popen.wait()
        self._questions.put(None)
        self._sender.join()
        self._connection.close()

    def ask(self, question: Callable[[], Mapping[str, Any]]) -> None:
        """Send a question, which is written in a thread. Each question has one answer."""
        self.asked += 1
        self._questions.put(question)

    def _send(self) -> None:
        """Send questions one after another. The process reads the next one only after it has answered the last."""
        with suppress(OSError):  # the process has died, which `answer` reports
            while (question := self._questions.get()) is not None:
                self._connection.send(question())

    def used(self) -> float:
        """Return the seconds of processor time that the process has used, or of the clock where that is unknown."""
        used = processor_seconds(self._popen.pid)
        return time.monotonic() if used is None else used

    def answer(self, end: float, most: float) -> str | InvalidPlanError | None:
        """Wait for the next answer: None if all is well, the error of a plan, or the reason why there is no result.

        The wait ends at a time on the clock of `time.monotonic()`, or when the process has used `most` seconds.
        """
        between = 0.1  # seconds between two looks at the processor time
        try:
            while not self._connection.poll(max(0.0, min(between, end - time.monotonic()))):
                if time.monotonic() >= end or self.used() >= most:
                    self._end()
                    return LATE
            found: str | InvalidPlanError | None = self._connection.recv()
        except (EOFError, ConnectionResetError):
            self._end()
            return "its process died"
        self.asked -= 1
        return found

    def _end(self) -> None:
        """End the process. No further answer is waited for."""
        self._popen.kill()
        self._popen.wait()
        self.asked = 0


def _serve(connection: Connection) -> None:
    """Answer questions about files, and about plans for the latest instance, until the connection is closed."""
    for package, name in ANNOTATIONS.items():
        stand_in = types.ModuleType(package)
        setattr(stand_in, name, object)
        sys.modules.setdefault(package, stand_in)

    problem, known = None, lru_cache(8)(parsed)  # the same few instances are often loaded again
    with suppress(EOFError):
        while True:
            question = connection.recv()
            answer: str | InvalidPlanError | None = None
            try:
                if "plan" in question:
                    validate(problem, question["plan"])
                else:
                    problem = known(question["domain"], question["problem"])
            except InstanceRefusedError as error:
                answer = str(error)
            except InvalidPlanError as error:
                answer = error
            except Exception as error:  # noqa: BLE001  the library's own internal errors
                answer = f"it fails at it ({type(error).__name__})"
            connection.send(answer)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
