"""Common style of all figures: colours, marks of policies, legends, and output files.

Text and axes have the colours of matplotlib's settings, so that figures can be drawn for dark pages as well. Needs the
extra `plots`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec
from zlib import crc32

from numpy.typing import NDArray

from planner.system.errors import require_package
from planner.system.files import atomic

from ...team.trace import robot_is_at

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

P = ParamSpec("P")

# Colours of Okabe and Ito, which can be distinguished with any colour vision.
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#E69F00", "#009E73", "#8C8C8C"
SKY, VERMILLION, PURPLE, WINE = "#56B4E9", "#D55E00", "#CC79A7", "#882255"

PAGE_WIDTH = 9.0  # inches, the text width of a landscape page
FORMATS = (".png", ".svg", ".pdf")

SETTINGS: dict[Any, Any] = {
    "font.size": 9, "axes.titlesize": 9, "axes.labelsize": 9, "legend.fontsize": 8.5, "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5, "figure.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
    "grid.alpha": 0.3, "legend.frameon": False, "text.parse_math": False,
}  # fmt: skip
DARK = {
    "figure.facecolor": "#16191d", "axes.facecolor": "#16191d", "savefig.facecolor": "auto", "grid.color": "#8a9099",
}  # fmt: skip
THICK: dict[str, Any] = {"linewidth": 3, "alpha": 0.75}
THIN: dict[str, Any] = {"linewidth": 0.9, "alpha": 0.6}


@dataclass(frozen=True)
class PolicyLook:
    """Marks of a policy in every figure. Colour, marker and line differ together."""

    color: str
    marker: str
    line: Any = "-"


LOOKS = {
    "none": PolicyLook(GREY, "s", (0, (1, 1.2))),
    "reactive": PolicyLook(ORANGE, "^", (0, (5, 1.5))),
    "attention": PolicyLook(BLUE, "o"),
    "attention-never": PolicyLook(SKY, "D", (0, (5, 1.5, 1, 1.5))),
    "attention-outlook": PolicyLook("#661100", "d", (0, (5, 1.5, 1, 1.5, 1, 1.5))),
    "priority": PolicyLook(GREEN, "P"),
    "whittle": PolicyLook(WINE, "*", (0, (3, 1, 1, 1))),
    "rollout": PolicyLook("#332288", "h", (0, (8, 2))),
}
OTHERS = ((VERMILLION, "v"), (PURPLE, "X"), ("#999933", "<"), ("#A0522D", "p"))


def looks(policies: Iterable[str]) -> dict[str, PolicyLook]:
    """Return the marks of each policy, in the order in which policies are drawn.

    An unknown name has marks that depend on the name only, or the next free ones if another unknown name has them.
    Colours are distinct as long as there are enough.
    """
    names, dashes = set(policies), ((0, (3, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
    found = {name: look for name, look in LOOKS.items() if name in names}
    for name in sorted(names - set(LOOKS)):
        first = crc32(name.encode())
        taken = set(found.values())
        wheel = (PolicyLook(*OTHERS[(first + i) % len(OTHERS)], line) for line in dashes for i in range(len(OTHERS)))
        free = (look for look in wheel if look not in taken)
        found[name] = next(free, PolicyLook(*OTHERS[first % len(OTHERS)]))
    return found


def panels(
    rows: int = 1, columns: int = 1, *, height: float, margin: float = 0.6, width: float = PAGE_WIDTH,
    layout: Literal["constrained"] | None = "constrained", **shared: Any,
) -> tuple[Figure, NDArray[Any]]:  # fmt: skip
    """Return a figure, and its panels in an array of shape (rows, columns).

    Parameters
    ----------
    rows, columns : int
    height : float
        Inches of each row.
    margin, width : float
        Inches beside the rows, and of the whole figure.
    layout : "constrained" or None
        How matplotlib places panels; None if the caller does.
    **shared
        Further arguments of `Figure.subplots`, such as `sharex`.
    """
    from .shown_figure import ShownFigure

    figure = ShownFigure(figsize=(width, margin + height * rows), layout=layout)
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def grid(count: int, columns: int, *, height: float, **more: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure with a number of panels, row by row in as many columns at most; further arguments as `panels`."""
    columns = min(count, columns)
    figure, axes = panels(-(-count // columns), columns, height=height, **more)
    for axis in axes.ravel()[count:]:
        axis.set_visible(False)
    return figure, list(axes.ravel()[:count])


def robot_bands(axes: Iterable[Axes], trace: Iterable[Mapping[str, Any]], place: int, start: float = -0.5) -> None:
    """Mark the steps in which a robot was with a person; a step begins at its number plus `start`."""
    steps = sorted({row["step"] for row in trace if robot_is_at(row, place)})
    for axis in axes:
        for step in steps:
            axis.axvspan(step + start, step + start + 1, color=ORANGE, alpha=0.22, linewidth=0)


def robot_entry() -> Artist:
    """Return the legend entry of what `robot_bands` draws."""
    from matplotlib.patches import Patch

    return Patch(color=ORANGE, alpha=0.22, label="robot present")


def is_followed(row: Mapping[str, Any]) -> bool:
    """Whether the person did what was suggested in a row of a trace."""
    return bool(row["suggestion"]) and row["suggestion"] == row["action"]


def whole_numbers(*axes: Axis, **how: Any) -> None:
    """Let axes be marked at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    for axis in axes:
        axis.set_major_locator(MaxNLocator(integer=True, **how))


def require() -> None:
    """Check that figures can be drawn.

    Raises
    ------
    MissingExtraError
        matplotlib is not installed.
    """
    require_package("figures need", "matplotlib", "plots")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Return a version of a drawing function that uses the common settings."""

    @wraps(draw)
    def with_settings(*args: P.args, **kwargs: P.kwargs) -> Figure:
        require()
        from matplotlib import rc_context

        with rc_context(SETTINGS):
            return draw(*args, **kwargs)

    return with_settings


def ink() -> str:
    """Return the colour of text on the present background."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def entry(label: str, **how: Any) -> Artist:
    """Return a legend entry: a line, or a marker without a line unless one is requested."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": ink(), "linestyle": "none" if "marker" in how else "-", **how}, label=label)


