"""One measurement of `bench/pairs.py`: decisions of a live team of two, one after each action.

    python bench/peers/decisions.py TASK [DECISIONS]

The result is one line of JSON on standard output: processor time in seconds, and the number of states whose cost-to-go
was looked up. Setting up the team is not included.
"""

from __future__ import annotations

import json
import random
import sys
import time
from typing import Any

from assist.live import Assistant
from planner import CostToGo, cost_to_go, find_instances, load


def counted(known: CostToGo) -> list[int]:
    """Return a list whose only number is that of the states which have been looked up since."""
    count, lookup = [0], type(known).lookup

    def counting(self: Any, states: Any, *more: Any) -> Any:
        found = lookup(self, states, *more)
        count[0] += len(found)
        return found

    type(known).lookup = counting  # type: ignore[method-assign]
    return count


def main(name: str, decisions: int = 200) -> None:
    """Measure, and print the result."""
    (instance,) = find_instances([name])
    known = cost_to_go(load(instance))
    team, rng = Assistant(known, ["ann", "bob"]), random.Random(1)
    team.recommend()
    count, begun = counted(known), time.process_time()
    for number in range(decisions):
        person = team.person(team.people[number % 2])
        if person.finished:
            team.begin(person.person)
            person = team.person(person.person)
        followed = person.suggestion is not None and rng.random() < 0.5
        team.observe(person.person, person.suggestion if followed else rng.choice(person.applicable))
        team.recommend()
    print(json.dumps({"seconds": time.process_time() - begun, "count": count[0]}))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
