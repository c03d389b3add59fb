"""A camera above a bench sees what somebody does, and reports it: python vision.py LINK PERSON.

LINK is the operator's. Here the camera is played: it sees a person who does what is suggested to them, and otherwise
anything that they can do.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Iterator

from assist.declare import Refusal
from assist.web.client import Client


def camera(service: Client, person: str) -> Iterator[str]:
    """See one action after the other, until the task is done; a real camera looks at the bench instead."""
    chance = random.Random(0)
    while not service.see(person)["finished"]:
        time.sleep(0.5)  # a person takes time to act, and meanwhile a robot may arrive
        seen = service.see(person)
        if seen["cost_to_go"] is None:
            return  # the task cannot be completed any more
        yield seen["suggestion"] or chance.choice(seen["applicable"])


def main(link: str, person: str) -> None:
    """Report what is seen."""
    service = Client(link)
    for action in camera(service, person):
        try:
            seen = service.observe(person, action)
        except Refusal as error:  # it has seen something that cannot have been
            print(f"{error.status}: {error}", file=sys.stderr)
            continue
        cost = seen["cost_to_go"]
        print(f"{person} {action}, {'a dead end' if cost is None else f'remaining cost {cost:g}'}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
