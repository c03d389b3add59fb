"""Reader of the SAS text that Fast Downward's translator writes (file format version 3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ..pddl.instances import Instance
from .task import Effect, Fact, Operator, Task, Variable

T = TypeVar("T")


def from_sas(sas: str, instance: Instance, note: str | None = None) -> Task:
    """Return the task of a SAS text; `note` becomes the note of the task."""
    text = _Sas(sas)
    text.expect("begin_version", "3", "end_version", "begin_metric")
    has_costs = text.number() == 1
    text.expect("end_metric")
    variables = text.each("variable", text.variable)
    mutexes = text.each("mutex_group", text.facts)
    text.expect("begin_state")
    initial = tuple(text.number() for _ in variables)
    text.expect("end_state", "begin_goal")
    goal = text.facts()
    text.expect("end_goal")
    grounded = text.each("operator", text.operator)
    axioms = text.each("rule", text.axiom)
    priced = [(action, cost if has_costs else 1) for action, _, _, cost in grounded]
    actions = sorted(set(priced))  # one for each cost that an action may have
    index = {action: number for number, action in enumerate(actions)}
    return Task(
        instance=instance,
        variables=variables,
        actions=tuple(action for action, _ in actions),
        costs=tuple(cost for _, cost in actions),
        operators=tuple(
            Operator(index[action], preconditions, effects)
            for action, (_, preconditions, effects, _) in zip(priced, grounded, strict=True)
        ),
        axioms=axioms,
        initial=initial,
        goal=goal,
        mutexes=mutexes,
        note=note,
    )


class _Sas:
    """A SAS text that is read line by line."""

    def __init__(self, sas: str) -> None:
        self._lines = iter(sas.split("\n"))

    def expect(self, *words: str) -> None:
        for word in words:
            if (line := next(self._lines)) != word:
                raise ValueError(f"SAS text: expected '{word}', found '{line}'")

    def number(self) -> int:
        return int(next(self._lines))

    def numbers(self) -> list[int]:
        return [int(word) for word in next(self._lines).split()]

    def facts(self) -> tuple[Fact, ...]:
        pairs = (next(self._lines).split() for _ in range(self.number()))
        return tuple((int(variable), int(value)) for variable, value in pairs)

    def each(self, section: str, one: Callable[[], T]) -> tuple[T, ...]:
        """Read a number of sections, each between a line that begins it and one that ends it."""
        found = []
        for _ in range(self.number()):
            self.expect(f"begin_{section}")
            found.append(one())
            self.expect(f"end_{section}")
        return tuple(found)

    def variable(self) -> Variable:
        name, layer = next(self._lines), self.number()
        return Variable(name, tuple(next(self._lines) for _ in range(self.number())), layer)

    def operator(self) -> tuple[str, tuple[Fact, ...], tuple[Effect, ...], int]:
        """Read an action with its preconditions, effects and cost."""
        action = f"({next(self._lines).strip()})"
        preconditions, effects = list(self.facts()), []
        for _ in range(self.number()):
            words = self.numbers()
            variable, before, after = words[-3:]
            if before != -1:
                preconditions.append((variable, before))
            effects.append(Effect(tuple(zip(words[1:-3:2], words[2:-3:2], strict=True)), variable, after))
        # each effect repeats the precondition of its variable
        return action, tuple(dict.fromkeys(preconditions)), tuple(effects), self.number()

    def axiom(self) -> Effect:
        conditions = self.facts()
        variable, _, after = self.numbers()
        return Effect(conditions, variable, after)
