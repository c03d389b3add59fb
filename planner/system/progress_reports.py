"""How far work is that other processes of this machine do.

A `Reporter` writes lines into a pipe, from whatever process the work is in; a `Listener` hears them in the process that
asked. Nothing waits for a report: where nobody listens any more, or too much has been said already, it is lost.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

Progress = Callable[[str, int, int | None], None]
"""Called with what is under way, how much of it is done, and of how much; None where nobody knows."""

LONGEST = 512
"""Bytes of a report: so many are written at once, on every system, or not at all."""

PATIENCE = 1.0
"""Seconds that the last reports may take to be heard."""


@dataclass(frozen=True)
class Reporter:
    """Says how far one piece of work is.

    Attributes
    ----------
    pipe : int or None
        Where to write; None where nobody listens.
    number : int
        Whose reports these are.
    """

    pipe: int | None
    number: int

    def __call__(self, *report: Any) -> None:
        """Say something that JSON can hold."""
        line = json.dumps([self.number, *report]).encode() + b"\n"
        if self.pipe is not None and len(line) <= LONGEST:
            with suppress(OSError):  # nobody reads it, or it is full
                os.write(self.pipe, line)


class Listener:
    """Hears reports, in a thread, from `start` to `close`.

    Attributes
    ----------
    pipe : int
        Where reporters write, without waiting; the processes that work get a copy.
    """

    def __init__(self, hear: Callable[..., None]) -> None:
        """Make the pipe; `hear` will be called with the number of the one who reports, and with what it says."""
        self._reading, self.pipe = os.pipe()
        os.set_blocking(self.pipe, False)
        self._thread = threading.Thread(target=self._listen, args=(hear,), daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """Hear what has been said, and end; nobody may go on reporting."""
        os.close(self.pipe)
        if self._thread.ident is not None:
            self._thread.join(PATIENCE)
        else:
            os.close(self._reading)

    def _listen(self, hear: Callable[..., None]) -> None:
        with os.fdopen(self._reading, encoding="utf-8") as lines:
            for line in lines:
                hear(*json.loads(line))
