"""What follows from the declaration of fields: checks, errors of one sentence, plain data, and lines of files."""

from __future__ import annotations

import copy
import inspect
import json
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin

import declared_tables
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, TypeAdapter

from assist.declare import tables
from assist.declare.declared import (
    Count,
    DeclarationError,
    Expected,
    Number,
    Text,
    Texts,
    Truth,
    Whole,
    checked,
    declared,
    is_declared,
    phrase,
    plain,
    sentences,
)
from assist.declare.options import value_of
from assist.declare.tables import convert, load, replaced
from assist.people import outcome
from assist.person import OfRobots, Robot, Setting
from planner.system.errors import InputFileError


@declared
class Wheel:
    """A wheel."""

    size: Annotated[Number, Field(gt=0, lt=9, description="Its size.")] = 1.0


@declared
class Cart:
    """A cart."""

    name: Text
    wheels: Annotated[tuple[Wheel, ...], Field(min_length=1, description="Its wheels.")] = (Wheel(), Wheel())
    load: Annotated[Whole | None, Field(ge=0, le=10, description="What it carries.")] = None
    drive: Literal["front", "rear"] = "front"
    brakes: Truth = True
    tags: Texts = ("a",)
    prices: dict[str, Number] | Number = 0.0


FAULTS: list[tuple[dict[str, Any], str]] = [
    ({}, "name: is missing; expected a text"),
    ({"nam": "x"}, "nam: unknown; did you mean 'name'?"),
    ({"name": ""}, "name '': expected a text"),
    ({"load": 11}, "load 11: expected a whole number from 0 to 10"),
    ({"load": 1.0}, "load 1.0: expected a whole number from 0 to 10"),
    ({"load": True}, "load True: expected a whole number from 0 to 10"),
    ({"brakes": 1}, "brakes 1: expected true or false"),
    ({"drive": "reer"}, """drive 'reer': expected "front" or "rear\""""),
    ({"tags": ["a", 3]}, "tags ['a', 3]: expected a list of one text or more"),
    ({"wheels": [{}, {"size": 9}]}, "wheels[2].size 9: expected a number above 0 and below 9"),
    ({"wheels": [{"sise": 1}]}, "wheels[1].sise: unknown; did you mean 'size'?"),
    ({"wheels": [{"size": float("nan")}]}, "wheels[1].size nan: expected a number above 0 and below 9"),
    ({"wheels": [{"size": np.True_}]}, f"wheels[1].size {np.True_!r}: expected a number above 0 and below 9"),
    ({"wheels": []}, "wheels []: expected a list of tables"),
    ({"prices": {"x": "y"}}, "prices.x 'y': expected a number"),
    ({"prices": {1: 2.0}}, "prices: key 1: expected a text"),
    ({"name": "\ud800"}, "name '\\ud800': expected Unicode text"),
    ({"drive": "x" * 60_000}, f"""drive '{"x" * 199}...: expected "front" or "rear\""""),
    ({"load": 10**400}, f"load 1{'0' * 199}...: expected a whole number from 0 to 10"),
]


