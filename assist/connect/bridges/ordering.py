"""Messages put back into the order of their numbers, and acknowledged in the order of their arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

FAR = 50
"""Missing numbers before a number, above which it is a sender's mistake; messages are not delayed by so many others."""


class InOrder(Generic[T]):
    """Holds back items until all with lower numbers have arrived.

    Parameters
    ----------
    room : int
        Largest number of items that are held back; more tolerate longer delays and cost memory.

    Attributes
    ----------
    next : int
        Number that is released next.
    held : dict of int to item
    """

    def __init__(self, room: int = 1000) -> None:
        self.next, self.held, self._room = 1, dict[int, T](), room
        self._passed = deque[range](maxlen=room)
        self._far: int | None = None

    def take(self, number: int, item: T) -> list[T]:
        """Return the items that can be processed now, in order.

        An item with a number that was released before is returned at once: it is a repetition. An item is dropped if
        too many are held back; its sender has to repeat it.
        """
        if number < self.next:
            return [item]
        before = list[T]()
        if number - 1 == self._far and len(self.missing(number)) > FAR:
            self._passed.append(self.missing(number))
            before = self.resume(number)
        if len(self.held) < self._room or number == self.next:
            self.held.setdefault(number, item)
        return before + self._released()

    def missing(self, number: int) -> range:
        """Return the numbers that have to arrive before a number is released."""
        return range(self.next, max(self.next, number))

    def jumps(self, number: int) -> bool:
        """Return whether a number is too far ahead to wait for those before it, unless it follows the last such number.

        Then the sender goes on from there, and `take` passes over the numbers before.
        """
        if len(self.missing(number)) <= FAR or number - 1 == self._far:
            return False
        self._far = number
        return True

    def late(self, number: int) -> bool:
        """Return whether a number has been passed over."""
        return any(number in numbers for numbers in self._passed)

    def pass_over(self) -> list[T]:
        """Skip the missing numbers before the first item that is held back; return what can be processed then."""
        if self.held:
            first = min(self.held)
            self._passed.append(range(self.next, first))
            self.next = first
        return self._released()

    def resume(self, number: int) -> list[T]:
        """Continue at a number that is known from elsewhere, if it is higher; return what can be processed then."""
        self.next = max(self.next, number)
        before = [self.held.pop(one) for one in sorted(self.held) if one < self.next]
        return before + self._released()

    def _released(self) -> list[T]:
        found = []
        while self.next in self.held:
            found.append(self.held.pop(self.next))
            self.next += 1
        return found


class Acknowledgements:
    """Acknowledges messages in the order in which they arrived, as MQTT demands, whenever they are done with.

    Parameters
    ----------
    send : callable
        Sends the acknowledgement of a message, given its identifier and quality of service.
    """

    def __init__(self, send: Callable[[int, int], object]) -> None:
        self._send, self._arrived, self._done = send, deque[tuple[int, int, int]](), set[int]()
        self._count, self.closed = 0, False

    def expect(self, identifier: int, quality: int) -> Callable[[], None]:
        """Return a function to call when a message that has arrived is done with."""
        self._count += 1
        number = self._count
        self._arrived.append((number, identifier, quality))

        def done() -> None:
            self._done.add(number)
            while self._arrived and self._arrived[0][0] in self._done:
                first, *message = self._arrived.popleft()
                self._done.remove(first)
                if not self.closed:
                    self._send(*message)

        return done

    def close(self) -> None:
        """Send nothing any more: the connection is lost, and the broker will deliver again what is open."""
        self.closed = True
