"""The tables of declared fields in the pages: `python tests/declared_tables.py` writes them.

A table stands between `<!-- declared MODULE CLASS -->` and `<!-- end -->`.
"""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path

from assist.declare.options import table

DOCS = Path(__file__).parent.parent / "docs"
MARKED = re.compile(r"(<!-- declared (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def renewed(text: str) -> str:
    """Return a page with its tables as the classes declare them."""

    def anew(found: re.Match[str]) -> str:
        return f"{found[1]}\n{table(getattr(import_module(found[2]), found[3]))}\n\n{found[4]}"

    return MARKED.sub(anew, text)


def main() -> None:
    for page in sorted(DOCS.rglob("*.md")):
        text = page.read_text()
        if text != renewed(text):
            page.write_text(renewed(text))
            sys.stdout.write(f"{page.relative_to(DOCS.parent)}\n")


if __name__ == "__main__":
    main()
