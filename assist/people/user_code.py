"""Functions and trust rules of the user in a Python file, written `FILE.py:NAME`. It may import others of its folder.

An error in them is reported in one line, with its file and line.
"""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from hashlib import sha256
from modulefinder import ModuleFinder
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Self

from planner import LimitError
from planner.system.errors import expected
from planner.system.files import no_such

from ..declare.declared import UserCodeError as UserCodeError

if TYPE_CHECKING:
    from .choices import Choices
    from .decision import Floats

PACKAGE = Path(__file__).parents[1]
_LOADING = RLock()
"""Held while a folder is searched for what a file imports."""


def parse(text: str, folder: Path | None = None) -> tuple[Path, str] | None:
    """Return file and function of FILE.py:FUNCTION, with FILE relative to a folder; None for other texts."""
    path, colon, function = text.rpartition(":")
    return ((folder or Path()) / path, function) if colon else None


def function_beside(folder: Path, text: str) -> str:
    """Return FILE.py:FUNCTION with a path from a folder; other texts unchanged."""
    source = parse(text, folder)
    return text if source is None else f"{source[0]}:{source[1]}"


def load(file: Path, name: str) -> Any:
    """Load a function or a trust rule from a Python file. A class without arguments stands for its object.

    Raises
    ------
    UserCodeError
        There is no such file or function, or the file cannot be run.
    """
    if not file.is_file():
        raise UserCodeError(f"{file}: {no_such(file)}")
    # A unique module name for each file, so that its classes can be pickled.
    module_name = f"_own_{sha256(str(file.resolve()).encode()).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise UserCodeError(f"{file}: expected a Python file, whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        with _importable(file.parent.resolve()):
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise UserCodeError(described(error, file)) from error
    function = getattr(module, name, None)
    if isinstance(function, type):
        function = object_of(function, f"{file}:{name}")
    if function is None:
        own = [one for one, value in vars(module).items() if callable(value) and value.__module__ == module_name]
        known = f"; {expected(name, own)}" if own else ""
        raise UserCodeError(f"{file}: has no function '{name}'{known}")
    if not callable(function) and not hasattr(function, "update"):
        raise UserCodeError(f"{file}:{name}: expected a function, or a trust rule with a method `update`")
    return function


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Let a file import others of its folder. They are forgotten afterwards: another folder may have the same names."""
    with _LOADING:
        before = {name.partition(".")[0] for name in sys.modules}
        importlib.invalidate_caches()
        sys.path.insert(0, str(folder))
        try:
            yield
        finally:
            sys.path.remove(str(folder))
            for name, module in list(sys.modules.items()):
                top, origin = name.partition(".")[0], Path(getattr(module, "__file__", None) or "")
                if top not in before and (folder / f"{top}.py" == origin or origin.is_relative_to(folder / top)):
                    del sys.modules[name]


def sources(file: Path) -> tuple[Path, ...]:
    """Return a Python file and those of its folder that it imports, also through each other."""
    found = ModuleFinder([str(file.parent)])
    try:
        found.run_script(str(file))
    except SyntaxError:  # it is told when the file is loaded
        return (file,)
    return tuple(sorted({Path(one.__file__) for one in found.modules.values() if one.__file__}))  # type: ignore[attr-defined]


def object_of(given: type, name: str) -> Any:
    """Return the object of a class without arguments.

    Raises
    ------
    UserCodeError
        The class needs arguments.
    """
    try:
        return given()
    except TypeError as error:
        raise UserCodeError(f"{name}: {error}; expected a class without arguments, or its object") from None


@contextmanager
def own_code(function: Any) -> Iterator[None]:
    """Tell errors of a user's function or object with their line, as a `UserCodeError`; those of the package stay."""
    try:
        yield
    except (UserCodeError, LimitError):
        raise
    except Exception as error:
        file = _file_of(function)
        if file is None:
            raise
        raise UserCodeError(described(error, file)) from error


def _file_of(function: Any) -> Path | None:
    """Return the file with the code of a user's function, or of the class of an object; None if it is of a package."""
    while hasattr(function, "func"):
        function = function.func
    code = getattr(function, "__code__", None) or getattr(type(function).__call__, "__code__", None)
    if code is None or Path(code.co_filename).is_relative_to(PACKAGE):
        return None
    return Path(code.co_filename)


def described(error: Exception | SystemExit, file: Path) -> str:
    """Return one line that describes an error and its line in the user's file."""
    line, said = None, str(error)
    if isinstance(error, SyntaxError) and Path(error.filename or "").resolve() == file.resolve():
        line, said = error.lineno, error.msg
    for frame in traceback.extract_tb(error.__traceback__):
        if Path(frame.filename) == file or Path(frame.filename).resolve() == file.resolve():
            line = frame.lineno
    text = " ".join(said.split())
    kind = "" if isinstance(error, UserCodeError) else type(error).__name__
    if isinstance(error, ModuleNotFoundError) and (file.parent / f"{error.name}.py").exists():
        text += "; expected its import at the beginning of the file, where the file's folder is searched"
    what = ": ".join(filter(None, (kind, text)))
    return f"{file}:{line}: {what}" if line else f"{file}: {what}"


@dataclass(frozen=True)
class UserObject:
    """What is in a user's file, loaded in every process that needs it.

    Attributes
    ----------
    file : Path
    name : str
        Name of the function or rule in that file.
    """

    file: Path
    name: str

    @classmethod
    def load(cls, file: Path, name: str) -> Self:
        """Return an object that is loaded now, so that an error of the file is reported here.

        Raises
        ------
        UserCodeError
            As in `load`.
        """
        _loaded(file, name)
        return cls(file, name)

    def __str__(self) -> str:
        return f"{self.file}:{self.name}"

    @property
    def __name__(self) -> str:
        """The name in messages and records."""
        return str(self)

    @property
    def loaded(self) -> Any:
        """What the file has under this name."""
        return _loaded(self.file, self.name)

    def result(self, function: Callable[..., Any], *given: Any) -> Any:
        """Return what the user's code returns.

        Raises
        ------
        UserCodeError
            It failed; the message has file and line.
        """
        try:
            return function(*given)
        except (Exception, SystemExit) as error:
            raise UserCodeError(described(error, self.file)) from error


class UserChoiceModel(UserObject):
    """A user's choice model: a `ChoiceModel`."""

    def __call__(self, choices: Choices, q: Floats, beta: Floats, /) -> Floats:
        """Return the function's choice probabilities."""
        found: Floats = self.result(self.loaded, choices, q, beta)
        return found

    @property
    def value(self) -> Any:
        """The function's attribute `value`, by which trust changes; an AttributeError if it has none."""
        return self.loaded.value


class UserRule(UserObject):
    """A user's rule by which theta moves, by suggestions to oneself (`TrustRule`) or to neighbours (`SeenRule`).

    It has the attributes and methods of the rule in the file.
    """

    def __getattr__(self, name: str) -> Any:
        """Return what the rule has under a name; of a method, a function whose errors are told with their line."""
        if name.startswith("__"):  # of a copy or a record, for which nothing is loaded
            raise AttributeError(name)
        found = getattr(self.loaded, name)
        return partial(self.result, found) if callable(found) else found


_loaded = cache(load)
