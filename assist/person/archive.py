"""Frozen dataclasses of arrays saved as files.

A file is a numpy `.npz` archive with one array per field. A field of a nested dataclass is named by its path, with dots
between the names. A field that is None is omitted. A mapping has two arrays: its names, and its numbers, with `.values`
after the name.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from planner.system import files
from planner.system.errors import InputFileError

T = TypeVar("T")


def save(file: Path, value: Any, **more: Any) -> None:
    """Save a dataclass, and further named arrays, to a file; the file is written completely or not at all."""
    with files.atomic(file) as path, path.open("wb") as stream:  # numpy would append a suffix to a file name
        np.savez_compressed(stream, **_pack(value, ""), **more)


def load(file: Path, cls: type[T]) -> T:
    """Load a dataclass; further arrays in the file are ignored.

    Raises
    ------
    InputFileError
        The file is of another kind, or it lacks a field.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        return _unpack(cls, found, "")
    except KeyError as error:
        raise InputFileError(f"{file}: no array {error}; expected a saved {cls.__name__}") from None
    except (ValueError, TypeError, IndexError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputFileError(f"{file}: {error}; expected a saved {cls.__name__}") from None


def _pack(value: Any, prefix: str) -> dict[str, Any]:
    packed: dict[str, Any] = {}
    for field in fields(value):
        part = getattr(value, field.name)
        if is_dataclass(part):
            packed |= _pack(part, f"{prefix}{field.name}.")
        elif isinstance(part, Mapping):
            packed[prefix + field.name] = np.array(list(part))
            packed[f"{prefix}{field.name}.values"] = np.array(list(part.values()))
        elif part is not None:
            packed[prefix + field.name] = np.asarray(part)
    return packed


def _unpack(cls: Any, arrays: Mapping[str, Any], prefix: str) -> Any:
    parts: dict[str, Any] = {}
    hints = get_type_hints(cls)
    for name in (field.name for field in fields(cls)):
        key, hint = prefix + name, hints[name]
        if get_origin(hint) is UnionType:
            hint = next(kind for kind in get_args(hint) if kind is not type(None))
            if not any(found == key or found.startswith(f"{key}.") for found in arrays):
                parts[name] = None
                continue
        if is_dataclass(hint):
            parts[name] = _unpack(hint, arrays, f"{key}.")
        elif hint in (bool, int, float, str):
            parts[name] = _of_kind(arrays[key], str if hint is str else np.float64, key).item()
        elif get_origin(hint) is Mapping:
            values = _of_kind(arrays[f"{key}.values"], np.float64, f"{key}.values")
            parts[name] = dict(zip(arrays[key].tolist(), values.tolist(), strict=True))
        elif get_origin(hint) is tuple:
            parts[name] = tuple(arrays[key].tolist())
        elif get_origin(hint) is np.ndarray:
            parts[name] = _of_kind(arrays[key], get_args(get_args(hint)[1])[0], key)
        else:
            parts[name] = arrays[key]
    return cls(**parts)


def _of_kind(array: NDArray[Any], kind: Any, key: str) -> NDArray[Any]:
    if not np.can_cast(array.dtype, kind, "same_kind"):
        raise ValueError(f"array {key!r} is of the kind {array.dtype}, not {np.dtype(kind)}")
    return array
