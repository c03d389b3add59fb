"""The map of the rooms and its figure, made from their docstrings and imports: `python tests/drawn_rooms.py`."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape

from test_architecture import ROOMS, ROOT, imports, modules, within

FILE = ROOT / "docs" / "figures" / "architecture.svg"
WIDTH, HEIGHT, ACROSS, DOWN, MARGIN = 218, 88, 236, 126, 12
COLUMNS = {
    "planner.system": 2, "planner.pddl": 2, "planner.grounding": 2,
    "planner.search.kernels": 1, "planner.search": 2,
    "planner.costtogo": 2, "planner.batch": 1.5, "planner": 2.5,
    "assist.declare": 3, "assist.people": 2.5, "assist.cli.terminal": 5.5, "assist.person": 2, "assist.drawing": 4,
    "assist.learning": 3, "assist.team": 2, "assist.certify.information_relaxation": 0.5, "assist.certify": 0,
    "assist.certify.coupled": 1, "assist.drawing.plots": 4, "assist.live": 3, "assist.studies": 2,
    "assist.studies.userstudy": 2.5, "assist.studies.reports": 1.5, "assist.web": 3.5, "assist.web.user_study": 3,
    "assist.connect": 5, "assist.connect.bridges": 4.5, "assist.cli.options": 2.5, "assist.cli.output": 1,
    "assist.cli": 2.5,
}  # fmt: skip
"""Where each room stands in its row; the rows follow from the imports."""
STYLE = """
.room { fill: #eef2f7; stroke: #6b7785; }
.name { font: 600 15px system-ui, sans-serif; fill: #1a2330; }
.about { font: 11.5px system-ui, sans-serif; fill: #3b4654; }
.way { fill: none; stroke: #6b7785; stroke-width: 1.5; }
.tip { fill: #6b7785; }
@media (prefers-color-scheme: dark) {
.room { fill: #222a35; stroke: #8b97a6; } .name { fill: #eef2f7; } .about { fill: #c3ccd8; }
.way { stroke: #8b97a6; } .tip { fill: #8b97a6; }
}
"""


def room_of(module: str) -> str:
    return max((room for room in ROOMS if within(module, room)), key=len)


def needs() -> dict[str, set[str]]:
    """Return for each package those that it imports from, without indirect ones."""
    found: dict[str, set[str]] = {room: set() for room in ROOMS}
    for module, file in modules().items():
        found[room_of(module)] |= {room_of(name) for name, _ in imports(module, file.read_text()) if name != "assist"}
    for room in found:
        found[room].discard(room)
    all_of: dict[str, set[str]] = {}
    for room in ROOMS:
        all_of[room] = found[room].union(*(all_of[other] for other in found[room]))
    return {
        room: {one for one in others if not any(one in all_of[other] for other in others)}
        for room, others in found.items()
    }


def rows(edges: Mapping[str, set[str]]) -> dict[str, int]:
    """Return the row of each package: one below the lowest one that it imports from."""
    found: dict[str, int] = {}
    for room in ROOMS:
        found[room] = 1 + max((found[other] for other in edges[room]), default=-1)
    return found


def sentence(room: str) -> str:
    """Return the first sentence of a package's docstring."""
    doc = ast.get_docstring(ast.parse((ROOT / room.replace(".", "/") / "__init__.py").read_text())) or ""
    return doc.partition("\n")[0]


def maps() -> dict[Path, str]:
    """Return the texts of all files with a map, renewed."""
    page = ROOT / "docs" / "contributing.md"
    found = {page: page.read_text(encoding="utf-8")}
    for folder in ("planner", "assist"):
        rooms = {room.partition(".")[2]: sentence(room) for room in ROOMS if re.fullmatch(rf"{folder}\.\w+", room)}
        listed = "".join(f"- `{name}`: {said}\n".replace("*", "\\*") for name, said in rooms.items())
        begin, end = f"<!-- rooms {folder} -->\n", "<!-- end -->"
        before, _, after = found[page].partition(begin)
        found[page] = before + begin + listed + end + after.partition(end)[2]
        file = ROOT / folder / "__init__.py"
        before, head, after = file.read_text(encoding="utf-8").partition("builds on earlier ones:\n\n")
        wide = max(map(len, rooms))
        listed = "\n".join(f"{name:{wide}}  {said}" for name, said in rooms.items())
        found[file] = before + head + listed + "\n\n" + after.partition("\n\n")[2]
    return found


def about(room: str) -> list[str]:
    """Return the description of a package for the figure."""
    said = re.sub(r"`| \(extra .*\)", "", sentence(room).partition(": ")[0]).rstrip(".")
    return textwrap.wrap(said, 31, break_on_hyphens=False)


def drawn() -> str:
    """Return the figure."""
    edges = needs()
    row = rows(edges)
    place = {room: (MARGIN + COLUMNS[room] * ACROSS, MARGIN + row[room] * DOWN) for room in ROOMS}
    wide, high = 2 * MARGIN + max(COLUMNS.values()) * ACROSS + WIDTH, 2 * MARGIN + max(row.values()) * DOWN + HEIGHT
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}" role="img">',
        "<title>The rooms of the packages, and which builds on which</title>", f"<style>{STYLE}</style>",
        '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path class="tip" d="M0 0 8 4 0 8z"/></marker>',
    ]  # fmt: skip
    for room in ROOMS:
        users = sorted((other for other in ROOMS if room in edges[other]), key=lambda other: place[other][0])
        for number, other in enumerate(users, start=1):
            x = place[room][0] + WIDTH * number / (len(users) + 1)
            above = sorted(edges[other], key=lambda one: (place[one][0], one))
            to = place[other][0] + WIDTH * (above.index(room) + 1) / (len(above) + 1)
            y, below = place[room][1] + HEIGHT, place[other][1]
            leave, arrive = below - (DOWN - HEIGHT), below - (DOWN - HEIGHT) / 2  # long ways turn at their end
            parts.append(
                f'<path class="way" marker-end="url(#tip)" d="M{x:.0f} {y} C{x:.0f} {max(leave, y + 19):.0f} {to:.0f} '
                f'{arrive:.0f} {to:.0f} {below}"/>'
            )
    for room, (x, y) in place.items():
        parts.append(f'<rect class="room" x="{x:g}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="8"/>')
        name = room.removeprefix("assist.")
        name = name if len(name) < 21 else name.rpartition(".")[2]
        parts.append(f'<text class="name" x="{x + 12:g}" y="{y + 20}">{name}/</text>')
        for number, line in enumerate(about(room)):
            parts.append(f'<text class="about" x="{x + 12:g}" y="{y + 37 + 15 * number}">{escape(line)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def main() -> None:
    """Write the maps and the picture."""
    for file, text in {**maps(), FILE: drawn()}.items():
        file.write_text(text, encoding="utf-8")
        print(file.relative_to(ROOT))


if __name__ == "__main__":
    main()
