"""Compiled expansion of packed states, with a decision tree for the operators whose conditions hold.

It works for every task: any number of words, conditional effects and derived variables. Kernels process one block at a
time, so that limits are checked between calls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...system.arrays import Ints, Words
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


@njit(nogil=True, error_model="numpy", inline="always", inner=True)
def sort_first(numbers, count):
    """Sort the first `count` numbers; there are few, so that insertion is fastest."""
    for i in range(1, count):
        number, at = numbers[i], i
        while at > 0 and numbers[at - 1] > number:
            numbers[at] = numbers[at - 1]
            at -= 1
        numbers[at] = number


class Rules(NamedTuple):
    """Conditional effects of operators, or of stages of axioms.

    A write sets `s[word] = s[word] & keep | value` in the packed state `s`.
    """

    tree: DecisionTree
    """Finds the rules that apply."""
    begin: Ints
    """Tests `begin[i]:begin[i + 1]` are those of the i-th operator, or of the i-th stage of axioms."""
    writes: Ints
    """Rows `writes[r]:writes[r + 1]` of the next three arrays are the writes of rule `r`."""
    word: Ints
    keep: Words
    """The bits of the word that stay."""
    value: Words
    """The bits of the word that are set."""


class PackedOperators(NamedTuple):
    """The transition function of a task; operators are in the order of their actions."""

    tree: DecisionTree
    action: Ints
    """Action of each operator."""
    effects: Rules
    """Effects of each operator."""
    axioms: Rules
    """Axioms in stages; the first sets all derived variables to their defaults."""
    again: NDArray[np.bool_]
    """Whether the axioms of each stage are cyclic, so that it is repeated until nothing changes."""


@njit(nogil=True, error_model="numpy", inline="always", inner=True)
def apply_rules(rules, group, before, after, found):
    """Apply the rules of a group whose conditions hold in `before`, in order, to `after`; return whether it changed."""
    changed = False
    writes, words, keep, value = rules.writes, rules.word, rules.keep, rules.value
    count = matching(rules.tree, rules.begin[group], rules.begin[group + 1], before, found)
    sort_first(found, count)
    for place in range(count):
        for row in range(writes[found[place]], writes[found[place] + 1]):
            word = words[row]
            own = after[word] & keep[row] | value[row]
            changed |= own != after[word]
            after[word] = own
    return changed


@njit(nogil=True, error_model="numpy")
def derive(axioms, again, states):
    """Set the derived variables of states, shape (n, words), stage by stage to the least fixed point."""
    found = np.empty(axioms.tree.most, dtype=np.int64)
    for stage in range(len(again)):
        for i in range(len(states)):
            while apply_rules(axioms, stage, states[i], states[i], found) and again[stage]:
                pass


@njit(nogil=True, error_model="numpy", inline="always")
def applicable(operators, state, found):
    """Write the applicable operators in ascending order, the first of each action, to `found`; return their number."""
    count = matching(operators.tree, 0, len(operators.tree.word), state, found)
    sort_first(found, count)
    kept = 0
    for place in range(count):
        if kept == 0 or operators.action[found[place]] != operators.action[found[kept - 1]]:
            found[kept] = found[place]
            kept += 1
    return kept


@njit(nogil=True, error_model="numpy")
def expand(operators, states, start, counts, actions, after):
    """Write the successors of `states[start:]`, as far as they fit the output.

    `counts` receives the number of actions of each state. `actions` and `after`, shape (m, words), receive a row per
    action. Return `stop`, such that `states[start:stop]` has been expanded, and the number of rows in use.
    """
    most = operators.tree.most
    found, effects = np.empty(most, dtype=np.int64), np.empty(operators.effects.tree.most, dtype=np.int64)
    filled, i = 0, start
    while i < len(states) and filled + most <= len(actions):
        number = applicable(operators, states[i], found)
        counts[i - start] = number
        for place in range(number):
            for w in range(states.shape[1]):
                after[filled, w] = states[i, w]
            apply_rules(operators.effects, found[place], states[i], after[filled], effects)
            actions[filled] = operators.action[found[place]]
            filled += 1
        i += 1
    derive(operators.axioms, operators.again, after[:filled])
    return i, filled
