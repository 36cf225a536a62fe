"""Drawings of targets for rendered images: dots, coded rings, circles, chessboards and bitmaps, in mm on a plane.

Each gives the share of ink of finely sampled points, computed from the distance to the nearest edge.
"""

from __future__ import annotations

from dataclasses import field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.targets.coded_rings import BITS, DOT, RING_FROM, RING_TO, SHEET
from metrocli.targets.pattern import Pattern, lattice

Field = npt.NDArray[np.floating]
FINE = 4
"""Samples per pixel and axis; four are enough, because a sample on an edge is partly covered."""


class Drawing(Protocol):
    """A drawing on a flat sheet."""

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the sheet in its plane, in mm."""

    def ink(self, x: Field, y: Field) -> Field:
        """Return the share (0..1) of ink in each sample of a grid (rows, columns); x, y in mm."""


@dataclass(frozen=True)
class Dot:
    """A disc around the origin of the plane."""

    radius: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        side = SHEET * self.radius
        return -side, -side, side, side

    def ink(self, x: Field, y: Field) -> Field:
        return inside(self.radius - np.hypot(x, y))


@dataclass(frozen=True)
class CodedRing:
    """A ring-coded target around the origin: a dot of this radius [mm], and a ring of segments from 2 to 3 radii."""

    code: int
    radius: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        side = SHEET * self.radius
        return -side, -side, side, side

    def ink(self, x: Field, y: Field) -> Field:
        rho = np.hypot(x, y)
        ring = inside(RING_TO * self.radius - rho) * inside(rho - RING_FROM * self.radius)
        return inside(DOT * self.radius - rho) + ring * inside(self._along(np.arctan2(y, x)) * rho)

    def _along(self, angle: Field) -> Field:
        """Return the angle [rad] to the nearest end of an arc, positive on arcs and negative on gaps."""
        bits = np.array([self.code >> place & 1 for place in range(BITS)])
        if bits.min() == bits.max():
            return np.full_like(angle, np.pi * (2 * bits[0] - 1))
        place = np.remainder(angle * (BITS / (2 * np.pi)), BITS)
        segment = np.minimum(place.astype(int), BITS - 1)
        since = _equal_before(bits)[segment] + (place - segment)
        until = _equal_before(bits[::-1])[::-1][segment] + 1 - (place - segment)
        return np.asarray((2 * bits - 1)[segment] * np.minimum(since, until) * (2 * np.pi / BITS))


def _equal_before(bits: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return for each segment how many segments directly before it have the same value."""
    counts = [next(n for n in range(BITS) if bits[place - n - 1] != bits[place]) for place in range(BITS)]
    return np.array(counts)


@dataclass(frozen=True)
class Circles:
    """Discs of the same radius around points (n, 2) of the plane, in mm."""

    centres: Array
    radius: float
    margin: float
    """Width of the sheet around the outermost centres [mm]."""

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        low, high = self.centres.min(0) - self.margin, self.centres.max(0) + self.margin
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def ink(self, x: Field, y: Field) -> Field:
        from scipy.spatial import KDTree

        # A block of samples shares one nearest circle: midway between two circles either one gives no ink.
        blocks = np.stack([x[::FINE, ::FINE], y[::FINE, ::FINE]], axis=-1)
        nearest = self.centres[KDTree(self.centres).query(blocks)[1]]
        nearest = np.repeat(np.repeat(nearest, FINE, axis=0), FINE, axis=1)[: x.shape[0], : x.shape[1]]
        return inside(self.radius - np.hypot(x - nearest[..., 0], y - nearest[..., 1]))


