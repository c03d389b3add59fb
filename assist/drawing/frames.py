"""Sequences of frames that show plans and episodes.

A frame is a state and the action taken in it. A plan is one row of frames. An episode has one row for each person, with
the robot's location and its suggestions.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..people.action_names import words_of
from . import svg
from .layout import TAG, Layout, text_width, wrapped
from .picture import MARGIN, WIDTH, Artist, Picture

ICON = 24.0
"""Width of the robot's icon in a title."""


@dataclass(frozen=True)
class Frame:
    """A state and the action taken in it.

    Attributes
    ----------
    values : tuple of int
        The values of the state, one per variable.
    title : str
        The person and the step.
    done : str
        The action, in words.
    advice : str
        The suggestion, and whether it was followed; or what the robot did itself. Empty without either.
    acted, hint : frozenset of str
        The objects of the action, and those of the suggestion or of the robot's own action.
    robot : bool
        Whether the robot was with this person.
    goals : str
        The probable goals of the person; empty if the goal is known.
    """

    values: tuple[int, ...]
    title: str
    done: str = ""
    advice: str = ""
    acted: frozenset[str] = frozenset()
    hint: frozenset[str] = frozenset()
    robot: bool = False
    goals: str = ""

    def text(self) -> str:
        """Return one line that describes the frame."""
        return " ".join(part for part in (f"{self.title}:", self.done or "the end.", self.advice, self.goals) if part)


Row = tuple[Frame, ...]


def plan_frames(artist: Artist, plan: Sequence[str], start: Sequence[int] | None = None) -> list[Row]:
    """Return the frames of a plan as one row: one before each action, and one at the end.

    Parameters
    ----------
    artist : Artist
    plan : sequence of str
        Ground actions, as `(name arg ...)` or `name(arg, ...)`.
    start : sequence of int, shape (variables,), optional
        Values of the state in which it begins; the initial one unless given.

    Raises
    ------
    ValueError
        An action is not applicable in its state.
    """
    values, frames = artist.subject.initial if start is None else start, []
    for step, text in enumerate(plan):
        action, after = _meant(artist, text, values, f"step {step}")
        frames.append(
            Frame(tuple(values), f"Step {step + 1} of {len(plan)}", artist.say(action), acted=_objects(action))
        )
        values = after
    return [(*frames, Frame(tuple(values), "End"))]


def episode_frames(artist: Artist, trace: Iterable[Mapping[str, Any]], episode: str | None = None) -> list[Row]:
    """Return the frames of an episode: one row for each person, all of one length.

    Parameters
    ----------
    artist : Artist
    trace : iterable of mapping
        The rows of `simulate --trace`, or of any log of recorded actions.
    episode : str, optional
        The name of an episode, or the number that ends its name. The first of the trace unless given.

    Raises
    ------
    ValueError
        The trace has no such episode, a row has no step or that of another row, or an action is not applicable in its
        state.
    """
    mine = episode_of(list(trace), episode)
    _check_steps(mine)
    people = list(dict.fromkeys(str(row.get("person")) for row in mine))
    steps = sorted({int(row["step"]) for row in mine})
    found = []
    for place, person in enumerate(people):
        own = {int(row["step"]): row for row in mine if str(row.get("person")) == person}
        values, frames = artist.subject.initial, []
        for step in steps:
            row, after = own.get(step), values
            if row is not None:
                place_in = f"{person}, {row.get('episode')}, step {step}"
                row = dict(row)
                if row.get("suggestion"):
                    row["suggestion"] = _meant(artist, row["suggestion"], values, place_in)[0]
                if row.get("executed"):
                    row["executed"], after = _meant(artist, row["executed"], values, place_in)
                if row.get("action"):
                    row["action"], after = _meant(artist, row["action"], after, place_in)
            frames.append(_frame(artist, values, person, step, row, place, _robot_places(mine, step)))
            values = after
        found.append((*frames, Frame(tuple(values), f"{person}, end")))
    return found


