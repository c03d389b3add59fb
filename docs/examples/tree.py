"""A robot whose behaviour tree (`pip install py-trees`) does what the live assistant advises: python tree.py LINK.

LINK is the operator's. Driving is played. It ends when everybody has finished.
"""

import sys
import time
from concurrent.futures import ThreadPoolExecutor

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence
from py_trees.trees import BehaviourTree

from assist.declare import Refusal
from assist.web.client import Client

errand = {}  # whom to go to, whether the robot is there, and what to suggest


class Request(Behaviour):
    """Ask the service for the errand, in a thread, so that no tick waits; fail if there is nothing to do."""

    def __init__(self, name, ask):
        super().__init__(name)
        self.ask, self.thread = ask, ThreadPoolExecutor(1)

    def initialise(self):
        """Send the request."""
        self.answer = self.thread.submit(self.ask)

    def update(self):
        """Return RUNNING until the answer is there."""
        if not self.answer.done():
            return Status.RUNNING
        try:
            errand.update(self.answer.result())
        except (Refusal, OSError) as error:
            print(error, flush=True)
            return Status.FAILURE
        return Status.FAILURE if errand["person"] is None else Status.SUCCESS


class Go(Behaviour):
    """Go to the person of the errand."""

    def initialise(self):
        """Begin to drive."""
        self.arrives = time.monotonic() + 0.05 * (not errand["arrived"])  # seconds
        if not errand["arrived"]:
            print(f"going to {errand['person']}", flush=True)

    def update(self):
        """Return RUNNING under way."""
        return Status.SUCCESS if time.monotonic() >= self.arrives else Status.RUNNING


class Say(Behaviour):
    """Make the suggestion of the errand, once."""

    said = None

    def update(self):
        """Suggest."""
        suggestion = errand["person"], errand["suggestion"], errand["reason"]  # which counts the answers
        if errand["suggestion"] is not None and suggestion != self.said:
            self.said = suggestion
            print(f"to {errand['person']}: {errand['suggestion']}", flush=True)
        return Status.SUCCESS


def main(link):
    """Serve people until all have finished."""
    client = Client(link)
    report = Request("report", lambda: errand if errand["arrived"] else client.arrived(errand["person"]))
    leaves = [Request("advice", client.robot), Go("go"), report, Say("say")]
    tree = BehaviourTree(Sequence("assist", memory=True, children=leaves))
    while not all(person["finished"] for person in client.team()["people"]):
        for _ in range(5):  # between two looks at the team
            tree.tick()
            time.sleep(0.02)


if __name__ == "__main__":
    main(*sys.argv[1:])