@pytest.mark.parametrize(("wrong", "message"), FAULTS, ids=str)
def test_a_fault_is_one_sentence(wrong: dict[str, Any], message: str) -> None:
    named = {} if {"nam"} & set(wrong) or not wrong else {"name": "c"}
    with pytest.raises(DeclarationError) as caught:
        Cart(**named | wrong)
    assert str(caught.value) == message
    assert caught.value.__context__ is None
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.place) == (message, caught.value.place)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("load = 11", ":2: load: 11; expected a whole number from 0 to 10"),
        ("tags = [\n'a',\n3,\n]", ':2: tags: ["a", 3]; expected a list of one text or more'),
        ("[[wheels]]\n\n[[wheels]]\nsize = 9", ":5: wheels[2].size: 9; expected a number above 0 and below 9"),
        ("[[wheels]]\nsize = 1\nsise = 1", ":4: wheels[1].sise: unknown; did you mean 'size'?"),
        ("[[wheels]]\nsize = nan", ":3: wheels[1].size: NaN; expected a number above 0 and below 9"),
        ("drive = 'reer'", ':2: drive: "reer"; expected "front" or "rear"'),
    ],
)
def test_a_fault_in_a_file_has_its_line(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "cart.toml"
    file.write_text(f"name = 'c'\n{text}\n")
    with pytest.raises(InputFileError) as caught:
        convert(load(file), Cart, file)
    assert str(caught.value) == f"{file}{message}"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_line_of_a_fault_is_found_in_few_steps_and_with_names_of_any_kind(
    end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    people = [f'"person-{number}" = "tiny"' for number in range(500)]
    text = ["[tasks]", *people, '"Dr. A [1]" = 3', "[other]", "text = '\u2028\x85'", "rows = [", "1,", "2]", "last = 4"]
    (file := tmp_path / "long.toml").write_bytes(end.join(text).encode())
    calls, loads = list[str](), tomllib.loads

    def counted(text: str) -> dict[str, Any]:
        calls.append(text)
        return loads(text)

    monkeypatch.setattr(tomllib, "loads", counted)
    for place, line in (
        ("tasks.Dr. A [1]", "\"Dr. A [1]\" = 3"), ("tasks.person-7", people[7]), ("other.last", "last = 4"),
        ("other.rows[2]", "rows = ["), ("other.none.x", "[other]"), ("nothing", "[tasks]"),
    ):  # fmt: skip
        calls.clear()
        assert text[tables.line_of(file, place) - 1] == line
        assert len(calls) < 20


def test_a_number_may_begin_with_its_point_also_in_a_list() -> None:
    assert value_of("[.2, -.5, 1.5]", tuple[float, float]) == [0.2, -0.5, 1.5]
    assert value_of(".5", float) == 0.5
    assert value_of('{file = "a .5"}', dict) == {"file": "a .5"}
    assert value_of("travel=.5", Any) == "travel=.5"


def test_numbers_of_any_kind_become_pythons_own_and_objects_stay_frozen() -> None:
    cart = Cart("c", [{"size": np.float32(0.5)}], np.int8(3), brakes=np.True_)  # type: ignore[arg-type,list-item]
    assert (type(cart.wheels[0].size), type(cart.load), type(cart.brakes)) == (float, int, bool)
    assert cart == Cart("c", (Wheel(0.5),), 3)
    assert len({Wheel(0.5), Wheel(0.5), Wheel(1)}) == 2
    with pytest.raises(AttributeError):
        cart.name = "d"  # type: ignore[misc]
    assert replace(cart, load=4).load == 4
    with pytest.raises(DeclarationError, match="load 99"):
        replace(cart, load=99)
    assert pickle.loads(pickle.dumps(cart)) == copy.deepcopy(cart) == cart
    with pytest.raises(InputFileError, match=r"^f: cart\.load: 99; expected a whole number from 0 to 10"):
        replaced(cart, {"load": 99}, Path("f"), "cart")


NUMBERS = st.floats(0, 1e15)
ROBOTS = st.builds(
    Robot, execute=st.none() | st.booleans(), c_suggest=st.none() | NUMBERS, c_execute=st.none() | NUMBERS,
    c_move=st.none() | NUMBERS, travel_time=st.none() | st.floats(0, 1e3),
)  # fmt: skip


NAMED = st.sampled_from([None, "paper", "constant", "outcome"])
RULES = (
    NAMED | st.builds(dict, rule=st.just("reliability"), counts=st.integers(0, 9))
    | st.builds(outcome, st.floats(0, 5), st.floats(0, 5), st.sampled_from(["true", "never"]))
)  # fmt: skip


@given(st.builds(
    Setting, gamma=st.floats(0.01, 0.99), robots=st.lists(ROBOTS, min_size=1, max_size=3).map(tuple), trust=RULES,
    believed_trust=RULES, c_ask=st.none() | NUMBERS, max_steps=st.integers(1, 10**9), c_move=NUMBERS,
))  # fmt: skip
def test_plain_data_make_an_equal_object(setting: Setting) -> None:
    assert Setting(**json.loads(json.dumps(plain(setting)))) == setting
    assert hash(Setting(**plain(setting))) == hash(setting)
    assert {"trust", "believed_trust"}.isdisjoint(plain(Setting()))


def classes() -> Iterator[type]:
    """Yield all declared classes of the project."""
    for file in sorted((Path(__file__).parents[3] / "assist").rglob("*.py")):
        if file.name == "__init__.py":
            continue
        if "import declared" in file.read_text() or ", declared" in file.read_text():
            module = import_module(".".join(file.relative_to(Path(__file__).parents[3]).with_suffix("").parts))
            for _, one in inspect.getmembers(module, inspect.isclass):
                if is_declared(one) and is_dataclass(one) and one.__module__ == module.__name__:
                    yield one


def is_made_of_nothing(kind: type) -> bool:
    try:
        kind()
    except (TypeError, DeclarationError):
        return False
    return True


def test_no_declared_field_takes_one_kind_of_value_for_another() -> None:
    """A text is no number, and a number no text or truth value, whatever pydantic would convert by itself."""
    for one in classes():
        for name, field in one.__pydantic_fields__.items():  # type: ignore[attr-defined]
            for wrong in ("1", 1, b"x", True):
                made = _made(field, wrong)
                taken = isinstance(made, str | int | float) and type(made) is not type(wrong)
                assert not taken or (type(wrong), type(made)) == (int, float), f"{one.__name__}.{name}: {wrong!r}"


def values_outside(field: Any) -> Iterator[Any]:
    """Yield values that no number of a field takes: others than numbers, and those just outside of its range."""
    limits = [
        (name, getattr(one, name)) for one in field.metadata for name in ("gt", "ge", "lt", "le") if hasattr(one, name)
    ]
    for name, end in limits:
        yield from (float("nan"), float("inf"), "1", True, [1.0], 1j)
        yield end if name in ("gt", "lt") else end + (1 if name == "le" else -1) * max(1, abs(end))


@pytest.mark.parametrize("kind", list(classes()), ids=lambda one: one.__name__)
def test_every_number_and_every_choice_says_what_it_takes(kind: type) -> None:
    """Of a class that is not made of nothing, each field is tried by itself."""
    for name, field in kind.__pydantic_fields__.items():  # type: ignore[attr-defined]
        own = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        for wrong in (*values_outside(field), *["none of these"] * (get_origin(field.annotation) is Literal)):
            if is_made_of_nothing(kind):
                with pytest.raises(DeclarationError, match=rf"^{name} .*: expected ") as refused:
                    kind(**{name: wrong})
            else:
                with pytest.raises(DeclarationError, match=r"expected ") as refused:
                    checked(own, wrong)
            assert "\n" not in str(refused.value)


def _made(field: Any, value: Any) -> Any:
    kind = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValueError:
        return value


def test_a_setting_has_a_sentence_for_each_field_and_a_robot_the_same() -> None:
    for kind in (Setting, Robot):
        assert all(text[0].isupper() and text.endswith(".") for text in sentences(kind).values())
        assert kind.__doc__ is not None
        assert all(f"\n{one.name}\n" in kind.__doc__ for one in fields(kind))
    assert sentences(Robot) == sentences(OfRobots)
    assert vars(Robot()) == dict.fromkeys(vars(OfRobots()))


def test_a_phrase_of_ones_own_stands_for_type_and_limits() -> None:
    @declared
    class Tank:
        level: Annotated[Number, Field(ge=0), Expected("litres above the mark")] = 1.0

    with pytest.raises(DeclarationError, match="level -1: expected litres above the mark"):
        Tank(-1)
    assert phrase(list[list[Number]]) == "a list of lists of numbers"
    assert phrase(tuple[Count, ...]) == "a list of whole numbers of 1 or more"


def test_tables_of_pages_are_as_the_classes_declare_them() -> None:
    pages = {page: page.read_text() for page in declared_tables.DOCS.rglob("*.md")}
    assert sum(text.count("<!-- declared ") for text in pages.values()) >= 3
    wrong = [str(page) for page, text in pages.items() if text != declared_tables.renewed(text)]
    assert wrong == [], "python tests/declared_tables.py writes them anew"


def test_declarations_import_no_arrays() -> None:
    rooms = ("people.trust_rules", "people.ranges", "person.settings", "learning.method")
    modules = ", ".join(f"assist.{room}" for room in rooms)
    code = f"import sys, {modules}; print(*{{'numpy', 'scipy', 'numba'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_a_representation_of_a_base_is_kept() -> None:
    class Short:
        def __repr__(self) -> str:
            return "short"

    @declared
    class Mixed(Short):
        size: Number = 1.0

    assert repr(Mixed()) == "short"
    assert repr(Wheel(2)) == "Wheel(size=2.0)"
