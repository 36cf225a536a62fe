"""Images of flat targets as a camera sees them: true perspective, lens distortion, blur, noise and black level."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from metrocli.targets.codes import BITS, DOT, RING_FROM, RING_TO, SHEET
from metrocli.targets.pattern import Pattern, lattice

if TYPE_CHECKING:
    from metrocli.imageset import Picture

Array = npt.NDArray[np.float64]
Field = npt.NDArray[np.floating]
Rays = Callable[[Array], Array]
"""Pixel coordinates (n, 2) to unit directions (n, 3) in the camera frame: projection and distortion, inverted."""

Size = tuple[int, int]

FINE = 4
"""Samples per pixel and axis; edges within a sample are covered in part, so this is far finer than it sounds."""
FAR = 1e6
"""Plane coordinate in mm that stands for where no ray meets the plane."""
COARSE = 16
"""Pixels between the rays that find where a target is."""


class Drawing(Protocol):
    """What is printed on a flat sheet."""

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the sheet in its plane, in mm."""

    def ink(self, x: Field, y: Field) -> Field:
        """Return which part (0..1) of each sample of a grid (rows, columns) is ink; x, y in mm."""


@dataclass(frozen=True)
class Placed:
    """A drawing in the camera frame: `X_camera = rotation @ (x, y, 0) + origin`, in mm."""

    drawing: Drawing
    rotation: Array
    origin: Array


@dataclass(frozen=True)
class Look:
    """How the image is exposed; levels in grey values."""

    ink: float = 30.0
    paper: float = 210.0
    background: float = 210.0
    """Around the sheets."""
    blur: float = 0.7
    """Standard deviation of the lens' point spread in pixels."""
    noise: float = 0.0
    """Standard deviation of a pixel's grey value."""
    black: float = 0.0
    """Taken off every pixel before negative ones are cut: five times the noise makes a dark background plain black."""
    bits: int = 8


RETRO_REFLECTIVE = Look(ink=220.0, paper=0.0, background=0.0, noise=2.0, black=10.0)
"""White on black with a ring light: nothing but the targets is bright."""


@dataclass(frozen=True)
class Dot:
    """A disc around the origin of the plane."""

    radius: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        side = SHEET * self.radius
        return -side, -side, side, side

    def ink(self, x: Field, y: Field) -> Field:
        return _inside(self.radius - np.hypot(x, y))


@dataclass(frozen=True)
class CodedRing:
    """A ring-coded target around the origin: a dot of this radius, and a ring of segments from two to three radii."""

    code: int
    radius: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        side = SHEET * self.radius
        return -side, -side, side, side

    def ink(self, x: Field, y: Field) -> Field:
        rho = np.hypot(x, y)
        ring = _inside(RING_TO * self.radius - rho) * _inside(rho - RING_FROM * self.radius)
        return _inside(DOT * self.radius - rho) + ring * _inside(self._along(np.arctan2(y, x)) * rho)

    def _along(self, angle: Field) -> Field:
        """Return the angle to the nearest end of an arc, positive on arcs."""
        bits = np.array([self.code >> place & 1 for place in range(BITS)])
        if bits.min() == bits.max():
            return np.full_like(angle, np.pi * (2 * bits[0] - 1))
        place = np.remainder(angle * (BITS / (2 * np.pi)), BITS)
        segment = np.minimum(place.astype(int), BITS - 1)
        since = _equal_before(bits)[segment] + (place - segment)
        until = _equal_before(bits[::-1])[::-1][segment] + 1 - (place - segment)
        return np.asarray((2 * bits - 1)[segment] * np.minimum(since, until) * (2 * np.pi / BITS))


