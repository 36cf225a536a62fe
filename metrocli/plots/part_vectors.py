"""Residuals over the part: a vector at each point where lengths give one, and the size of w there."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots import plotted_points as labels
from metrocli.plots.magnify import in_words, length_in_words, magnification, thinned_vectors, words
from metrocli.plots.places import places_of
from metrocli.plots.plotted_points import PlottedPoints
from metrocli.plots.style import OUTLINE, SIZES, Canvas, arrows
from metrocli.result import Result

_SHARE = 1 / 10
_AXES = "xyz"
_NEAREST = 8
"""Points by which the name of the worst gives way"""


@dataclass(frozen=True)
class PartResiduals:
    """What the figure shows."""

    names: tuple[str, ...]
    at: Array
    """(n, 3) mm"""
    rms: Array
    """(n,) root mean square of w at the point"""
    vectors: Array | None
    """(n, 3) mm: sum over the tracers of the residual along the beam"""
    magnification: float
    plane: tuple[int, int]
    """The two axes along which the points extend most"""
    points: int


def data(result: Result, about: str) -> PartResiduals | None:
    """Return the residuals at the points; of many points, the largest in each cell of the picture.

    With tracers, the vector at a point is `sum_j v_ij e_ij`: residual times unit vector from the tracer to the point.
    """
    table = result.tables.get("residuals")
    held = places_of(result)
    points = next((kind for kind in held if kind.kind == "points"), None)
    if points is None or table is None or "normalised" not in table or not len(table):
        return None
    key = next((name for name in ("point", "target") if name in table), None)
    if key is None:
        return None
    place = {name: n for n, name in enumerate(points.names)}
    of = np.array([place.get(name, -1) for name in table.texts(key)])
    w = table.numbers("normalised")
    used = (of >= 0) & np.isfinite(w)
    if not used.any():
        return None
    counts = np.bincount(of[used], minlength=len(points.names))
    square = np.bincount(of[used], w[used] ** 2, len(points.names))
    rms = np.sqrt(square / np.maximum(counts, 1))
    seen = np.flatnonzero(counts)
    vectors = _along_beams(result, points, held, of)
    low_to_high = np.argsort(-np.ptp(points.at[seen], axis=0), kind="stable")[:2]
    plane = (int(low_to_high.min()), int(low_to_high.max()))
    rows = seen[thinned_vectors(points.at[seen][:, plane], rms[seen])]
    factor = 1.0
    if vectors is not None:
        extent = float(np.ptp(points.at[rows], axis=0).max())
        factor = magnification(float(np.linalg.norm(vectors[rows], axis=1).max()), _SHARE * extent)
    chosen = None if vectors is None else vectors[rows]
    names = tuple(points.names[row] for row in rows)
    return PartResiduals(names, points.at[rows], rms[rows], chosen, factor, plane, len(seen))


def _along_beams(result: Result, points: PlottedPoints, held: tuple[PlottedPoints, ...], of: Array) -> Array | None:
    tracers, table = next((kind for kind in held if kind.kind == "tracers"), None), result.tables["residuals"]
    if tracers is None or "tracer" not in table or table.units.get("residual") != "mm":
        return None
    station = {name: n for n, name in enumerate(tracers.names)}
    by = np.array([station.get(name, -1) for name in table.texts("tracer")])
    used = (of >= 0) & (by >= 0)
    beam = points.at[of[used]] - tracers.at[by[used]]
    along = table.numbers("residual")[used, None] * beam / np.linalg.norm(beam, axis=1)[:, None]
    return np.stack([np.bincount(of[used], along[:, k], len(points.names)) for k in range(3)], axis=1)


def height(residuals: PartResiduals) -> float:
    """Return the height of the figure in inches."""
    wide, high = np.ptp(residuals.at[:, residuals.plane], axis=0)
    return float(np.clip(5.2 * high / max(wide, 1e-9) + 0.9, 2.6, 6.0))


def draw(canvas: Canvas, residuals: PartResiduals) -> str:
    """Draw the figure and return its caption."""
    (axes,), bar = canvas.axes_and_bar()
    axes.set_aspect("equal")
    i, j = residuals.plane
    x, y = residuals.at[:, i], residuals.at[:, j]
    largest = max(2.0, float(residuals.rms.max()))
    drawn = axes.scatter(
        x, y, c=residuals.rms, s=16, cmap=SIZES, vmin=0, vmax=largest, zorder=3,
        linewidths=OUTLINE, edgecolors=canvas.theme.muted,
    )  # fmt: skip
    moved = ""
    if residuals.vectors is not None:
        vectors = residuals.vectors * residuals.magnification
        arrows(axes, residuals.at[:, residuals.plane], vectors[:, residuals.plane], canvas.theme.first)
        sizes = np.linalg.norm(residuals.vectors, axis=1)
        longest = f"{length_in_words(float(sizes.max()))} at {residuals.names[int(np.argmax(sizes))]}"
        factor = in_words(residuals.magnification)
        moved = f"Arrows: residuals of the lengths, summed along the beams, magnified {factor}; longest {longest}. "
    worst = int(np.argmax(residuals.rms))
    ground = {"facecolor": canvas.theme.surface, "edgecolor": "none", "alpha": 0.8, "pad": 0.4}
    look = {"color": canvas.theme.second, "fontweight": "bold", "zorder": 5, "bbox": ground}
    labels.name(axes, residuals.names[worst], residuals.at[:, residuals.plane], worst, _NEAREST, **look)
    axes.plot(x[worst], y[worst], "o", ms=9, mfc="none", mec=canvas.theme.second, mew=1.4, zorder=4)
    axes.margins(0.12)
    axes.set_xlabel(f"{_AXES[i]} (mm)")
    axes.set_ylabel(f"{_AXES[j]} (mm)")
    canvas.colour_bar(drawn, bar, "rms of w")
    text = (
        f"{moved}Colour: root mean square of the normalised residuals at the point, 1 if there is noise only; "
        f"the largest is {residuals.rms[worst]:.3g} at {residuals.names[worst]}."
    )
    return " ".join(
        filter(None, [text, words(len(residuals.at), residuals.points, "the largest of each cell", "points")])
    )
