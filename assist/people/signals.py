"""Recovery of a person's actions from the facts that sensors report.

Sensors often report facts ("box b is on the platform"), not actions. `ActionRecovery` finds the ground actions that
explain the reported changes from the person's present state. It does not choose between explanations: changes with
several explanations are ambiguous, changes without any are impossible, and both are reported as such.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from planner import CostToGo

from ..declare.refusals import Refusal
from .action_names import unmatched, words_of

Kind = Literal["recovered", "ambiguous", "impossible"]

ATOM = re.compile(r"Atom (?!new-axiom@)([^()]+)\(([^()]*)\)(?: = (.*))?")
"""A fact in the translator's notation, without its auxiliary facts; a function has a value after its arguments."""
NEGATED = re.compile(r"\(\s*not\s*(?P<fact>\(.*\))\s*\)", re.I)


class FactChange(NamedTuple):
    """A fact that has begun or ceased to hold.

    Attributes
    ----------
    fact : str
        As `(predicate argument ...)` or `predicate(argument, ...)`; the last argument of a function is its value.
    holds : bool
        Whether it holds now.
    """

    fact: str
    holds: bool = True

    @classmethod
    def of(cls, text: str) -> FactChange:
        """Return the change that `(fact)` or `(not (fact))` stands for."""
        negated = NEGATED.fullmatch(text.strip())
        return cls(text, True) if negated is None else cls(negated["fact"], False)


@dataclass(frozen=True)
class Recovery:
    """The explanations of some changes.

    Attributes
    ----------
    kind : "recovered", "ambiguous" or "impossible"
        Whether there is one explanation, several, or none.
    explanations : tuple of tuple of str
        Sequences of ground actions in PDDL notation; an empty one if there were no changes.
    state : int or None
        State after the actions; None unless recovered.
    """

    kind: Kind
    explanations: tuple[tuple[str, ...], ...]
    state: int | None

    @property
    def actions(self) -> tuple[str, ...]:
        """The recovered actions.

        Raises
        ------
        ValueError
            The changes are ambiguous or impossible.
        """
        if self.kind != "recovered":
            raise ValueError(str(self))
        return self.explanations[0]

    def __str__(self) -> str:
        shown = ["; ".join(one) for one in self.explanations[:3]]
        if self.kind == "impossible":
            return "no sequence of actions explains the changes"
        if self.kind == "recovered":
            return shown[0]
        more = len(self.explanations) - len(shown)
        return f"the changes may be {' or '.join(shown)}" + f" or one of {more} others" * (more > 0)


class _Step(NamedTuple):
    """An action, the changes that it makes visible, and the state after it."""

    action: int
    changes: frozenset[tuple[str, bool]]
    after: int


