"""The table of the requests that report events, as the documentation has it."""

from __future__ import annotations

import re

from ..live.events import Event, kinds


def event_table(base: type[Event]) -> str:
    """Return a table in Markdown of the events below a class: request, fields of the body, and what has happened."""
    rows = ["| request | fields | reports |", "|---|---|---|"]
    for kind in kinds(base).values():
        if kind.path is None or not kind.__module__.startswith("assist."):
            continue
        inside = re.findall(r"\{(\w+)\}", kind.path)
        fields = ", ".join(f"`{name}`" for name in kind.fields() if name not in inside and kind.method == "POST")
        said = str(kind.__doc__).strip().splitlines()[0].rstrip(".")
        who = "operator: " if kind.by_operator else ""
        rows.append(f"| `{kind.method} {kind.path}` | {fields} | {who}{said[0].lower()}{said[1:]} |")
    return "\n".join(rows) + "\n"
