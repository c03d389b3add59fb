"""The errors that more than one module raises."""

from __future__ import annotations


class MissingExtraError(ImportError):
    """A package that only an extra of this project installs."""
