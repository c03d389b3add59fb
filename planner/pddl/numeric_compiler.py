"""The compiler of numbers and durations: from the reading of an instance to a classical one.

Each step is a module: actions in parts and without times (`durative`), with what is kept of their numbers and with
costs (`numeric_schemas`), the values of each number (`value_sets`, `value_ranges`), and their encoding as facts
(`numeric_encoding`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import prod

from ..system.errors import UnsuitedError
from . import numeric_encoding, numeric_schemas
from .compilation import MOST_VALUES, Compilation
from .declarations import OBJECT, Symbol, Typed, Types, refuse
from .durative import timed_schemas
from .expressions import (
    COMPLEMENT,
    FALSE,
    TRUE,
    Number,
    as_shown,
    conjuncts,
    free_variables,
    listed,
    normal_form,
    terms_of,
    word,
)
from .formulas import LARGEST_COST, TIMES, Cost
from .instances import Expression
from .numeric_encoding import EncodedAction
from .numeric_schemas import Preparation, metric_of, unit_of
from .reader import Action, Domain, DurativeAction, Problem, Reading, Rule
from .static_facts import Statics
from .value_ranges import Bounds, Proofs
from .value_scope import Encoder, Scope, relation_symbols, value_symbol
from .value_sets import GroundChange, Read, Trial, ValueSets, ground_changes, initial_values, reads, saturations

MOST_GROUNDED = 10_000_000
"""Rows of static relations, and ways to satisfy conditions of actions, that the translator grounds in minutes."""
MOST_ROWS = 10_000
"""Combinations of objects up to which forgotten values are searched for."""


class Compiler:
    """The compilation of one instance, for which values of numbers without a proven bound may be tried.

    A fluent may have `most_values` values. What is independent of the values is done once. What cannot be compiled
    raises a `PDDLError`, which says why.
    """

    def __init__(self, reading: Reading, most_values: int = MOST_VALUES) -> None:
        self.reading = reading
        self.file = reading.instance.domain
        self.objects = reading.objects
        timed = timed_schemas(reading)
        goal = normal_form(reading.problem.goal, self.objects)
        rules = [(rule, normal_form(rule.condition, self.objects)) for rule in reading.domain.rules]
        self._required = {
            each.name: [part for _, condition in each.conditions for part in conjuncts(condition)] for each in timed
        }
        changing = numeric_schemas.changing(timed)
        self.metric = metric_of(reading, changing)
        self.roles = numeric_schemas.roles(timed, goal, (condition for _, condition in rules), self.metric)
        changed_facts = frozenset(each.atom.head for schema in timed for _, _, each in schema.literals)
        self.statics = Statics(
            reading,
            reading.domain.predicates.keys() - changed_facts - {rule.head.name for rule, _ in rules},
            ({*reading.domain.functions, "total-cost"}) - changing,
        )
        self._add_weights()
        try:
            self.goal = self.statics.simplified(self.statics.expanded(goal), {})
            self.rules = [(rule, self.statics.expanded(condition)) for rule, condition in rules]
        except UnsuitedError:
            refuse(reading.instance.problem, None, "the goal compares too many numbers within (forall ...); expected "
                   "fewer objects")  # fmt: skip
        preparation = Preparation(reading, self.statics, self.roles, self.metric, _dependencies(rules))
        self.costed = [each for schema in timed for each in preparation.prepared(schema)]
        self.bounds = self._bounds(most_values)

    def compilation(self, trial: Trial | None = None, most_grounded: int = MOST_GROUNDED) -> Compilation:
        """Return the compilation.

        Where a function has no proven bound, or too many values, this raises an `UnprovenError`, unless there is a
        `trial`. Static relations and ways to satisfy conditions may be `most_grounded` together.
        """
        encoder = self._encoder(self.bounds.sets(trial))
        actions = []
        for each in self.costed:
            try:
                action = numeric_encoding.encoded(encoder, each, self._kinds(each.schema.parameters))
            except UnsuitedError:
                refuse(self.file, each.schema.place, f"action '{each.schema.name}' has too many combinations "
                       "of objects in its numbers; expected fewer objects, or fewer in one expression")  # fmt: skip
            if action is not None:
                actions.append(action)
        return self._assembled(encoder, actions, most_grounded)

    def _forgotten(self) -> Iterator[str]:
        """Yield a sentence on each static function that most objects have a value of, but not all that an action takes.

        The action is never applicable to the others. Objects that an action takes twice do not count, such as a way
        from a place to itself. Functions of one object are left out: that an object has no value is often meant.
        """
        found: dict[str, tuple[set[tuple[str, ...]], set[tuple[str, ...]], dict[str, None]]] = {}
        for each in self.reading.domain.entries:
            if isinstance(each, Rule) or each.name not in self._required:
                continue
            formulas = (each.precondition, each.effect) if isinstance(each, Action) else (
                each.duration, each.condition, each.effect)  # fmt: skip
            kinds = self._kinds(each.parameters)
            for term in dict.fromkeys(part for formula in formulas for part in formula.walk()):
                names = [part.word for part in term.parts[1:]]
                if term.head not in self.statics.values or len(names) < 2 or not kinds.keys() >= set(names):
                    continue
                given = self.statics.values[term.head]
                rows = self._taken(names, kinds, self._required[each.name])
                without, have, readers = found.setdefault(term.head, (set(), set(), {}))
                have |= rows & given.keys()
                if lacking := rows - given.keys():
                    without |= lacking
                    readers[each.name] = None
        for name, (without, have, readers) in found.items():
            if without and len(without) < len(have):
                first = f"({' '.join((name, *min(without)))})"
                verb = "is" if len(readers) == 1 else "are"
                others = f", as {len(without) - 1} more" if len(without) > 1 else ""
                yield f"{first} has no value{others}, so that {' and '.join(readers)} {verb} not applicable there"

    def _taken(
        self, names: list[str], kinds: Mapping[str, str], conditions: Iterable[Expression]
    ) -> set[tuple[str, ...]]:
        """Return the different objects for variables that the static facts of conditions on them admit."""
        own = list(dict.fromkeys(names))
        each = [self.statics.of_kind(kinds[name]) for name in own]
        if prod(map(len, each)) > MOST_ROWS:
            return set()
        facts = [
            part for part in conditions
            if part.head in self.statics.facts and free_variables(part).keys() <= set(own)
        ]  # fmt: skip
        found = set()
        for row in product(*each):
            bound = dict(zip(own, row, strict=True))
            if len(set(row)) == len(row) and all(self.statics.simplified(part, bound) == TRUE for part in facts):
                found.add(tuple(bound[name] for name in names))
        return found

    def _add_weights(self) -> None:
        """Add a static function with the weight of each fluent of the metric."""
        statics = self.statics
        for name in self.metric.functions:
            table = {words[1:]: weight for words, weight in self.metric.weights.items() if words[0] == name}
            symbol = self.reading.domain.functions.get(name)
            if symbol is None or () in table:
                continue
            kinds = {f"?{n}": self._kind(each.kinds) for n, each in enumerate(symbol.parameters)}
            every: dict[tuple[str, ...], Number] = {tuple(row.values()): 0 for row in statics.bindings(kinds, ())}
            statics.values[f"weight of {name}"] = {**every, **table}

    def _kind(self, kinds: tuple[str, ...]) -> str:
        kept = self.reading.domain.types.reduced(kinds)
        return kept[0] if len(kept) == 1 else self.reading.unions[kept]

    def _kinds(self, variables: Iterable[Typed]) -> dict[str, str]:
        return {each.name: self._kind(each.kinds) for each in variables}

    def _bounds(self, most_values: int) -> Bounds:
        """Return the search for the values of each fluent."""
        statics = self.statics
        changes: list[GroundChange] = []
        compared: list[Read] = list(reads(self.goal, {}))
        for rule, condition in self.rules:
            compared += reads(condition, self._kinds(rule.head.parameters))
        for each in self.costed:
            kinds = self._kinds(each.schema.parameters)
            try:
                changes += ground_changes(statics, each.schema, kinds)
            except UnsuitedError:
                refuse(self.file, each.schema.place, f"action '{each.schema.name}' changes numbers for too many "
                       "combinations of objects; expected fewer objects")  # fmt: skip
            top = (each.schema.precondition,)
            compared += reads(each.schema.precondition, kinds, top)
            for literal in each.schema.literals:
                compared += reads(literal.condition, {**kinds, **literal.variables}, top)
            for change in each.schema.changes:
                compared += reads(change.condition, {**kinds, **change.variables}, top)
        initial = initial_values(self.roles.kept, self.reading.problem.values, (each.fluent for each in changes))
        try:
            limits = saturations(statics, self.roles.kept, self.costed, compared, changes, initial)
        except UnsuitedError:
            refuse(self.file, self.costed[0].schema.place, "the numbers of this domain are compared for too many "
                   "combinations of objects; expected fewer objects, or fewer comparisons")  # fmt: skip
        of_actions = {each.name: self._kinds(each.parameters) for each in self._signatures()}
        proofs = Proofs(self.reading, statics, self.costed, changes, initial, of_actions)
        return Bounds(proofs, limits, most_values)

    def _encoder(self, sets: ValueSets) -> Encoder:
        domain = self.reading.domain
        taken = {*self.objects, *domain.predicates, *domain.functions, *domain.types.parents, OBJECT,
                 *self.reading.unions.values(), *(entry.name for entry in self._signatures())}  # fmt: skip
        limits = self.bounds.saturations
        return Encoder(self.file, self.statics, sets, limits, self.roles.kept, taken)

    def _signatures(self) -> list[Action | DurativeAction]:
        return [entry for entry in self.reading.domain.entries if not isinstance(entry, Rule)]

    def _assembled(self, encoder: Encoder, actions: list[EncodedAction], most_grounded: int) -> Compilation:
        """Return the compilation with encoded actions."""
        domain, problem = self.reading.domain, self.reading.problem
        root = _Root(self.reading, encoder.fresh("object-of-file"), encoder.fresh("never"))
        every = [cost for action in actions for cost in action.costs.values()]
        unit = unit_of(every)
        self._check_costs(actions, unit)
        entries: list[Action | DurativeAction | Rule] = []
        names: dict[str, tuple[str, int]] = {}
        functions: dict[str, Symbol] = {}
        values: dict[tuple[str, ...], Number] = {("total-cost",): 0}
        used: set[str] = set()
        for action in actions:
            schema = action.schema
            name = schema.name if schema.name not in used else encoder.fresh(f"{schema.name}-{len(entries)}")
            used.add(name)
            if name != schema.name or len(action.parameters) > len(schema.parameters):
                names[name] = schema.name, len(schema.parameters)
            costs = {row: int(cost / unit) for row, cost in action.costs.items()}
            if len(set(costs.values())) == 1:
                cost = Cost(next(iter(costs.values())), (), schema.place)
                amount = word(str(cost.number))
            else:
                function = encoder.fresh(f"cost-of-{name}")
                variables = tuple(Typed(f"?x{n}", (OBJECT,), schema.place) for n in range(len(action.cost_variables)))
                functions[function] = Symbol(function, variables, schema.place)
                values.update({(function, *row): value for row, value in costs.items()})
                cost = Cost(None, (function, *action.cost_variables), schema.place)
                amount = listed(*map(word, cost.function))
            increase = listed(word("increase"), listed(word("total-cost")), amount)
            effect = listed(word("and"), *map(root.formula, action.effect), increase)
            parameters = tuple(root.typed(each) for each in action.parameters)
            entries.append(
                Action(name, parameters, root.formula(action.precondition), effect, cost, schema.place)
            )  # fmt: skip
        place = problem.init
        predicates = {name: root.symbol(each) for name, each in domain.predicates.items()}
        for name in encoder.names:
            declared = domain.functions.get(name) or Symbol(name, (), place)
            symbol = value_symbol(encoder, declared)
            predicates[symbol.name] = root.symbol(symbol)
        for rule, condition in self.rules:
            scope = Scope(encoder, self._kinds(rule.head.parameters), (), "", rule.head.place)
            entries.append(Rule(root.symbol(rule.head), root.formula(scope.formula(condition))))
        wanted, conditions = numeric_encoding.goal(encoder, self.goal, place)
        for name, condition in conditions:
            head = Symbol(name, (), place)
            predicates[name] = head
            entries.append(Rule(head, root.formula(condition)))
        text = root.formula(wanted)
        self._check_size(encoder, actions, most_grounded)
        if root.uses_never:
            predicates[root.never] = Symbol(root.never, (), place)
        for each in relation_symbols(encoder, place):
            predicates[each.name] = each
        facts = dict(problem.facts)
        facts.update(dict.fromkeys(encoder.symbol_facts(), place))
        objects = {
            name: root.typed(each) for name, each in self.objects.items()
        }  # in the domain, whose rules name them
        objects.update({name: Typed(name, (encoder.value_type,), place) for name in encoder.objects.values()})
        compiled_domain = Domain(
            domain.name, root.types(encoder.value_type), objects, predicates, functions, tuple(entries)
        )  # fmt: skip
        asked = Problem(problem.name, {}, facts, values, text, problem.metric or place, problem.init)
        reading = Reading(self.reading.instance, compiled_domain, asked, root.unions)
        shown = {
            predicate: (name, {each: encoder.shown[each] for each in encoder.objects.values()})
            for name, predicate in encoder.names.items()
        }  # fmt: skip
        durations = sum(isinstance(entry, DurativeAction) for entry in domain.entries)
        notes = (*self.metric.notes, *self._notes(), *without_value(self.reading), *self._forgotten())
        return Compilation(reading, unit, names, shown, {"durations": durations, "numbers": len(encoder.names)}, notes)

    def _notes(self) -> list[str]:
        """Return what is said of durations that are free."""
        free = [
            entry.name for entry in self.reading.domain.entries
            if isinstance(entry, DurativeAction) and "(= ?duration" not in str(entry.duration)
        ]  # fmt: skip
        return [f"the least duration is taken for {', '.join(free)}"] if free else []

    def _check_size(self, encoder: Encoder, actions: list[EncodedAction], most_grounded: int) -> None:
        """Refuse a compilation that the translator would not ground in some minutes."""
        of_each = [
            numeric_encoding.ways(
                encoder, each.precondition, [one.name for one in each.parameters[len(each.schema.parameters) :]]
            )
            for each in actions
        ]
        if of_each and len(encoder.facts) + sum(of_each) > most_grounded:
            most = actions[of_each.index(max(of_each))].schema
            encoder.too_many(most.place, f"action '{most.name}'")

    def _check_costs(self, actions: list[EncodedAction], unit: Fraction) -> None:
        for action in actions:
            largest = max(action.costs.values())
            if largest / unit > LARGEST_COST:
                scale = "" if unit == 1 else f" of {as_shown(unit)}, the unit in which all costs are whole numbers"
                refuse(self.file, action.schema.place, f"action '{action.schema.name}' costs {as_shown(largest)}, more "
                       f"than {LARGEST_COST} units{scale}; expected smaller costs, or fewer decimals")  # fmt: skip


def condition_of(action: Action | DurativeAction) -> Expression:
    """Return all that an action requires."""
    return action.precondition if isinstance(action, Action) else action.condition


def without_value(reading: Reading) -> Iterator[str]:
    """Yield a sentence on each function that conditions of actions read, and that never has a value."""
    actions = [each for each in reading.domain.entries if not isinstance(each, Rule)]
    known = {term[0] for term in reading.problem.values}
    assigned = {
        part.parts[1].head: each.name
        for each in actions
        for part in each.effect.walk()
        if part.head == "assign" and part.parts[1].head not in _compared(condition_of(each)) - known
    }
    known |= assigned.keys()
    for name in reading.domain.functions:
        readers = [each.name for each in actions if any(part.head == name for part in condition_of(each).walk())]
        if readers and name not in known and name != "total-cost":
            of = f"condition of {readers[0]}" if len(readers) == 1 else f"conditions of {', '.join(readers)}"
            yield f"({name}) has no value at the beginning, so that no comparison with it holds, as in the {of}"


def _compared(condition: Expression) -> set[str]:
    """Return the functions without whose value a condition does not hold: those of comparisons that it surely makes."""
    if condition.head in ("and", *TIMES):
        return {name for part in condition.parts[1:] for name in _compared(part)}
    if condition.head in COMPLEMENT:
        return {term.head for side in condition.parts[1:] for term in terms_of(side)}
    return set()


def _dependencies(rules: Iterable[tuple[Rule, Expression]]) -> dict[str, frozenset[str]]:
    """Return the predicates and functions that each derived predicate depends on, directly or not."""
    found: dict[str, frozenset[str]] = {}
    for rule, condition in rules:
        found[rule.head.name] = found.get(rule.head.name, frozenset()) | {each.head for each in condition.walk()}
    for middle in found:
        for name, names in found.items():
            if middle in names:
                found[name] = names | found[middle]
    return found


class _Root:
    """A type for all objects of the files, beside that of the values, and a fact that never holds."""

    def __init__(self, reading: Reading, name: str, never: str) -> None:
        self.name, self.never, self.uses_never = name, never, False
        self.reading = reading
        self.unions = {tuple(self.kind(each) for each in kinds): union for kinds, union in reading.unions.items()}

    def kind(self, kind: str) -> str:
        """Return the type that stands for a type of the files."""
        return self.name if kind == OBJECT else kind

    def typed(self, each: Typed) -> Typed:
        """Return an object or a variable with the type that stands for its own."""
        return replace(each, kinds=tuple(map(self.kind, each.kinds)))

    def symbol(self, symbol: Symbol) -> Symbol:
        """Return a predicate with the types that stand for its own."""
        return replace(symbol, parameters=tuple(map(self.typed, symbol.parameters)))

    def types(self, values: str) -> Types:
        """Return the types with this one and that of the values."""
        before = self.reading.domain.types
        parents = {name: tuple(map(self.kind, above)) for name, above in before.parents.items() if name != OBJECT}
        return Types({OBJECT: (), self.name: (OBJECT,), values: (OBJECT,), **parents}, before.places)

    def formula(self, formula: Expression) -> Expression:
        """Return a formula whose quantified variables have the types that stand for their own.

        The empty disjunction, which some readers do not know, becomes the fact that never holds.
        """
        if formula == FALSE:
            self.uses_never = True
            return listed(word(self.never))
        if formula.word or not formula.parts:
            return formula
        if formula.head in ("forall", "exists"):
            words = [part.word for part in formula.parts[1].parts]
            words[2::3] = map(self.kind, words[2::3])
            return listed(formula.parts[0], listed(*map(word, words)), *map(self.formula, formula.parts[2:]))
        return formula._replace(parts=tuple(map(self.formula, formula.parts)))
