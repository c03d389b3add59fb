"""Progress reports from other processes of this machine.

A `Reporter` writes lines into a pipe, from the process that does the work. A `Listener` reads them in the process that
started the work. Writing never blocks: a report is lost if the pipe is full or closed.
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
"""Receives the description of a stage, the number of items done, and their total (None if it is unknown)."""


@dataclass(frozen=True)
class Reporter:
    """Reports the progress of one item of work, by its number, to a pipe, or to nobody if there is no listener."""

    pipe: int | None
    number: int

    def __call__(self, *report: Any) -> None:
        """Report values that JSON can represent."""
        # Largest report in bytes. POSIX guarantees that writes of up to 512 bytes to a pipe are atomic; longer
        # reports are lost.
        longest = 512
        line = json.dumps([self.number, *report]).encode() + b"\n"
        if self.pipe is not None and len(line) <= longest:
            with suppress(OSError):  # the pipe is closed or full
                os.write(self.pipe, line)


class Listener:
    """Receives reports in a thread, from `start` to `close`.

    Reporters write to `pipe` without blocking. Worker processes get a copy of this descriptor.
    """

    def __init__(self, hear: Callable[..., None]) -> None:
        """Create the pipe. `hear` will be called with the number of the item and the reported values."""
        self._reading, self.pipe = os.pipe()
        os.set_blocking(self.pipe, False)
        self._thread = threading.Thread(target=self._listen, args=(hear,), daemon=True)

    def start(self) -> None:
        """Start the thread that receives reports."""
        self._thread.start()

    def close(self) -> None:
        """Receive the reports that were sent, and stop.

        It waits at most one second if another process still holds a copy of the pipe.
        """
        os.close(self.pipe)
        if self._thread.ident is not None:
            self._thread.join(1.0)
        else:
            os.close(self._reading)

    def _listen(self, hear: Callable[..., None]) -> None:
        with os.fdopen(self._reading, encoding="utf-8") as lines:
            for line in lines:
                hear(*json.loads(line))
