"""The files and jobs that a result was made from, as a graph from left to right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.patches import FancyBboxPatch, PathPatch
from matplotlib.path import Path as MplPath

from metrocli.frozen import dataclass
from metrocli.plots.context import LineageFile, ResultContext
from metrocli.plots.style import Canvas
from metrocli.result import Result

_LETTERS = 112
"""Letters of a line over the whole width; of a longer name the end is kept"""
_ROW = 0.52
"""Height of a row in inches"""


@dataclass(frozen=True)
class Graph:
    """What the figure shows."""

    nodes: tuple[LineageFile, ...]
    place: dict[str, tuple[int, int]]
    """Column, counted from the measurements, and row of each node"""

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return 1 + max(c for c, _ in self.place.values()), 1 + max(r for _, r in self.place.values())


def data(result: Result, context: ResultContext) -> Graph | None:
    """Return the graph; None for a result whose files are not recorded."""
    if len(context.lineage) < 2:
        return None
    known = {file.name: file for file in context.lineage}
    far: dict[str, int] = {}
    _measure(context.lineage[0].name, 0, known, far)
    last = max(far.values())
    place: dict[str, tuple[int, int]] = {}
    for distance in range(last + 1):
        names = [name for name in known if far.get(name) == distance]
        names.sort(key=lambda name: (_level(name, context.lineage, place), name))
        place |= {name: (last - distance, row) for row, name in enumerate(names)}
    return Graph(context.lineage, place)


def _measure(name: str, distance: int, known: Mapping[str, LineageFile], far: dict[str, int]) -> None:
    """Set the number of jobs on the longest way from each file to the result."""
    if distance < far.get(name, 0):
        return
    far[name] = distance
    for need in known[name].needs:
        _measure(need, distance + 1, known, far)


def _level(name: str, nodes: Sequence[LineageFile], place: Mapping[str, tuple[int, int]]) -> float:
    """Return the mean row of what was made from a file, so that few lines cross."""
    rows = [place[node.name][1] for node in nodes if name in node.needs and node.name in place]
    return sum(rows) / max(len(rows), 1)


def height(graph: Graph) -> float:
    """Return the height of the figure in inches."""
    return 0.3 + _ROW * graph.size[1]


def draw(canvas: Canvas, graph: Graph) -> str:
    """Draw the figure and return its caption."""
    theme, (columns, rows) = canvas.theme, graph.size
    axes = canvas.axes()[0]
    axes.set_axis_off()
    axes.set_xlim(-0.02, columns)
    axes.set_ylim(rows, 0)
    wide = 0.86 if columns > 1 else 1.0
    letters = int(_LETTERS * wide / columns) - 1
    for node in graph.nodes:
        x, y = graph.place[node.name]
        colour = theme.third if node.sound and node.kind else theme.muted if node.sound else theme.second
        box = FancyBboxPatch(
            (x, y + 0.12), wide, 0.76, boxstyle="round,pad=0,rounding_size=0.04",
            facecolor=theme.surface, edgecolor=colour, lw=1.2, zorder=2,
        )  # fmt: skip
        axes.add_patch(box)
        folder, _, name = node.name.rpartition("/")
        lines = [line for line in (name, node.kind or folder) if line]
        for k, line in enumerate(lines):
            at = y + 0.5 + 0.34 * (k - (len(lines) - 1) / 2)
            ink = theme.ink if k == 0 else theme.muted
            text = line if len(line) <= letters else f"…{line[1 - letters :]}"
            axes.text(x + 0.03, at, text, va="center", fontsize=6.6, color=ink, zorder=3)
        for need in node.needs:
            u, v = graph.place[need]
            bend = (u + wide + x) / 2
            ends = [(u + wide, v + 0.5), (bend, v + 0.5), (bend, y + 0.5), (x, y + 0.5)]
            curve = MplPath(ends, [MplPath.MOVETO, *[MplPath.CURVE4] * 3])
            axes.add_patch(PathPatch(curve, facecolor="none", edgecolor=theme.muted, lw=0.8, zorder=1))
    changed = [node.name for node in graph.nodes if not node.sound]
    state = f"Changed, missing or not fit for use (orange): {', '.join(changed)}." if changed else "All are as read."
    return f"Files (grey) and results with the jobs that made them (green), from the measurements on the left. {state}"
