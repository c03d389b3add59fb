"""What a long sweep has found so far, in a file, so that another process can continue it.

A checkpoint is a set of arrays and numbers. It belongs to one task whose states have certain indices, which its `key`
identifies. A file that was cut off or changed is recognised by its digest, and not used.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grounding.task import Task
from ..system.files import atomic

FORMAT = 2
"""Raised where the searches, or the numbering of states, change."""

EVERY = 600.0
"""Seconds between two checkpoints."""

DIGEST = hashlib.sha256().digest_size
"""Bytes at the beginning of a file: the digest of all others."""


@dataclass
class Checkpoint:
    """Where a sweep keeps what it has found.

    Attributes
    ----------
    file : Path
        It is removed when the sweep is done.
    task : Task
    indices : iterable of arrays
        They determine which state each index means.
    last : float
        When it was written, on `time.monotonic()`'s clock; first when the sweep began.
    fault : str or None
        Why a checkpoint could not be used, or not be written.
    """

    file: Path
    task: Task
    indices: Iterable[NDArray[Any]]
    last: float = field(default_factory=time.monotonic)
    fault: str | None = None

    @cached_property
    def key(self) -> str:
        """A hash of the task and of what its indices mean."""
        task = self.task
        what = (FORMAT, np.__version__, task.variables, task.operators, task.costs, task.initial, task.goal)
        found = hashlib.sha256(repr(what).encode())
        for array in self.indices:
            found.update(repr((array.dtype, array.shape)).encode() + array.tobytes())
        return found.hexdigest()

    @property
    def due(self) -> bool:
        """Whether it is time for another one."""
        return time.monotonic() - self.last >= EVERY

    def save(self, stage: str, numbers: Mapping[str, int], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a checkpoint in place of the one before; the sweep can do without, where that fails."""
        about = {"key": self.key, "stage": stage, "numbers": dict(numbers), "arrays": list(arrays)}
        try:
            with atomic(self.file) as path, path.open("w+b") as stream:
                stream.write(bytes(DIGEST) + json.dumps(about).encode() + b"\n")
                for array in arrays.values():
                    np.save(stream, array, allow_pickle=False)
                stream.seek(DIGEST)
                digest = hashlib.file_digest(stream, "sha256").digest()
                stream.seek(0)
                stream.write(digest)
        except OSError as error:
            self.fault = f"what the sweep had found could not be kept for --resume: {error}"
        self.last = time.monotonic()

    def load(self, stage: str) -> tuple[dict[str, int], dict[str, NDArray[Any]]] | None:
        """Return the numbers and the arrays of a checkpoint of a stage; None if there is none that can be used."""
        if not self.file.is_file():
            return None
        with self.file.open("rb") as stream:
            digest = stream.read(DIGEST)
            if hashlib.file_digest(stream, "sha256").digest() != digest:
                self.fault = f"{self.file} is damaged, so that the sweep began from the start"
                return None
            stream.seek(DIGEST)
            about = json.loads(stream.readline())
            if (about["key"], about["stage"]) != (self.key, stage):
                return None
            return about["numbers"], {name: np.load(stream, allow_pickle=False) for name in about["arrays"]}

    def remove(self) -> None:
        """Remove the file: the sweep is done."""
        if self.file.is_file():
            try:
                self.file.unlink()
            except OSError as error:
                self.fault = f"{self.file} is no longer needed, and could not be removed: {error.strerror}"
