"""Logs of actions for tests, written by hand or by simulated people."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from assist.learning import AdviceLog, Entry, Log
from assist.learning.advice_model import LAPSE, AdviceModel
from assist.people import Choices, choice, influence, perceived_cost, perceived_value, trust

RIGHT, WRONG, BACK = "(place hammer slot-1 box-a)", "(place hammer slot-2 box-a)", "(return box-a)"
FETCH = "(fetch box-a)"


def lines(
    *actions: str, person: str = "ann", episode: str = "1", told: Mapping[int, str | None] | None = None
) -> list[dict]:
    return [
        {"person": person, "episode": episode, "step": step, "action": action, "suggestion": (told or {}).get(step)}
        for step, action in enumerate(actions)
    ]


def log_of(rows: list[dict]) -> Log:
    return Log(tuple(Entry(n, **row) for n, row in enumerate(rows, start=1)))


def people_at_work(
    choices: Choices,
    beta: list[float],
    rng: np.random.Generator,
    *,
    theta: float = 0.6,
    eta: float = 0.2,
    suggest: float = 0.0,
    episodes: int = 3,
    noise: np.ndarray | None = None,
) -> list[dict]:
    """Simulate people with the functions of the model, and write down what they do."""
    rows = []
    h = choices.h if noise is None else np.where(choices.goal, 0.0, choices.h + noise)
    q = perceived_cost(choices, h)
    v = perceived_value(choices, q)
    for k, own in enumerate(beta):
        for episode in range(episodes):
            x, trusts = choices.initial, theta
            for step in range(2000):
                slots = np.flatnonzero(choices.applicable[x])
                told = int(rng.choice(slots)) if rng.random() < suggest else -1
                p = influence(choice(q[x], choices.applicable[x], own), told, trusts)
                slot = int(rng.choice(len(p), p=p))
                name = None if told < 0 else choices.name(x, told)
                rows += lines(choices.name(x, slot), person=f"p{k}", episode=str(episode), told={0: name})
                rows[-1]["step"] = step
                if told >= 0:
                    trusts = float(trust(trusts, v[x], v[choices.targets[x, told]], eta))
                x = int(choices.targets[x, slot])
                if choices.goal[x]:
                    break
    return rows


def write_log(file: Path, rows: list[dict], tail: str = "") -> Path:
    file.write_text("".join(json.dumps(row) + "\n" for row in rows) + tail)
    return file


def simulated(people: int, trials: int, seed: int, *, spread: float = 1.5, steps: float = 0.0) -> AdviceLog:
    """Draw people of base E, whose logit theta falls by `steps` after each disagreement with wrong advice."""
    rng = np.random.default_rng(seed)
    rows: list[list[object]] = []
    for k in range(people):
        logit = rng.normal(0.5, spread)
        for trial in range(trials):
            agrees, right, c = rng.random() < 0.5, rng.random() < 0.6, rng.uniform(0, 1)
            z = 3.3 + 1.2 * c if agrees else min(max(logit, -4.595), 4.595) - 1.5 * c
            follows = rng.random() < LAPSE + (1 - 2 * LAPSE) / (1 + math.exp(-z))
            rows.append([f"p{k:03}", trial == 0, 0, agrees, follows, right, True, c, 0.0])
            if not agrees and not right:
                logit -= steps
    person, *others = (list(column) for column in zip(*rows, strict=True))
    kinds = (bool, int, bool, bool, bool, bool, float, float)
    return AdviceLog(np.array(person), *(np.array(c, dtype=k) for c, k in zip(others, kinds, strict=True)))


def predictions(model: AdviceModel, log: AdviceLog) -> np.ndarray:
    """Return the log probability of each answer, given the person's answers before it, shape (N,)."""
    found, weights = model.likelihood(log)
    with np.errstate(divide="ignore"):
        logs = np.log(found)
    joint = []
    for own in np.split(logs, np.flatnonzero(log.first)[1:]):
        every = np.logaddexp.reduce(own.cumsum(axis=0) + weights, axis=1)
        joint.append(np.diff(every, prepend=0.0))
    return np.concatenate(joint)
