"""Log lines as JSON objects, one a line, for systems that collect logs."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime

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
        return json.dumps(line, default=str, ensure_ascii=False)


def log_json() -> None:
    """Write the log of this process to stderr as JSON, with a line for each report."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("assist").setLevel(logging.INFO)
    logging.getLogger(f"{__package__}.reports").setLevel(logging.INFO)
