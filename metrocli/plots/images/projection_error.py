"""Expected projection error of a camera over its image."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import SIZES, Canvas
from metrocli.result import Result
from metrocli.tasks.shared.images.calibrated import of_each


@dataclass(frozen=True)
class ProjectionError:
    """Standard uncertainty of projected points over the image of each camera, [px]."""

    cameras: tuple[tuple[str, Array, Array, Array], ...]
    """Name, u (columns,), v (rows,) and the uncertainty (rows, columns)"""


def data(result: Result, about: str) -> ProjectionError | None:
    """Return the uncertainty over the image, of each of several cameras; None without the table."""
    table = result.tables.get("projection_error")
    if table is None or not len(table):
        return None
    each = []
    for name, rows in of_each(table):
        u, v = np.unique(table.numbers("u")[rows]), np.unique(table.numbers("v")[rows])
        each.append((name, u, v, table.numbers("std")[rows].reshape(len(v), len(u))))
    return ProjectionError(tuple(each))


def _columns(shown: ProjectionError) -> int:
    return min(2, len(shown.cameras))


def height(shown: ProjectionError) -> float:
    """Return the height of the figure in inches."""
    columns = _columns(shown)
    each = min(4.6 / columns * max(np.ptp(v) / np.ptp(u) for _, u, v, _ in shown.cameras), 5.5) + 0.6
    return float(each * -(-len(shown.cameras) // columns) + 0.3)


def draw(canvas: Canvas, shown: ProjectionError) -> str:
    """Draw the figure and return its caption."""
    columns = _columns(shown)
    rows = -(-len(shown.cameras) // columns)
    panels, bar = canvas.axes_and_bar(rows, columns, len(shown.cameras), common=False)
    known = np.concatenate([std[std > 0] for *_, std in shown.cameras] or [np.ones(1)])
    low, high = (float(known.min()), float(known.max())) if known.size else (1e-3, 1.0)
    levels = np.geomspace(low, high * 1.001, 13) if high > 1.05 * low else np.array([low / 1.1, high * 1.1])
    drawn = None
    for axes, (name, u, v, std) in zip(panels, shown.cameras, strict=True):
        axes.set_aspect("equal")
        axes.grid(False)
        drawn = axes.contourf(u, v, np.maximum(std, low), levels, cmap=SIZES, norm="log")
        axes.set_ylim(float(v.max()), float(v.min()))
        axes.set_xlabel("u (px)")
        axes.set_ylabel("v (px)")
        if name:
            axes.set_title(name)
        axes.locator_params(nbins=4)
    canvas.colour_bar(drawn, bar, "px")
    ticks = np.geomspace(low, high, 4)
    bar.set_yticks(ticks, [f"{tick:.2g}" for tick in ticks])
    bar.minorticks_off()
    worst = max(float(std.max()) for *_, std in shown.cameras)
    middle = [float(std[len(v) // 2, len(u) // 2]) for _, u, v, std in shown.cameras]
    centre = " and ".join(f"{value:.2g}" for value in middle)
    return (
        "Standard uncertainty of the image of a fixed point at the distance of the targets, after the camera is moved "
        f"as suits the readings best: {centre} px in the middle of the image, at most {worst:.2g} px."
    )