class ActionRecovery:
    """Finds the actions behind changes of facts.

    An explanation is a sequence of actions that can be done one after the other and makes every reported change as
    often as it was reported, and no others except for up to `unreported` ones. An explanation is omitted if a shorter
    one leaves fewer changes unreported.

    If all visible changes are reported as they happened, and every action causes one, then no more than `longest`
    actions are never recovered wrongly. Where reports are lost, an action without any report can be missed.

    Parameters
    ----------
    known : CostToGo
        The task.
    predicates : iterable of str, optional
        Predicates of the facts that the sensors can see; by default all.
    longest : int
        Largest number of actions in an explanation. The time grows with this power of the number of applicable actions.
    unreported : int
        Largest number of visible changes that may have been lost. An action without any visible change counts as one.
        With a larger number, sensors may lose more reports, but more changes are ambiguous.
    unseen : int
        Largest number of further actions in an explanation of which nothing was reported, before the last one, if all
        that they change is one visible fact or none. With 0, they are assumed to be rarer than other explanations; with
        1, fewer recoveries are wrong where reports are lost, and more changes are ambiguous.
    stored : int
        Number of states whose transitions are kept; the default takes some hundred megabytes.
    """

    def __init__(
        self, known: CostToGo, *, predicates: Iterable[str] | None = None, longest: int = 3, unreported: int = 0,
        unseen: int = 0, stored: int = 65_536,
    ) -> None:  # fmt: skip
        if longest < 1 or unreported < 0 or unseen < 0:
            raise ValueError(
                f"longest {longest}, unreported {unreported}, unseen {unseen}; expected at least 1, 0 and 0"
            )
        self.known, self.longest, self.unreported, self.stored = known, longest, unreported, stored
        self.unseen = unseen
        seen = None if predicates is None else {name.lower() for name in predicates}
        self._facts = [[_visible(fact, seen) for fact in variable.facts] for variable in known.task.variables]
        self.facts = frozenset(fact for facts in self._facts for fact in facts if fact is not None)
        if seen is not None and (unknown := seen - {fact[1:-1].split()[0] for fact in self.facts}):
            raise unmatched(f"{min(unknown)}: no fact of this predicate changes in the task")
        self._steps: dict[int, list[_Step]] = {}

    def recover(self, state: int, changes: Iterable[FactChange | str]) -> Recovery:
        """Return the explanations of changes in a state.

        Parameters
        ----------
        state : int
            The person's state before the changes.
        changes : iterable of FactChange or str
            All reported changes since then, in any order, each as often as it happened. A text is `(fact)` for a fact
            that holds now, or `(not (fact))`.

        Raises
        ------
        Refusal
            The task has no such fact that changes, or it is not of the visible predicates.
        """
        reported = Counter(map(self._named, changes))
        if not reported:
            return Recovery("recovered", ((),), state)
        found: dict[tuple[int, ...], int] = {}
        slack = self.unreported
        for length in range(1, self.longest + 1):
            least = slack
            for actions, after, missing in self._explained(state, reported, length, slack, self.unseen):
                found[actions] = after
                least = min(least, missing)
            slack = least
        names = self.known.task.actions
        explanations = tuple(tuple(names[action] for action in actions) for actions in found)
        if len(found) == 1:
            return Recovery("recovered", explanations, next(iter(found.values())))
        return Recovery("ambiguous" if found else "impossible", explanations, None)

    def _named(self, change: FactChange | str) -> tuple[str, bool]:
        """Return a change as the task's spelling of the fact, and whether the fact holds."""
        fact, holds = FactChange.of(change) if isinstance(change, str) else change
        try:
            named = f"({' '.join(words_of(fact))})"
        except Refusal as error:
            raise unmatched(str(error).replace("(name", "(predicate").replace("name(", "predicate(")) from None
        if named not in self.facts:
            near = difflib.get_close_matches(named, self.facts, n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            raise unmatched(f"{named} is no visible fact that changes in the task{meant}")
        return named, bool(holds)

    def _explained(
        self, state: int, reported: Counter[tuple[str, bool]], length: int, slack: int, unseen: int
    ) -> Iterable[tuple[tuple[int, ...], int, int]]:
        """Yield the explanations of a length: actions, the state after them, and the number of unreported changes."""
        for step in self._options(state):
            extra = sum(change not in reported for change in step.changes) + (not step.changes)
            if unseen and length > 1 and extra == max(1, len(step.changes)) == 1:
                for actions, after, missing in self._explained(step.after, reported, length - 1, slack, unseen - 1):
                    yield (step.action, *actions), after, missing
            if extra > slack:
                continue
            rest = reported - Counter(step.changes)
            if length == 1:
                if not rest:
                    yield (step.action,), step.after, extra
                continue
            for actions, after, missing in self._explained(step.after, rest, length - 1, slack - extra, unseen):
                yield (step.action, *actions), after, extra + missing

    def _options(self, state: int) -> list[_Step]:
        """Return the applicable actions with their visible changes."""
        if state not in self._steps:
            if len(self._steps) >= self.stored:
                self._steps.clear()
            rows = self.known.choices([state])
            before, *after = self.known.values([state, *rows.targets]).tolist()
            self._steps[state] = [
                _Step(action, self._changes(before, values), target)
                for action, target, values in zip(rows.actions.tolist(), rows.targets.tolist(), after, strict=True)
            ]
        return self._steps[state]

    def _changes(self, before: list[int], after: list[int]) -> frozenset[tuple[str, bool]]:
        """Return the visible changes between the values of two states."""
        return frozenset(
            (fact, holds)
            for facts, old, new in zip(self._facts, before, after, strict=True)
            if old != new
            for fact, holds in ((facts[old], False), (facts[new], True))
            if fact is not None
        )


def _visible(fact: str, predicates: set[str] | None) -> str | None:
    """Return a variable's value as a fact in PDDL; None if it is not one, or not of these predicates."""
    found = ATOM.fullmatch(fact)
    if found is None or (predicates is not None and found[1].lower() not in predicates):
        return None
    return f"({' '.join([found[1], *(found[2].split(', ') if found[2] else ()), *filter(None, [found[3]])])})".lower()
