"""Numeric results of a study: means for each team size and policy, savings with intervals, and comparisons.

Everything is computed over pools of people, not over their episodes; see `assist.studies.statistics`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.system.files import finite

from ...learning.intervals import IntervalEstimate
from ...person.settings import Setting
from ...team.policy_names import BASELINES, hardly_assists
from .. import statistics
from ..study import SCHEMA, Study

if TYPE_CHECKING:
    import pandas as pd

ARM = ("condition", "setting", "prior", "population", "instance")
"""Fields that the episodes of an arm share."""

MEASURES = {
    "actions": "human_actions_per_person", "costs": "cost_per_person", "interventions": "interventions",
    "moves": "moves",
}  # fmt: skip
ENDS = ("finished_percent", "cut_off")
"""How episodes end: percentage of people who finish, and share of episodes in which somebody does not."""

# The reactive policy weighs no costs and has no belief, so that prices, discounting and the robot's model of people
# change none of `MEASURES`. Every other field counts, new ones included.
UNUSED_BY_REACTIVE = ("gamma", "c_suggest", "c_move", "c_execute", "lapse", "believed_trust")


class Found:
    """The results of a study, by pool.

    Attributes
    ----------
    study : Study
    pools : DataFrame
        One row for each arm, policy, team size and pool: the mean over its episodes of each of `MEASURES` and `ENDS`.
    main : dict
        The arms of the headline and the figures: the first condition with its first setting, prior and population.
    compared : tuple of str
        Measures in which policies are compared: costs, which are people's time where they are durations, where they are
        not the numbers of actions.
    """

    def __init__(self, study: Study, episodes: pd.DataFrame) -> None:
        self.study, self.episodes = study, episodes
        keys = [*ARM, "policy", "humans", "repeat"]
        columns = [*MEASURES.values(), *ENDS]
        measured = episodes.groupby(keys, observed=True)[columns].mean()
        pools = measured.rename(columns={column: name for name, column in MEASURES.items()}).reset_index()
        self.pools = pools.astype(dict.fromkeys((*ARM, "policy"), str))
        priced = bool((pools["costs"] != pools["actions"]).any())
        self.compared = ("actions", *["costs"] * priced, "interventions")
        first = study.conditions[0]
        self.main = {
            "condition": first.name, "setting": first.settings[0][0], "prior": first.priors[0],
            "population": first.populations[0],
        }  # fmt: skip

    def with_baselines(self, arm: dict[str, str], own: pd.DataFrame) -> pd.DataFrame:
        """Add baselines that an arm lacks, if the first condition has them for the same teams and random numbers.

        Without assistance, people's actions depend only on the step limit. Under the reactive policy they depend on
        all of the setting but `UNUSED_BY_REACTIVE`.
        """
        import pandas as pd

        here, main = self._setting(arm), dict(self.study.conditions[0].settings)[self.main["setting"]]
        parts = [own]
        for name in BASELINES:
            if name not in set(own["policy"]) and has_same_baseline(name, here, main):
                where = {"population": arm["population"], "instance": arm["instance"], "policy": name}
                same = rows_of(self.pools, self.main | where)
                if {*own["humans"]} <= {*same["humans"]}:
                    parts.append(same[same["repeat"].isin(own["repeat"]) & same["humans"].isin(own["humans"])])
        return pd.concat(parts)

    def _setting(self, arm: dict[str, str]) -> Setting:
        return dict(self.study.condition(arm["condition"]).settings)[arm["setting"]]

    def arms(self, **wanted: str) -> Iterator[tuple[dict[str, str], pd.DataFrame]]:
        """Yield each arm with the wanted properties, and its pools."""
        for values, own in rows_of(self.pools, wanted).groupby(list(ARM), observed=True, sort=False):
            yield dict(zip(ARM, _texts(values), strict=True)), own

    def summary(self) -> dict[str, Any]:
        """Return all results as plain data, which `docs/study.md` describes."""
        study = self.study
        return {
            "schema": SCHEMA, "title": study.title, "seed": study.seed, "repeats": study.repeats,
            "fingerprint": study.fingerprint(), "headline": self.headline(), "cells": self.cells(),
            "comparisons": self.comparisons(), "seldom_assisted": self.seldom_assisted(),
            "uneven": self.uneven(), "decline": self.decline(), "contrasts": self.contrasts(),
            "readings": self.readings(),
        }  # fmt: skip

    def headline(self) -> dict[str, Any]:
        """Return the savings of the focus policy in the first condition, over all team sizes, by task and overall.

        The values are those of `main`. Other populations, settings and priors of the condition are under `others`.
        """
        first = self.study.conditions[0]
        groups = [
            {"condition": first.name, "setting": setting, "prior": prior, "population": population}
            for setting, _ in first.settings for prior in first.priors for population in first.populations
        ]  # fmt: skip
        found = [self._headline(group) for group in groups]
        return {"policy": self.study.focus, **found[0], "others": found[1:]}

    def _headline(self, group: dict[str, str]) -> dict[str, Any]:
        by_task = {arm["instance"]: own for arm, own in self.arms(**group)}
        together = rows_of(self.pools, group)
        return {
            **group, "pools": int(together["repeat"].nunique()), **self._savings(together),
            **self._ends(group, together),
            "instances": {instance: self._savings(own) for instance, own in by_task.items()},
        }  # fmt: skip

    def _ends(self, group: dict[str, str], pools: pd.DataFrame) -> dict[str, Any]:
        """Return how many episodes of a group were cut off, the step limit, and how many people finished."""
        own = rows_of(self.episodes, group)
        finished = {policy: average(pools, "finished_percent", policy) for policy in dict.fromkeys(pools["policy"])}
        return {
            "episodes": len(own), "cut_off": int(own["cut_off"].sum()), "max_steps": self._setting(group).max_steps,
            "finished": {policy: estimate.within(0.0, 100.0).record() for policy, estimate in finished.items()},
        }  # fmt: skip

    def _savings(self, pools: pd.DataFrame) -> dict[str, Any]:
        focus, found = self.study.focus, {}
        for measure in self.compared:
            for other in self.study.compared_with(focus):
                estimate = saving(pools, measure, focus, other)
                if math.isfinite(estimate.value):
                    found[f"{measure}_vs_{other.replace('-', '_')}"] = estimate.record()
        return found

    def cells(self) -> list[dict[str, Any]]:
        """Return descriptive statistics for each arm, team size and policy."""
        found = []
        keys = [*ARM, "humans", "policy"]
        pools: dict[tuple[str, ...], pd.DataFrame] = {
            _texts(key): own for key, own in self.pools.groupby(keys, observed=True)
        }
        for key, own in self.episodes.groupby(keys, observed=True, sort=False):
            found.append({
                **dict(zip(keys, _plain(key), strict=True)), "episodes": len(own),
                "pools": int(own["repeat"].nunique()), "cut_off": int(own["cut_off"].sum()),
                **{
                    column: _described(own[column].to_numpy(dtype=float), pools[_texts(key)][name].to_numpy())
                    for name, column in MEASURES.items()
                },
            })  # fmt: skip
        return found

    def comparisons(self) -> list[dict[str, Any]]:
        """Compare policies with the baselines over all team sizes (`humans` null); in main arms also by size."""
        found = []
        for arm, own in self.arms():
            pools = self.with_baselines(arm, own)
            present = set(pools["policy"])
            sizes = sorted(own["humans"].unique()) if self.main.items() <= arm.items() else []
            for humans in (None, *map(int, sizes)):
                those = pools if humans is None else pools[pools["humans"] == humans]
                for policy in dict.fromkeys(own["policy"]):
                    for against in [one for one in self.study.compared_with(policy) if one in present]:
                        named = {"humans": humans, "policy": policy, "against": against}
                        cut_off = max(float(ends.mean()) for ends in paired(those, "cut_off", policy, against))
                        for measure in self.compared:
                            ends = paired(those, measure, policy, against)
                            for record in _compared(*ends):
                                record |= {"cut_off_percent": 100 * cut_off, "pools": len(ends[0])}
                                found.append({**arm, **named, "measure": measure, **record})
        return found

    def seldom_assisted(self) -> list[dict[str, Any]]:
        """Return the arms in which a policy that weighs costs hardly assists, with whom it does, and the cost."""
        found = []
        acted = self.episodes[self.episodes["steps"] > 0].groupby([*ARM, "policy"], observed=True, sort=False)
        for key, assisted in acted["helped_percent"].mean().items():
            *arm, policy = _texts(key)
            labels = dict(zip(ARM, arm, strict=True))
            costs = set(self._setting(labels).fleet.each("c_suggest").tolist())
            if hardly_assists(policy, assisted) and len(costs) == 1:
                found.append({**labels, "policy": policy, "assisted": assisted, "c_suggest": costs.pop()})
        return found

    def uneven(self) -> list[dict[str, Any]]:
        """Return the means that rest on few of their pools: on fewer than half, and than `FEW`, if these were alike."""
        found = []
        for arm, own in self.arms():
            for policy, measure in product(dict.fromkeys(own["policy"]), self.compared):
                means = own[own["policy"] == policy].groupby("repeat")[measure].mean()
                alike = statistics.alike(means)
                if len(means) >= statistics.FEW > alike and alike < len(means) / 2:
                    found.append({**arm, "policy": policy, "measure": measure, "pools": len(means), "alike": alike})
        return found

    def decline(self) -> list[dict[str, Any]]:
        """Return the difference of the focus policy's savings between small and large teams, in percentage points."""
        found = []
        focus = self.study.focus
        for arm, own in self.arms(condition=self.main["condition"]):
            sizes = sorted(own["humans"].unique())
            extremes = [own[own["humans"] == size] for size in (sizes[0], sizes[-1])]
            for against in [name for name in self.study.baselines if name in set(own["policy"]) and name != focus]:
                for measure in self.compared:
                    first, last = (paired(part, measure, focus, against) for part in extremes)
                    estimate = statistics.change(first, last)
                    if math.isfinite(estimate.value) and len(sizes) > 1:
                        found.append({
                            **arm, "policy": focus, "against": against, "measure": measure,
                            "humans": [int(sizes[0]), int(sizes[-1])], **estimate.record(),
                        })  # fmt: skip
        return found

    def contrasts(self) -> list[dict[str, Any]]:
        """Return ratios of interventions between populations, in every arm that has all of them."""
        found = []
        for family, pools in self._families():
            for contrast in self.study.contrasts:
                if not {*contrast.of, *contrast.to} <= set(pools["population"]):
                    continue
                for policy in dict.fromkeys(pools["policy"]):
                    sides = [
                        _interventions(pools[(pools["policy"] == policy) & pools["population"].isin(side)])
                        for side in (contrast.of, contrast.to)
                    ]
                    above, below = sides[0].align(sides[1], join="inner")
                    estimate = statistics.quotient(above, below)
                    if above.sum() > 0:  # otherwise the ratio is undefined
                        found.append({**family, "policy": policy, "contrast": contrast.name, **estimate.record()})
        return found

    def readings(self) -> list[dict[str, Any]]:
        """Compare interventions with the reference's under each interpretation of unspecified details, best fit first.

        `off` is the mean absolute difference to the reference's numbers of interventions.
        """
        found = []
        targets = () if self.study.reference is None else self.study.reference.interventions
        for family, pools in self._families() if targets else ():
            if not {name for one in targets for name in one.populations} <= set(pools["population"]):
                continue
            largest = max(pools["humans"])
            for policy in [name for name in dict.fromkeys(pools["policy"]) if name not in BASELINES]:
                own = pools[pools["policy"] == policy]
                for counted, part, per_person in (
                    ("per episode, all K", own, False),
                    (f"per episode, K = {largest}", own[own["humans"] == largest], False),
                    ("per person, all K", own, True),
                ):
                    means = [
                        statistics.mean(_interventions(part[part["population"].isin(one.populations)], per_person))
                        for one in targets
                    ]
                    wrong = [abs(m.value - one.mean) for m, one in zip(means, targets, strict=True)]
                    found.append({
                        **family, "policy": policy, "counted": counted, "interventions": [m.record() for m in means],
                        "off": float(np.mean(wrong)),
                    })  # fmt: skip
        return sorted(found, key=lambda reading: reading["off"])

    def _families(self) -> Iterator[tuple[dict[str, str], pd.DataFrame]]:
        """Yield groups of arms that differ only in the population, and their pools."""
        names = [name for name in ARM if name != "population"]
        for values, own in self.pools.groupby(names, observed=True, sort=False):
            yield dict(zip(names, _texts(values), strict=True)), own


