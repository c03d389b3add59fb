"""What people saw of suggestions to their neighbours, from the log of a team, and the rules by which it moved them.

Who were a team, and who acted when, follows from columns of the log. With `order`, all of the log is of one team, whose
events it numbers, as the log of a live team has it; `since` is the number when the person came. Without it people who
have the same episode are a team, and count its steps together, as in the trace of a simulation. Whoever acts has seen
the suggestions to neighbours before. The gain of a neighbour's step is the fall of the cost-to-go.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..declare.declared import is_declared
from ..people.decision import NOTHING
from ..people.neighbourhood import Neighbourhood
from ..people.neighbours import SEEN_RULES, Neighbours, SeenNothing, WithSeen, seen_rule_of
from ..people.sights import Acting, sights_of
from ..people.trust_rules import TrustRule
from .evidence import Evidence, observations_of
from .log import Entry
from .method import Method
from .observations import Ints, Observations
from .rule_families import RuleFamily, name_of

BEFORE_ALL = -(2**63)
"""Number before that of every action: a person is there from the beginning."""


def with_neighbours(people: Evidence | Sequence[Observations], neighbours: Neighbours | None) -> Sequence[Observations]:
    """Return each person's observations, with what they saw of neighbours, whatever the rule is.

    Their places are those in the log or, if it has none, follow from the order of their names. What this function
    returned is returned as it is. Observations in which nothing was seen, as those of `observed` are, are refused.
    """
    each = observations_of(people)
    if neighbours is None:
        return each
    if not isinstance(people, Evidence):
        if not any(len(o.seen.before) for o in each):
            raise ValueError("neighbours: expected replayed(task, log), as observations do not say who saw what")
        return each
    places = _places(people, each)
    graph = Neighbourhood(neighbours.rule, neighbours.weights(1 + max(places.values(), default=0)))
    if not graph.watched.any():
        return each
    if people.goals:
        raise ValueError("neighbours: expected a log whose goal is known")
    entries, recording = {(*one.names, one.step): one for one in people.log.entries}, people.recording
    steps = [recording.step[recording.person == number] for number in range(len(each))]
    acts = [_acts(o, step, entries, places) for o, step in zip(each, steps, strict=True)]
    return [replace(o, seen=seen) for o, seen in zip(each, sights_of(acts, graph), strict=True)]


def seen_families(own: TrustRule | RuleFamily, neighbours: Neighbours | None = None) -> dict[str, RuleFamily]:
    """Return the rules by which theta moves by what is seen of neighbours, by name, beside a rule of one's own.

    "none" is the person's own rule alone. The rule of `neighbours` is one of them, also if it is the user's own.
    """
    mine, seen = _family(own), _seen(neighbours)
    return {"none": mine} | {name: _joined(mine, name, one) for name, one in seen.items()}


def rule_beside(own: TrustRule | RuleFamily, method: Method) -> RuleFamily:
    """Return the family of a rule of one's own, beside which theta moves by what is known beforehand of neighbours."""
    seen: Any = seen_rule_of(method.neighbours)
    name = seen.tag["rule"] if is_declared(type(seen)) else name_of(seen)
    mine = _family(own)
    return mine if name == "none" else _joined(mine, name, _seen(method.neighbours)[name])


def _family(own: TrustRule | RuleFamily) -> RuleFamily:
    return own if isinstance(own, RuleFamily) else RuleFamily.of(own)


def _seen(neighbours: Neighbours | None) -> dict[str, RuleFamily]:
    """Return the rules by which theta moves by what is seen alone, by name, but not "none"."""
    each = {name: RuleFamily.made_by(make) for name, make in SEEN_RULES.items() if make is not SeenNothing}
    if not is_declared(type(given := seen_rule_of(neighbours))):
        each[name_of(given)] = RuleFamily.of(given)
    return each


def _joined(own: RuleFamily, name: str, seen: RuleFamily) -> RuleFamily:
    return own.joined(seen, WithSeen, f", neighbours {name}")


def _places(evidence: Evidence, people: Iterable[Observations]) -> Mapping[tuple[str, str], int]:
    """Return the place of each person in each episode."""
    given = {one.names: one.place for one in evidence.log.entries if one.place is not None}
    if min(given.values(), default=0) < 0:
        raise ValueError(f"place {min(given.values())}: expected a number from 0")
    if given:
        return given
    of_team: dict[str, list[str]] = {}
    for o in people:
        for name in o.episodes:
            of_team.setdefault(name, []).append(o.person)
    return {(person, name): k for name, those in of_team.items() for k, person in enumerate(those)}


def _acts(
    o: Observations, step: Ints, entries: Mapping[tuple[str, str, int], Entry], places: Mapping[tuple[str, str], int]
) -> Acting:
    """Return when a person acted, whose choices have these steps."""
    episode = np.array(o.episodes)[o.begins.cumsum() - 1].tolist() if len(o) else []
    rows = [entries[o.person, name, at] for name, at in zip(episode, step.tolist(), strict=True)]
    try:
        place = [places[one.names] for one in rows]
    except KeyError as error:
        raise ValueError(f"place: expected one of {error.args[0]}, as others have one") from None
    return Acting(
        ["" if one.order is not None else one.episode for one in rows],
        np.array([one.step if one.order is None else one.order for one in rows], dtype=np.int64),
        np.array([BEFORE_ALL if one.since is None else one.since for one in rows], dtype=np.int64),
        place, o.begins.cumsum() - 1, np.flatnonzero(o.suggested != NOTHING),
        o.cost_to_go - o.ahead[np.arange(len(o)), o.chosen], o.chosen == o.suggested,
    )  # fmt: skip
