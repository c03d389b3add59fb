"""Every public name is in the reference, with its parameters."""

from __future__ import annotations

import dataclasses
import inspect
import re
from importlib import import_module
from typing import Any, get_type_hints, is_typeddict

import pytest
from conftest import ROOT
from test_architecture import PACKAGES, handed_on


def entries(documented: Any) -> set[str]:
    """The names that a docstring lists, or a sentence beside a declared field; also those of the bases of a class."""
    if not inspect.isclass(documented):
        return listed(documented)
    return set().union(*(listed(base) | declared(base) for base in documented.__mro__))


def declared(kind: type) -> set[str]:
    """The fields of a class that are declared with a sentence."""
    fields = vars(kind).get("__pydantic_fields__", {})
    return {name for name, field in fields.items() if field.description}


def listed(documented: Any) -> set[str]:
    """The parameters and attributes that a docstring lists."""
    parts = re.split(r"\n([A-Z][A-Za-z ]+)\n-{3,}\n", inspect.cleandoc(documented.__doc__ or ""))
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    lines = "\n".join(sections.get(name, "") for name in ("Parameters", "Attributes")).splitlines()
    heads = [line.split(" : ")[0] for line in lines if line and not line.startswith(" ")]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def expected(value: Any) -> set[str]:
    """Return the names to be listed: fields of a dataclass, entries of options, or parameters of another callable."""
    if is_typeddict(value):
        return set(get_type_hints(value))
    if inspect.isclass(value) and (issubclass(value, BaseException) or getattr(value, "_is_protocol", False)):
        return set()
    if dataclasses.is_dataclass(value):
        return {field.name for field in dataclasses.fields(value) if not field.name.startswith("_")}
    return set(inspect.signature(value).parameters)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_says_what_it_takes(package: str) -> None:
    values = {name: getattr(import_module(package), name) for name, _ in handed_on(package)}
    callables = {name: value for name, value in values.items() if callable(value)}
    assert callables
    assert [name for name, value in callables.items() if not (value.__doc__ or "").strip()] == []
    lacking = {name: sorted(expected(value) - entries(value)) for name, value in callables.items()}
    assert {name: missing for name, missing in lacking.items() if missing} == {}


def test_the_reference_has_every_package() -> None:
    text = (ROOT / "docs" / "reference.md").read_text()
    assert re.findall(r"^\.\. automodule:: (\S+)$", text, re.M) == [*PACKAGES, "planner.engine"]
    assert text.count(":members:") == len(PACKAGES) + 1
    constants = {
        f"{module}.{name}"
        for package in PACKAGES
        for name, module in handed_on(package)
        if not callable(getattr(import_module(package), name)) and package != "assist"
    }
    assert set(re.findall(r"^\.\. autodata:: (\S+)$", text, re.M)) == constants
