"""How far the instances of `solve` are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from planner import Instance
from planner.batch.solve_instance import COMPILING, SolveRecord
from planner.system.progress import compiling_line, stages


@contextmanager
def solving(
    count: int, add: Callable[[SolveRecord], None]
) -> Iterator[tuple[Callable[[SolveRecord], None], Callable[..., None]]]:
    """Show how far the instances are; give what is called with each record, and with each stage of an instance.

    Each record is handed to `add` as well.
    """
    solved = 0
    say = compiling_line()
    with stages() as show:

        def advance(record: SolveRecord) -> None:
            nonlocal solved
            solved += 1
            add(record)

        def stage(instance: Instance, what: str, done: int, total: int | None) -> None:
            from rich import table  # noqa: F401  loads what shows the records, while another process works on them

            if what == COMPILING:
                say()
            show(what if count == 1 else f"{solved} of {count} solved; {instance}: {what}", done, total)

        yield advance, stage