@dataclass(frozen=True)
class Chessboard:
    """A chessboard with this number of inner corners, the first at the origin; the square at -x, -y of it is dark."""

    columns: int
    rows: int
    pitch: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        return -2 * self.pitch, -2 * self.pitch, (self.columns + 1) * self.pitch, (self.rows + 1) * self.pitch

    def ink(self, x: Field, y: Field) -> Field:
        board = np.ones_like(x)
        for along, count in ((x, self.columns), (y, self.rows)):
            board = board * inside(along + self.pitch) * inside(count * self.pitch - along)
        return (0.5 + 0.5 * self._stripes(x) * self._stripes(y)) * board

    def _stripes(self, along: Field) -> Field:
        """Return +1 and -1 on stripes of one pitch in turn, +1 on the stripe from 0 to the pitch."""
        turn = np.remainder(along / self.pitch, 2.0)
        return 2 * inside(np.where(turn < 1, np.minimum(turn, 1 - turn), -np.minimum(turn - 1, 2 - turn))) - 1


@dataclass(frozen=True)
class Bitmap:
    """A picture (rows, columns) of square cells of side `cell` mm, 1 ink and 0 paper, its upper left at `corner`."""

    cells: Array
    cell: float
    corner: tuple[float, float]
    margin: float = field(default=0.0)

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        rows, columns = self.cells.shape
        x, y = self.corner
        return (
            x - self.margin,
            y - self.margin,
            x + columns * self.cell + self.margin,
            y + rows * self.cell + self.margin,
        )

    def ink(self, x: Field, y: Field) -> Field:
        at_x, at_y = (x - self.corner[0]) / self.cell, (y - self.corner[1]) / self.cell
        fraction_x, fraction_y = np.remainder(at_x + 0.5, 1.0) - 0.5, np.remainder(at_y + 0.5, 1.0) - 0.5
        column, row = np.rint(at_x).astype(int), np.rint(at_y).astype(int)
        right, below = inside(fraction_x), inside(fraction_y)
        padded = np.pad(self.cells, 1)
        rows, columns = padded.shape
        left, above = np.clip(column, 0, columns - 2), np.clip(row, 0, rows - 2)
        upper = padded[above, left] * (1 - right) + padded[above, left + 1] * right
        lower = padded[above + 1, left] * (1 - right) + padded[above + 1, left + 1] * right
        return np.asarray(upper * (1 - below) + lower * below)


def board(pattern: Pattern) -> Drawing:
    """Return the drawing of a board, with its points at the coordinates of `pattern_points`.

    Circles without a diameter have a radius of 0.3 pitches. Raises ValueError if the pattern has no pitch.
    """
    if pattern.pitch is None:
        raise ValueError("a board without a pitch cannot be drawn")
    rows, columns = pattern.shape
    if pattern.type == "charuco":
        from metrocli.targets.charuco import artwork

        cells, count = artwork(pattern)
        return Bitmap(cells, pattern.pitch / count, (-pattern.pitch, -pattern.pitch), pattern.pitch)
    if pattern.type == "aprilgrid":
        from metrocli.targets import aprilgrid

        cells, cell = aprilgrid.artwork(pattern)
        gap = pattern.pitch - (pattern.marker_size or 0.0)
        return Bitmap(cells, cell, (-gap, -gap), pattern.pitch)
    if pattern.type == "chessboard":
        return Chessboard(columns, rows, pattern.pitch)
    radius = pattern.diameter / 2 if pattern.diameter else 0.3 * pattern.pitch
    return Circles(lattice(pattern).astype(float) * pattern.pitch, radius, 1.5 * pattern.pitch)


def inside(distance: Field) -> Field:
    """Return the share (0..1) of each sample that is inside an edge.

    `distance` is the distance to the edge at each sample, positive inside; divided by its slope per sample it gives
    the share to first order.
    """
    # every second sample: an edge is straight over two of them, and this takes most of the time of an image
    down, right = np.gradient(distance[::2, ::2])
    slope = np.sqrt(down * down + right * right) / 2
    rows, columns = distance.shape
    steep = np.maximum(np.repeat(np.repeat(slope, 2, axis=0), 2, axis=1)[:rows, :columns], 1e-12)
    return np.asarray(np.clip(0.5 + distance / steep, 0.0, 1.0))
