"""Candidates for dark or bright ellipses: contours of thresholded images, as starts for the grey-value fit.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Picture
from metrocli.frozen import dataclass

SMALLEST = 3.0
"""Smallest minor diameter of a candidate, in pixels."""
FLATTEST = 0.3
"""Smallest ratio of the minor to the major axis."""
ROUND = 0.12
"""Largest relative difference between a contour's area and that of the ellipse with the same moments."""
FAINTEST = 0.4
"""Smallest contrast times size of a circle of a grid, relative to that of the other circles"""
STEP = 0.06
"""Step of the local thresholds above the mean of the surroundings, as a share of the image's grey-value range."""


def eight_bit(picture: Picture) -> npt.NDArray[np.uint8]:
    """Return the picture in 8 bits; one of 16 bits is scaled from its own range of grey values."""
    if picture.dtype == np.uint8:
        return picture.astype(np.uint8, copy=False)
    low, high = int(picture.min()), int(picture.max())
    return ((picture.astype(np.float32) - low) * (255.0 / max(high - low, 1))).astype(np.uint8)


def ellipses(picture: Picture, polarity: str) -> list[Ellipse]:
    """Return the ellipse-like blobs of a polarity (dark, bright, either), each once, as starts for `ellipses.fit`."""
    grey = eight_bit(picture)
    candidates: list[Ellipse] = []
    for wanted in ("dark", "bright") if polarity == "either" else (polarity,):
        turned = grey if wanted == "bright" else 255 - grey
        for mask in _masks(np.asarray(turned, np.uint8)):
            candidates += _in_mask(mask)
    return _distinct(candidates)


def clearest(picture: Picture, candidates: list[Ellipse], most: int) -> list[Ellipse]:
    """Return at most so many of the ellipses, in their order: the clearest."""
    if len(candidates) <= most:
        return candidates
    kept = np.sort(np.argsort(-_clearness(picture, candidates), kind="stable")[:most])
    return [candidates[row] for row in kept]


def as_clear(picture: Picture, candidates: list[Ellipse], number: int) -> list[Ellipse]:
    """Return the ellipses that are about as clear as so many of the clearest: the grain of a surface is fainter."""
    clearness = _clearness(picture, candidates)
    least = FAINTEST * np.sort(clearness)[::-1][min(number, len(candidates)) - 1]
    return [candidate for candidate, clear in zip(candidates, clearness, strict=True) if clear >= least]


def _clearness(picture: Picture, candidates: list[Ellipse]) -> Array:
    """Return contrast times size: the contrast of eight pixels inside each ellipse against eight around it."""
    height, width = picture.shape
    angle = np.arange(8) * (np.pi / 4)
    u, v, long, short = np.array([(ellipse.u, ellipse.v, ellipse.long, ellipse.short) for ellipse in candidates]).T

    def mean(away: Array) -> Array:
        at_u = np.clip(np.rint(u[:, None] + away[:, None] * np.cos(angle)), 0, width - 1).astype(int)
        at_v = np.clip(np.rint(v[:, None] + away[:, None] * np.sin(angle)), 0, height - 1).astype(int)
        return np.asarray(picture[at_v, at_u].mean(axis=1))

    return np.asarray(np.abs(mean(short / 2) - mean(1.5 * long + 1)) * short)