def episode_of(rows: Sequence[Mapping[str, Any]], episode: str | None = None) -> list[Mapping[str, Any]]:
    """Return the rows of one episode of a trace; parameters and errors as in `episode_frames`."""
    names = list(dict.fromkeys(str(row.get("episode")) for row in rows))
    if not names:
        raise ValueError("the log is empty")
    matching = [name for name in names if name == episode or name.endswith(f"-{episode}")]
    episode = names[0] if episode is None else matching[0] if len(matching) == 1 else episode
    if len(matching) > 1 and episode not in matching:
        raise ValueError(f"episode {episode!r}: expected one of {', '.join(matching[:10])}")
    if episode not in names:
        raise ValueError(f"episode {episode!r}: the log has {', '.join(names[:10])}{' ...' * (len(names) > 10)}")
    return [row for row in rows if str(row.get("episode")) == episode]


def with_goals(rows: Sequence[Row], shares: Sequence[Sequence[Mapping[str, float]]], *, most: int = 3) -> list[Row]:
    """Return frames with the most probable goals of each person at each time.

    Parameters
    ----------
    rows : list of tuple of Frame
    shares : sequence, shape (people, frames), of mapping of str to float
        The probability of each goal.
    most : int
        Number of goals that are named.
    """

    def named(share: Mapping[str, float]) -> str:
        first = sorted(share, key=lambda name: -share[name])[:most]
        return f"goal: {', '.join(f'{name} {share[name]:.0%}' for name in first)}{', ...' * (len(share) > most)}"

    return [
        tuple(replace(frame, goals=named(share)) for frame, share in zip(row, own, strict=True))
        for row, own in zip(rows, shares, strict=True)
    ]