def sample(name: str, look: PolicyLook, *, line: bool = True) -> Artist:
    """Return the legend entry of a policy."""
    return entry(
        name, color=look.color, marker=look.marker, linestyle=look.line if line else "none", markersize=6, linewidth=1.4
    )


def legend_below(figure: Figure, entries: Sequence[Artist]) -> None:
    """Add a legend below all panels, in as few rows as its width allows."""
    figure.align_ylabels()
    for columns in range(len(entries), 0, -1):
        legend = figure.legend(handles=entries, loc="outside lower center", ncols=columns)
        if columns == 1 or legend.get_window_extent().width < figure.bbox.width:
            break
        legend.remove()


def save(figure: Figure, file: Path) -> None:
    """Save a figure in the format given by the file's suffix, atomically."""
    with atomic(file) as path:
        figure.savefig(path, dpi=150)


def save_for_pages(figure_of: Callable[[], Figure], folder: Path, name: str, *, dark: bool = True) -> list[Path]:
    """Draw a figure for light and for dark pages, and write both as PNG and SVG; return the files.

    The same figure always gives the same files.

    Parameters
    ----------
    figure_of : callable
        Draws the figure. It is called once for each background.
    folder : Path
    name : str
        The files are `name.png`, `name.svg`, `name-dark.png` and `name-dark.svg`.
    dark : bool
        Whether to write the figures for dark pages.
    """
    require()
    from matplotlib import rc_context, style

    files = []
    backgrounds: dict[str, list[str | Path | dict[str, Any]]] = {
        "": ["default"], "-dark": ["default", "dark_background", DARK],
    }  # fmt: skip
    if not dark:
        del backgrounds["-dark"]
    for suffix, background in backgrounds.items():
        with style.context(background), rc_context({"svg.hashsalt": name}):
            figure = figure_of()
            for ending, metadata in ((".png", {}), (".svg", {"Date": None})):
                files.append(folder / f"{name}{suffix}{ending}")
                with atomic(files[-1]) as path:
                    figure.savefig(path, dpi=150, metadata=metadata)
                figure.set_layout_engine("none")  # the layout is computed once, which saves a third of the time
    return files
