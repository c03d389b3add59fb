"""Ctrl-C, and the signals by which service managers, batch systems and closing terminals end a program."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """One of `SIGNALS` has come; `exit_code` is that of a shell for it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn the first of these signals into an `Interrupted`; a second one ends the process at once.

    A signal that is ignored from the start, as Ctrl-C in a script's background job and the closing terminal under
    `nohup`, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    come = False

    def interrupt(number: int, _: FrameType | None) -> NoReturn:
        nonlocal come
        if come:  # tidying up takes too long for somebody
            os._exit(128 + number)
        come = True
        raise Interrupted(number)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    heard = [number for number in SIGNALS if before[number] not in (signal.SIG_IGN, None)]
    try:
        for number in heard:
            signal.signal(number, interrupt)
        yield
    finally:
        for number in heard:
            signal.signal(number, before[number])
