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
from .layout import TAG, Layout, text_width
from .picture import MARGIN, WIDTH, Artist, Picture

CAPTION = 3 * TAG
"""Height of the caption of a frame, in pixels: title, action and advice; goals are a further line."""


class FramesError(ValueError):
    """A plan or a trace cannot be drawn; the message states the reason."""


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


def plan_frames(artist: Artist, plan: Sequence[str]) -> list[Row]:
    """Return the frames of a plan as one row: one before each action, and one at the end.

    Parameters
    ----------
    artist : Artist
    plan : sequence of str
        Ground actions, as `(name arg ...)` or `name(arg, ...)`.

    Raises
    ------
    FramesError
        An action is not applicable in its state.
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
    FramesError
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
        raise FramesError("the trace is empty")
    matching = [name for name in names if name == episode or name.endswith(f"-{episode}")]
    episode = names[0] if episode is None else matching[0] if len(matching) == 1 else episode
    if episode not in names:
        raise FramesError(f"episode {episode!r}: the trace has {', '.join(names[:10])}{' ...' * (len(names) > 10)}")
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
        raise FramesError(f"{where}: {error}") from None


def _check_steps(rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise an error if a row of an episode has no step, or if a person has two rows for one."""
    seen = set()
    for row in rows:
        where, step = f"{row.get('person')}, {row.get('episode')}", row.get("step")
        if not isinstance(step, int | np.integer) or isinstance(step, bool):
            raise FramesError(f"{where}: step {json.dumps(step, default=str)}; expected a whole number in every row")
        if (row.get("person"), step) in seen:
            raise FramesError(f"{where}, step {step}: in two rows; are these two episodes, or two people?")
        seen.add((row.get("person"), step))


def _robot_places(rows: Iterable[Mapping[str, Any]], step: int) -> list[int | None]:
    row = next((row for row in rows if row["step"] == step), {})
    return row.get("robot_places", [row.get("robot_place")])


def _frame(
    artist: Artist, values: Sequence[int], person: str, step: int, row: Mapping[str, Any] | None, place: int,
    robots: list[int | None],
) -> Frame:  # fmt: skip
    title = f"{person}, step {step + 1}"
    if row is None or not (row.get("action") or row.get("executed")):
        return Frame(tuple(values), title, "has finished" if row is None else "waits")
    action, suggestion, executed = row.get("action"), row.get("suggestion"), row.get("executed")
    helped = suggestion or executed
    there = place in robots if {"robot_place", "robot_places"} & set(row) else helped is not None
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
    """Draw all frames in one picture: a plan wraps into several lines, an episode has one line for each person.

    Parameters
    ----------
    artist : Artist
    rows : list of tuple of Frame
    width : float
        In pixels. A frame takes about half of it, and a line of a plan about twice of it.
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
                *svg.draw_layout(cell[frame], x, y + _caption_height(frame), frame.acted, frame.hint),
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
                *svg.draw_layout(cell[frame], x, y + _caption_height(frame), frame.acted, frame.hint),
            ]
            texts.append(frame.text())
        text = " ".join(texts)
        whole = 2 * MARGIN + across * size[0], 2 * MARGIN + -(-len(rows) // across) * size[1]
        title = f"{artist.subject.task.name}: step {step + 1} of {len(rows[0])}"
        pictures.append(Picture(svg.document(parts, *whole, title, text, theme), text, *whole))
    return pictures


def _cells(artist: Artist, rows: Sequence[Row], width: float) -> tuple[dict[Frame, Layout], tuple[float, float]]:
    """Return the layouts of all frames, and the size of a cell in which each fits."""
    found = {frame: artist.layout(frame.values, width) for row in rows for frame in row}
    words = max(text_width(line) for frame in found for line in (frame.title, frame.done, frame.advice, frame.goals))
    wide = max(words + 10, *(layout.width for layout in found.values()))
    high = max(layout.height for layout in found.values())
    return found, (wide + 2 * MARGIN, high + max(map(_caption_height, found)) + MARGIN)


def _caption_height(frame: Frame) -> float:
    return CAPTION + (TAG if frame.goals else 0)


def _caption(frame: Frame, x: float, y: float) -> list[str]:
    """Return the caption of a frame: title, action, advice and goals, with an icon if the robot is there."""
    parts = []
    if frame.robot:
        parts.append(svg.icon("robot", x, y, "ka-here"))
    parts.append(svg.text(x + (24 if frame.robot else 0), y + 14, frame.title, "ka-title"))
    parts.append(svg.text(x, y + 14 + TAG, frame.done))
    if frame.advice:
        parts.append(svg.text(x, y + 14 + 2 * TAG, frame.advice, "ka-said"))
    if frame.goals:
        parts.append(svg.text(x, y + 14 + 3 * TAG, frame.goals, "ka-small"))
    return parts
