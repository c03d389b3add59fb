"""A robot whose behaviour tree (py-trees) does what the live assistant advises: python tree.py LINK.

LINK is the operator's. Driving is played. It ends when everybody has finished.
"""

from __future__ import annotations

import sys
import time

import py_trees

from assist.bridges.behaviour_tree import assistance
from assist.web.client import Client


class PlayedRobot:
    """A robot that needs a moment for each way."""

    def go(self, person: str) -> None:
        """Begin to go to a person."""
        print(f"going to {person}", flush=True)
        self.arrives = time.monotonic() + 0.05  # seconds

    def there(self) -> bool | None:
        """Return True when it has arrived."""
        return True if time.monotonic() >= self.arrives else None

    def stop(self) -> None:
        """Stop going."""
        print("stopping", flush=True)

    def say(self, person: str, suggestion: str) -> None:
        """Suggest an action to a person."""
        print(f"to {person}: {suggestion}", flush=True)


def main(link: str) -> None:
    """Serve people until all have finished."""
    client = Client(link)
    tree = py_trees.trees.BehaviourTree(assistance(client, PlayedRobot()))
    while not all(person["finished"] for person in client.team()["people"]):
        for _ in range(5):  # between two looks at the team
            tree.tick()
            time.sleep(0.02)
    tree.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
