"""The log of a service on stderr: one line for each record, as text or as a JSON object.

What people and machines write into names cannot forge a line, move a terminal's cursor or change its colours.
"""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime
from typing import Literal

from planner.system.errors import visible

USUAL = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
"""Attributes of every log record; others are fields that the caller has added (`extra`)."""


class JsonLines(logging.Formatter):
    """Formats a log record as a JSON object: `time` (UTC), `level`, `logger`, `message`, and the caller's fields."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the object as text."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(), "logger": record.name, "message": record.getMessage(),
        }  # fmt: skip
        line |= {name: value for name, value in vars(record).items() if name not in USUAL}
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return visible(json.dumps(line, default=str, ensure_ascii=False))


class TextLines(logging.Formatter):
    """Formats a log record as its message on one line; signs that end lines or control a terminal are written out."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; the lines of an exception follow it."""
        line = visible(record.getMessage()).replace("\n", "\\n")
        return f"{line}\n{visible(self.formatException(record.exc_info))}" if record.exc_info else line


def write_log(form: Literal["text", "json"]) -> None:
    """Write the log of this process to stderr: warnings and connections; as JSON also a line for each report."""
    handler = logging.StreamHandler()
    handler.setFormatter(TextLines() if form == "text" else JsonLines())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("assist.connect").setLevel(logging.INFO)
    if form == "json":
        logging.getLogger("assist").setLevel(logging.INFO)
        logging.getLogger(f"{__package__}.reports").setLevel(logging.INFO)
