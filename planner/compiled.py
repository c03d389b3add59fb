"""numba, and what has to be known of it: code is compiled once after an installation, and kept in a cache."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

from numba import njit as njit
from numba.core import event

BLAS = "scipy.linalg.cython_blas"


def _load_without_scipy() -> None:
    """Load the part of numba that looks whether scipy is there, without loading scipy, which takes longer than numba.

    It asks on behalf of `np.cov` only, which is not compiled here and has another way; what does need scipy loads it.
    """
    if BLAS in sys.modules:
        return
    sys.modules[BLAS] = None  # type: ignore[assignment]  # "not there"
    try:
        with suppress(ImportError):
            import_module("numba.np.arraymath")
    finally:
        del sys.modules[BLAS]


_load_without_scipy()


@contextmanager
def compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` before each function that is compiled meanwhile, since it is not in the cache."""

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:  # noqa: ARG002
            tell()

        def on_end(self, event: Any) -> None:
            """Nobody is told."""

    with event.install_listener("numba:compile", Listener()):
        yield
