"""A few of the broken inputs of `fuzz.py`, which makes ten thousand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT


@pytest.mark.slow
def test_broken_inputs_are_refused(tmp_path: Path) -> None:
    command = [sys.executable, ROOT / "tests" / "fuzz.py", "15", "7", tmp_path, "solve,simulate,fit"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("15 broken inputs, 0 faults\n")
