"""What a long sweep has found so far, in a folder, so that another process can go on.

A checkpoint is a set of arrays and numbers, written to a folder beside the one it replaces and put in its place when
it is complete: there is always a whole one. It belongs to one task, searched in one way, which its `key` names.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .task import Task

FORMAT = 1
"""Raised where the searches, or the numbering of states, change."""

EVERY = 600.0
"""Seconds between two checkpoints."""


@dataclass
class Checkpoint:
    """Where a sweep keeps what it has found.

    Attributes
    ----------
    folder : Path
        It is removed when the sweep is done.
    key : str
        What the sweep is of.
    last : float
        When it was written, on `time.monotonic()`'s clock; first when the sweep began.
    """

    folder: Path
    key: str
    last: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, folder: Path, task: Task, size: int) -> Checkpoint:
        """Name the checkpoint of a task whose indices are below `size`."""
        text = f"{FORMAT} {size} {np.__version__} {task.sas} {task.costs}"
        return cls(folder, hashlib.sha256(text.encode()).hexdigest())

    @property
    def due(self) -> bool:
        """Whether it is time for another one."""
        return time.monotonic() - self.last >= EVERY

    def save(self, stage: str, numbers: Mapping[str, int], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a checkpoint; the one before goes when it is complete."""
        fresh, old = (self.folder.with_name(f".{self.folder.name}.{word}") for word in ("new", "old"))
        for left in (fresh, old):
            shutil.rmtree(left, ignore_errors=True)
        fresh.mkdir(parents=True)
        for name, array in arrays.items():
            np.save(fresh / f"{name}.npy", array)
        text = json.dumps({"key": self.key, "stage": stage, **numbers})
        (fresh / "checkpoint.json").write_text(text, encoding="utf-8")
        if self.folder.exists():
            self.folder.rename(old)
        fresh.rename(self.folder)
        shutil.rmtree(old, ignore_errors=True)
        self.last = time.monotonic()

    def load(self, stage: str) -> tuple[dict[str, int], dict[str, NDArray[Any]]] | None:
        """Give the numbers and the arrays of a checkpoint of a stage; None if there is none, or of something else."""
        file = self.folder / "checkpoint.json"
        if not file.is_file():
            return None
        numbers = json.loads(file.read_text(encoding="utf-8"))
        if numbers.pop("key", None) != self.key or numbers.pop("stage", None) != stage:
            return None
        return numbers, {path.stem: np.load(path) for path in sorted(self.folder.glob("*.npy"))}

    def remove(self) -> None:
        """Take it away: the sweep is done."""
        shutil.rmtree(self.folder, ignore_errors=True)
