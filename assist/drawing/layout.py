"""Layout of a scene: nested boxes in a fixed order, with space reserved for objects that may arrive.

Lengths are in pixels at the natural size of a drawing. Text is measured with fixed widths of letters, so that a layout
depends on the scene only and not on the fonts of the machine.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from .scene import Node, Scene

SMALL = 11 / 13  # font size of a tag, relative to that of a title, as in `drawing.css`
BROAD, SLIM = "mwMWGOQ@%", "ijlftrI-.,:;'|()[]! "
HEAD, TAG = 30.0, 22.0  # height of the line of a title, and of a tag; an icon is as wide as a tag is high
PAD, GAP, NOTE = 10.0, 8.0, 16.0  # space within a box, space between boxes, height of a line of notes
LEAST = 64.0  # smallest width of a box
ICONS = frozenset({"person", "robot", "van", "tray", "locker", "parcel"})

Size = tuple[float, float]


@dataclass
class Box:
    """A rectangle and its contents; `x` and `y` are relative to the enclosing box.

    Attributes
    ----------
    node : Node
        The part of the scene that it shows.
    width, height : float
    tags : list of tuple (text, done, x, y)
    lines : list of tuple (text, x, y)
    boxes : list of Box
    """

    node: Node
    width: float
    height: float
    tags: list[tuple[str, bool, float, float]] = field(default_factory=list)
    lines: list[tuple[str, float, float]] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True)
class Layout:
    """The boxes of a scene, with their coordinates.

    Attributes
    ----------
    boxes : list of Box
    width, height : float
    """

    boxes: list[Box]
    width: float
    height: float


def text_width(text: str) -> float:
    """Return the approximate width of a title in pixels, for a wide typeface."""
    return sum(
        12.4 if letter in BROAD else 5.4 if letter in SLIM else 9.4 if letter.isupper() else 8.6 for letter in text
    )


def tag_width(text: str) -> float:
    """Return the approximate width of a tag in pixels, its symbol included."""
    return SMALL * text_width(text) + 26


def tag_rows(
    tags: list[tuple[str, bool]], width: float, x: float, y: float
) -> tuple[list[tuple[str, bool, float, float]], Size]:
    """Return the tags of rows of a width, each with its coordinates, and the size of all rows."""
    placed, at, line, widest = [], 0.0, 0, 0.0
    for text, done in tags:
        if at and at + tag_width(text) > width:
            at, line = 0.0, line + 1
        placed.append((text, done, x + at, y + line * (TAG + 4)))
        at += tag_width(text) + 5
        widest = max(widest, at - 5)
    return placed, (widest, (line + 1) * (TAG + 4) if tags else 0.0)


class Arranger:
    """Lays out scenes of one task.

    Parameters
    ----------
    room : mapping of str to list of Node
        For each place, the objects that may be there, without contents; space is reserved for them.
    """

    def __init__(self, room: Mapping[str, list[Node]]) -> None:
        self.room = room
        self._reserved: dict[tuple[str, float], Size] = {}
        self._measured: set[str] = set()

    def layout(self, scene: Scene, width: float) -> Layout:
        """Return the layout of a scene in a picture of approximately the given width."""
        boxes = [self._tower(node, width) for node in scene.roots]
        return Layout(boxes, *_rows(boxes, width, 0.0))

    def _tower(self, node: Node, width: float) -> Box:
        """Return a frameless box around a node and the nodes that are stacked on it."""
        base = self._box(node, width)
        if not node.on:
            return base
        above = [self._tower(one, width) for one in node.on]
        across = sum(box.width for box in above) + GAP * (len(above) - 1)
        whole = Box(Node(f"{node.key}##tower", "", replace(node.look, shape="tower")), max(base.width, across), 0.0)
        _widen(above[0] if len(above) == 1 else base, whole.width)
        _widen(base, whole.width)
        at, high = (
            (whole.width - sum(box.width for box in above) - GAP * (len(above) - 1)) / 2,
            max(box.height for box in above),
        )
        for box in above:
            box.x, box.y = at, high - box.height
            at += box.width + GAP
        base.x, base.y = 0.0, high + 2
        whole.height = high + 2 + base.height
        whole.boxes = [*above, base]
        return whole

    def _box(self, node: Node, width: float) -> Box:
        head = text_width(node.title) + (TAG if node.look.shape in ICONS else 0) + 2 * PAD
        head += sum(SMALL * text_width(mark) + 20 for mark in node.marks)
        small = node.look.shape in ("chip", "ball", "block", "parcel")
        inner = max(head - 2 * PAD, min(width - 2 * PAD, 200.0))
        tags, (tags_width, tags_height) = tag_rows(node.wants, inner, PAD, HEAD)
        content, size = self._inside(node, width - 2 * PAD)
        box = Box(node, max(head, LEAST, tags_width + 2 * PAD, size[0] + 2 * PAD), HEAD + tags_height, tags)
        for one in content:
            one.x, one.y = one.x + PAD, one.y + box.height
        box.boxes = content
        box.height += size[1] + (PAD if content or size[1] else 2 if small else 4)
        if node.notes:
            _add_notes(box, width)
        return box

    def _inside(self, node: Node, width: float) -> tuple[list[Box], Size]:
        """Return the boxes within a node and their size: movable objects first, then its parts, in rows."""
        parts = [self._box(one, width) for one in node.inside if one.key.find("#") > 0]
        free = [self._tower(one, width) for one in node.inside if one.key.find("#") < 1]
        size = self._fill(node, free, width)
        if not parts:
            return free, size
        room = Box(node, *size, boxes=free)
        whole = _rows([room, *parts] if size[1] else parts, width, 0.0)
        for box in free:
            box.x, box.y = box.x + room.x, box.y + room.y
        return [*free, *parts], whole

    def _fill(self, node: Node, boxes: list[Box], width: float) -> Size:
        """Place boxes in a node with reserved space, and return their total size.

        Objects of one shape form a grid. If there is space for all of them, each has a fixed cell.
        """
        may = self.room.get(node.key, [])
        count = node.look.holds or (1 if node.is_object else len(may))
        sizes = [self._size(one, width) for one in may]
        if len({one.look.shape for one in may}) != 1:
            size = _rows(boxes, width, 0.0) if boxes else (0.0, 0.0)
            return max([size[0], *(one[0] for one in sizes)]), max([size[1], *(one[1] for one in sizes)])
        wide = max([*(one[0] for one in sizes), *(box.width for box in boxes)])
        high = max([max(one[1] for one in sizes) * min(node.look.high, len(may)), *(box.height for box in boxes)])
        homes = {one.key: number for number, one in enumerate(may)} if count == len(may) else {}
        count = max(count, len(boxes))
        # Up to four boxes form one row; more form a grid that is slightly wider than high.
        few = count if node.look.high > 1 or count <= 4 else math.ceil(math.sqrt(count)) + 2
        columns = max(1, min(few, int((width + GAP) // (wide + GAP))))
        for number, box in enumerate(boxes):
            row, column = divmod(homes.get(box.node.key.split("#")[0] or box.node.key, number), columns)
            _widen(box, wide)
            box.x = column * (wide + GAP)
            box.y = row * (high + GAP) + (high - box.height) * (node.look.high > 1)
        rows = math.ceil(count / columns)
        return columns * (wide + GAP) - GAP, rows * (high + GAP) - GAP

    def _size(self, node: Node, width: float) -> Size:
        """Return the size of an empty node with its reserved space; a place that contains itself reserves none."""
        key = (node.key, width)
        if key not in self._reserved and node.key not in self._measured:
            self._measured.add(node.key)
            box = self._box(node, width)
            self._measured.remove(node.key)
            self._reserved[key] = (box.width, box.height)
        return self._reserved.get(key, (LEAST, HEAD))


def _widen(box: Box, width: float) -> None:
    """Widen a box to a width, unless its shape has a fixed one."""
    if box.node.look.shape not in ("chip", "ball", "parcel", "tower"):
        box.width = max(box.width, width)


def _add_notes(box: Box, width: float) -> None:
    """Write the connections of a node below the contents of its box."""
    letters = max(12, int((max(box.width, min(width, 240)) - 2 * PAD) / 6.5))
    lines = textwrap.wrap(f"to {', '.join(box.node.notes)}", letters)
    for number, line in enumerate(lines):
        box.lines.append((line, PAD, box.height + 10 + NOTE * number))
    box.width = max(box.width, *(SMALL * text_width(line) + 2 * PAD for line in lines))
    box.height += NOTE * len(lines) + 4


def _rows(boxes: list[Box], width: float, top: float) -> Size:
    """Place boxes in rows of a width, with one height per row, and return their total size."""
    at, y, high, widest = 0.0, top, 0.0, 0.0
    row: list[Box] = []
    for box in [*boxes, None]:
        if box is None or (row and at + box.width > width + 0.5):
            for one in row:
                if one.node.look.shape in ("panel", "part", "slot"):
                    one.height = high
            y += high + GAP
            at, high, row = 0.0, 0.0, []
        if box is not None:
            box.x, box.y = at, y
            at += box.width + GAP
            high = max(high, box.height)
            widest = max(widest, at - GAP)
            row.append(box)
    return widest, max(top, y - GAP)
