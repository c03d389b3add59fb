"""Cost-to-go tables in files: written block by block, and memory-mapped when opened.

A file is an uncompressed `.npz` archive of numpy, which `numpy.load` can read as well; `docs/commands.md` describes the
arrays. Tables of a billion states exceed the memory, and often only some states are needed. `open_table` therefore maps
the file into memory, and reads only the parts that are accessed.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tokenize import TokenError
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import ArrayLike, NDArray

from ..grounding.task import in_unit, pddl_fact
from ..search.packing import Packing
from ..search.state_space import as_floats, state_numbers
from ..system.arrays import Ints, Words, outline
from ..system.errors import InputFileError
from ..system.files import atomic
from .table import Table


@dataclass(frozen=True)
class SavedTable:
    """A cost-to-go table in a file.

    Attributes
    ----------
    packing : Packing
    states : uint64 array, shape (n, words)
    distance : unsigned integer array, shape (n,)
        h* of each state, a multiple of `unit`; the type's largest value marks dead ends.
    initial : int
        Number of the initial state.
    facts : text array, shape (variables, values)
        Meaning of each value of each variable: `(on a b)`, `(not (on a b))`, or `<none of those>`; empty for values
        that the variable does not have.
    unit : Fraction
        Cost in the file's unit that a distance of 1 stands for.
    """

    packing: Packing
    states: Words
    distance: NDArray[np.unsignedinteger]
    initial: int
    facts: NDArray[np.str_]
    unit: Fraction

    __repr__ = outline

    def __len__(self) -> int:
        return len(self.distance)

    def lookup(self, states: ArrayLike) -> NDArray[np.float64]:
        """Return h* of states in the file's unit of cost, shape (N,); infinite at dead ends."""
        return in_unit(as_floats(self.distance[state_numbers(states, len(self))]), self.unit)

    def values(self, states: ArrayLike) -> Ints:
        """Return the values, shape (N, variables), of states, shape (N,)."""
        return self.packing.unpack(self.states[state_numbers(states, len(self))])


def save_table(file: str | Path, table: Table) -> None:
    """Save a cost-to-go table as `.npz`, atomically.

    Parameters
    ----------
    table : Table
    file : path
    """
    task = table.task
    packing = Packing.of(task)
    width = max(len(variable.facts) for variable in task.variables)
    arrays = {
        "cost_to_go": table.distance,
        "initial": np.asanyarray(table.initial),
        "unit": np.array([task.unit.numerator, task.unit.denominator], dtype=np.int64),
        "word": packing.word,
        "shift": packing.shift,
        "bits": packing.bits,
        "facts": np.array([[*map(pddl_fact, v.facts), *[""] * (width - len(v.facts))] for v in task.variables]),
    }
    with atomic(Path(file)) as path, path.open("wb") as stream, zipfile.ZipFile(stream, "w") as archive:
        with archive.open("states.npy", "w", force_zip64=True) as target:
            shape = {"descr": npy.dtype_to_descr(np.dtype(np.uint64)), "fortran_order": False}
            npy.write_array_header_1_0(target, {**shape, "shape": (len(table), packing.words)})
            block = 1 << 16  # states that are written at a time; it bounds the memory for unpacked states
            for start in range(0, len(table), block):
                rows = np.arange(start, min(start + block, len(table)))
                target.write(packing.pack(table.values(rows)).tobytes())
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as target:
                npy.write_array(target, array, allow_pickle=False)


def open_table(file: str | Path) -> SavedTable:
    """Open a table that `save_table` has written; only the parts that are accessed are read.

    Parameters
    ----------
    file : path

    Raises
    ------
    InputFileError
        The file is not such a table, is truncated, or contains arrays that do not match.
    """
    file = Path(file)
    try:
        with zipfile.ZipFile(file) as archive, file.open("rb") as stream:
            members = archive.infolist()
            arrays = {member.filename.removesuffix(".npy"): _mapped(file, stream, member) for member in members}
        return _table(arrays)
    except (zipfile.BadZipFile, NotImplementedError, TokenError, TypeError, KeyError, ValueError, IndexError) as error:
        raise InputFileError.of(file, None, f"no table of costs-to-go ({error})") from None


def _table(arrays: Mapping[str, NDArray[Any]]) -> SavedTable:
    """Return the table of the given arrays after checking their types and shapes.

    The entries of single states are not checked.
    """
    states, distance, facts = arrays["states"], arrays["cost_to_go"], arrays["facts"]
    for name, kinds, dimensions in (
        ("states", "u", 2),
        ("cost_to_go", "u", 1),
        ("facts", "U", 2),
        ("initial", "iu", 0),
        ("unit", "i", 1),
    ):
        array = arrays[name]
        if array.dtype.kind not in kinds or array.ndim != dimensions:
            raise ValueError(f"{name} is of the kind {array.dtype} and has {array.ndim} dimensions")
    packing, initial = Packing.of_sizes((facts != "").sum(axis=1).tolist()), int(arrays["initial"])
    if states.dtype != np.uint64 or states.shape != (len(distance), packing.words) or not 0 <= initial < len(distance):
        raise ValueError(
            f"states, {states.dtype} {states.shape}, are not those of {len(distance)} costs-to-go and of the facts"
        )
    unit = arrays["unit"].tolist()
    if len(unit) != 2 or min(unit) <= 0:
        raise ValueError(f"unit is {unit}; expected a numerator and a denominator")
    for name in ("word", "shift", "bits"):
        if not np.array_equal(arrays[name], getattr(packing, name)):
            raise ValueError(f"{name} is not where this version puts the variables")
    return SavedTable(packing, states, distance, initial, facts, Fraction(*unit))


def _mapped(file: Path, stream: io.BufferedReader, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return an array of an archive, memory-mapped."""
    local_header = 30  # bytes of a file's local header in a ZIP archive, before the file name
    if member.header_offset < 0:
        raise ValueError(f"{member.filename} begins before the file")
    stream.seek(member.header_offset)
    header = stream.read(local_header)
    # The file name and an extra field follow; the last two numbers of the header are their lengths.
    lengths = np.frombuffer(header[-4:], dtype="<u2")
    stream.seek(member.header_offset + local_header + int(lengths.sum()))
    if npy.read_magic(stream) != (1, 0):
        raise ValueError(f"{member.filename} is written in another way")
    shape, fortran_order, dtype = npy.read_array_header_1_0(stream)
    if not shape or 0 in shape:
        return np.fromfile(stream, dtype=dtype, count=1 if not shape else 0).reshape(shape)
    order: Literal["C", "F"] = "F" if fortran_order else "C"
    return np.memmap(file, dtype=dtype, mode="r", offset=stream.tell(), shape=shape, order=order)
