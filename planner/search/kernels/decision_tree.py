"""Compiled search of a decision tree for the operators whose conditions hold in a packed state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...states.packing import Ints, Words
from ...system.jit import njit


class DecisionTree(NamedTuple):
    """Tests that find the applicable operators, or rules, in depth-first order.

    A test holds in a packed state `s` where `s[word] & mask == value`. The arrays up to `field` have an entry per test.
    """

    word: Ints
    mask: Words
    value: Words
    skip: Ints
    """Next test after a failed one: the first that is not below it. A negative entry denotes a *switch*, a test that
    never holds; the next test is then `jump[(s[word] >> shift & field) - skip - 1]`.
    """
    shift: Words
    field: Words
    jump: Ints
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
    words, mask, value, skip, shift, field = tree.word, tree.mask, tree.value, tree.skip, tree.shift, tree.field
    jump, first, operator = tree.jump, tree.first, tree.operator
    count = 0
    t = begin
    while t < end:
        word = state[words[t]]
        if word & mask[t] == value[t]:
            for row in range(first[t], first[t + 1]):
                found[count] = operator[row]
                count += 1
            t += 1
            continue
        target = skip[t]
        if target < 0:
            target = jump[np.int64(word >> shift[t] & field[t]) - target - 1]
        t = target
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