def rows_of(frame: pd.DataFrame, wanted: Mapping[str, Any]) -> pd.DataFrame:
    """Return the rows that have the wanted values."""
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    return frame


def has_same_baseline(policy: str, one: Setting, other: Setting) -> bool:
    """Whether people act alike under a policy of `BASELINES` in two settings, with the same random numbers."""
    if policy == "none":
        return one.max_steps == other.max_steps
    if one.observation is not None:  # the robot notices mistakes by its belief, for which its model and prior matter
        return False
    return replace(one, **{name: getattr(other, name) for name in UNUSED_BY_REACTIVE}) == other


def _interventions(pools: pd.DataFrame, per_person: bool = False) -> Any:
    """Return the mean interventions of each repeat over populations and team sizes, as a series."""
    value = pools["interventions"] / (pools["humans"] if per_person else 1)
    return value.groupby(pools["repeat"]).mean()


def paired(pools: pd.DataFrame, measure: str, policy: str, against: str) -> tuple[Any, Any]:
    """Return a measure's mean in each pool under two policies, arrays of shape (n,) in the same order of pools."""
    means = pools.groupby(["policy", "repeat"], observed=True)[measure].mean()
    mine, other = means.loc[policy], means.loc[against]
    mine, other = mine.align(other, join="inner")
    return mine.to_numpy(), other.to_numpy()


