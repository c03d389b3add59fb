"""Compiled expansion of packed states.

It works for every task: any number of words, conditional effects and derived variables. Kernels process one block at a
time, so that limits are checked between calls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...states.packing import Ints, Words
from ...system.jit import njit


class DecisionTree(NamedTuple):
    """Tests that find the applicable operators or rules, in depth-first order as in `RankedOperators`.

    Attributes
    ----------
    word, skip : int64 arrays, shape (tests,)
    mask, value, shift, field : uint64 arrays, shape (tests,)
    jump : int64 array
    first : int64 array, shape (tests + 1,)
    operator : int64 array, shape (operators,)
        Operators, or rules, in the order of the tests.
    most : int
        Bound on the number of them, within one group, that apply in one state.
    """

    word: Ints
    mask: Words
    value: Words
    skip: Ints
    shift: Words
    field: Words
    jump: Ints
    first: Ints
    operator: Ints
    most: int


class Rules(NamedTuple):
    """Conditional effects of operators, or of stages of axioms.

    Attributes
    ----------
    trie : DecisionTree
        Finds the rules that apply.
    begin : int64 array, shape (n + 1,)
        Tests `begin[i]:begin[i + 1]` are those of the i-th operator, or of the i-th stage of axioms.
    writes : int64 array, shape (rules + 1,)
        Rows `writes[r]:writes[r + 1]` of the next three arrays are the writes of rule `r`: `s[word] & keep | value`.
    write_word : int64 array
    write_keep, write_value : uint64 arrays
    """

    trie: DecisionTree
    begin: Ints
    writes: Ints
    write_word: Ints
    write_keep: Words
    write_value: Words


class PackedOperators(NamedTuple):
    """The transition function of a task; operators are in the order of their actions.

    Attributes
    ----------
    trie : DecisionTree
    action : int64 array, shape (operators,)
    effects : Rules
        Effects of each operator.
    axioms : Rules
        Axioms in stages; the first sets all derived variables to their defaults.
    again : bool array, shape (stages,)
        Whether the axioms of a stage are cyclic, so that it is repeated until nothing changes.
    """

    trie: DecisionTree
    action: Ints
    effects: Rules
    axioms: Rules
    again: NDArray[np.bool_]


@njit(nogil=True, error_model="numpy")
def write(rules, rule, state):
    """Apply a rule to a state; return whether the state has changed."""
    changed = False
    for row in range(rules.writes[rule], rules.writes[rule + 1]):
        word = rules.write_word[row]
        after = state[word] & rules.write_keep[row] | rules.write_value[row]
        changed |= after != state[word]
        state[word] = after
    return changed


@njit(nogil=True, error_model="numpy")
def derive(axioms, again, states):
    """Set the derived variables of states, shape (n, words), stage by stage to the least fixed point."""
    trie = axioms.trie
    for stage in range(len(again)):
        for i in range(len(states)):
            state, changed = states[i], True
            while changed:
                changed = False
                t = axioms.begin[stage]
                while t < axioms.begin[stage + 1]:
                    word = state[trie.word[t]]
                    if word & trie.mask[t] == trie.value[t]:
                        for place in range(trie.first[t], trie.first[t + 1]):
                            changed |= write(axioms, trie.operator[place], state)
                        t += 1
                        continue
                    target = trie.skip[t]
                    if target < 0:
                        target = trie.jump[np.int64(word >> trie.shift[t] & trie.field[t]) - target - 1]
                    t = target
                changed &= again[stage]


@njit(nogil=True, error_model="numpy")
def applicable(book, state, operators):
    """Write the applicable operators in ascending order, the first of each action; return their number."""
    trie = book.trie
    count = 0
    t = np.int64(0)
    while t < len(trie.word):
        word = state[trie.word[t]]
        if word & trie.mask[t] == trie.value[t]:
            for place in range(trie.first[t], trie.first[t + 1]):
                operator = trie.operator[place]
                at = count
                while at > 0 and operators[at - 1] > operator:
                    operators[at] = operators[at - 1]
                    at -= 1
                operators[at] = operator
                count += 1
            t += 1
            continue
        target = trie.skip[t]
        if target < 0:
            target = trie.jump[np.int64(word >> trie.shift[t] & trie.field[t]) - target - 1]
        t = target
    kept = 0
    for place in range(count):
        if kept == 0 or book.action[operators[place]] != book.action[operators[kept - 1]]:
            operators[kept] = operators[place]
            kept += 1
    return kept


@njit(nogil=True, error_model="numpy")
def expand(book, states, start, counts, actions, after):
    """Write the successors of `states[start:]`, as far as they fit the output.

    `counts` receives the number of actions of each state. `actions` and `after`, shape (m, words), receive a row per
    action.

    Returns
    -------
    stop : int
        `states[start:stop]` has been expanded.
    filled : int
        Number of rows in use.
    """
    operators, due = np.empty(book.trie.most, dtype=np.int64), np.empty(book.effects.trie.most, dtype=np.int64)
    effects, tests = book.effects, book.effects.trie  # unpacked once, since unpacking takes longer than use
    begin, writes, write_word, keep, value = (
        effects.begin, effects.writes, effects.write_word, effects.write_keep, effects.write_value,
    )  # fmt: skip
    word, mask, wanted, skip, shift = tests.word, tests.mask, tests.value, tests.skip, tests.shift
    field, jump, first, rules = tests.field, tests.jump, tests.first, tests.operator
    filled, i = 0, start
    while i < len(states) and filled + book.trie.most <= len(actions):
        number = applicable(book, states[i], operators)
        counts[i - start] = number
        for place in range(number):
            operator = operators[place]
            target = after[filled]
            for w in range(len(target)):
                target[w] = states[i, w]
            count, t = 0, begin[operator]
            while t < begin[operator + 1]:
                found = states[i, word[t]]
                if found & mask[t] == wanted[t]:
                    for row in range(first[t], first[t + 1]):
                        at = count
                        while at > 0 and due[at - 1] > rules[row]:  # they apply in ascending order
                            due[at] = due[at - 1]
                            at -= 1
                        due[at] = rules[row]
                        count += 1
                    t += 1
                    continue
                after_it = skip[t]
                if after_it < 0:
                    after_it = jump[np.int64(found >> shift[t] & field[t]) - after_it - 1]
                t = after_it
            for at in range(count):
                for row in range(writes[due[at]], writes[due[at] + 1]):
                    target[write_word[row]] = target[write_word[row]] & keep[row] | value[row]
            actions[filled] = book.action[operator]
            filled += 1
        i += 1
    derive(book.axioms, book.again, after[:filled])
    return i, filled
