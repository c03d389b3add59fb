"""Compiled search of a decision tree for the operators whose conditions hold in a packed state."""

from __future__ import annotations

from typing import NamedTuple

from ...states.packing import Ints, Words
from ...system.jit import njit


class DecisionTree(NamedTuple):
    """Tests that find the applicable operators, or rules, in depth-first order.

    A test holds in a packed state `s` where `s[word] & mask == value`. The first four arrays have an entry per test.
    """

    word: Ints
    mask: Words
    value: Words
    skip: Ints
    """Next test after a failed one: the first that is not below it."""
    first: Ints
    """Rows `first[t]:first[t + 1]` of `operator` apply if `t` and all tests above it hold."""
    operator: Ints
    """Operators, or rules, in the order of the tests."""
    most: int
    """Bound on the number of them, within one group, that apply in one state."""


@njit(nogil=True, error_model="numpy", inline="always")
def matching(tree, begin, end, state, found):
    """Write the operators that the tests `begin` to `end` find in a state to `found`; return their number."""
    # Unpacked once, since unpacking takes longer than use.
    words, mask, value, skip, first, operator = tree.word, tree.mask, tree.value, tree.skip, tree.first, tree.operator
    count = 0
    t = begin
    while t < end:
        if state[words[t]] & mask[t] == value[t]:
            for row in range(first[t], first[t + 1]):
                found[count] = operator[row]
                count += 1
            t += 1
        else:
            t = skip[t]
    return count


@njit(nogil=True, error_model="numpy", inline="always")
def sort_first(numbers, count):
    """Sort the first `count` numbers; there are few, so that insertion is fastest."""
    for i in range(1, count):
        number, at = numbers[i], i
        while at > 0 and numbers[at - 1] > number:
            numbers[at] = numbers[at - 1]
            at -= 1
        numbers[at] = number
