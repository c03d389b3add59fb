"""Plans and episodes, picture by picture.

A frame is a state with what was done in it. A plan is one row of frames; an episode has a row for each person, with
the robot where it was and what it suggested.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..people.action_names import words_of
from . import svg
from .layout import Layout, text_width
from .picture import MARGIN, WIDTH, Artist, Picture

CAPTION = 22.0
LINES = 3
"""Of text above a frame."""


class FramesError(ValueError):
    """A plan or a trace that cannot be drawn; the message says why."""


@dataclass(frozen=True)
class Frame:
    """A state with what was done in it.

    Attributes
    ----------
    values : tuple of int
    title : str
        When, and of whom.
    done : str
        What was done, in words.
    advice : str
        What was suggested and whether it was followed; empty for nothing.
    acted, hint : frozenset of str
        The objects of both.
    robot : bool
        Whether the robot was there.
    """

    values: tuple[int, ...]
    title: str
    done: str = ""
    advice: str = ""
    acted: frozenset[str] = frozenset()
    hint: frozenset[str] = frozenset()
    robot: bool = False

    def text(self) -> str:
        """Say in one line what happens."""
        return " ".join(part for part in (f"{self.title}:", self.done or "the end.", self.advice) if part)


Row = tuple[Frame, ...]


def plan_frames(artist: Artist, plan: Sequence[str]) -> list[Row]:
    """Follow a plan: a frame before each action, and one at the end.

    Parameters
    ----------
    artist : Artist
    plan : sequence of str
        Ground actions, as `(name arg ...)` or `name(arg, ...)`.

    Raises
    ------
    FramesError
        An action cannot be applied where its turn comes.
    """
    values, frames = artist.subject.initial, []
    for step, text in enumerate(plan):
        action, after = _meant(artist, text, values, f"step {step}")
        frames.append(
            Frame(tuple(values), f"Step {step + 1} of {len(plan)}", artist.say(action), acted=_objects(action))
        )
        values = after
    return [(*frames, Frame(tuple(values), "End"))]


def episode_frames(artist: Artist, trace: Iterable[Mapping[str, Any]], episode: str | None = None) -> list[Row]:
    """Follow everybody of an episode: a row for each person, all equally long.

    Parameters
    ----------
    artist : Artist
    trace : iterable of mapping
        What `simulate --trace` writes, or any log of recorded actions.
    episode : str, optional
        The name of one, or its number where it ends in that; the first of the trace unless given.

    Raises
    ------
    FramesError
        There is no such episode, or its actions are not those of the task.
    """
    rows = list(trace)
    names = list(dict.fromkeys(str(row.get("episode")) for row in rows))
    if not names:
        raise FramesError("the trace is empty")
    matching = [name for name in names if name == episode or name.endswith(f"-{episode}")]
    episode = names[0] if episode is None else matching[0] if len(matching) == 1 else episode
    if episode not in names:
        raise FramesError(f"episode {episode!r}: the trace has {', '.join(names[:10])}{' ...' * (len(names) > 10)}")
    mine = [row for row in rows if str(row.get("episode")) == episode]
    people = list(dict.fromkeys(str(row.get("person")) for row in mine))
    steps = sorted({int(row["step"]) for row in mine})
    found = []
    for place, person in enumerate(people):
        own = {int(row["step"]): row for row in mine if str(row.get("person")) == person}
        values, frames = artist.subject.initial, []
        for step in steps:
            row, after = own.get(step), values
            if row is not None:
                place_in = f"{person}, {episode}, step {step}"
                row = dict(row)
                if row.get("suggestion"):
                    row["suggestion"] = _meant(artist, row["suggestion"], values, place_in)[0]
                if row.get("action"):
                    row["action"], after = _meant(artist, row["action"], values, place_in)
            frames.append(_frame(artist, values, person, step, row, place, _robot_place(mine, step)))
            values = after
        found.append((*frames, Frame(tuple(values), f"{person}, end")))
    return found


def _meant(artist: Artist, text: str, values: Sequence[int], where: str) -> tuple[str, list[int]]:
    try:
        return artist.subject.meant(str(text), values)
    except ValueError as error:
        raise FramesError(f"{where}: {error}") from None


def _robot_place(rows: Iterable[Mapping[str, Any]], step: int) -> int | None:
    return next((row.get("robot_place") for row in rows if row["step"] == step), None)


def _frame(
    artist: Artist, values: Sequence[int], person: str, step: int, row: Mapping[str, Any] | None, place: int,
    robot: int | None,
) -> Frame:  # fmt: skip
    title = f"{person}, step {step + 1}"
    if row is None or not row.get("action"):
        return Frame(tuple(values), title, "has finished" if row is None else "waits")
    action, suggestion = str(row["action"]), row.get("suggestion")
    there = place == robot if "robot_place" in row else suggestion is not None
    if suggestion is None:
        return Frame(tuple(values), title, artist.say(action), acted=_objects(action), robot=there)
    followed = suggestion == action
    advice = f"robot: {artist.say(str(suggestion))} ({'followed' if followed else 'not followed'})"
    return Frame(tuple(values), title, artist.say(action), advice, _objects(action), _objects(str(suggestion)), there)


def _objects(action: str) -> frozenset[str]:
    return frozenset(words_of(action)[1:])


def draw_strip(artist: Artist, rows: Sequence[Row], *, width: float = WIDTH, theme: svg.Theme = "auto") -> Picture:
    """Draw all frames side by side; one row of a plan in several lines, an episode with a line for each person.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    width : float
        In pixels. Each frame is about half as wide, a line of a plan's frames about twice.
    theme : "auto", "light" or "dark"
    """
    cell, size = _cells(artist, rows, width / 2)
    columns = len(rows[0]) if len(rows) > 1 else max(1, int(width * 2 // size[0]))
    parts, texts = [], []
    for number, row in enumerate(rows):
        for place, frame in enumerate(row):
            line, column = divmod(place, columns)
            x, y = MARGIN + column * size[0], MARGIN + (number + line) * size[1]
            parts.append(f'<g class="ka-step" data-step="{place}">')
            parts += [
                *_caption(frame, x, y),
                *svg.draw_layout(cell[frame], x, y + LINES * CAPTION, frame.acted, frame.hint),
            ]
            parts.append("</g>")
            texts.append(frame.text())
    lines = len(rows) if len(rows) > 1 else -(-len(rows[0]) // columns)
    across, high = 2 * MARGIN + min(columns, len(rows[0])) * size[0], 2 * MARGIN + lines * size[1]
    name = f"{artist.subject.task.name}: {'a plan' if len(rows) == 1 else 'an episode'}"
    text = " ".join(texts)
    return Picture(svg.document(parts, across, high, name, text, theme), text, across, high)


def draw_frames(
    artist: Artist, rows: Sequence[Row], *, width: float = WIDTH, theme: svg.Theme | None = "auto"
) -> list[Picture]:
    """Draw one picture for each step, everybody in it; all are of one size.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    width : float
        About how wide each picture is to be, in pixels.
    theme : "auto", "light", "dark" or None
    """
    across = 1 if len(rows) == 1 else 2
    cell, size = _cells(artist, rows, width / across)
    pictures = []
    for step in range(len(rows[0])):
        parts, texts = [], []
        for number, row in enumerate(rows):
            line, column = divmod(number, across)
            x, y = MARGIN + column * size[0], MARGIN + line * size[1]
            frame = row[step]
            parts += [
                *_caption(frame, x, y),
                *svg.draw_layout(cell[frame], x, y + LINES * CAPTION, frame.acted, frame.hint),
            ]
            texts.append(frame.text())
        text = " ".join(texts)
        whole = 2 * MARGIN + across * size[0], 2 * MARGIN + -(-len(rows) // across) * size[1]
        title = f"{artist.subject.task.name}: step {step + 1} of {len(rows[0])}"
        pictures.append(Picture(svg.document(parts, *whole, title, text, theme), text, *whole))
    return pictures


def _cells(artist: Artist, rows: Sequence[Row], width: float) -> tuple[dict[Frame, Layout], tuple[float, float]]:
    """Lay out all frames; give the size that each may take."""
    found = {frame: artist.layout(frame.values, width) for row in rows for frame in row}
    words = max(text_width(line) for frame in found for line in (frame.title, frame.done, frame.advice))
    wide = max(words + 10, *(layout.width for layout in found.values()))
    high = max(layout.height for layout in found.values())
    return found, (wide + 2 * MARGIN, high + LINES * CAPTION + MARGIN)


def _caption(frame: Frame, x: float, y: float) -> list[str]:
    """Write what happens above a frame, with the robot where it is there."""
    parts = []
    if frame.robot:
        parts.append(svg.icon("robot", x, y, "ka-here"))
    parts.append(svg.text(x + (24 if frame.robot else 0), y + 14, frame.title, "ka-title"))
    parts.append(svg.text(x, y + 14 + CAPTION, frame.done))
    if frame.advice:
        parts.append(svg.text(x, y + 14 + 2 * CAPTION, frame.advice, "ka-said"))
    return parts
