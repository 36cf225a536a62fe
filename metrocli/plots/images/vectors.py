"""Residual vectors over the image."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.plots.magnify import in_words, magnification, round_size, thinned_vectors, words
from metrocli.plots.noise_bands import largest_of
from metrocli.plots.readings import ImageResiduals, image_residuals
from metrocli.plots.style import Canvas, Theme, arrows, images_height
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
    camera: str

    @property
    def longest(self) -> float:
        """Length of the longest vector [px]."""
        return float(np.hypot(*self.vectors[self.worst]))


def data(result: Result, about: str) -> tuple[Vectors, ...] | None:
    """Return the residual vectors of each camera; of many, the longest in each cell of the image."""
    each = image_residuals(result)
    if not each:
        return None
    sizes = [np.hypot(*residuals.vectors.T) for residuals in each]
    most = _MOST // len(each)
    rows = [thinned_vectors(residuals.places, lengths, most) for residuals, lengths in zip(each, sizes, strict=True)]
    typical = float(np.quantile(np.concatenate(sizes), 0.95))
    whole = all(len(chosen) == len(lengths) for chosen, lengths in zip(rows, sizes, strict=True))
    share = _SHARE if whole else 1 / most**0.5  # those of neighbouring cells stay apart
    factor = magnification(typical, share * min(residuals.size[0] for residuals in each))
    bound = largest_of(2 * sum(map(len, sizes)))
    scale = round_size(max(typical, 1e-300))
    return tuple(
        _chosen(residuals, chosen, bound, (factor, scale)) for residuals, chosen in zip(each, rows, strict=True)
    )


def _chosen(residuals: ImageResiduals, rows: Index, bound: float, sizes: tuple[float, float]) -> Vectors:
    beyond = np.nan_to_num(np.abs(residuals.w)).max(axis=1) > bound
    worst = int(np.argmax(np.hypot(*residuals.vectors[rows].T)))
    return Vectors(
        residuals.places[rows], residuals.vectors[rows], beyond[rows], *sizes, residuals.size,
        len(residuals.rows), worst, residuals.name(int(rows[worst])), residuals.camera,
    )  # fmt: skip


def height(shown: tuple[Vectors, ...]) -> float:
    """Return the height of the figure in inches."""
    return images_height([field.size for field in shown])


def draw(canvas: Canvas, shown: tuple[Vectors, ...]) -> str:
    """Draw the figure and return its caption."""
    theme, first = canvas.theme, shown[0]
    panels = canvas.images([field.camera for field in shown])
    for axes, field in zip(panels, shown, strict=True):
        axes.set_xlim(-0.5, field.size[0] - 0.5)
        axes.set_ylim(field.size[1] - 0.5, -0.5)
        for chosen, colour in ((~field.beyond, theme.first), (field.beyond, theme.second)):
            if chosen.any():
                arrows(axes, field.places[chosen], field.vectors[chosen] * field.magnification, colour)
    if not first.camera:
        _draw_scale(panels[0], first, theme)
    field = max(shown, key=lambda vectors: vectors.longest)
    text = (
        f"Reading minus model, magnified {in_words(field.magnification)}. Longest: {field.longest:.3g} px at "
        f"{field.worst_name}. {sum(int(vectors.beyond.sum()) for vectors in shown)} vectors (orange) exceed what noise "
        "reaches in 5 % of cases."
    )
    kept = "the longest of each cell of the image"
    counts = sum(len(vectors.places) for vectors in shown), sum(vectors.readings for vectors in shown)
    return " ".join(filter(None, [text, words(*counts, kept)]))


def _draw_scale(axes: Axes, field: Vectors, theme: Theme) -> None:
    at, arrow = 1.035, field.scale * field.magnification / field.size[0]
    axes.annotate(
        "", (arrow, at), (0, at), xycoords="axes fraction", annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": theme.ink, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    label = f"{field.scale:g} px (vectors {in_words(field.magnification)})"
    axes.text(arrow + 0.015, at, label, transform=axes.transAxes, va="center", fontsize=8)
    axes.set_title(" ")  # room for the scale
