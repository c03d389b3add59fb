"""The errors that more than one module raises."""

from __future__ import annotations

from pathlib import Path


class MissingExtraError(ImportError):
    """A package that only an extra of this project installs."""


class ResultsExistError(ValueError):
    """An output folder that holds results already."""


class DamagedFileError(ValueError):
    """A file of results that was cut off, changed, or made by something else.

    Attributes
    ----------
    file : Path
    line : int or None
        Counted from 1.
    message : str
    """

    def __init__(self, file: Path, line: int | None, message: str) -> None:
        super().__init__(file, line, message)
        self.file, self.line, self.message = file, line, message

    def __str__(self) -> str:
        return f"{self.file}{'' if self.line is None else f':{self.line}'}: {self.message}"
