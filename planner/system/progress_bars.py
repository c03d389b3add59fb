"""How far something is, on a terminal: a bar, and a line in words."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text


class Line(ProgressColumn):
    """How far it is in words, seconds included."""

    def render(self, task: Task) -> Text:
        """Give it as it is by now."""
        return Text(str(task.fields.get("line", "")))


class Bar:
    """Shows how far something is, until it is closed."""

    def __init__(self) -> None:
        self._progress = Progress(SpinnerColumn(), BarColumn(), Line(), console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("", total=None)
        self._progress.start()

    def show(self, line: object, done: int, total: int | None) -> None:
        """Show so many of so many, and a line in words, as `str` gives it at the time."""
        if self._progress.tasks[0].total != total:
            self._progress.reset(self._task, total=total)
        self._progress.update(self._task, completed=done, line=line)

    def close(self) -> None:
        """Show nothing any more."""
        self._progress.stop()
