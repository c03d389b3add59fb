"""Pictures of the states of a task."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from planner.system.files import atomic

from ..declare.catalogue import FIRST, catalogue
from ..people.action_names import words_of
from . import svg
from .layout import GAP, Arranger, Layout, label, label_rows
from .profile import Profile
from .raster import png
from .scene import Node, Scene, arrange
from .subject import Subject

if TYPE_CHECKING:
    from planner import AnyTask

MARGIN = 12.0  # pixels around a drawing
WIDTH = 760.0  # default width of a picture in pixels; fits the text column of a page or a notebook


@dataclass(frozen=True)
class Picture:
    """A drawing and its description.

    Attributes
    ----------
    svg : str
        A complete SVG document with its own style sheet.
    text : str
        The description that screen readers read.
    width, height : float
        Natural size, in pixels.
    """

    svg: str
    text: str
    width: float
    height: float

    def _repr_svg_(self) -> str:
        return self.svg

    def __repr__(self) -> str:
        return f"<Picture of {self.width:.0f} x {self.height:.0f} pixels: {self.text}>"

    def save(self, file: str | PathLike[str]) -> None:
        """Write the picture to a file, atomically.

        Parameters
        ----------
        file : path
            Its name ends in `.svg` or `.png`. A PNG has light colours and 1.5 times the natural size.

        Raises
        ------
        ValueError
            The name has another ending.
        MissingExtraError
            The file is a PNG, and the extra `plots` is not installed.
        """
        path = Path(file)
        kind = path.suffix.lower()
        if kind not in (".svg", ".png"):
            raise ValueError(f"{path}: expected a name that ends in .svg or .png")
        if kind == ".svg":
            content = self.svg.encode()
        else:  # a PNG cannot follow the reader's preference of colours
            content = png(self.svg.replace(svg.style("auto"), svg.style("light")), self.width)
        with atomic(path) as new:
            new.write_bytes(content)


class Artist:
    """Draws the states of one task.

    Parameters
    ----------
    task : Task, or whatever `planner.load` takes
    profile : Profile, optional
        The appearance of drawings. Read from `drawing.toml` in the domain's folder, or inferred from the task, unless
        given.
    goal : bool
        Whether drawings show the task's goal; not if people may pursue another one.
    language : str
        Of the words around the domain's own, and of these as far as `drawing.toml` has them; as in `catalogue`.

    Raises
    ------
    InputFileError
        The domain's `drawing.toml` is invalid.
    """

    def __init__(
        self, task: AnyTask, profile: Profile | None = None, *, goal: bool = True, language: str = FIRST
    ) -> None:
        subject = Subject.of(task)
        self.subject = subject if goal else replace(subject, goal=())
        self.profile = Profile.of(self.subject, catalogue(language)) if profile is None else profile
        room = self._room()
        self._containers = frozenset(room)
        self._arranger = Arranger({} if self.profile.guessed else room)
        self._placed = lru_cache(maxsize=256)(self._lay_out)

    def draw(
        self,
        values: Sequence[int] | None = None,
        *,
        width: float = WIDTH,
        acted: Collection[str] = (),
        hint: Collection[str] = (),
        goal: bool = True,
        lost: bool = False,
        theme: svg.Theme | None = "auto",
    ) -> Picture:
        """Draw a state.

        Parameters
        ----------
        values : sequence of int, shape (variables,), optional
            The state; the initial one unless given.
        width : float
            Approximate width of the picture, in pixels.
        acted, hint : collection of str
            Objects to highlight: those of an action, and those of a suggestion.
        goal : bool
            Whether the goal is listed below the drawing.
        lost : bool
            Whether the list says that the goal can no longer be reached.
        theme : "auto", "light", "dark" or None
            The colours; None omits the style sheet, for pages that include it.
        """
        scene, layout = self._placed(tuple(self.subject.initial if values is None else values), width - 2 * MARGIN)
        across = max(layout.width, min(width, 320.0))
        parts = svg.draw_layout(layout, MARGIN, MARGIN, acted, hint)
        below, high = self._below(scene, across, MARGIN + layout.height + 2 * GAP, goal, lost)
        parts += below
        description = self.text(scene)
        title = self.profile.texts.texts["drawing.title"].format(task=self.subject.task.name)
        document = svg.document(
            parts, across + 2 * MARGIN, high + MARGIN, title, description, theme, self.profile.language
        )
        return Picture(document, description, across + 2 * MARGIN, high + MARGIN)

    def scene(self, values: Sequence[int] | None = None) -> Scene:
        """Return the scene of a state."""
        return arrange(self.subject, self.profile, self.subject.initial if values is None else values, self._containers)

    def layouts(self, states: Sequence[Sequence[int]], width: float = WIDTH) -> list[Layout]:
        """Return layouts of states that follow each other; an object is where it was, unless it moved."""
        return self._arranger.layouts([self.scene(values) for values in states], width)

    def text(self, scene: Scene) -> str:
        """Return the description of a scene: what is where, and which parts of the goal hold."""
        done = [text for text, so in scene.goal if so]
        left = [text for text, so in scene.goal if not so]
        words = [f"{'; '.join([*scene.said, *scene.also])}." if scene.said or scene.also else ""]
        say = self.profile.texts
        words += [say("drawing.goal_done", done=str(len(done)), all=str(len(scene.goal)))] if scene.goal else []
        if left:
            words.append(say("drawing.open", facts="; ".join(left)))
        return " ".join(filter(None, words))

    def has_words(self, action: str) -> bool:
        """Return whether the domain has words for a ground action."""
        name = words_of(action)[0]
        return name in self.profile.words and name in self.subject.parameters

    def say(self, action: str) -> str:
        """Return a ground action in words."""
        name, *arguments = words_of(action)
        template, parameters = self.profile.words.get(name), self.subject.parameters.get(name, ())
        if template is None:
            return " ".join([name, ", ".join(arguments)]).strip()
        said = dict(zip(parameters, arguments, strict=False))
        return " ".join(said.get(word, word) for word in template.split(" "))

    def _lay_out(self, values: tuple[int, ...], width: float) -> tuple[Scene, Layout]:
        scene = self.scene(values)
        return scene, self._arranger.layouts([scene], width)[0]

    def _below(self, scene: Scene, width: float, top: float, goal: bool, lost: bool) -> tuple[list[str], float]:
        """Return the elements of the list of the goal's parts below the boxes, and the y coordinate of their end."""
        if not (goal and scene.goal):
            return [], top - 2 * GAP
        done = sum(so for _, so in scene.goal)
        title = self.profile.texts("drawing.lost" if lost else "drawing.goal", done=str(done), all=str(len(scene.goal)))
        labels = [label(text, so, width) for text, so in scene.goal]
        _, high = label_rows(labels, width, MARGIN, top + 20)
        parts = [svg.text(MARGIN, top + 12, title, "ka-title")]
        return [*parts, *(part for one in labels for part in svg.draw_label(one, 0, 0))], top + 20 + high

    def _room(self) -> dict[str, list[Node]]:
        """Return, for each place, the objects that may be there."""
        room: dict[str, dict[str, Node]] = {}
        nodes = {name: Node(name, name, self.profile.look(self.subject, name)) for name in self.subject.objects}
        nodes |= {f"#{name}": Node(f"#{name}", look.title or name, look) for name, look in self.profile.things.items()}
        for fact in sorted(self.subject.changing | self.subject.constant):
            rule = self.profile.places.get(fact[0])
            if rule is not None and rule.how != "on":
                what, where = rule.of(fact)
                room.setdefault(where, {})[what] = nodes[what]
        return {where: list(found.values()) for where, found in room.items()}
