"""What a change of the core must keep (see `gates`): the small cases always, the others with the slow tests."""

from __future__ import annotations

from typing import Any

import pytest
from gates import KINDS, Gate, difference, gates, recorded

RECORDED = {kind: recorded(kind) for kind in KINDS}


def marked(gate: Gate) -> Any:
    return pytest.param(gate, marks=() if gate.quick else pytest.mark.slow, id=f"{gate.kind}: {gate.name}")


@pytest.mark.parametrize("gate", [marked(gate) for gate in gates()])
def test_it_is_as_recorded(gate: Gate) -> None:
    assert difference(gate, RECORDED[gate.kind]) is None


def test_every_record_is_of_a_case() -> None:
    names = {kind: {gate.name for gate in gates() if gate.kind == kind} for kind in KINDS}
    assert names == {kind: set(known["cases"]) for kind, known in RECORDED.items()}
