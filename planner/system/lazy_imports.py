"""Packages that hand on names, and load the modules that these are from when they are first asked for.

What a package exports stands in its `__init__.pyi`, which type checkers and editors read as well. A command that only
shows its help, or a script that only plans, so does not load what compiles, draws or makes tables.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import lazy_loader


class _Package(ModuleType):
    """A package in which a module may be called like what it holds: the name is that of what it holds."""

    def __setattr__(self, name: str, value: Any) -> None:
        # Importing `planner.costtogo.sweep` would otherwise put the module where the function is to be found.
        if not (isinstance(value, ModuleType) and name in self.__dict__.get("__all__", ())):
            super().__setattr__(name, value)


def lazy_exports(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Give a package the `__getattr__`, `__dir__` and `__all__` that its list asks for.

    Parameters
    ----------
    package, file : str
        Its `__name__` and `__file__`.
    """
    sys.modules[package].__class__ = _Package
    found, listed, names = lazy_loader.attach_stub(package, file)
    return found, listed, names
