"""SVG elements of drawings, light and dark colours, and descriptions for screen readers."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache
from html import escape
from pathlib import Path
from typing import Literal

from .layout import HEAD, ICONS, LINE, PAD, TAG, Box, Label, Layout

Theme = Literal["auto", "light", "dark"]
LIGHT = {
    "ink": "#1d2430", "quiet": "#596273", "paper": "#ffffff", "panel": "#eef1f5", "card": "#ffffff", "line": "#8d96a5",
    "crate": "#fbf6ec", "wood": "#9a7b4f", "someone": "#e8f1fb", "accent": "#0b62b8", "hint": "#b3400a",
    "done": "#0a7a4b", "done-soft": "#e2f5ec", "open": "#8d96a5", "mark": "#f3e3b5",
}  # fmt: skip
DARK = {
    "ink": "#e8ebf0", "quiet": "#a7b0bf", "paper": "#14181e", "panel": "#1f252d", "card": "#2a313b", "line": "#6d7888",
    "crate": "#332d22", "wood": "#b3915f", "someone": "#1b3147", "accent": "#6db3f8", "hint": "#ff9d5c",
    "done": "#4cc38a", "done-soft": "#16392a", "open": "#6d7888", "mark": "#55481c",
}  # fmt: skip
ICON_PATHS = {
    "person": "M9 8.5a3 3 0 1 0 0-6 3 3 0 0 0 0 6M3 17c0-4 3-6 6-6s6 2 6 6",
    "robot": "M4 7h10v8H4zM9 7V3M9 3h.1M7 11h.1M11 11h.1M2 10v3M16 10v3",
    "van": "M2 5h9v8H2zM11 8h3l2 3v2h-5zM6.5 14a1.5 1.5 0 1 1-3 0M14.5 14a1.5 1.5 0 1 1-3 0",
    "tray": "M2 8l2 5h10l2-5",
    "locker": "M4 2h10v14H4zM11 8v2",
    "parcel": "M3 5h12v10H3zM3 8h12M9 5v3",
}
ROUND = {
    "chip": 15.0,
    "ball": 15.0,
    "panel": 10.0,
    "person": 12.0,
    "robot": 12.0,
    "crate": 4.0,
    "block": 2.0,
    "locker": 2.0,
}


@cache
def rules() -> str:
    """Return the style sheet of all drawings, with variables for the colours."""
    return Path(__file__).with_name("drawing.css").read_text(encoding="utf-8")


def variables(colours: dict[str, str]) -> str:
    """Return the CSS declarations of colours."""
    return "".join(f"--ka-{name}:{value};" for name, value in colours.items())


@cache
def style(theme: Theme = "auto") -> str:
    """Return the complete style sheet: both themes for "auto", else one theme without variables."""
    if theme == "auto":
        dark = f"@media(prefers-color-scheme:dark){{.ka{{{variables(DARK)}}}}}"
        return f".ka{{{variables(LIGHT)}}}\n{dark}\n{rules()}"
    colours = LIGHT if theme == "light" else DARK
    return re.sub(r"var\(--ka-([a-z-]+)\)", lambda name: colours[name[1]], rules())


def number(value: float) -> str:
    """Return a length in pixels as text, to a tenth."""
    return f"{value:.1f}".removesuffix(".0")


def text(x: float, y: float, content: str, *classes: str, anchor: str = "start") -> str:
    """Return a line of text."""
    named = f' class="{" ".join(classes)}"' if classes else ""
    middle = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{number(x)}" y="{number(y)}"{named}{middle}>{escape(content)}</text>'


def rectangle(x: float, y: float, width: float, height: float, css: str, radius: float = 0.0) -> str:
    """Return a rectangle with rounded corners."""
    return (
        f'<rect class="{css}" x="{number(x)}" y="{number(y)}" width="{number(width)}" height="{number(height)}"'
        f' rx="{number(radius)}"/>'
    )


def draw_label(label: Label, x: float, y: float) -> list[str]:
    """Return the elements of a mark, or of a part of the goal with a tick if it holds and else a ring."""
    x, y = x + label.x, y + label.y
    css = {None: "ka-mark", True: "ka-tag-done", False: "ka-tag"}[label.done]
    parts = [rectangle(x, y, label.width, label.height, css, 5)]
    if label.done:
        parts.append(f'<path class="ka-tick" d="M{number(x + 7)} {number(y + 11)}l3 3.5 5.5-7"/>')
    elif label.done is not None:
        parts.append(f'<circle class="ka-ring" cx="{number(x + 11)}" cy="{number(y + TAG / 2)}" r="4"/>')
    at = x + (6 if label.done is None else 20)
    return [*parts, *(text(at, y + 15 + LINE * n, line, "ka-small") for n, line in enumerate(label.lines))]


def icon(name: str, x: float, y: float, *classes: str) -> str:
    """Return one of the icons."""
    named = " ".join(("ka-icon", *classes))
    return f'<path class="{named}" transform="translate({number(x)} {number(y)})" d="{ICON_PATHS[name]}"/>'


def draw_box(box: Box, x: float, y: float, acted: Collection[str], hint: Collection[str]) -> list[str]:
    """Return the elements of a box and its contents, at absolute coordinates."""
    x, y = x + box.x, y + box.y
    node, shape = box.node, box.node.look.shape
    inner = [part for one in box.boxes for part in draw_box(one, x, y, acted, hint)]
    if box.is_tower:
        return inner
    named = f' data-object="{escape(node.key)}"' if node.is_object else ""
    classes = ["ka-node", f"ka-{shape}"]
    classes += [
        name
        for name, so in (("ka-done", node.done), ("ka-acted", node.key in acted), ("ka-hint", node.key in hint))
        if so
    ]
    parts = [f'<g class="{" ".join(classes)}"{named}>']
    parts.append(rectangle(x, y, box.width, box.height, "ka-frame", ROUND.get(shape, 6.0)))
    if node.colour is not None:
        colour = f"ka-{node.colour % 8}"  # `drawing.css` has eight colours of groups; more groups repeat them
        parts.append(rectangle(x + 3, y + 5, 4, min(box.height, HEAD) - 10, colour, 2))
    at = x + PAD
    if shape in ICONS:
        parts.append(icon(shape, at, y + 6))
        at += TAG
    parts.append(
        text(
            at, y + 20, node.title, *(("ka-title",) if box.boxes or shape in ("panel", "part", "slot", "crate") else ())
        )
    )
    for label in box.labels:
        parts += draw_label(label, x, y)
    parts += [text(x + line_x, y + line_y, line, "ka-small", "ka-quiet") for line, line_x, line_y in box.lines]
    return [*parts, *inner, "</g>"]


def draw_layout(
    layout: Layout, x: float, y: float, acted: Collection[str] = (), hint: Collection[str] = ()
) -> list[str]:
    """Return the elements of a layout; `acted` and `hint` are objects to highlight."""
    return [part for box in layout.boxes for part in draw_box(box, x, y, acted, hint)]


def document(
    parts: list[str], width: float, height: float, title: str, description: str, theme: Theme | None = "auto",
    language: str = "en",
) -> str:  # fmt: skip
    """Return a complete SVG document; theme None omits the style sheet, for pages that include it."""
    styled = "" if theme is None else f"<style>{style(theme)}</style>\n"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="ka" role="img" lang="{language}" '
        f'viewBox="0 0 {number(width)} {number(height)}" '
        f'width="{number(width)}" height="{number(height)}">\n'
        f"<title>{escape(title)}</title>\n<desc>{escape(description)}</desc>\n{styled}"
        f"{rectangle(0, 0, width, height, 'ka-paper')}\n{chr(10).join(parts)}\n</svg>\n"
    )
