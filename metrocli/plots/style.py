"""The look of all figures: colours that colour-blind eyes tell apart, sizes, captions; light and dark."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from metrocli.arrays import Array
from metrocli.frozen import dataclass

WIDTH = 6.4
"""Width of a figure in inches: that of the text on A4"""
_EMPTY = 0.1
"""Empty height by which a figure shrinks [inches]"""
_CAPTION = 108
"""Letters of one line of the caption"""


@dataclass(frozen=True)
class Theme:
    """Colours by their role; each role has another colour, so that a page can replace them."""

    surface: str
    ink: str
    muted: str
    grid: str
    band: str
    """Fill of envelopes and uncertainty bands"""
    first: str
    second: str
    """What stands out: beyond a limit, not determined"""
    third: str
    fourth: str

    @property
    def cycle(self) -> tuple[str, ...]:
        """Colours of several kinds of marks side by side."""
        return self.first, self.third, self.fourth, self.second


LIGHT = Theme("#fffffe", "#1b1c1d", "#5b6066", "#dcdfe2", "#cfe3f1", "#0072b2", "#d55e00", "#007f5f", "#a0568a")
DARK = Theme("#16181b", "#e8eaec", "#a3a9b0", "#363b41", "#1f4560", "#56b4e9", "#ff8f3d", "#35c19b", "#dd95c0")
"""After Okabe and Ito (2008): blue, vermilion, bluish green and reddish purple"""
BOTH_SIDES = LinearSegmentedColormap.from_list("both sides", ["#c04a00", "#f7c8a4", "#f4f4f2", "#a9cfe8", "#00568a"])
"""Colours of values about 0; of sizes it is cividis"""
SIZES = "cividis"
OUTLINE = 0.4
"""Line about a mark whose colour is a size: the least of them is as dark as the dark ground"""
_MARKS = re.compile(r'<use [^<>]*?( style="[^"]*")/>(?:\s*<use [^<>]*?\1/>)+')
"""Marks of one look, which the group that they are in can state for all"""
_INDENT = re.compile(r"\n +")
_ELEMENT = re.compile("<[^<>]+>")
_DIGITS = re.compile(r"(\d\.\d\d)\d+")
"""More digits of a point (1/72 inch) than an image can show"""
LETTERS = 24
"""Letters of a name inside a figure: a longer one would take the room of what is shown"""
MARKERS = ("o", "s", "^", "D")


def _settings(theme: Theme, name: str) -> Any:
    return {
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans"],
        "font.size": 9,
        "axes.titlesize": 9.5,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 9,
        "axes.edgecolor": theme.muted,
        "axes.labelcolor": theme.ink,
        "axes.facecolor": theme.surface,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.formatter.useoffset": False,
        "grid.color": theme.grid,
        "grid.linewidth": 0.6,
        "figure.facecolor": theme.surface,
        "figure.edgecolor": theme.surface,
        "figure.titlesize": 10.5,
        "figure.titleweight": "bold",
        "legend.frameon": False,
        "legend.fontsize": 8,
        "lines.linewidth": 1.4,
        "text.color": theme.ink,
        "xtick.color": theme.muted,
        "ytick.color": theme.muted,
        "xtick.labelcolor": theme.ink,
        "ytick.labelcolor": theme.ink,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "svg.fonttype": "none",
        "svg.hashsalt": name,
        "pdf.fonttype": 42,
        "path.simplify": True,
    }


def images_height(sizes: Sequence[tuple[float, float]]) -> float:
    """Return the height in inches of a figure of images of these widths and heights [px], two in a row."""
    rows = -(-len(sizes) // 2)
    high = max(height / width for width, height in sizes)
    return min(5.6 / min(2, len(sizes)) * high + 0.9, 6.5) * rows


@dataclass(frozen=True)
class Canvas:
    """A figure to draw on, with its colours."""

    figure: Figure
    theme: Theme

    def axes(self, rows: int = 1, columns: int = 1, **how: Any) -> list[Axes]:
        """Return axes in rows and columns, row by row."""
        return list(self.figure.subplots(rows, columns, squeeze=False, **how).ravel())

    def images(self, names: Sequence[str]) -> list[Axes]:
        """Return axes of images, [px], of one camera or of several, two in a row, each with its name."""
        columns = min(2, len(names))
        all_axes = self.axes(-(-len(names) // columns), columns)
        for axes, name in zip(all_axes, names, strict=False):
            axes.set_aspect("equal", anchor="NW")
            axes.set_xlabel("u (px)")
            axes.set_ylabel("v (px)")
            axes.set_title(name)
            if columns > 1:
                axes.locator_params(nbins=4)
        for unused in all_axes[len(names) :]:
            unused.remove()
        return all_axes[: len(names)]

    def axes_and_bar(
        self, rows: int = 1, columns: int = 1, count: int = 1, common: bool = True
    ) -> tuple[list[Axes], Axes]:
        """Return `count` axes in rows and columns, with common scales or own ones, and the place of a scale of colours.

        The scale is as high as the axes and stands beside them, also where equal units make them smaller than their
        room: they are then at its left.
        """
        grid = self.figure.add_gridspec(rows, columns + 1, width_ratios=[1.0] * columns + [0.035 * columns])
        axes: list[Axes] = []
        for k in range(count):
            first = axes[0] if axes and common else None
            axes.append(self.figure.add_subplot(grid[divmod(k, columns)], sharex=first, sharey=first, anchor="NW"))
        bar = self.figure.add_subplot(grid[:, -1])
        bar.set_axes_locator(partial(_beside, axes))
        return axes, bar

    def colour_bar(self, drawn: Any, place: Axes, label: str) -> None:
        """Add the scale of colours."""
        bar = self.figure.colorbar(drawn, cax=place)
        bar.set_label(label)
        bar.outline.set_visible(False)


@contextmanager
def canvas(name: str, height: float, theme: Theme) -> Iterator[Canvas]:
    """Yield an empty figure of a height in inches; `name` makes the names inside an SVG distinct."""
    with matplotlib.rc_context(_settings(theme, name)):
        figure = Figure(figsize=(WIDTH, height))
        FigureCanvasAgg(figure)
        yield Canvas(figure, theme)


def arrows(axes: Axes, at: Array, vectors: Array, colour: str, width: float = 0.0022) -> None:
    """Draw vectors (n, 2) at places (n, 2), in the units of the axes; `width` is a share of that of the axes."""
    axes.quiver(
        at[:, 0], at[:, 1], vectors[:, 0], vectors[:, 1], color=colour, width=width,
        angles="xy", scale_units="xy", scale=1, headwidth=3.5, zorder=3,
    )  # fmt: skip


def _beside(panels: list[Axes], bar: Axes, renderer: Any) -> Bbox:
    """Return the place of a scale of colours: where its room is, as high as the panels together."""
    for panel in panels:
        panel.apply_aspect()
    whole, room = Bbox.union([panel.get_position() for panel in panels]), bar.get_position(original=True)
    gap = room.x0 - max(panel.get_position(original=True).x1 for panel in panels)
    return Bbox.from_bounds(whole.x1 + gap, whole.y0, room.width, whole.height)


def bare(axes: Axes) -> None:
    """Remove frame and grid of axes that show a picture."""
    axes.grid(False)
    axes.spines[:].set_visible(False)


def arrange(canvas: Canvas, title: str = "", caption: str = "") -> None:
    """Fit the axes with their labels into the figure; with a title above and a caption below it, the figure grows.

    It shrinks by the height that axes with equal units leave empty.
    By matplotlib's tight layout: its constrained layout takes four times as long. Once, unless the new sizes of the
    axes change their ticks, whose labels may then be wider.
    """
    figure, theme = canvas.figure, canvas.theme
    width, height = figure.get_size_inches()
    lines = textwrap.wrap(caption, _CAPTION)
    above, below = 0.3 if title else 0.0, 0.155 * len(lines) + 0.1 if lines else 0.0
    whole = height + above + below
    ticks = _ticks(figure)
    # labels are measured from the room of the axes, which equal units would leave
    equal = [axes for axes in figure.axes if axes.get_aspect() != "auto"]
    for axes in equal:
        axes.set_aspect("auto")
    _fit(figure, above, below, (width, whole))
    empty = _empty_height(equal, (width, whole))
    if empty > _EMPTY:
        whole -= empty
        _fit(figure, above, below, (width, whole))
    elif _ticks(figure) != ticks:
        _fit(figure, above, below, (width, whole))
    for axes in equal:
        axes.set_aspect("equal")
    if title:
        figure.text(0.01, 1 - 0.08 / whole, title, va="top", fontsize=10.5, fontweight="bold")
    if lines:
        text = "\n".join(lines)
        figure.text(0.01, 0.06 / whole, text, va="bottom", fontsize=7.5, color=theme.muted, linespacing=1.3)


def _fit(figure: Figure, above: float, below: float, size: tuple[float, float]) -> None:
    """Fit the axes into a figure of a size, but for a strip above and one below them [inches]."""
    figure.set_size_inches(*size)
    # without a part of the figure to fit into, matplotlib measures all texts once instead of twice
    rect = (0, below / size[1], 1, 1 - above / size[1]) if above or below else None
    figure.tight_layout(pad=0.4, rect=rect)


def _empty_height(equal: Iterable[Axes], size: tuple[float, float]) -> float:
    """Return the height that axes in a figure of a size do not fill if their units are equal [inches]."""
    rows: dict[float, float] = {}
    for axes in equal:
        room = axes.get_position(original=True)
        free = room.height * size[1] - room.width * size[0] * axes.get_data_ratio()
        rows[round(room.y0, 3)] = min(free, rows.get(round(room.y0, 3), free))
    return sum(rows.values())


def _ticks(figure: Figure) -> list[list[float]]:
    return [axis.get_majorticklocs().tolist() for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]


def write(canvas: Canvas, path: Path, form: str) -> None:
    """Write a figure as svg, pdf or png; the same figure gives the same bytes."""
    canvas.figure.savefig(path, format=form, dpi=200, metadata=_without_date(form))


def svg(canvas: Canvas) -> str:
    """Return a figure as the text of an SVG image.

    Without `savefig`, which first draws everything once to no purpose.
    """
    text = StringIO()
    FigureCanvasSVG(canvas.figure).print_svg(text, metadata=_without_date("svg"))  # type: ignore[no-untyped-call]
    # inside the elements only: numbers that are read keep their digits
    short = _ELEMENT.sub(lambda element: _DIGITS.sub(r"\1", element[0]), _INDENT.sub("\n", text.getvalue()))
    return _MARKS.sub(lambda marks: f"<g{marks[1]}>{marks[0].replace(marks[1], '')}</g>", short)


def png(canvas: Canvas) -> bytes:
    """Return a figure as the bytes of a PNG image of 256 colours, a third of the size of one of all colours."""
    from PIL import Image  # matplotlib needs it for its images

    drawn, written = BytesIO(), BytesIO()
    canvas.figure.savefig(drawn, format="png", dpi=150, metadata=_without_date("png"))
    few = Image.open(drawn).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    few.save(written, "png", optimize=True)
    return written.getvalue()


def _without_date(form: str) -> dict[str, Any]:
    return {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}[form]
