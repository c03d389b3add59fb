"""Announcements of compilation. Who listens need not import the compiler, which takes longer than most small work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listening: list[Callable[[], None]] = []


@contextmanager
def compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` before each function that is compiled within the context because it is not in the cache."""
    _listening.append(tell)
    try:
        yield
    finally:
        _listening.remove(tell)


def announce() -> None:
    """Tell all who listen that a function is going to be compiled."""
    for tell in tuple(_listening):
        tell()
