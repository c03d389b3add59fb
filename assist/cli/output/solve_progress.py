"""Progress of `solve`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from planner import Instance
from planner.batch.results_folder import COMPILING, SolveRecord
from planner.system.progress import compiling_line, stages

LARGE_SEARCH = "the search of large tasks: about ten seconds"


@contextmanager
def solving(
    count: int, add: Callable[[SolveRecord], None]
) -> Iterator[tuple[Callable[[SolveRecord], None], Callable[..., None]]]:
    """Show the progress of `count` instances.

    Yield two callables: one for each finished record, and one for each stage of an instance. Finished records are also
    passed to `add`.
    """
    solved = 0
    say = compiling_line()
    with stages() as show:

        def advance(record: SolveRecord) -> None:
            nonlocal solved
            solved += 1
            add(record)

        def stage(instance: Instance, what: str, done: int, total: int | None) -> None:
            if what == COMPILING:
                say(LARGE_SEARCH)
            show(what if count == 1 else f"{solved} of {count} solved; {instance}: {what}", done, total)

        yield advance, stage
