"""When code is compiled: announcements, and functions that are readable first. This needs no compiler.

Who listens need not import the compiler, which takes longer than most small work. Compiling takes seconds, and loading
what is compiled takes half a second. So the readable definition of a function is used until it has done the work of
about a second. From then on, the compiled one is, as there may be much more to come. Both give equal results. Where it
takes a small share of the time, as in a service that waits for people, nothing can be saved, and it remains in use:
somebody would wait for the compiler, which also takes 100 MB.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_listening: list[Callable[[str], None]] = []


@contextmanager
def compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Call `tell` before each function that is compiled within the context because it is not in the cache.

    It receives what the function is for, and about how long compiling takes.
    """
    _listening.append(tell)
    try:
        yield
    finally:
        _listening.remove(tell)


def announce(purpose: str) -> None:
    """Tell all who listen that a function is going to be compiled, and what it is for."""
    for tell in tuple(_listening):
        tell(purpose)


class ReadableFirst:
    """A function that is readable first, and compiled where it pays.

    Parameters
    ----------
    readable, compiled : callable
        The two definitions; results do not depend on which one is used.
    work : callable
        Returns about how many nanoseconds the readable definition takes, from the arguments.
    """

    enough = 1_000_000_000
    """Nanoseconds of work by the readable definition before the compiled one takes over."""
    small = 0.1
    """Share of the time that the work of the readable definition may take without being counted."""

    def __init__(self, readable: Callable[..., Any], compiled: Callable[..., Any], work: Callable[..., float]) -> None:
        self.readable, self.compiled = readable, compiled
        self._work, self._done, self._last = work, 0.0, 0

    def __call__(self, *arguments: Any) -> Any:
        """Call one of the definitions."""
        if self._done > self.enough:
            return self.compiled(*arguments)
        now = time.monotonic_ns()
        self._done = max(0.0, self._done - self.small * (now - self._last)) + self._work(*arguments)
        self._last = now
        return self.readable(*arguments)
