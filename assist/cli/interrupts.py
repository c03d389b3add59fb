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
PATIENCE = 3.0  # seconds that a command may take to tidy up


class Interrupted(KeyboardInterrupt):
    """One of `SIGNALS` has come; `exit_code` is that of a shell for it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn the first of these signals into an `Interrupted`, and end the process soon, whatever it waits for.

    It ends at once with a second signal, and after `PATIENCE` without one: what is finished is on the disk already. A
    signal that is ignored from the start, as Ctrl-C in a script's background job and the closing terminal under
    `nohup`, stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    patience: threading.Timer | None = None

    def end(number: int) -> NoReturn:
        os.write(2, b"interrupted\n")
        os._exit(128 + number)

    def interrupt(number: int, _: FrameType | None) -> NoReturn:
        nonlocal patience
        if patience is not None:
            end(number)
        patience = threading.Timer(PATIENCE, end, (number,))
        patience.daemon = True
        patience.start()
        raise Interrupted(number)

    heard = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: handler for number, handler in heard.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in heard:
            signal.signal(number, interrupt)
        yield
    except Interrupted as interrupted:  # before or after the command itself
        os.write(2, b"interrupted\n")
        raise SystemExit(interrupted.exit_code) from None
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)
        if patience is not None:
            patience.cancel()
