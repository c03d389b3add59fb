"""Leaves of a behaviour tree (py_trees) for a robot that assists: what to do, go there, report it, and suggest.

    tree = py_trees.trees.BehaviourTree(assistance(Client(operator_link), robot))
    tree.tick_tock(period_ms=200)

The leaves share the service's instruction as `errand` on the blackboard. Requests run in a thread, so that a tick never
waits for the network: a leaf is RUNNING until its answer arrives. It fails if the service refuses or cannot be reached.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

from planner.system.errors import MissingExtraError

from ..web.client import Client, RefusedError

try:
    from py_trees.behaviour import Behaviour
    from py_trees.common import Access, Status
    from py_trees.composites import Sequence
except ImportError:
    raise MissingExtraError("a behaviour tree needs", "py_trees", "py-trees") from None

NAMESPACE = "assistance"
"""Namespace of the blackboard; trees of several robots in one process need one each."""


class Robot(Protocol):
    """The functions of a robot that the leaves call. No method may wait."""

    def go(self, person: str) -> None:
        """Begin to go to a person."""

    def there(self) -> bool | None:
        """Return True if the robot has arrived, False if it cannot arrive, None while it is under way."""

    def stop(self) -> None:
        """Stop going."""

    def say(self, person: str, suggestion: str) -> None:
        """Suggest an action to a person."""


class _Leaf(Behaviour):
    """A leaf with access to the errand: the service's instruction of whom to go to and what to suggest."""

    def __init__(self, name: str, namespace: str) -> None:
        super().__init__(name)
        self._board = self.attach_blackboard_client(namespace=namespace)
        self._board.register_key("errand", Access.WRITE)

    @property
    def errand(self) -> dict[str, Any]:
        """The service's last instruction; empty before the first."""
        found: dict[str, Any] = self._board.errand if self._board.exists("errand") else {}
        return found


class _Request(_Leaf):
    """A leaf that asks the service for the errand, in a thread of its own."""

    usual_name: str

    def __init__(
        self, client: Client, name: str | None = None, namespace: str = NAMESPACE, number: int = 1
    ) -> None:  # fmt: skip
        super().__init__(name or self.usual_name, namespace)
        self._client, self._number = client, number
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=self.name)
        self._answer: Future[dict[str, Any]] | None = None

    def _asks(self) -> Callable[[], dict[str, Any]] | None:
        """Return the request; None if none is necessary."""
        raise NotImplementedError

    def initialise(self) -> None:
        """Send the request."""
        request = self._asks()
        self._answer = None if request is None else self._thread.submit(request)

    def update(self) -> Status:
        """Return RUNNING until the answer has arrived."""
        if self._answer is None:
            return Status.SUCCESS
        if not self._answer.done():
            return Status.RUNNING
        try:
            self._board.errand = self._answer.result()
        except (RefusedError, OSError) as error:
            self.feedback_message = str(error)
            return Status.FAILURE
        return Status.SUCCESS

    def shutdown(self) -> None:
        """End the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)


class GetAdvice(_Request):
    """Asks the service for the robot's errand; fails if there is none.

    Parameters
    ----------
    client : Client
        With the operator's link.
    name, namespace : str
    number : int
        Number of the robot, from 1.
    """

    usual_name = "get advice"

    def _asks(self) -> Callable[[], dict[str, Any]]:
        return lambda: self._client.robot(self._number)

    def update(self) -> Status:
        """Return FAILURE if there is no errand."""
        status = super().update()
        if status is Status.SUCCESS and self.errand["person"] is None:
            self.feedback_message = "nothing to do"
            return Status.FAILURE
        return status


class GoTo(_Leaf):
    """Sends the robot to the person of the errand; succeeds at once if the robot is there.

    Parameters
    ----------
    robot : Robot
    name, namespace : str
    """

    def __init__(self, robot: Robot, name: str = "go to", namespace: str = NAMESPACE) -> None:
        super().__init__(name, namespace)
        self._robot = robot

    def initialise(self) -> None:
        """Begin to go."""
        if not self.errand["arrived"]:
            self.feedback_message = f"to {self.errand['person']}"
            self._robot.go(self.errand["person"])

    def update(self) -> Status:
        """Return RUNNING while the robot is under way."""
        there = self.errand["arrived"] or self._robot.there()
        if there is None:
            return Status.RUNNING
        return Status.SUCCESS if there else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        """Stop the robot if the tree does something else before it has arrived.

        Parameters
        ----------
        new_status : Status
            INVALID if the tree interrupts the leaf.
        """
        if self.status is Status.RUNNING and new_status is Status.INVALID:
            self._robot.stop()


class ReportArrival(_Request):
    """Reports that the robot is at the person of the errand, which may change the errand.

    Parameters
    ----------
    client : Client
        With the operator's link.
    name, namespace : str
    number : int
        Number of the robot, from 1.
    """

    usual_name = "report arrival"

    def _asks(self) -> Callable[[], dict[str, Any]] | None:
        person = self.errand["person"]
        return None if self.errand["arrived"] else lambda: self._client.arrived(person, self._number)


class Suggest(_Leaf):
    """Makes the suggestion of the errand, once; fails if there is none, or if the robot has to go elsewhere first.

    Parameters
    ----------
    robot : Robot
    name, namespace : str
    """

    def __init__(self, robot: Robot, name: str = "suggest", namespace: str = NAMESPACE) -> None:
        super().__init__(name, namespace)
        self._robot = robot
        self._said: Any = None

    def update(self) -> Status:
        """Make the suggestion, unless it has been made; fail if there is none yet."""
        errand = self.errand
        if errand["suggestion"] is None or not errand["arrived"]:
            self.feedback_message = "no suggestion"
            return Status.FAILURE
        # The reason has counts of the person's answers, so that the same suggestion later is another one.
        said = errand["person"], errand["suggestion"], errand["reason"]
        if said != self._said:
            self._said, self.feedback_message = said, errand["suggestion"]
            self._robot.say(errand["person"], errand["suggestion"])
        return Status.SUCCESS


def assistance(client: Client, robot: Robot, namespace: str = NAMESPACE, number: int = 1) -> Behaviour:
    """Return the tree of a robot that does what the service advises, one errand in each round.

    Parameters
    ----------
    client : Client
        With the operator's link.
    robot : Robot
    namespace : str
        Namespace of the blackboard; trees of several robots in one process need one each.
    number : int
        Number of the robot, from 1.
    """
    leaves: list[Behaviour] = [
        GetAdvice(client, namespace=namespace, number=number), GoTo(robot, namespace=namespace),
        ReportArrival(client, namespace=namespace, number=number), Suggest(robot, namespace=namespace),
    ]  # fmt: skip
    return Sequence("assist", memory=True, children=leaves)
