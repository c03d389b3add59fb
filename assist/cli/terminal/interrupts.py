"""Handling of Ctrl-C and of the signals with which batch systems and closing terminals end a program."""

from __future__ import annotations

import atexit
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE = 3.0  # seconds for cleaning up; users wait no longer, and finished results are already saved


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt(number)` at the first signal, and make sure that the process ends soon.

    The process exits at a second signal, or `PATIENCE` seconds after the first. Finished results are saved before. A
    signal that is ignored at the start stays ignored, as for background jobs of scripts and under `nohup`.
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
        raise KeyboardInterrupt(number)

    heard = {number: signal.getsignal(number) for number in SIGNALS}
    heard = {number: handler for number, handler in heard.items() if handler not in (signal.SIG_IGN, None)}
    try:
        for number in heard:
            signal.signal(number, interrupt)
        yield
    except (KeyboardInterrupt, Exception) as error:
        if come is None:
            raise
        # The signal came outside the command, or the command turned the interrupt into another error.
        os.write(2, b"interrupted\n")
        raise SystemExit(128 + come) from error
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)
        for timer in patience:
            timer.cancel()
        atexit.unregister(_exit_at_signals)
        atexit.register(_exit_at_signals)


def _exit_at_signals() -> None:
    """Make signals end the process at once while Python exits, where an interrupt would be printed as a traceback."""
    for number in SIGNALS:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, signal.SIG_DFL)


def _importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported. Some modules swallow an exception at this time and stay half-loaded."""
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            return True
        frame = frame.f_back
    return False
