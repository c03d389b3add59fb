"""A progress bar with a line of text, on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task
from rich.text import Text


class Line(ProgressColumn):
    """Column that shows the line of text, which includes the elapsed seconds."""

    def render(self, task: Task) -> Text:
        """Return the current text."""
        return Text(str(task.fields.get("line", "")))


class Bar:
    """Shows progress until it is closed."""

    def __init__(self) -> None:
        self._progress = Progress(SpinnerColumn(), BarColumn(), Line(), console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("", total=None)
        self._progress.start()

    def show(self, line: object, done: int, total: int | None) -> None:
        """Show a count, its total, and a line of text, which is `str(line)` at the time of drawing."""
        if self._progress.tasks[0].total != total:
            self._progress.reset(self._task, total=total)
        self._progress.update(self._task, completed=done, line=line)

    def close(self) -> None:
        """Remove the bar."""
        self._progress.stop()
