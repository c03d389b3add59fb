"""Random PDDL in all forms, compared with answers that need no reader (`bench/random_pddl.py`)."""

from __future__ import annotations

import pytest
import random_pddl


@pytest.mark.parametrize(
    "number", [*range(6), *(pytest.param(number, marks=pytest.mark.slow) for number in range(6, 200))]
)
def test_files_are_read_as_they_were_meant_or_refused_with_their_line(number: int) -> None:
    outcome = random_pddl.check(number)
    assert outcome.violation == ""
    assert outcome.result in (("refused", "harmless") if outcome.fault else ("solved",))
