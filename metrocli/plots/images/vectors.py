"""Residual vectors over the image."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.plots.magnify import in_words, magnification, round_size, thinned_vectors, words
from metrocli.plots.noise_bands import largest_of
from metrocli.plots.readings import image_residuals
from metrocli.plots.style import Canvas, arrows
from metrocli.result import Result

_MOST = 500
"""Most vectors; more would hide each other"""
_SHARE = 1 / 14
"""Length of the vectors in the picture, of its width"""


@dataclass(frozen=True)
class Vectors:
    """What the figure shows."""

    places: Array
    """(n, 2) px"""
    vectors: Array
    """(n, 2) px, as measured"""
    beyond: Mask
    """(n,) whether |w| of u or v exceeds what noise reaches in 5 % of measurements"""
    magnification: float
    scale: float
    """Length (px) of the arrow that shows the scale"""
    size: tuple[float, float]
    readings: int
    worst: int
    """Row of the longest vector"""
    worst_name: str


def data(result: Result, about: str) -> Vectors | None:
    """Return the residual vectors; of many, the longest in each cell of the image."""
    residuals = image_residuals(result)
    if residuals is None:
        return None
    sizes = np.hypot(*residuals.vectors.T)
    rows = thinned_vectors(residuals.places, sizes, _MOST)
    typical = float(np.quantile(sizes, 0.95))
    share = _SHARE if len(rows) == len(sizes) else 1 / _MOST**0.5  # those of neighbouring cells stay apart
    factor = magnification(typical, share * residuals.size[0])
    bound = largest_of(2 * len(sizes))
    beyond = np.nan_to_num(np.abs(residuals.w)).max(axis=1) > bound
    worst = int(np.argmax(sizes[rows]))
    return Vectors(
        residuals.places[rows], residuals.vectors[rows], beyond[rows], factor, round_size(max(typical, 1e-300)),
        residuals.size, len(sizes), worst, residuals.name(int(rows[worst])),
    )  # fmt: skip


def height(field: Vectors) -> float:
    """Return the height of the figure in inches."""
    return min(5.6 * field.size[1] / field.size[0] + 0.9, 6.5)


def draw(canvas: Canvas, field: Vectors) -> str:
    """Draw the figure and return its caption."""
    theme, (wide, high) = canvas.theme, field.size
    axes = canvas.axes()[0]
    axes.set_aspect("equal")
    axes.set_xlim(-0.5, wide - 0.5)
    axes.set_ylim(high - 0.5, -0.5)
    for chosen, colour in ((~field.beyond, theme.first), (field.beyond, theme.second)):
        if chosen.any():
            arrows(axes, field.places[chosen], field.vectors[chosen] * field.magnification, colour)
    arrow = field.scale * field.magnification
    axes.annotate(
        "", (arrow / wide, 1.035), (0, 1.035), xycoords="axes fraction", annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": theme.ink, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    label = f"{field.scale:g} px (vectors {in_words(field.magnification)})"
    axes.text(arrow / wide + 0.015, 1.035, label, transform=axes.transAxes, va="center", fontsize=8)
    axes.set_title(" ")  # room for the scale
    axes.set_xlabel("u (px)")
    axes.set_ylabel("v (px)")
    longest = float(np.hypot(*field.vectors[field.worst]))
    text = (
        f"Reading minus model, magnified {in_words(field.magnification)}. Longest: {longest:.3g} px at "
        f"{field.worst_name}. {int(field.beyond.sum())} vectors (orange) exceed what noise reaches in 5 % of cases."
    )
    kept = "the longest of each cell of the image"
    return " ".join(filter(None, [text, words(len(field.places), field.readings, kept)]))
