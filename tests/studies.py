"""A small simulation study for tests, and functions that write and run it."""

from __future__ import annotations

from pathlib import Path

from conftest import KITTING

TINY = f"""
title = "small"
seed = 5
repeats = 3
instances = ["{KITTING}/tiny.pddl"]
humans = [1, 2]
pool = 4
draws = 2
trials = 2

[setting]
c_suggest = 0.2
max_steps = 100

[populations.everybody]

[populations.novices]
beta = [0.1, 0.5]

[[conditions]]
name = "first"

[[conditions]]
name = "dear"
policies = ["attention"]
settings = [{{ c_suggest = 0.6 }}, {{ c_suggest = 0.2, c_move = 2.0 }}]
repeats = 2

[[conditions]]
name = "novices"
populations = ["novices"]
priors = ["own", "everybody"]
"""
RESULTS = ("episodes.jsonl", "summary.json", "report.md", "report.html", "study.json")


def write(folder: Path, text: str = TINY) -> Path:
    file = folder / "small.toml"
    file.write_text(text)
    return file


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in RESULTS}