def _meant(artist: Artist, text: str, values: Sequence[int], where: str) -> tuple[str, list[int]]:
    try:
        return artist.subject.meant(str(text), values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _check_steps(rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise an error if a row of an episode has no step, or if a person has two rows for one."""
    seen = set()
    for row in rows:
        where, step = f"{row.get('person')}, {row.get('episode')}", row.get("step")
        if not isinstance(step, int | np.integer) or isinstance(step, bool):
            raise ValueError(f"{where}: step {json.dumps(step, default=str)}; expected a whole number in every row")  # noqa: TRY004
        if (row.get("person"), step) in seen:
            raise ValueError(f"{where}, step {step}: in two rows; are these two episodes, or two people?")
        seen.add((row.get("person"), step))


def _robot_places(rows: Iterable[Mapping[str, Any]], step: int) -> list[int | None]:
    row = next((row for row in rows if row["step"] == step), {})
    return row.get("robot_places", [])


def _frame(
    artist: Artist, values: Sequence[int], person: str, step: int, row: Mapping[str, Any] | None, place: int,
    robots: list[int | None],
) -> Frame:  # fmt: skip
    title = f"{person}, step {step}"
    if row is None or not (row.get("action") or row.get("executed")):
        return Frame(tuple(values), title, "has finished" if row is None else "waits")
    action, suggestion, executed = row.get("action"), row.get("suggestion"), row.get("executed")
    helped = suggestion or executed
    there = place in robots if "robot_places" in row else helped is not None
    done = artist.say(str(action)) if action else "waits"
    advice = ""
    if executed:
        advice = f"robot does: {artist.say(str(executed))}"
    elif suggestion:
        advice = f"robot: {artist.say(str(suggestion))} ({'followed' if suggestion == action else 'not followed'})"
    acted, hint = (_objects(str(one)) if one else frozenset() for one in (action, helped))
    return Frame(tuple(values), title, done, advice, acted, hint, there)


def _objects(action: str) -> frozenset[str]:
    return frozenset(words_of(action)[1:])


def draw_strip(artist: Artist, rows: Sequence[Row], *, width: float = WIDTH, theme: svg.Theme = "auto") -> Picture:
    """Draw all frames in one picture, in lines of its width; in an episode, one for each person below each other.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    width : float
        In pixels. A frame takes about half of it.
    theme : "auto", "light" or "dark"
    """
    cells, columns = _Cells.in_columns(artist, rows, width, min(2, len(rows[0])))
    columns = min(len(rows[0]), max(columns, int((width - 2 * MARGIN) // cells.width)))
    parts = []
    for number, row in enumerate(rows):
        for place in range(len(row)):
            line, column = divmod(place, columns)
            x, y = MARGIN + column * cells.width, MARGIN + (line * len(rows) + number) * cells.height
            parts += [f'<g class="ka-step" data-step="{place}">', *cells.draw(number, place, x, y), "</g>"]
    lines = len(rows) * -(-len(rows[0]) // columns)
    across, high = 2 * MARGIN + columns * cells.width, 2 * MARGIN + lines * cells.height
    name = f"{artist.subject.task.name}: {'a plan' if len(rows) == 1 else 'an episode'}"
    text = " ".join(frame.text() for row in rows for frame in row)
    return Picture(svg.document(parts, across, high, name, text, theme), text, across, high)


def draw_frames(
    artist: Artist, rows: Sequence[Row], *, width: float = WIDTH, theme: svg.Theme | None = "auto"
) -> list[Picture]:
    """Draw one picture for each step, with all people in it; all pictures have one size.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    width : float
        Approximate width of a picture, in pixels.
    theme : "auto", "light", "dark" or None
        The colours; None omits the style sheet, for pages that include it.
    """
    cells, across = _Cells.in_columns(artist, rows, width, min(2, len(rows)))
    pictures = []
    for step in range(len(rows[0])):
        parts, texts = [], []
        for number, row in enumerate(rows):
            line, column = divmod(number, across)
            parts += cells.draw(number, step, MARGIN + column * cells.width, MARGIN + line * cells.height)
            texts.append(row[step].text())
        text = " ".join(texts)
        whole = 2 * MARGIN + across * cells.width, 2 * MARGIN + -(-len(rows) // across) * cells.height
        title = f"{artist.subject.task.name}: step {step + 1} of {len(rows[0])}"
        pictures.append(Picture(svg.document(parts, *whole, title, text, theme), text, *whole))
    return pictures


@dataclass(frozen=True)
class _Cells:
    """Frames of one size, each with a caption.

    Attributes
    ----------
    rows : sequence of Row
    layouts : list of list of Layout
        For each frame.
    captions : list of list of list of (str, str)
        For each frame, lines with their classes.
    top : float
        Height of the captions.
    width, height : float
        Size of a cell.
    """

    rows: Sequence[Row]
    layouts: list[list[Layout]]
    captions: list[list[list[tuple[str, str]]]]
    top: float
    width: float
    height: float

    @classmethod
    def in_columns(cls, artist: Artist, rows: Sequence[Row], width: float, columns: int) -> tuple[_Cells, int]:
        """Lay out frames in columns of a picture; in one as wide as the picture if they do not fit otherwise."""
        cells = cls.of(artist, rows, (width - 2 * MARGIN) / columns)
        if columns == 1 or columns * cells.width <= width - 2 * MARGIN + 1:
            return cells, columns
        return cls.of(artist, rows, width - 2 * MARGIN), 1

    @classmethod
    def of(cls, artist: Artist, rows: Sequence[Row], width: float) -> _Cells:
        """Lay out frames in cells of about a width, margin included."""
        inner = width - MARGIN
        found = artist.layouts([frame.values for row in rows for frame in row], inner)
        layouts = [found[number * len(row) : (number + 1) * len(row)] for number, row in enumerate(rows)]
        captions = [[_caption(frame, inner) for frame in row] for row in rows]
        lines = [line for row in captions for caption in row for line, _ in caption]
        top = TAG * max(len(caption) for row in captions for caption in row) + TAG / 2
        wide = max(*(layout.width for layout in found), *(text_width(line) for line in lines))
        return cls(rows, layouts, captions, top, wide + MARGIN, top + max(one.height for one in found) + MARGIN)

    def draw(self, row: int, step: int, x: float, y: float) -> list[str]:
        """Return the elements of a frame: its caption, with an icon if the robot is there, and the state."""
        frame, parts = self.rows[row][step], []
        if frame.robot:
            parts.append(svg.icon("robot", x, y, "ka-here"))
        for number, (line, css) in enumerate(self.captions[row][step]):
            indent = ICON if frame.robot and not number else 0
            parts.append(svg.text(x + indent, y + 14 + TAG * number, line, *filter(None, [css])))
        return [*parts, *svg.draw_layout(self.layouts[row][step], x, y + self.top, frame.acted, frame.hint)]


def _caption(frame: Frame, width: float) -> list[tuple[str, str]]:
    """Return the lines of the caption of a frame, each with its class: title, action, advice and goals."""
    found = [(frame.title, "ka-title")]
    for text, css in ((frame.done, ""), (frame.advice, "ka-said"), (frame.goals, "ka-small")):
        found += [(line, css) for line in wrapped(text, width)] if text else []
    return found
