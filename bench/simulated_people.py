"""Simulated people with known parameters and their actions, for the benchmarks of learning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assist.people import NOTHING_YET, Situation, Vocabulary, features, goals_met
from assist.people.decision import NOTHING, choice, influence, trust
from assist.people.perceived_suggestions import PerceivedSuggestions, moved
from assist.people.trust_rules import TrustRule
from planner import CostToGo


@dataclass(frozen=True)
class People:
    """Simulated people; each array has the shape (K,).

    `noise`, shape (K, n), is their misconception in cost units for each state of the task.
    """

    beta: np.ndarray
    theta: np.ndarray
    eta: float = 0.2
    noise: np.ndarray | None = None

    def names(self) -> list[str]:
        digits = len(str(len(self.beta)))
        return [f"person-{k + 1:0{digits}}" for k in range(len(self.beta))]


def perceived(answers: CostToGo, people: People, who: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the perceived cost-to-go of states; both arrays have the shape (m,)."""
    h = answers.lookup(states)
    if people.noise is None:
        return h
    return np.where(answers.is_goal(states), 0.0, h + people.noise[who, states])


def perceived_costs(answers: CostToGo, people: People, who: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return Q, actions and target states, each of shape (m, A), for people in states."""
    offsets, actions, targets = answers.choices(states)
    counts = np.diff(offsets)
    rows = np.repeat(np.arange(len(states)), counts)
    slots = np.arange(len(actions)) - offsets[rows]
    shape = (len(states), max(1, int(counts.max(initial=1))))
    q, act, to = np.full(shape, np.inf), np.full(shape, -1), np.repeat(states[:, None], shape[1], axis=1)
    q[rows, slots] = np.asarray(answers.task.costs)[actions] + perceived(answers, people, who[rows], targets)
    act[rows, slots], to[rows, slots] = actions, targets
    return q, act, to


def value(answers: CostToGo, people: People, who: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return V(x) = -min Q(x, a), shape (m,)."""
    if people.noise is None:
        return -answers.lookup(states)
    return np.where(answers.is_goal(states), 0.0, -perceived_costs(answers, people, who, states)[0].min(axis=1))


def record(
    answers: CostToGo,
    people: People,
    *,
    episodes: int,
    rng: np.random.Generator,
    suggest: float = 0.0,
    good: float = 0.5,
    most: int = 10_000,
) -> list[dict]:
    """Simulate people; return the log of their actions.

    Parameters
    ----------
    suggest : float
        Probability of a suggestion in each step. A share `good` of the suggestions begin an optimal plan; the others
        are random applicable actions.
    most : int
        Largest number of steps of an episode.
    """
    names, actions_of = people.names(), answers.task.actions
    who = np.repeat(np.arange(len(names)), episodes)
    number = np.tile(np.arange(episodes), len(names))
    x = np.full(len(who), answers.initial, dtype=np.int64)
    theta = people.theta[who].copy()
    going = ~answers.is_goal(x)
    rows: list[dict] = []
    for step in range(most):
        at = np.flatnonzero(going)
        if not len(at):
            break
        k = who[at]
        q, actions, targets = perceived_costs(answers, people, k, x[at])
        applicable = actions >= 0
        told = np.full(len(at), NOTHING, dtype=np.int64)
        asked = np.flatnonzero(rng.random(len(at)) < suggest)
        if len(asked):
            exact = (
                q if people.noise is None else perceived_costs(answers, People(people.beta, people.theta), k, x[at])[0]
            )
            best = (exact == exact.min(axis=1, keepdims=True))[asked]
            pool = np.where((rng.random(len(asked)) < good)[:, None], best, applicable[asked])
            told[asked] = np.where(pool, rng.random(pool.shape), -1.0).argmax(axis=1)
        p = influence(choice(q, applicable, people.beta[k]), told, theta[at])
        slot = (p.cumsum(axis=1) <= rng.random((len(at), 1))).sum(axis=1)
        slot = np.minimum(slot, p.shape[1] - 1 - (p[:, ::-1] > 0).argmax(axis=1))
        lines = np.arange(len(at))
        rows += [
            {
                "person": names[k[i]], "episode": str(number[at[i]] + 1), "step": step,
                "action": actions_of[actions[i, slot[i]]],
                "suggestion": actions_of[actions[i, told[i]]] if told[i] != NOTHING else None,
            }
            for i in lines
        ]  # fmt: skip
        if len(asked):
            before = value(answers, people, k[asked], x[at][asked])
            after = value(answers, people, k[asked], targets[asked, told[asked]])
            theta[at[asked]] = trust(theta[at[asked]], before, after, people.eta)
        x[at] = targets[lines, slot]
        going[at] = ~answers.is_goal(x[at])
    return rows


def record_with_terms(
    answers: CostToGo, beta: np.ndarray, weights: np.ndarray, actions: int, rng: np.random.Generator
) -> list[dict]:
    """Simulate people whose choices depend on terms; return the log of their actions. There are no suggestions.

    Parameters
    ----------
    beta : float array, shape (K,)
    weights : float array, shape (K, J)
    actions : int
        Number of actions of each person, in as many episodes as needed.
    """
    count, words = len(beta), Vocabulary.of(answers.task.actions)
    names = People(beta, beta).names()
    x = np.full(count, answers.initial, dtype=np.int64)
    last, previous = (np.full(count, NOTHING_YET, dtype=np.int64) for _ in range(2))
    episode, step = np.ones(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    rows: list[dict] = []
    for _ in range(actions):
        q, options, targets = perceived_costs(answers, People(beta, beta), np.arange(count), x)
        met = goals_met(answers, targets.ravel()).reshape(targets.shape)
        here = Situation(
            answers.task.actions, words, x, options >= 0, options, targets, goals_met(answers, x), met, last, previous
        )
        bias = np.einsum("kaj,kj->ka", features(here), weights)
        p = choice(q, options >= 0, beta, bias)
        slot = np.minimum((p.cumsum(axis=1) <= rng.random((count, 1))).sum(axis=1), (options >= 0).sum(axis=1) - 1)
        taken = options[np.arange(count), slot]
        rows += [
            {"person": names[k], "episode": f"{episode[k]}", "step": int(step[k]), "action": answers.task.actions[a]}
            for k, a in enumerate(taken.tolist())
        ]
        previous, last, x = x, taken, targets[np.arange(count), slot]
        done = answers.is_goal(x)
        episode, step = episode + done, np.where(done, 0, step + 1)
        last, previous = np.where(done, NOTHING_YET, last), np.where(done, NOTHING_YET, previous)
        x = np.where(done, answers.initial, x)
    return rows


def record_with_trust(
    answers: CostToGo,
    people: People,
    rule: TrustRule,
    *,
    suggestions: int,
    rng: np.random.Generator,
    suggest: float = 0.5,
    good: float = 0.5,
    last: np.ndarray | None = None,
) -> list[dict]:
    """Simulate people whose influence moves by a rule and is carried from episode to episode; return their log.

    Parameters
    ----------
    suggestions : int
        Number of suggestions to each person, after which they stop.
    suggest, good
        As of `record`. People know h*.
    last : float array, shape (K,), optional
        Receives each person's theta after the last suggestion.
    """
    names, actions_of = people.names(), answers.task.actions
    x = np.full(len(names), answers.initial, dtype=np.int64)
    theta, heard, outcomes = people.theta.copy(), *np.zeros((2, len(names)), dtype=np.int64)
    episode, step = np.ones(len(names), dtype=np.int64), np.zeros(len(names), dtype=np.int64)
    rows: list[dict] = []
    while (going := np.flatnonzero(heard < suggestions)).size:
        q, actions, targets = perceived_costs(answers, people, going, x[going])
        lines, best = np.arange(len(going)), q == q.min(axis=1, keepdims=True)
        pool = np.where((rng.random(len(going)) < good)[:, None], best, actions >= 0)
        picked = np.where(pool, rng.random(pool.shape), -1.0).argmax(axis=1)
        told = np.where(rng.random(len(going)) < suggest, picked, NOTHING)
        p = influence(choice(q, actions >= 0, people.beta[going]), told, theta[going])
        slot = (p.cumsum(axis=1) <= rng.random((len(going), 1))).sum(axis=1)
        slot = np.minimum(slot, p.shape[1] - 1 - (p[:, ::-1] > 0).argmax(axis=1))
        for i, k in enumerate(going.tolist()):
            rows.append({
                "person": names[k], "episode": str(episode[k]), "step": int(step[k]),
                "action": actions_of[actions[i, slot[i]]],
                "suggestion": actions_of[actions[i, told[i]]] if told[i] != NOTHING else None,
            })  # fmt: skip
        asked = told != NOTHING
        h = answers.lookup(targets[lines, picked])
        seen = PerceivedSuggestions.of(q[lines, picked], q.min(axis=1), -q.min(axis=1), -h, best[lines, picked])
        after, more = moved(rule, theta[going], outcomes[going], seen.event(slot == told, rule.feedback))
        theta[going], outcomes[going] = np.where(asked, after, theta[going]), np.where(asked, more, outcomes[going])
        heard[going] += asked
        x[going] = targets[lines, slot]
        step[going] += 1
        done = going[answers.is_goal(x[going])]
        x[done], step[done] = answers.initial, 0
        episode[done] += 1
    if last is not None:
        last[:] = theta
    return rows