def _equal_before(bits: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return how many segments right before each one have its value."""
    counts = [next(n for n in range(BITS) if bits[place - n - 1] != bits[place]) for place in range(BITS)]
    return np.array(counts)


@dataclass(frozen=True)
class Circles:
    """Discs of one radius around points (n, 2) of the plane."""

    centres: Array
    radius: float
    margin: float
    """Width of the sheet around the outermost centres."""

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        low, high = self.centres.min(0) - self.margin, self.centres.max(0) + self.margin
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def ink(self, x: Field, y: Field) -> Field:
        from scipy.spatial import KDTree

        # One nearest circle serves a block of samples: midway between circles it does not matter which it is.
        blocks = np.stack([x[::FINE, ::FINE], y[::FINE, ::FINE]], axis=-1)
        nearest = self.centres[KDTree(self.centres).query(blocks)[1]]
        nearest = np.repeat(np.repeat(nearest, FINE, axis=0), FINE, axis=1)[: x.shape[0], : x.shape[1]]
        return _inside(self.radius - np.hypot(x - nearest[..., 0], y - nearest[..., 1]))


@dataclass(frozen=True)
class Chessboard:
    """Inner corners (columns, rows) of a chessboard, the first at the origin, the square towards -x and -y dark."""

    columns: int
    rows: int
    pitch: float

    @property
    def sheet(self) -> tuple[float, float, float, float]:
        return -2 * self.pitch, -2 * self.pitch, (self.columns + 1) * self.pitch, (self.rows + 1) * self.pitch

    def ink(self, x: Field, y: Field) -> Field:
        board = np.ones_like(x)
        for along, count in ((x, self.columns), (y, self.rows)):
            board = board * _inside(along + self.pitch) * _inside(count * self.pitch - along)
        return (0.5 + 0.5 * self._stripes(x) * self._stripes(y)) * board

    def _stripes(self, along: Field) -> Field:
        """Return -1 on the stripe before 0, +1 on the next, and so on."""
        turn = np.remainder(along / self.pitch, 2.0)
        return 2 * _inside(np.where(turn < 1, np.minimum(turn, 1 - turn), -np.minimum(turn - 1, 2 - turn))) - 1


@dataclass(frozen=True)
class Bitmap:
    """A picture (rows, columns) of 0 paper and 1 ink in squares of `cell` mm, its upper left corner at `corner`."""

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
        right, below = _inside(fraction_x), _inside(fraction_y)
        padded = np.pad(self.cells, 1)
        rows, columns = padded.shape
        left, above = np.clip(column, 0, columns - 2), np.clip(row, 0, rows - 2)
        upper = padded[above, left] * (1 - right) + padded[above, left + 1] * right
        lower = padded[above + 1, left] * (1 - right) + padded[above + 1, left + 1] * right
        return np.asarray(upper * (1 - below) + lower * below)


def board(pattern: Pattern) -> Drawing:
    """Return the drawing of a board, its points where `pattern_points` has them."""
    if pattern.pitch is None:
        raise ValueError("a board without a pitch cannot be drawn")
    rows, columns = pattern.shape
    if pattern.type == "charuco":
        from metrocli.targets.charuco import artwork

        cells, count = artwork(pattern)
        return Bitmap(cells, pattern.pitch / count, (-pattern.pitch, -pattern.pitch), pattern.pitch)
    if pattern.type == "chessboard":
        return Chessboard(columns, rows, pattern.pitch)
    radius = pattern.diameter / 2 if pattern.diameter else 0.3 * pattern.pitch
    return Circles(lattice(pattern).astype(float) * pattern.pitch, radius, 1.5 * pattern.pitch)


def render(size: Size, rays: Rays, scene: Sequence[Placed], look: Look, rng: np.random.Generator) -> Picture:
    """Return the image (height, width) of a scene; later drawings lie before earlier ones.

    Only the surroundings of each drawing are computed; their edges are exact to about 0.001 px.
    """
    width, height = size
    image = np.full((height, width), float(look.background))
    u, v = np.arange(-COARSE, width + 2 * COARSE, COARSE), np.arange(-COARSE, height + 2 * COARSE, COARSE)
    coarse = _ray_grid(rays, u, v)
    for placed in scene:
        box = _close_box(rays, coarse, placed, (width, height), _around(look.blur))
        if box is not None:
            u0, v0, u1, v1 = box
            paper, ink = _coverage(rays, placed, box, look.blur)
            part = image[v0:v1, u0:u1]
            image[v0:v1, u0:u1] = part * (1 - paper) + look.paper * (paper - ink) + look.ink * ink
    if look.noise:
        image += look.noise * rng.standard_normal(image.shape)
    whole = np.rint(np.clip(image - look.black, 0, 2**look.bits - 1))
    return whole.astype(np.uint8) if look.bits <= 8 else whole.astype(np.uint16)


def _inside(distance: Field) -> Field:
    """Return which part of each sample is inside, from a field that is positive inside and its slope there."""
    down, right = np.gradient(distance[::2, ::2])
    slope = np.sqrt(down * down + right * right) / 2
    rows, columns = distance.shape
    steep = np.maximum(np.repeat(np.repeat(slope, 2, axis=0), 2, axis=1)[:rows, :columns], 1e-12)
    return np.asarray(np.clip(0.5 + distance / steep, 0.0, 1.0))


def _ray_grid(rays: Rays, u: npt.NDArray[np.generic], v: npt.NDArray[np.generic]) -> Array:
    """Return directions (rows, columns, 3) at the crossings of columns u and rows v."""
    grid = np.stack(np.meshgrid(u, v), axis=-1).astype(float)
    return np.asarray(rays(grid.reshape(-1, 2))).reshape(grid.shape[:2] + (3,))


def _on_plane(directions: Array, placed: Placed) -> Array:
    """Return plane coordinates (..., 2) in mm of directions (..., 3); far away where a ray does not meet the plane."""
    into = directions @ placed.rotation
    start = placed.origin @ placed.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        length = start[2] / into[..., 2]
        at = length[..., None] * into[..., :2] - start[:2]
    at[~((length > 0) & np.isfinite(at).all(-1))] = np.inf
    return np.asarray(at)


def _box(coarse: Array, placed: Placed) -> tuple[int, int, int, int] | None:
    """Return columns and rows of the coarse grid that surround the sheet; None where it is out of sight."""
    at = _on_plane(coarse, placed)
    corners = np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]])
    low, high = corners.min(0), corners.max(0)
    left, top, right, bottom = placed.drawing.sheet
    seen = (low[..., 0] < right) & (high[..., 0] > left) & (low[..., 1] < bottom) & (high[..., 1] > top)
    rows, columns = np.nonzero(seen & np.isfinite(high).all(-1))
    if not len(rows):
        return None
    last = columns.max() + 2, rows.max() + 2
    return (
        max(int(columns.min()) - 1, 0),
        max(int(rows.min()) - 1, 0),
        min(int(last[0]), coarse.shape[1] - 1),
        min(int(last[1]), coarse.shape[0] - 1),
    )


def _close_box(rays: Rays, coarse: Array, placed: Placed, size: Size, around: int) -> tuple[int, int, int, int] | None:
    """Return the pixels (u0, v0, u1, v1) of the image that the sheet and its blur touch; None where there are none."""
    box = _box(coarse, placed)
    if box is None:
        return None
    u0, v0 = (COARSE * box[0] - COARSE, COARSE * box[1] - COARSE)
    u, v = np.arange(u0, COARSE * box[2]), np.arange(v0, COARSE * box[3])
    fine = _box(_ray_grid(rays, u, v), placed)
    if fine is None:
        return None
    left, top = max(u0 + fine[0] - around, 0), max(v0 + fine[1] - around, 0)
    right, bottom = min(u0 + fine[2] + around, size[0]), min(v0 + fine[3] + around, size[1])
    return (left, top, right, bottom) if left < right and top < bottom else None


def _around(blur: float) -> int:
    """Return how many pixels the blur of an edge reaches."""
    return int(np.ceil(4 * blur)) + 2


def _coverage(rays: Rays, placed: Placed, box: tuple[int, int, int, int], blur: float) -> tuple[Field, Field]:
    """Return which part of each pixel of a box (u0, v0, u1, v1) is sheet and which is ink, after the lens' blur.

    Plane coordinates are computed at pixels and interpolated in between, which is exact to 1e-4 px.
    """
    u0, v0, u1, v1 = box
    around = _around(blur)
    u, v = np.arange(u0 - around, u1 + around), np.arange(v0 - around, v1 + around)
    at = _on_plane(_ray_grid(rays, u, v), placed)
    at[~np.isfinite(at)] = FAR
    fine = at.shape[1] * FINE, at.shape[0] * FINE
    x, y = (cv2.resize(np.ascontiguousarray(at[..., axis]), fine).astype(np.float32) for axis in (0, 1))
    left, top, right, bottom = placed.drawing.sheet
    sheet = _inside(x - left) * _inside(right - x) * _inside(y - top) * _inside(bottom - y)
    ink = sheet * placed.drawing.ink(x, y)
    paper, printed = (_pixels(part, blur) for part in (sheet, ink))
    inner = slice(around, -around)
    return paper[inner, inner], printed[inner, inner]


def _pixels(fine: Field, blur: float) -> Field:
    """Blur a finely sampled field and integrate it over pixels."""
    reach = 2 * int(np.ceil(4.5 * blur * FINE)) + 1
    soft = cv2.GaussianBlur(fine, (reach, reach), blur * FINE) if blur > 0 else fine
    rows, columns = fine.shape
    return np.asarray(soft.reshape(rows // FINE, FINE, columns // FINE, FINE).mean((1, 3)))
