"""What a change of learning must keep: estimates, intervals and comparisons of small logs, as recorded."""

from __future__ import annotations

import json
import warnings
from functools import cache
from typing import Any

import pytest
from conftest import TESTS
from gates_records import here, near
from learning_figures import figures, plain

FILE = TESTS / "data" / "learning.json"
RECORD: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
RECORDED: dict[str, Any] = RECORD["figures"]
NEAR = 1e-6 if RECORD["machine"] == here() else 1e-2
"""Largest relative difference; searches end elsewhere where the last bits differ."""


@cache
def every() -> dict[str, Any]:
    return dict(figures(large=False))


LONG = {"influence, reliability"}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in RECORDED])
def test_figures_are_as_recorded(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = plain(every()[name]())
    assert near(RECORDED[name], found, NEAR), f"{name} was {RECORDED[name]}, is {found}"


def test_every_figure_is_recorded() -> None:
    assert set(every()) == set(RECORDED)
