"""Numbers of which only thresholds matter, and the values that are one for them.

Let a fluent f only grow (or be assigned), by amounts that do not read changing numbers, and let f be read only in
comparisons with static values. Let m be such that each of these comparisons has one truth value for all numbers of
[m, oo), or of (m, oo). Map each state to the one in which f is replaced by the class of its value, where all values of
that interval are one class. The map is a bisimulation: two states of one class satisfy the same conditions, since f
occurs only in comparisons, which agree within the interval; a growth by d >= 0 leads from the interval into itself, and
from equal values below it to equal values; an assignment does not read f. Costs do not read f. So the classes have the
same plans with the same costs as the states. Falling fluents are the mirror image.

Nothing is saturated that also moves the other way, or that another effect, a cost or a duration reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

from .conditions import COMPLEMENT, free_variables, variables_of
from .durative import key
from .formulas import listed, word
from .instances import Expression
from .numeric_expressions import Number, linear, terms_of, whole
from .numeric_schemas import Costed
from .static_facts import Statics, literal_number
from .value_sets import Fluent, GroundChange, Saturation, Value

MIRRORED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "==", "!=": "!="}


@dataclass(frozen=True)
class Read:
    """A comparison with the types of all variables in scope, and the conditions under which it matters."""

    comparison: Expression
    kinds: Mapping[str, str]
    conditions: tuple[Expression, ...] = ()


def reads(condition: Expression, kinds: Mapping[str, str], conditions: tuple[Expression, ...] = ()) -> Iterator[Read]:
    """Yield the comparisons within a condition."""
    head, parts = condition.head, condition.parts[1:]
    if head in COMPLEMENT:
        yield Read(condition, kinds, conditions)
    elif head in ("and", "or", "failed"):
        for part in parts:
            yield from reads(part, kinds, conditions)
    elif head in ("forall", "exists"):
        yield from reads(parts[1], {**kinds, **variables_of(parts[0])}, conditions)


def saturations(
    statics: Statics,
    kept: Iterable[str],
    costed: Iterable[Costed],
    compared: Iterable[Read],
    changes: Iterable[GroundChange],
    initial: Mapping[Fluent, Value],
) -> dict[Fluent, Saturation]:
    """Return the fluents that saturate.

    `compared` are all comparisons of the instance, `changes` all changes with objects for their variables.
    """
    ways: dict[str, set[bool]] = {name: set() for name in kept}  # whether amounts are positive
    excluded: set[str] = set()
    fluents: dict[str, set[Fluent]] = {name: set() for name in kept}
    for fluent in initial:
        fluents[fluent[0]].add(fluent)
    for change in changes:
        fluents[change.fluent[0]].add(change.fluent)
        if not change.grows:
            continue
        amount = literal_number(change.amount)
        if amount is None:
            excluded.add(change.fluent[0])
        elif amount:
            ways[change.fluent[0]].add(amount > 0)
    for each in costed:
        expressions = [change.amount for change in each.schema.changes]
        expressions += [each.cost, *([each.schema.duration] if each.schema.duration is not None else [])]
        excluded.update(term.head for expression in expressions for term in terms_of(expression))
    cuts: dict[str, list[tuple[Read, Expression, str, Expression, Number]]] = {name: [] for name in kept}
    for read in compared:
        head, (left, right) = read.comparison.head, read.comparison.parts[1:]
        split = linear(listed(word("-"), left, right), statics.is_static)
        names = [term.head for side in (left, right) for term in terms_of(side) if term.head not in statics.values]
        if split is None or len(split[0]) != 1:
            excluded.update(names)
            continue
        ((term, factor),) = split[0].values()
        if not factor:
            continue
        cuts[term.head].append((read, term, head if factor > 0 else MIRRORED[head], split[1], factor))
    found: dict[Fluent, Saturation] = {}
    for name, found_ways in ways.items():
        if name not in excluded and len(found_ways) == 1:
            above = found_ways == {True}
            limits = _limits(statics, cuts[name], fluents[name], above)
            for fluent in fluents[name]:
                begin = initial.get(fluent)
                found[fluent] = limits.get(fluent) or Saturation(above, 0 if begin is None else begin, True)
    return found


def _limits(
    statics: Statics,
    cuts: Iterable[tuple[Read, Expression, str, Expression, Number]],
    fluents: Iterable[Fluent],
    above: bool,
) -> dict[Fluent, Saturation]:
    """Return the interval of each fluent on which all comparisons are constant."""
    best: dict[Fluent, tuple[Number, int]] = {}
    sign = 1 if above else -1
    for read, term, head, rest, factor in cuts:
        closed = head in ((">=", "<") if above else ("<=", ">"))
        variables = {
            name: read.kinds[name] for name in dict.fromkeys([*free_variables(term), *free_variables(rest)])
        }  # fmt: skip
        for row in statics.bindings(variables, read.conditions, terms_of(rest)):
            bound = dict(zip(variables, row, strict=True))
            fluent = tuple(bound.get(each, each) for each in key(term))
            try:
                threshold = whole(Fraction(-statics.value(rest, bound)) / factor)
            except ArithmeticError:
                continue
            cut = (sign * threshold, 0 if closed else 1)
            best[fluent] = max(best.get(fluent, cut), cut)
    return {
        fluent: Saturation(above, sign * cut, not is_open) for fluent, (cut, is_open) in best.items()
        if fluent in set(fluents)
    }  # fmt: skip
