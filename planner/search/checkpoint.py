"""Checkpoints: the progress of a long sweep in a file, from which another process can continue.

A checkpoint is a set of arrays and numbers. It belongs to one task and one ranking of its states, which its `key`
identifies. A truncated or changed file is recognised by its digest, and not used.
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
"""Version of the file format. It must be raised when the searches or the numbering of states change."""

EVERY = 600.0
"""Seconds between two checkpoints. Shorter loses less work at a crash, and writes more often."""

DIGEST = hashlib.sha256().digest_size
"""Bytes of the digest at the beginning of a file, which covers all other bytes."""


@dataclass
class Checkpoint:
    """The checkpoint file of a sweep.

    Attributes
    ----------
    file : Path
        The file, which is removed when the sweep is done.
    task : Task
    indices : iterable of arrays
        Arrays that determine the state of each rank.
    last : float
        Time of the latest checkpoint on the clock of `time.monotonic()`; initially the start of the sweep.
    fault : str or None
        The reason if a checkpoint could not be used or written.
    """

    file: Path
    task: Task
    indices: Iterable[NDArray[Any]]
    last: float = field(default_factory=time.monotonic)
    fault: str | None = None

    @cached_property
    def key(self) -> str:
        """Hash of the task and of the meaning of its ranks."""
        task = self.task
        what = (FORMAT, np.__version__, task.variables, task.operators, task.costs, task.initial, task.goal)
        found = hashlib.sha256(repr(what).encode())
        for array in self.indices:
            found.update(repr((array.dtype, array.shape)).encode() + array.tobytes())
        return found.hexdigest()

    @property
    def due(self) -> bool:
        """Whether the next checkpoint is due."""
        return time.monotonic() - self.last >= EVERY

    def save(self, stage: str, numbers: Mapping[str, int], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Replace the checkpoint. If this fails, `fault` says so and the sweep continues."""
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
        """Return the numbers and arrays of a checkpoint of the stage; None if there is no usable one."""
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
        """Remove the file when the sweep is done."""
        if self.file.is_file():
            try:
                self.file.unlink()
            except OSError as error:
                self.fault = f"{self.file} is no longer needed, and could not be removed: {error.strerror}"
