"""3-D view of points, tracers and cameras, with deviation vectors and uncertainty ellipsoids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots import plotted_points as labels
from metrocli.plots.magnify import in_words, length_in_words, magnification, round_size, thinned_vectors
from metrocli.plots.places import places_of
from metrocli.plots.plotted_points import PlottedPoints
from metrocli.plots.style import MARKERS, Canvas, arrows, bare
from metrocli.result import Result
from metrocli.words import counted, in_a_row

_MOST = 1500
"""Most points of one kind; the longest vector is always among them"""
_SHARE = 1 / 10
_ROOMY = 25
"""Points of one kind from which on ellipsoids become smaller with the distance of the points"""
_K = 2.0
"""Half axes of the ellipsoids in standard deviations"""
_NAMED, _MANY = 12, 100
"""Most places that have names; those above the other have small marks"""
_WIDE = 360.0
"""Width or height [points] that the places take in the figure"""
TURN, TILT = np.radians(-55.0), np.radians(24.0)
"""Direction of view: turn about z, then tilt"""


@dataclass(frozen=True)
class Scene:
    """What the figure shows; sizes are true, magnified only when drawn."""

    places: tuple[PlottedPoints, ...]
    vectors: float
    """Magnification of the deviations"""
    ellipsoids: float
    """Magnification of the ellipsoids"""
    left_out: int
    """Points that are not shown"""

    @property
    def all_at(self) -> Array:
        """Every place, (n, 3) mm."""
        return np.concatenate([place.at for place in self.places])


def data(result: Result, about: str) -> Scene | None:
    """Return the places with magnifications: vectors are a tenth of the picture, ellipsoids too if there are few."""
    places = places_of(result)
    if sum(len(place.at) for place in places) < 2:
        return None
    kept = tuple(map(_largest, places))
    size = float(np.linalg.norm(np.ptp(np.concatenate([place.at for place in kept]), axis=0)))
    vectors = [np.linalg.norm(place.vectors, axis=1).max() for place in kept if place.vectors is not None]
    variances = [np.trace(place.covariance, axis1=1, axis2=2) for place in kept if place.covariance is not None]
    spreads = [_K * np.sqrt(variance[np.isfinite(variance)].max(initial=0.0)) for variance in variances]
    most = max(len(place.at) for place in kept)
    room = _SHARE * size * min(1.0, (_ROOMY / most) ** (1 / 3))
    factors = [
        magnification(float(max(sizes, default=0.0)), length)
        for sizes, length in ((vectors, _SHARE * size), (spreads, room))
    ]
    left_out = sum(len(place.at) for place in places) - sum(len(place.at) for place in kept)
    return Scene(kept, factors[0], factors[1], left_out)


def _largest(place: PlottedPoints) -> PlottedPoints:
    """Return the place with the longest vector in each cell of the space, or places at equal steps, in their order."""
    if len(place.at) <= _MOST:
        return place
    if place.vectors is None:
        rows = np.linspace(0, len(place.at) - 1, _MOST).astype(np.intp)
    else:
        rows = thinned_vectors(place.at, np.linalg.norm(place.vectors, axis=1), _MOST)
    vectors, covariance, lines = (
        None if values is None else values[rows] for values in (place.vectors, place.covariance, place.lines)
    )
    names = tuple(place.names[row] for row in rows)
    return PlottedPoints(place.kind, names, place.at[rows], vectors, place.vector_name, covariance, lines)


def named(places: Sequence[PlottedPoints]) -> list[tuple[int, int]]:
    """Return place and row of each name, those that matter most first: one of each place, then the next of each."""
    each = [
        place.named if place.named is not None else range(len(place.names) if len(place.names) <= _NAMED else 0)
        for place in places
    ]
    ranked = sorted(
        (rank, k, row) for k, rows in enumerate(each) for rank, row in enumerate(rows) if not places[k].faint
    )
    return [(k, row) for _, k, row in ranked]


def view(turn: float = TURN, tilt: float = TILT) -> Array:
    """Return the rows right, up and towards the eye, (3, 3), of a view turned about z and tilted."""
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    towards = np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    return np.stack([right, np.cross(towards, right), towards])


def outline(covariance: Array, rows: Array) -> tuple[Array, Array, Array]:
    """Return half axes a >= b, (n,) each, and the angle of a, (n,) rad, of ellipsoids as they are seen.

    The outline of the ellipsoid `x' C^-1 x = 1`, projected along a direction, is the ellipse of `P C P'`, (2, 2).
    """
    flat = np.einsum("ai,nij,bj->nab", rows[:2], covariance, rows[:2])
    sizes, axes = np.linalg.eigh(flat)
    half = np.sqrt(np.maximum(sizes, 0))
    return half[:, 1], half[:, 0], np.arctan2(axes[:, 1, 1], axes[:, 0, 1])


def height(scene: Scene) -> float:
    """Return the height of the figure in inches."""
    wide, high = np.ptp(scene.all_at @ view()[:2].T, axis=0)
    return float(np.clip(5.6 * high / max(wide, 1e-9) + 0.9, 3.0, 6.0))


def draw(canvas: Canvas, scene: Scene) -> str:
    """Draw the figure and return its caption."""
    axes, theme, rows = canvas.axes()[0], canvas.theme, view()
    bare(axes)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_aspect("equal")
    shown = [place for place in scene.places if not place.faint]
    for place in scene.places:
        if place.faint and place.lines is not None:
            _draw_lines(axes, place.lines, rows, place.kind, color=theme.muted, lw=0.3, alpha=0.4, zorder=0.5)
    for place, colour, marker in zip(shown, theme.cycle, MARKERS, strict=False):
        flat = place.at @ rows[:2].T
        _draw_spread(axes, place, flat, scene.ellipsoids, rows, theme.muted)
        if place.lines is not None:
            _draw_lines(axes, place.lines, rows, "", color=colour, lw=0.6)
        if place.vectors is not None:
            arrows(axes, flat, place.vectors @ rows[:2].T * scene.vectors, colour, 0.002)
        size = 6.0 if len(place.names) <= _NAMED else 4.0 if len(place.names) <= _MANY else 2.2
        axes.plot(*flat.T, marker, ms=size, mew=0, color=colour, label=place.kind)
    _draw_names(axes, scene, rows)
    axes.margins(0.1)
    axes.autoscale_view()
    _draw_scale(axes, scene, rows, theme.ink, theme.muted)
    if len(scene.places) > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=len(scene.places), borderaxespad=0.2)
    return _caption(scene)


def _draw_names(axes: Axes, scene: Scene, rows: Array) -> None:
    """Write the names that `named` lists; where they are many, those that have room."""
    listed, at = named(scene.places), scene.all_at @ rows[:2].T
    first = np.cumsum([0, *(len(place.at) for place in scene.places)])
    texts, numbers = [scene.places[k].names[row] for k, row in listed], [int(first[k]) + row for k, row in listed]
    chosen = range(len(texts)) if len(texts) <= _NAMED else labels.apart(texts, at, numbers, 1, _WIDE)
    for k in chosen:
        labels.name(axes, texts[k], at, numbers[k], 1)


def _draw_lines(axes: Axes, lines: Array, rows: Array, label: str, **look: Any) -> None:
    """Draw lines as one, which has gaps: an image of many is far larger."""
    ends = lines.reshape(-1, 2, 3)
    flat = ends[(ends[:, 0] != ends[:, 1]).any(axis=1)] @ rows[:2].T
    broken = np.concatenate([flat, np.full((len(flat), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    axes.plot(*broken.T, "-", label=label or "_", **look)


def _draw_spread(axes: Axes, place: PlottedPoints, flat: Array, factor: float, rows: Array, colour: str) -> None:
    if place.covariance is None:
        return
    usable = np.isfinite(place.covariance).all(axis=(1, 2))
    long, short, angle = outline(place.covariance[usable], rows)
    size = 2 * _K * factor
    drawn = EllipseCollection(
        size * long, size * short, np.degrees(angle), units="xy", offsets=flat[usable],
        offset_transform=axes.transData, facecolors="none", edgecolors=colour, linewidths=0.6,
    )  # fmt: skip
    axes.add_collection(drawn)


def _draw_scale(axes: Axes, scene: Scene, rows: Array, ink: str, muted: str) -> None:
    """Draw the axes x, y, z with a round length at the lower left corner of all places."""
    at = scene.all_at
    length = round_size(0.25 * float(np.ptp(at, axis=0).max()))
    flat = at @ rows[:2].T
    spans = np.ptp(flat, axis=0)
    origin = flat.min(axis=0) - 0.04 * spans.max()
    for name, direction in zip("xyz", rows[:2].T * length, strict=True):
        tip = origin + 1.12 * direction
        line = {"arrowstyle": "-|>", "color": ink, "lw": 1, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tuple(origin + direction), tuple(origin), arrowprops=line)
        axes.text(float(tip[0]), float(tip[1]), name, ha="center", va="center", fontsize=8)
    axes.annotate(
        f"{length:g} mm", tuple(origin), xytext=(-7, 0), textcoords="offset points",
        ha="right", va="center", fontsize=8, color=muted,
    )  # fmt: skip
    axes.update_datalim(np.array([origin, origin + rows[:2, 0] * length]))
    axes.autoscale_view()


def _caption(scene: Scene) -> str:
    shown = in_a_row([place.kind for place in scene.places])
    still = "in the still picture the three arrows have the stated length along x, y and z"
    parts = [f"Parallel projection: {shown}; {still}."]
    for place in scene.places:
        if place.vectors is not None:
            sizes = np.linalg.norm(place.vectors, axis=1)
            worst = int(np.argmax(sizes))
            largest = f"{length_in_words(float(sizes[worst]))} at {place.names[worst]}"
            parts.append(
                f"Vectors: {place.vector_name}, magnified {in_words(scene.vectors)}; the longest is {largest}."
            )
        if place.covariance is not None:
            factor = in_words(scene.ellipsoids)
            parts.append(f"Ellipsoids ({place.kind}): two standard deviations along each axis, magnified {factor}.")
    if any(place.named is not None and len(place.named) < len(place.names) for place in scene.places):
        parts.append("Named are the worst image of each camera, the first and the last.")
    if scene.left_out:
        longest = "; the longest vector of each cell stays" if any(x.vectors is not None for x in scene.places) else ""
        parts.append(f"{counted(scene.left_out, 'point', 'are')} left out{longest}.")
    return " ".join(parts)
