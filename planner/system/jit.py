"""Just-in-time compilation with numba, its cache on disk, and when code is compiled.

A function is compiled when it is first called. Later processes load its code from the cache. numba itself is imported
then, too: that takes longer than most small work, which needs no compiled code. Compiling takes seconds, and loading
what is compiled takes half a second. So some functions are readable first (`ReadableFirst`). Who listens to what is
compiled (`compiling`) need not import the compiler, nor numpy.
"""

from __future__ import annotations

import functools
import hashlib
import linecache
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from types import FrameType, FunctionType, ModuleType
from typing import Any

from .files import locked

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

    The readable definition is used until it has done the work of about a second. From then on, the compiled one is, as
    there may be much more to come. Both give equal results. Where it takes a small share of the time, as in a service
    that waits for people, nothing can be saved, and it remains in use: somebody would wait for the compiler, which also
    takes 100 MB.

    `work` returns about how many nanoseconds the readable definition takes, from the arguments.
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


BLAS = "scipy.linalg.cython_blas"

COMPILED_FOR = "a part that saves time at large sizes: some seconds"
"""What the functions of a module are compiled for, and about how long this takes, unless the module says it itself."""

LONGEST_WAIT = 120.0
"""Seconds for which a process waits while another one compiles the same function, before it compiles it, too."""

_loading = threading.RLock()


@cache
def _numba() -> Any:
    """Import numba, and let it announce each function that is compiled because it is not in the cache."""
    with _interrupted_later():
        _load_without_scipy()
        import numba
        from numba.core import event
        from numba.core.registry import cpu_target

        cpu_target.typing_context.refresh()  # what the first compilation would do
        cpu_target.target_context.refresh()

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            announce(event.data["dispatcher"].py_func.__globals__.get("COMPILED_FOR", COMPILED_FOR))

        def on_end(self, event: Any) -> None:
            """Do nothing."""

    event.register("numba:compile", Listener())
    return numba


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Let Ctrl-C take effect after this block, within a second or two: an interrupted numba would stay half-loaded."""
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    come: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: come.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if come:
        handler(*come[0])


def _load_without_scipy() -> None:
    """Import numba, but not scipy.linalg: that would take 0.2 s of 0.5 s.

    numba needs it for `np.cov` only, which is not compiled here. Code that does need it imports it itself.
    """
    if "scipy.linalg" in sys.modules:
        return
    sys.modules[BLAS] = None  # type: ignore[assignment]  # Python treats it as not installed
    try:
        import_module("numba.np.arraymath")
    finally:
        del sys.modules[BLAS]


class Compiled:
    """A function that numba compiles, or loads from its cache, when it is first called, here or by compiled code."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self._options = options

    @cached_property
    def _dispatcher(self) -> Any:
        with _loading:
            if "_dispatcher" in vars(self):  # another thread was first
                return vars(self)["_dispatcher"]
            dispatcher = _numba().njit(cache=True, no_cfunc_wrapper=True, **self._options)(self.__wrapped__)
            if not _numba().config.DISABLE_JIT:
                _compile_once(dispatcher._cache)
                files = dispatcher._cache._cache_file
                files._source_stamp = stamp(self.__module__)
                files._load_index = _readable(files._load_index)
            return dispatcher

    @property
    def at_hand(self) -> bool:
        """Whether it has been compiled, here or in an earlier process; for other types of arguments it may not be."""
        with _loading:
            found = self._dispatcher
            return _numba().config.DISABLE_JIT or bool(found.overloads or found._cache._cache_file._load_index())

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the compiled function."""
        return self._dispatcher(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of numba's function, such as its type, which compiled code asks for."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._dispatcher, name)

    def __reduce__(self) -> str:
        """Let it be sent to other processes by its name."""
        return str(self.__qualname__)


class Inner(Compiled):
    """A compiled function that only compiled code calls, so that numba makes no code by which Python would call it.

    That code takes arguments out of their Python objects, field by field. For a function whose arguments are named
    tuples of many arrays, it is larger than the function itself.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, {**options, "no_cpython_wrapper": True})

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Refuse a call by Python, which would end the process; without compilation, compiled code is Python."""
        if _numba().config.DISABLE_JIT:
            return super().__call__(*arguments, **named)
        raise TypeError(f"only compiled code can call {self.__module__}.{self.__qualname__}: it is declared inner")


class Intrinsic:
    """A function of numba's `intrinsic`, which is made when compiled code first needs it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)  # type: ignore[arg-type]

    @cached_property
    def _numba_type_(self) -> Any:
        numba = _numba()
        from numba.core.registry import cpu_target

        with _loading:
            made = numba.extending.intrinsic(self.__wrapped__)  # type: ignore[attr-defined]
            cpu_target.typing_context.refresh()  # which makes it known
            return cpu_target.typing_context.resolve_value_type(made)


