"""Numbers of states, values of states and table files: invalid ones are refused, always in the same way."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import KITTING, ROOT, kit
from test_architecture import PACKAGES, handed_on

from planner import Cache, Instance, OnDemand, load, open_table, save_table, sweep
from planner.costtogo.orbit_table import orbits
from planner.grounding.task import pddl_fact


@pytest.fixture(scope="module")
def forms(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """The same task in all the ways in which its cost-to-go is held, with 21 states or fewer."""
    table = kit("tiny")
    file = tmp_path_factory.mktemp("tables") / "tiny.npz"
    save_table(file, table)
    found = orbits(table.task, max_orbits=100)
    asked, looked_up = OnDemand(table.task), OnDemand(table.task, orbits=found)
    return [table, open_table(file), found.table(table.task), asked, looked_up]


NONE = [[-1], [10**6], [0, -1], [2**63], [2**70], [-(2**70)], [0.5], [np.nan], [True], ["a"], [None]]


@pytest.mark.parametrize("numbers", NONE, ids=str)
def test_what_is_no_number_of_a_state_is_one_error(forms: list[Any], numbers: list[Any]) -> None:
    for form in forms:
        asked = [form.lookup, form.values]
        if not hasattr(form, "packing") or isinstance(form, OnDemand):
            asked += [form.is_goal, form.choices, form.plan_lengths]
        for function in asked:
            with pytest.raises(IndexError, match="states are numbered"):
                function(numbers)


def test_single_numbers_count_from_the_first() -> None:
    table = kit("tiny")
    for function in (table.optimal_plan, table.space.facts, table.space.options, table.__getitem__):
        for number in (-1, len(table)):
            with pytest.raises(IndexError, match="states are numbered from 0 to 20"):
                function(number)
    assert table.lookup([]).tolist() == table.lookup(np.empty(0)).tolist() == []
    assert table.lookup(np.arange(21, dtype=np.uint8)).tolist() == table.h.tolist()
    assert table.lookup(np.arange(6).reshape(2, 3)).shape == (2, 3)


@pytest.mark.parametrize("name", ["tiny", "paper", "sealed"])
def test_values_that_are_no_state_have_no_orbit(name: str) -> None:
    """In these kits all symmetric objects begin alike, so that the image of a state is a state."""
    table = kit(name)
    found = orbits(table.task, max_orbits=10**6)
    sizes, rng = [len(variable.facts) for variable in table.task.variables], np.random.default_rng(0)
    some = table.values(rng.integers(len(table), size=2000))
    changed = some.copy()
    changed[np.arange(2000), rng.integers(len(sizes), size=2000)] += rng.integers(-3, 4, size=2000)
    for values in (
        rng.integers(-2, 9, size=(20_000, len(sizes))),
        rng.integers(sizes, size=(2000, len(sizes))),
        changed,
    ):
        own = table.space.numbering.numbers(values)
        np.testing.assert_array_equal(found.index.numbers(values) >= 0, own >= 0)
    assert (found.index.numbers(some) >= 0).all()
    small = found.table(table.task)
    for value in (-1, max(sizes), 2**62):
        with pytest.raises(KeyError):
            small.numbers([[value] * len(sizes)])


def test_the_page_says_how_states_are_unpacked(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "commands.md").read_text()
    (formula,) = re.findall(r"variable v is `(.*)` \|", page)
    table = kit("paper-fixed")
    save_table(tmp_path / "table.npz", table)
    arrays = dict(np.load(tmp_path / "table.npz"))
    for v in range(len(table.task.variables)):
        values = eval(formula, {"np": np, "v": v, **arrays})
        np.testing.assert_array_equal(values, table.values(np.arange(len(table)))[:, v])
    facts = {str(fact) for fact in arrays["facts"].reshape(-1)}
    assert {"(platform-free)", "(in-storage box-a)", "(not (in-storage box-a))"} <= facts
    assert not any("Atom" in fact or "," in fact for fact in facts)


@pytest.mark.parametrize(
    ("fact", "shown"),
    [
        ("Atom on(a, b)", "(on a b)"),
        ("NegatedAtom on(a, b)", "(not (on a b))"),
        ("Atom done()", "(done)"),
        ("NegatedAtom done()", "(not (done))"),
        ("Atom new-axiom@0(x)", "(new-axiom@0 x)"),
        ("<none of those>", "<none of those>"),
    ],
)
def test_facts_in_pddl(fact: str, shown: str) -> None:
    assert pddl_fact(fact) == shown


def test_paths_may_be_strings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    problem, domain = str(KITTING / "tiny.pddl"), str(KITTING / "domain.pddl")
    task = load(Instance(problem, domain), cache="kept")  # type: ignore[arg-type]
    assert load(problem, domain, cache="kept") == task
    assert len(list(Path("kept").iterdir())) == 1
    table = sweep(task)
    save_table("tiny.npz", table)
    assert open_table("tiny.npz").lookup([0]).tolist() == table.lookup([0]).tolist()
    assert Cache(task, "costs").file == Cache(task, Path("costs")).file


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield all callables that the packages export, except those generated for dataclasses and errors."""
    for package in PACKAGES:
        for name, module in handed_on(package):
            one = getattr(import_module(module), name)
            if not inspect.isclass(one):
                yield f"{module}.{name}", one
                continue
            for method, function in inspect.getmembers(one, callable):
                made = method == "__init__" and not is_dataclass(one) and not issubclass(one, Exception)
                if made or not method.startswith("_"):
                    yield f"{module}.{name}.{method}", function


def test_public_functions_take_paths_and_strings() -> None:
    wrong = []
    for name, function in functions():
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            continue
        annotations = [str(one.annotation) for one in signature.parameters.values()]
        wrong += [f"{name}: {one}" for one in annotations if re.search(r"\bPath\b", one) and "str" not in one]
    assert wrong == []
