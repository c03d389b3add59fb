"""The tables of declared classes in the pages: `python tests/declared_tables.py` writes them.

A table stands between `<!-- declared MODULE CLASS -->` and `<!-- end -->`; for the rules, `CLASS` is `RULES` or
`SEEN_RULES`. Of a view that has a person's view, the table has what it has beside that.
"""

from __future__ import annotations

import re
import sys
from dataclasses import MISSING
from importlib import import_module
from pathlib import Path
from typing import Any

from assist.declare.declared import (
    View,
    annotation_of,
    bare,
    default_of,
    is_declared,
    names_of,
    phrase,
    plain,
    sentences,
)
from assist.declare.options import toml
from assist.live.event_base import Event
from assist.live.events import kinds
from assist.live.views import PersonView
from assist.people.trust_rules import RULES, described, fields_of
from planner.system.results import markdown_table

DOCS = Path(__file__).parent.parent / "docs"
MARKED = re.compile(r"(<!-- declared (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def renewed(text: str) -> str:
    """Return a page with its tables as the classes declare them."""

    def anew(found: re.Match[str]) -> str:
        return f"{found[1]}\n{table(getattr(import_module(found[2]), found[3]))}\n\n{found[4]}"

    return MARKED.sub(anew, text)


def table(kind: Any) -> str:
    """Return the fields of a declared class, an event's kinds, or rules by which theta moves: what each is."""
    if isinstance(kind, dict):
        return rule_table(kind)
    if issubclass(kind, View):
        before = sentences(PersonView) if kind is not PersonView and issubclass(kind, PersonView) else {}
        rows = [(f"`{name}`", text) for name, text in sentences(kind).items() if name not in before]
        return markdown_table(("field", "meaning"), rows)
    return event_table(kind) if issubclass(kind, Event) else field_table(kind)


def field_table(kind: Any) -> str:
    """Return a table of the fields of a declared class in Markdown: name, sentence, range and default."""
    rows = []
    for name in sorted(names_of(kind), key=lambda one: default_of(kind, one) is not MISSING):
        annotation, default = annotation_of(kind, name), default_of(kind, name)
        value = None if default is MISSING or is_declared(bare(annotation)) else plain(default)
        shown = "" if value in (None, [], {}) else f"`{toml(value)}`"
        rows.append(
            (f"`{name}`", sentences(kind)[name], phrase(annotation), "required" if default is MISSING else shown)
        )
    return markdown_table(("field", "meaning", "what it is", "default"), rows)


def event_table(base: type[Event]) -> str:
    """Return a table of the events below a class: kind, request, fields of the body, and what has happened."""
    rows = []
    for kind in kinds(base).values():
        if kind.path is None or not kind.__module__.startswith("assist."):
            continue
        inside = re.findall(r"\{(\w+)\}", kind.path)
        fields = ", ".join(f"`{name}`" for name in kind.fields() if name not in inside)
        said = str(kind.__doc__).strip().splitlines()[0].rstrip(".")
        who = "operator: " if kind.by_operator else ""
        rows.append(
            (
                f"`{kind.model_fields['kind'].default}`",
                f"`POST {kind.path}`",
                fields,
                f"{who}{said[0].lower()}{said[1:]}",
            )
        )
    return markdown_table(("event", "request", "fields", "reports"), rows)


def rule_table(rules: dict[str, Any]) -> str:
    """Return a table of shipped rules: name, sentence, and the fields that each is made with."""
    rows = []
    for name, make in rules.items():
        rule, said = make(), sentences(type(make()))
        numbers = (one for one in fields_of(make) if one != "feedback")  # which all trust rules have
        fields = (f"`{one}`, by default {toml(plain(getattr(rule, one)))}: {said[one]}" for one in numbers)
        first = described(make)
        rows.append((f"`{name}`", first[0].upper() + first[1:], " ".join(fields)))
    after = "a suggestion" if rules is RULES else "what is seen"
    return markdown_table(("rule", f"theta after {after}", "numbers"), rows)


def main() -> None:
    for page in sorted(DOCS.rglob("*.md")):
        text = page.read_text()
        if text != renewed(text):
            page.write_text(renewed(text))
            sys.stdout.write(f"{page.relative_to(DOCS.parent)}\n")


if __name__ == "__main__":
    main()
