"""Random small numeric and durative tasks: compiled ones cost what a direct search over the original meaning finds."""

from __future__ import annotations

from pathlib import Path

import pytest
from direct_search import Direct
from random_numeric import draw
from test_cases_numbers import answer

from planner import Instance
from planner.pddl.compilation import compiled
from planner.pddl.reader import read

SEEDS = range(24)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_compiled_task_costs_what_the_direct_search_finds(tmp_path: Path, seed: int) -> None:
    texts = draw(seed)
    instance = Instance(tmp_path / "p.pddl", tmp_path / "domain.pddl")
    instance.problem.write_text(texts.problem)
    instance.domain.write_text(texts.domain)
    right = Direct(texts.domain, texts.problem).search(1_000)
    compilation = compiled(read(instance))
    cost, states, decided = answer(compilation)
    if right.known:
        assert cost == right.cost
    if right.states is not None and not decided:
        assert states <= right.states  # saturated and dropped numbers make fewer states