def saving(pools: pd.DataFrame, measure: str, policy: str, against: str) -> IntervalEstimate:
    """Return the saving of a policy against another in percent, over all given pools."""
    mine, other = paired(pools, measure, policy, against)
    return statistics.saving(mine, other)


def _compared(mine: Any, other: Any) -> Iterator[dict[str, Any]]:
    estimate = statistics.saving(mine, other)
    if math.isfinite(estimate.value):  # undefined if the baseline is 0
        effect, better = finite(statistics.effect(other - mine)), float((mine < other).mean())
        yield {**estimate.record(), "effect": effect, "pools_better": better}


def average(pools: pd.DataFrame, measure: str, policy: str) -> IntervalEstimate:
    """Return the mean of a measure over pools."""
    return statistics.mean(pools[pools["policy"] == policy].groupby("repeat")[measure].mean().to_numpy())


def _described(values: Any, pools: Any) -> dict[str, float | int | None]:
    """Return statistics of a measure over episodes, and the interval of its mean over pools."""
    estimate = statistics.mean(pools)
    return {
        "mean": float(values.mean()), "sd": finite(values.std(ddof=1)) if len(values) > 1 else None, "n": len(values),
        "low": finite(estimate.low), "high": finite(estimate.high), "median": float(np.median(values)),
        "highest": float(values.max()),
    }  # fmt: skip


def _texts(key: Hashable) -> tuple[str, ...]:
    return tuple(str(part) for part in key) if isinstance(key, tuple) else (str(key),)


def _plain(key: Hashable) -> tuple[Any, ...]:
    assert isinstance(key, tuple)
    return tuple(part.item() if isinstance(part, np.generic) else part for part in key)
