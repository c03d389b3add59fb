"""Messages put back into the order of their numbers."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class InOrder(Generic[T]):
    """Holds back items until all with lower numbers have arrived.

    Parameters
    ----------
    first : int
        The lowest number that has not been released.
    room : int
        Largest number of items that are held back; more tolerate longer delays and cost memory.

    Attributes
    ----------
    next : int
        Number that is released next.
    held : dict of int to item
    """

    def __init__(self, first: int = 1, room: int = 1000) -> None:
        self.next, self.held, self._room = first, dict[int, T](), room
        self._passed = deque[range](maxlen=room)

    def take(self, number: int, item: T) -> list[T]:
        """Return the items that can be processed now, in order.

        An item with a number that was released before is returned at once: it is a repetition. An item is dropped if
        too many are held back; its sender has to repeat it.
        """
        if number < self.next:
            return [item]
        if len(self.held) < self._room or number == self.next:
            self.held.setdefault(number, item)
        return self._released()

    def late(self, number: int) -> bool:
        """Return whether a number has been passed over."""
        return any(number in numbers for numbers in self._passed)

    def pass_over(self) -> list[T]:
        """Give up the missing numbers before the first item that is held back; return what can be processed then."""
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
