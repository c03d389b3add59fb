"""Layout of scenes: nested boxes in a fixed order, with space reserved for objects that may arrive.

The scenes of a plan are laid out together. Each place has numbered cells; an object keeps its cell as long as it stays,
and a cell has the size of the largest object that is ever in it. So nothing moves in a picture but what moves.

Lengths are in pixels at the natural size of a drawing. Text is measured with fixed widths of letters, so that a layout
depends on the scenes only and not on the fonts of the machine.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from .scene import HEADING, TASK, Node, Scene

SMALL = 12 / 13  # font size of a label, relative to that of a title, as in `drawing.css`
BROAD, SLIM = "mwMWGOQ@%", "ijlftrI-.,:;'|()[]! "
HEAD, TAG = 30.0, 22.0  # height of the line of a title, and of a label; an icon is as wide as a label is high
LINE = 15.0  # height of each further line of a label
PAD, GAP, NOTE = 10.0, 8.0, 16.0  # space within a box, space between boxes, height of a line of notes
LEAST = 64.0  # smallest width of a box
BESIDE = 240.0  # largest width of a title with marks beside it; with more, marks are below it
ICONS = frozenset({"person", "robot", "van", "tray", "locker", "parcel"})
FIXED = frozenset({"chip", "ball", "parcel"})
TOWER = "##tower"  # ends the key of a node that is a tower of boxes
"""Shapes that are as wide as their text."""
PASSES = 12
"""Times that scenes are laid out until their reserved sizes are large enough; each level of nesting needs one."""

Size = tuple[float, float]


@dataclass
class Label:
    """A mark of an object, or a part of the goal; `x` and `y` are relative to its box.

    Attributes
    ----------
    lines : list of str
    done : bool or None
        Whether the part of the goal holds; None for a mark.
    width, height, x, y : float
    """

    lines: list[str]
    done: bool | None
    width: float
    height: float
    x: float = 0.0
    y: float = 0.0


@dataclass
class Box:
    """A rectangle and its contents; `x` and `y` are relative to the enclosing box.

    Attributes
    ----------
    node : Node
        The part of the scene that it shows.
    width, height : float
    labels : list of Label
    lines : list of tuple (text, x, y)
    boxes : list of Box
    """

    node: Node
    width: float
    height: float
    labels: list[Label] = field(default_factory=list)
    lines: list[tuple[str, float, float]] = field(default_factory=list)
    boxes: list[Box] = field(default_factory=list)
    x: float = 0.0
    y: float = 0.0

    @property
    def is_tower(self) -> bool:
        """Whether it is a frameless box around a node and what is stacked on it."""
        return self.node.key.endswith(TOWER)


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


def wrapped(text: str, width: float) -> list[str]:
    """Return the lines of a text of titles' size that is at most about `width` pixels wide."""
    if text_width(text) <= width:
        return [text]
    return textwrap.wrap(text, max(8, int(width / (text_width(text) / len(text))))) or [text]


def label(text: str, done: bool | None, width: float) -> Label:
    """Return a label of a width at most; its text wraps."""
    beside = 12.0 if done is None else 28.0  # a part of the goal has a tick or a ring
    lines = wrapped(text, (width - beside) / SMALL)
    return Label(lines, done, SMALL * max(map(text_width, lines)) + beside, TAG + LINE * (len(lines) - 1))


def label_rows(labels: Sequence[Label], width: float, x: float, y: float) -> Size:
    """Place labels in rows of a width, and return the size of all rows."""
    at, top, high, widest = 0.0, 0.0, 0.0, 0.0
    for one in labels:
        if at and at + one.width > width:
            at, top, high = 0.0, top + high + 4, 0.0
        one.x, one.y = x + at, y + top
        at += one.width + 6
        high, widest = max(high, one.height), max(widest, at - 6)
    return widest, (top + high + 4 if labels else 0.0)


class Arranger:
    """Lays out scenes of one task.

    Parameters
    ----------
    room : mapping of str to list of Node
        For each place, the objects that may be there, without contents; space is reserved for them.
    """

    def __init__(self, room: Mapping[str, list[Node]]) -> None:
        self.room = room

    def layouts(self, scenes: Sequence[Scene], width: float) -> list[Layout]:
        """Return layouts of scenes in pictures of approximately a width; an object is where it was, unless it moved."""
        return _Frames(self.room, scenes, width).layouts()


