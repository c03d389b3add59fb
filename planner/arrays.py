"""Arrays in frozen dataclasses, which nobody changes."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np


def read_only(record: Any) -> None:
    """Make all arrays in the fields of a dataclass read-only."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
