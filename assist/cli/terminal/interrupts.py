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
    come: int | None = None
    patience: list[threading.Timer] = []

    def end(number: int) -> NoReturn:
        os.write(2, b"interrupted\n")
        os._exit(128 + number)

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        nonlocal come
        if come is not None or _importing(frame):
            end(number)
        come = number
        patience.append(threading.Timer(PATIENCE, end, (number,)))
        patience[0].daemon = True
        patience[0].start()
        raise Interrupted(number)

    heard = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: handler for number, handler in heard.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in heard:
            signal.signal(number, interrupt)
        yield
    except (KeyboardInterrupt, Exception) as error:
        if come is None:
            raise
        # Before or after the command itself; or what was interrupted has made another error of it.
        os.write(2, b"interrupted\n")
        raise SystemExit(128 + come) from error
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)
        for timer in patience:
            timer.cancel()


def _importing(frame: FrameType | None) -> bool:
    """Whether a module is being loaded: some print an exception that comes then, and go on half-loaded."""
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            return True
        frame = frame.f_back
    return False