def _masks(grey: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.uint8]]:
    """Return masks of the bright pixels: brighter than Otsu's threshold, than wide and than narrow surroundings."""
    # not the maximum: some hot pixels would raise the step for all
    spread = int(np.percentile(grey[::4, ::4], 99.9)) - int(grey.min())
    step = max(6.0, STEP * spread)
    masks = [cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1]]
    # OpenCV takes windows of odd width only
    for width in {max(min(grey.shape) // 8, 11) | 1, 41}:
        masks.append(cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, width, -step))
    return [mask.astype(np.uint8, copy=False) for mask in masks]


def _in_mask(mask: npt.NDArray[np.uint8]) -> list[Ellipse]:
    """Return the ellipses among the contours whose centre pixel is set; holes and rings of the mask are left out."""
    contours = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    height, width = mask.shape
    candidates = []
    for contour in contours:
        if len(contour) < 6:
            continue
        ellipse = _of_contour(np.asarray(contour, np.int32))
        if ellipse is None:
            continue
        u, v = round(ellipse.u), round(ellipse.v)
        if 0 <= u < width and 0 <= v < height and mask[v, u]:
            candidates.append(ellipse)
    return candidates


def _of_contour(contour: npt.NDArray[np.int32]) -> Ellipse | None:
    """Return the ellipse with the contour's moments; None if the contour is not an ellipse."""
    m = cv2.moments(contour)
    area = m["m00"]
    if area < 4.0:
        return None
    uu, uv, vv = m["mu20"] / area, m["mu11"] / area, m["mu02"] / area
    mean, half = (uu + vv) / 2, np.hypot((uu - vv) / 2, uv)
    if mean - half <= 0:
        return None
    # The contour runs through the centres of the outermost pixels: half a pixel is added to each semi-axis.
    long, short = 2 * np.sqrt(mean + half), 2 * np.sqrt(mean - half)
    # pixels make the outline of a small blob rougher
    round_enough = abs(area / (np.pi * long * short) - 1) < ROUND + 0.5 / short
    if not round_enough or 2 * short + 1 < SMALLEST or short + 0.5 < FLATTEST * (long + 0.5):
        return None
    angle = 0.5 * np.arctan2(2 * uv, uu - vv)
    return Ellipse(m["m10"] / area, m["m01"] / area, float(long) + 0.5, float(short) + 0.5, float(angle))


def _distinct(candidates: list[Ellipse]) -> list[Ellipse]:
    """Return one ellipse of each group with nearly the same centre and size: several masks show the same blob."""
    cells: dict[tuple[int, int], list[Ellipse]] = {}
    kept = []
    for ellipse in candidates:
        cell = int(ellipse.u // 2), int(ellipse.v // 2)
        around = (
            other for du in (-1, 0, 1) for dv in (-1, 0, 1) for other in cells.get((cell[0] + du, cell[1] + dv), ())
        )
        if any(_same(ellipse, other) for other in around):
            continue
        cells.setdefault(cell, []).append(ellipse)
        kept.append(ellipse)
    return kept


def _same(a: Ellipse, b: Ellipse) -> bool:
    near = np.hypot(a.u - b.u, a.v - b.v) < max(1.0, 0.3 * a.short)
    return bool(near and 0.6 < a.short / b.short < 1.67)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse in an image; pixel (0, 0) is the centre of the first pixel."""

    u: float
    v: float
    long: float
    """Longer semi-axis in pixels."""
    short: float
    angle: float = 0.0
    """Direction of the longer semi-axis in radians, from u towards v."""

    @property
    def centre(self) -> tuple[float, float]:
        """The centre (u, v) in pixels."""
        return self.u, self.v

    @property
    def shape(self) -> Array:
        """The lower triangular matrix W (2, 2) that maps offsets from the centre to the unit circle."""
        cos, sin, a, b = np.cos(self.angle), np.sin(self.angle), self.long**-2.0, self.short**-2.0
        uu, uv, vv = a * cos * cos + b * sin * sin, (a - b) * cos * sin, a * sin * sin + b * cos * cos
        r = np.sqrt(vv)
        # W'W is the quadratic form of the ellipse; a triangle leaves out the turn
        # of the circle, which no grey value shows
        return np.array([[np.sqrt(max(uu - uv * uv / vv, 1e-300)), 0.0], [uv / r, r]])

    def lies_in(self, picture: Picture, share: float) -> bool:
        """Return whether the ellipse with semi-axes of this share of its own lies in the picture."""
        reach = share * np.linalg.norm(np.linalg.inv(self.shape), axis=1)
        ends = np.array(picture.shape[::-1]) - 0.5
        return bool((self.centre - reach > -0.5).all() and (self.centre + reach < ends).all())
