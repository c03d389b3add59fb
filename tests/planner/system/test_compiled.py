"""Compiled code is cached for later processes, and compiled again when a file that it depends on changes."""

from __future__ import annotations

import ast
import linecache
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numba
import pytest
from conftest import ROOT

from planner.system.jit import njit, stamp

SHARED = """
from typing import NamedTuple
from planner.system.jit import njit

LIMIT = 100

class Pair(NamedTuple):
    a: float
    b: float

@njit()
def inner(x):
    return x + 1
"""
CONSTANTS = "WEIGHT = 10_000\nOTHER = 1\n"
BETWEEN = """
from planner.system.jit import njit
from .shared import inner

@njit()
def middle(x):
    return inner(x)
"""
CALLER = """
from planner.system.jit import njit
from . import constants
from .between import middle
from .shared import LIMIT, Pair

@njit()
def outer(x):
    return middle(x) + LIMIT + constants.WEIGHT + Pair(0, 1_000_000).b
"""
FILES = {"__init__": "", "shared": SHARED, "constants": CONSTANTS, "between": BETWEEN, "caller": CALLER, "unused": ""}


def called() -> tuple[int, bool]:
    """Call `outer(1)` as a new process would; return its value and whether its code came from the cache."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "made"]:
        del sys.modules[name]
    stamp.cache_clear()
    linecache.clearcache()
    outer = import_module("made.caller").outer
    return int(outer(1)), sum(outer.stats.cache_hits.values()) > 0


def test_an_edit_of_any_file_that_code_was_compiled_from_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python compares times of files, and these are too close
    (tmp_path / "made").mkdir()
    for name, text in FILES.items():
        (tmp_path / "made" / f"{name}.py").write_text(text)
    assert not import_module("made.caller").outer.at_hand
    assert called() == (1_010_102, False)
    assert called() == (1_010_102, True)
    assert import_module("made.caller").outer.at_hand
    edits = [
        ("shared", "x + 1", "x + 2", 1_010_103),  # a function two calls away
        ("shared", "LIMIT = 100", "LIMIT = 300", 1_010_303),
        ("constants", "WEIGHT = 10_000", "WEIGHT = 20_000", 1_020_303),  # of a module
        ("shared", "    a: float\n    b: float", "    b: float\n    a: float", 20_303),
    ]
    for name, old, new, expected in edits:
        file = tmp_path / "made" / f"{name}.py"
        file.write_text(file.read_text().replace(old, new))
        assert called() == (expected, False), new
    (tmp_path / "made" / "unused.py").write_text("WEIGHT = 1\n")
    assert called() == (20_303, True)


TYPED = """
from typing import NamedTuple
from planner.system.jit import njit

class Pair(NamedTuple):
    a: int

@njit()
def first(pair):
    return pair.a

def start():
    return first(Pair(7)), sum(first.stats.cache_hits.values()) > 0
"""


def test_code_whose_types_were_renamed_or_are_gone_is_compiled_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba reads the types of all cached code before it looks whether that is stale."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    file = tmp_path / "renamed.py"

    def started(text: str) -> tuple[int, bool]:
        file.write_text(text)
        sys.modules.pop("renamed", None)
        stamp.cache_clear()
        linecache.clearcache()
        found: tuple[int, bool] = import_module("renamed").start()
        return found

    assert started(TYPED) == (7, False)
    assert started(TYPED) == (7, True)
    assert started(TYPED.replace("Pair", "Couple")) == (7, False)
    assert started(TYPED.replace("Pair", "Couple")) == (7, True)
    for index in (tmp_path / "__pycache__").glob("*.nbi"):
        index.write_bytes(index.read_bytes()[:-20])
    assert started(TYPED.replace("Pair", "Couple")) == (7, False)


TWICE = """
from planner.system.jit import njit

@njit()
def inner(x):
    return x + 1

@njit()
def outer(x):
    return 2 * inner(x)

print(outer(1), *(sum(one.stats.cache_misses.values()) for one in (outer, inner)))
"""


@pytest.mark.slow
def test_processes_that_start_together_compile_a_function_once(tmp_path: Path) -> None:
    (tmp_path / "twice.py").write_text(TWICE)
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{tmp_path}", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    started = [
        subprocess.Popen([sys.executable, "-c", "import twice"], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = sorted(process.communicate()[0].split() for process in started)
    assert said == [["4", "0", "0"], ["4", "1", "1"]]


@pytest.mark.slow
def test_numba_can_be_switched_off() -> None:
    code = "from assist.people.influence_kernels import update_trust; print(update_trust(0.5, 0.0, 1.0))"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0.5\n", "")


@pytest.mark.parametrize("package", ["planner", "assist"])
def test_all_compiled_code_is_cached_in_this_way(package: str) -> None:
    for file in (ROOT / package).rglob("*.py"):
        if file != ROOT / "planner" / "system" / "jit.py":
            if not re.search(r"\.\s*(njit|jit|vectorize|guvectorize)\b", text := file.read_text()):
                continue  # which is much faster than to parse it
            uses = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
            assert not [node for node in uses if node.attr in ("njit", "jit", "vectorize", "guvectorize")], file


@njit()
def ratio(a: float, b: float) -> float:
    return a / b


@njit(fastmath={"arcp"})
def ratio_by_a_reciprocal(a: float, b: float) -> float:
    return ratio(a, b)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_arithmetic_is_that_of_the_function_and_not_of_its_first_caller() -> None:
    """The reciprocal of a subnormal number is infinite, and its ratio to itself is one."""
    ratio_by_a_reciprocal(1.0, 2.0)
    assert ratio(1e-310, 1e-310) == 1.0


@njit(inner=True)
def doubled(a: float) -> float:
    return 2.0 * a


@njit()
def doubled_twice(a: float) -> float:
    return float(doubled(doubled(a)))


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_python_is_refused_by_name_where_only_compiled_code_may_call() -> None:
    """numba would end the process."""
    assert doubled_twice(1.5) == 6.0
    with pytest.raises(TypeError, match=r"^only compiled code can call .*\.doubled: it is declared inner$"):
        doubled(1.5)


def test_an_interrupt_while_the_compiler_is_imported_leaves_it_whole(tmp_path: Path) -> None:
    """Otherwise no later call in the same session could use it."""
    script = """
import _thread, signal, sys
from planner.system.jit import njit

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == "numba.core.typing.templates":
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)

@njit()
def doubled(x):
    return 2 * x

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupts())
try:
    doubled(2)
except KeyboardInterrupt:
    print("interrupted")
print(doubled(3), "scipy.linalg" in sys.modules)  # which takes 0.1 s, and is not needed
"""
    (tmp_path / "script.py").write_text(script)
    inside = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, env=inside)
    assert done.stdout.split() == ["interrupted", "6", "False"], done.stderr