def intrinsic(function: Callable[..., Any]) -> Any:
    """Return an intrinsic of numba, whose code is that which the given function returns."""
    return Intrinsic(function)


def njit(
    *, fastmath: bool | set[str] = False, inner: bool = False, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator like `numba.njit` whose cache also depends on the other files that the code uses.

    A function that is `inner` can be called by compiled code only (`Inner`), and is compiled in about half the time.

    The arithmetic of a function depends on its own `fastmath` only. Without the option, numba would compile it with
    that of the first function that calls it, so that results would depend on the order of compilation.

    numba itself compares only the file of the function. It would load outdated code after an edit of a function or a
    constant that is compiled into this one from another file.
    """
    return lambda function: (Inner if inner else Compiled)(function, {"fastmath": fastmath, **options})


def _compile_once(stored: Any) -> None:
    """Let one process compile a function, while others wait for its code and load it; `stored` is numba's cache of it.

    Commands that start several processes, and tests, would otherwise compile the same function several times at once.
    """
    load, save, held = stored.load_overload, stored.save_overload, list[Any]()

    def loaded(signature: Any, context: Any) -> Any:
        code = load(signature, context)
        if code is not None or held:
            return code
        lock = _locked(Path(stored.cache_path, f"{stored._cache_file._index_name}.lock"))
        code = None if lock is None else load(signature, context)
        if lock is not None:
            if code is None:
                held.append(lock)  # until the code is saved
            else:
                lock.close()
        return code

    def saved(signature: Any, code: Any) -> None:
        try:
            save(signature, code)
        finally:
            while held:
                held.pop().close()

    stored.load_overload, stored.save_overload = loaded, saved


def _locked(path: Path) -> Any:
    """Return an open file that no other process has locked; None if there is no such file within the longest wait."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            file = opened.enter_context(path.open("w"))
            if locked(file.fileno(), LONGEST_WAIT):
                opened.pop_all()
                return file
    return None


def _readable(load: Callable[[], dict[Any, str]]) -> Callable[[], dict[Any, str]]:
    """Return a function that loads an index of cached code, and returns an empty index if it cannot be read.

    numba reads the whole index before it compares stamps. The index refers to the classes of argument types, and such a
    class may have been renamed or moved since.
    """

    def loaded() -> dict[Any, str]:
        try:
            return load()
        except (AttributeError, ImportError, pickle.UnpicklingError, EOFError):
            return {}

    return loaded


@cache
def stamp(module: str) -> str:
    """Return a hash of everything that the compiled functions of a module may take from files.

    It covers the module's own file, this file, which sets options of the compilation, and the values of the constants
    that the module imports. It covers the same of each module from which the module imports compiled functions,
    intrinsics or named tuples, and of each module that is imported whole.
    """
    import numpy as np

    constants = (bool, int, float, str, tuple, np.generic)  # types of values that numba compiles into the code
    names = vars(sys.modules[module])
    found = hashlib.sha256(
        "".join(linecache.getlines(names["__file__"], names) + linecache.getlines(__file__)).encode()
    )
    for name, value in sorted(names.items()):
        other = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
        if name.startswith("__") or isinstance(value, FunctionType) or _is_plain_class(value):
            continue
        if isinstance(value, constants):
            found.update(f"{name} {value!r}".encode())
        elif isinstance(value, np.ndarray):
            found.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
        elif other and other != module and other.partition(".")[0] in ("planner", module.partition(".")[0]):
            found.update(stamp(other).encode())
    return found.hexdigest()


def _is_plain_class(value: object) -> bool:
    """Whether a value is a class that compiled code cannot use, that is, any class but a named tuple."""
    return isinstance(value, type) and not issubclass(value, tuple)
