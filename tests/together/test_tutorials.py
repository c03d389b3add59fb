"""Every cell of the tutorials runs, each notebook by itself, and each ends with a picture."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT

pytest.importorskip("matplotlib")

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
SLOW = {"cluster", "compare", "fit", "live", "person", "policy", "timed", "userstudy"}
"""Those with other processes, bounds, fits or larger tasks, which building the documentation runs, too."""

CELL = re.compile(r"^```\{code-cell\}\n(?::tags: ([^\n]*)\n)?\n?(.*?)^```$", re.M | re.S)


def shown(cell: str, names: dict[str, Any], where: str) -> Any:
    """Run a cell, and return the value of its last expression; None if it has none."""
    tree = ast.parse(cell)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, where, "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), where, "eval"), names)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if page.stem in SLOW else []) for page in TUTORIALS],
)
def test_a_tutorial_runs_and_ends_with_a_picture(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "IPython" in page.read_text():
        pytest.importorskip("IPython")  # of the extra `docs`
    monkeypatch.setenv("MPLBACKEND", "agg")
    (place := tmp_path / "docs" / "tutorials").mkdir(parents=True)
    (tmp_path / "domains").symlink_to(ROOT / "domains")
    (tmp_path / "docs" / "examples").symlink_to(ROOT / "docs" / "examples")
    monkeypatch.chdir(place)
    names: dict[str, Any] = {"__name__": "__main__"}
    values = []
    for number, (tags, cell) in enumerate(CELL.findall(page.read_text()), 1):
        value = shown(cell, names, f"{page.name}, cell {number}")
        if "remove-cell" not in tags:
            values.append(value)
    looks = ("_repr_svg_", "_repr_png_", "_repr_html_")
    assert any(hasattr(value, look) and getattr(value, look)() for look in looks for value in values[-1:]), page.name
    bare = [value for value in values if hasattr(value, "savefig") and not hasattr(value, "_repr_png_")]
    assert not bare, f"{page.name}: a notebook would show {bare[0]!r} as a line of text"
