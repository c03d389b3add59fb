"""Functions with a readable and a compiled definition, which give equal results, to the last bit.

Compiling takes seconds, and loading what is compiled takes half a second. So the readable definition is used until it
has done the work of about a second. From then on, the compiled one is, as there may be much more to come.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


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

    def __init__(self, readable: Callable[..., Any], compiled: Callable[..., Any], work: Callable[..., float]) -> None:
        self.readable, self.compiled = readable, compiled
        self._work, self._done = work, 0.0

    def __call__(self, *arguments: Any) -> Any:
        """Call one of the definitions."""
        if self._done > self.enough:
            return self.compiled(*arguments)
        self._done += self._work(*arguments)
        return self.readable(*arguments)
