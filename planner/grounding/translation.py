"""Grounding of a compiled instance by Fast Downward's translator, compared with what was read."""

from __future__ import annotations

from ..pddl.compilation import Compilation
from ..system.limits import NO_LIMITS, Limits
from . import cross_check, fast_downward
from .plain_assignments import with_plain_assignments
from .sas_reader import from_sas
from .shown_names import in_the_files_terms
from .task import Task


def ground(compilation: Compilation, limits: Limits = NO_LIMITS) -> Task:
    """Ground a compiled instance, and compare the result with what was read."""
    reading = compilation.reading
    sas = fast_downward.translate(reading, limits)
    task = from_sas(sas, reading.instance, "; ".join((*reading.notes, *compilation.notes)) or None)
    cross_check.check(reading, task)
    if compilation.numbers:
        task = with_plain_assignments(task)
    return in_the_files_terms(task, compilation)