class _Frames:
    """Scenes that are laid out together.

    Attributes
    ----------
    cells : list of dict
        For each scene and place, the number of the cell of each object there.
    roots : list of str
        The nodes that are in no place in some scene, in their order.
    least : dict
        The largest size so far of the heading and the whole of each node, and of each cell.
    stacks : set of str
        Places in which objects are ever stacked; objects stand at the bottom of their cells there.
    mutual : set of str
        Objects that are in themselves if the scenes are taken together, as blocks that are taken for boxes: each is
        in the other at some time. Nothing is reserved in them.
    """

    def __init__(self, room: Mapping[str, list[Node]], scenes: Sequence[Scene], width: float) -> None:
        self.room, self.scenes, self.width = room, scenes, width
        self.least: dict[tuple[str, str | int], Size] = {}
        self.stacks: set[str] = set()
        self.cells: list[dict[str, dict[str, int]]] = []
        self.counts: dict[str, int] = {}
        self.roots: list[str] = []
        self._holds = {node.key: node.look.holds for scene in scenes for node in _every(scene.roots)}
        self._measured: set[str] = set()
        self._assign()
        within: dict[str, set[str]] = {}
        for scene in scenes:
            for place, nodes in _places(scene.roots):
                within.setdefault(place, set()).update(node.key for node in nodes)
        self.mutual = {place for place in within if place in _reached(place, within)}

    def layouts(self) -> list[Layout]:
        """Return the layout of each scene."""
        for _ in range(PASSES):
            before = dict(self.least)
            found = [self._layout(scene, cells) for scene, cells in zip(self.scenes, self.cells, strict=True)]
            if self.least == before:
                break
        return found

    def _assign(self) -> None:
        """Give each object a cell in each of its places: the one it has, else a former one, else the first free one."""
        present: dict[str, dict[str, int]] = {}
        former: dict[tuple[str, str], int] = {}
        for scene in self.scenes:
            here: dict[str, dict[str, int]] = {}
            for place, nodes in _places(scene.roots):
                homes, last = self._homes(place), present.get(place, {})
                found = {node.key: last[node.key] for node in nodes if node.key in last}
                for node in nodes:
                    if node.key not in found:
                        wanted = homes.get(node.key, former.get((place, node.key), -1))
                        free = next(cell for cell in range(len(nodes)) if cell not in found.values())
                        found[node.key] = free if wanted < 0 or wanted in found.values() else wanted
                        former[place, node.key] = found[node.key]
                    if node.on:
                        self.stacks.add(place)
                here[place] = found
                self.counts[place] = max(self.counts.get(place, 0), 1 + max(found.values()))
            present = here
            self.cells.append(here)
            at = 0
            for node in scene.roots:  # merge the orders of all scenes
                if node.key in self.roots:
                    at = self.roots.index(node.key) + 1
                else:
                    self.roots.insert(at, node.key)
                    at += 1
        self.counts[""] = len(self.roots)

    def _homes(self, place: str) -> dict[str, int]:
        """Return the cells of a place that has one for each object that may be there."""
        may = self.room.get(place, [])
        holds = self._holds.get(place) or (len(may) if "#" in place else 1)
        return {one.key: number for number, one in enumerate(may)} if holds == len(may) else {}

    def _layout(self, scene: Scene, cells: dict[str, dict[str, int]]) -> Layout:
        own = {"": {key: number for number, key in enumerate(self.roots)}, **cells}
        boxes = [self._tower(node, self.width, own) for node in scene.roots]
        if any(node.on for node in scene.roots):
            self.stacks.add("")
        return Layout(boxes, *self._rows("", boxes, self.width, own[""]))

    def _reserve(self, key: str, what: str | int, size: Size) -> Size:
        """Return the largest of all sizes of something so far."""
        before = (0.0, 0.0) if key in self.mutual and what != "head" else self.least.get((key, what), (0.0, 0.0))
        self.least[key, what] = max(before[0], size[0]), max(before[1], size[1])
        return self.least[key, what]

    def _held(self, place: str, boxes: list[Box], cells: dict[str, int], count: int) -> list[Size]:
        """Return the sizes of the cells of a place, which are enlarged for the boxes that are in them now."""
        if place in self.mutual:
            self.least |= {(place, cell): (0.0, 0.0) for cell in range(count)}
        for box in boxes:
            self._reserve(place, cells[_own(box)], (box.width, box.height))
        return [self.least.get((place, cell), (0.0, 0.0)) for cell in range(count)]

    def _tower(self, node: Node, width: float, cells: dict[str, dict[str, int]]) -> Box:
        """Return a node with the nodes that are stacked on it, in a frameless box around them."""
        base = self._box(node, width, cells)
        if not node.on:
            return base
        place = _top(node)
        above = [self._tower(one, width, cells) for one in node.on]
        across, _ = self._rows(place, above, math.inf, cells[place])
        high = max(one.height for one in above)
        for one in above:
            one.y = high - one.height
        whole = Box(Node(node.key + TOWER, "", replace(node.look, shape="block")), max(base.width, across), 0.0)
        base.y, whole.height = high + 2, high + 2 + base.height
        whole.boxes = [*above, base]
        return whole

    def _box(self, node: Node, width: float, cells: dict[str, dict[str, int]]) -> Box:
        labels, head = self._heading(node, width)
        box = Box(node, 0.0, 0.0, labels)
        box.boxes, size = self._inside(node, width - 2 * PAD, cells)
        for one in box.boxes:
            one.x, one.y = one.x + PAD, one.y + head[1]
        small = node.look.shape in (*FIXED, "block")
        box.width = max(head[0], LEAST, size[0] + 2 * PAD)
        box.height = head[1] + size[1] + (PAD if box.boxes or size[1] else 2 if small else 4)
        if node.notes:
            _add_notes(box, width)
        box.width, box.height = self._reserve(node.key, "whole", (box.width, box.height))
        return box

    def _heading(self, node: Node, width: float) -> tuple[list[Label], Size]:
        """Return the labels of a node, and the size of its title with them."""
        title = text_width(node.title) + (TAG if node.look.shape in ICONS else 0) + 2 * PAD
        inner = max(title - 2 * PAD, min(width - 2 * PAD, 200.0 if node.key != TASK else math.inf))
        wants = [label(text, done, inner) for text, done in node.wants]
        across, high = label_rows(wants, inner, PAD, HEAD)
        marks = [label(mark, None, inner) for mark in node.marks]
        beside = title + sum(mark.width + 6 for mark in marks)
        if beside <= BESIDE and all(len(mark.lines) == 1 for mark in marks):
            label_rows(marks, math.inf, title - PAD + 6, 4)
            title = beside
        else:
            wide, rows = label_rows(marks, inner, PAD, HEAD + high)
            across, high = max(across, wide), high + rows
        return [*marks, *wants], self._reserve(node.key, "head", (max(title, across + 2 * PAD), HEAD + high))

    def _inside(self, node: Node, width: float, cells: dict[str, dict[str, int]]) -> tuple[list[Box], Size]:
        """Return the boxes within a node and their size: movable objects first, then its parts, in rows."""
        parts = [self._box(one, width, cells) for one in node.inside if one.key.find("#") > 0]
        free = [self._tower(one, width, cells) for one in node.inside if one.key.find("#") < 1]
        size = self._fill(node, free, width, cells.get(node.key, {}))
        if not parts:
            return free, size
        room = Box(node, *size, boxes=free)
        whole = _in_rows([room, *parts] if size[1] else parts, width)
        for box in free:
            box.x, box.y = box.x + room.x, box.y + room.y
        return [*free, *parts], whole

    def _fill(self, node: Node, boxes: list[Box], width: float, cells: dict[str, int]) -> Size:
        """Place boxes in a node with reserved space, and return their total size; objects of one shape form a grid."""
        may = self.room.get(node.key, [])
        sizes = [self._size(one, width) for one in may]
        if len({one.look.shape for one in may}) != 1:
            size = self._rows(node.key, boxes, width, cells)
            return max([size[0], *(one[0] for one in sizes)]), max([size[1], *(one[1] for one in sizes)])
        count = node.look.holds or (1 if node.is_object else len(may))
        count = max(count, self.counts.get(node.key, 0))
        held = self._held(node.key, boxes, cells, count)
        wide = max(one[0] for one in [*sizes, *held])
        high = max(max(one[1] for one in sizes) * min(node.look.high, len(may)), *(one[1] for one in held))
        # Up to four boxes form one row; more form a grid that is slightly wider than high.
        few = count if node.look.high > 1 or count <= 4 else math.ceil(math.sqrt(count)) + 2
        columns = max(1, min(few, int((width + GAP) // (wide + GAP))))
        stands = node.look.high > 1 or node.key in self.stacks
        for box in boxes:
            row, column = divmod(cells[_own(box)], columns)
            _widen(box, wide, centred=stands)
            box.x += column * (wide + GAP)
            box.y = row * (high + GAP) + (high - box.height) * stands
        rows = math.ceil(count / columns)
        return columns * (wide + GAP) - GAP, rows * (high + GAP) - GAP

    def _rows(self, place: str, boxes: list[Box], width: float, cells: dict[str, int]) -> Size:
        """Place boxes in the cells of a place, which form rows of a width, and return the total size."""
        blank = Node("", "", HEADING)
        free = [Box(blank, *size) for size in self._held(place, boxes, cells, self.counts.get(place, 0))]
        size = _in_rows([cell for cell in free if cell.width], width)
        for box in boxes:
            cell = free[cells[_own(box)]]
            stands = place in self.stacks
            if stands:
                _widen(box, cell.width, centred=True)
            elif box.node.look.shape in ("panel", "slot"):
                box.height = cell.height
            box.x, box.y = box.x + cell.x, cell.y + (cell.height - box.height) * stands
        return size

    def _size(self, node: Node, width: float) -> Size:
        """Return the size of an empty node with its reserved space; a place that contains itself reserves none."""
        if node.key in self._measured:
            return LEAST, HEAD
        self._measured.add(node.key)
        head = self.least.get((node.key, "head"), (text_width(node.title) + 2 * PAD, HEAD))
        size = self._fill(node, [], width - 2 * PAD, {}) if self.room.get(node.key) else (0.0, 0.0)
        self._measured.remove(node.key)
        small = node.look.shape in (*FIXED, "block")
        icon = TAG if node.look.shape in ICONS else 0.0
        wide = max(head[0] + icon, LEAST, size[0] + 2 * PAD)
        return wide, head[1] + size[1] + (PAD if size[1] else 2 if small else 4)


def _every(nodes: Sequence[Node]) -> Iterator[Node]:
    """Yield nodes with all that is in or on them."""
    for node in nodes:
        yield node
        yield from _every(node.inside)
        yield from _every(node.on)


def _reached(place: str, within: Mapping[str, set[str]]) -> set[str]:
    """Return all that is ever in a place, at any depth."""
    found, waiting = set[str](), [place]
    while waiting:
        new = within.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


def _own(box: Box) -> str:
    """Return the key of the node that a box shows, or that a tower stands on."""
    return box.node.key.removesuffix(TOWER)


def _top(node: Node) -> str:
    """Return the place on a node."""
    return f"{node.key}##top"


def _places(roots: Sequence[Node]) -> Iterator[tuple[str, list[Node]]]:
    """Yield each place with the movable nodes in it."""
    for node in _every(roots):
        free = [one for one in node.inside if one.key.find("#") < 1]
        if free:
            yield node.key, free
        if node.on:
            yield _top(node), node.on


def _widen(box: Box, width: float, *, centred: bool) -> None:
    """Widen a box to a width, a tower with all that is not placed in cells; a shape of fixed width is centred."""
    if box.is_tower:
        *above, base = box.boxes
        across = max((one.x + one.width for one in above), default=0.0)
        if len(above) == 1:
            above[0].x = 0.0
            _widen(above[0], width, centred=True)
        else:
            for one in above:
                one.x += (width - across) / 2
        _widen(base, width, centred=True)
        box.width = max(box.width, width)
    elif box.node.look.shape not in FIXED:
        box.width = max(box.width, width)
    elif centred:
        box.x = (width - box.width) / 2


def _add_notes(box: Box, width: float) -> None:
    """Write the connections of a node below the contents of its box."""
    letters = max(12, int((max(box.width, min(width, 240)) - 2 * PAD) / 7))
    lines = textwrap.wrap(f"to {', '.join(box.node.notes)}", letters)
    for number, line in enumerate(lines):
        box.lines.append((line, PAD, box.height + 10 + NOTE * number))
    box.width = max(box.width, *(SMALL * text_width(line) + 2 * PAD for line in lines))
    box.height += NOTE * len(lines) + 4


def _in_rows(boxes: list[Box], width: float) -> Size:
    """Place boxes in rows of a width, with one height per row, and return their total size."""
    at, y, high, widest = 0.0, 0.0, 0.0, 0.0
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
    return widest, max(0.0, y - GAP)
