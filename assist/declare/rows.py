"""Declared classes as tables of an SQLite database: a column for each field, in the order of the fields."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from .declared import annotation_of, bare, has_none, names_of

T = TypeVar("T")

TYPES = {int: "INTEGER", str: "TEXT", bytes: "BLOB"}


def created(table: str, kind: Any, more: Mapping[str, str], *constraints: str) -> str:
    """Return the statement that creates a table unless it exists.

    Parameters
    ----------
    table : str
    kind : type
        The declared class of its rows.
    more : mapping of str to str
        What is said of a column beside its type and that it is not null.
    *constraints : str
        What is said of the table.
    """
    columns = []
    for name in names_of(kind):
        annotation = annotation_of(kind, name)
        null = "" if has_none(annotation) else "NOT NULL"
        columns.append(" ".join(filter(None, [name, TYPES[bare(annotation)], null, more.get(name, "")])))
    return f"CREATE TABLE IF NOT EXISTS {table} ({', '.join([*columns, *constraints])})"


def insert(db: sqlite3.Connection, table: str, row: Any, *, instead: bool = False) -> None:
    """Add a row, or with `instead` put it in the place of the one with the same key."""
    named = {one.name: getattr(row, one.name) for one in fields(row)}
    what = "INSERT OR REPLACE INTO" if instead else "INSERT INTO"
    db.execute(f"{what} {table} VALUES ({', '.join(f':{name}' for name in named)})", named)


def select(db: sqlite3.Connection, kind: type[T], table: str, rest: str = "", values: Any = ()) -> list[T]:
    """Return rows of a table as objects of a declared class, which may have fewer fields than the table has columns."""
    found = db.execute(f"SELECT {', '.join(names_of(kind))} FROM {table} {rest}", values)
    return [kind(*row) for row in found]
