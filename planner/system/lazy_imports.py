"""Packages that export names lazily: a module is imported when one of its names is first used.

The exports of a package are listed in its `__init__.pyi`, which type checkers and editors read as well. Commands that
only show their help, and scripts that only plan, thus do not import compilers, plotting or tables.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import lazy_loader


class _Package(ModuleType):
    """A package in which an exported name takes precedence over a submodule of the same name."""

    def __setattr__(self, name: str, value: Any) -> None:
        # Importing the submodule would otherwise replace the exported function by the module.
        if not (isinstance(value, ModuleType) and name in self.__dict__.get("__all__", ())):
            super().__setattr__(name, value)


def lazy_exports(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, `__dir__` and `__all__` of a package with lazy exports.

    Parameters
    ----------
    package, file : str
        The `__name__` and `__file__` of the package.
    """
    sys.modules[package].__class__ = _Package
    found, listed, names = lazy_loader.attach_stub(package, file)
    return found, listed, names
