"""Rendered images of flat targets, with exact perspective, lens distortion, blur, noise and black level."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array, Picture
from metrocli.frozen import dataclass
from metrocli.targets.drawings import Drawing, inside

Field = npt.NDArray[np.floating]
Rays = Callable[[Array], Array]
"""Function from pixel coordinates (n, 2) to unit directions (n, 3) in the camera's frame (inverse lens model)."""

Size = tuple[int, int]

FINE = 4
"""Samples per pixel and axis; four are enough, because a sample on an edge is partly covered."""
FAR = 1e6
"""Plane coordinate [mm] of a ray that does not meet the plane."""
COARSE = 16
"""Distance in pixels of the rays that locate a target in the image."""


@dataclass(frozen=True)
class PlacedDrawing:
    """A drawing in the camera frame: `X_camera = rotation @ (x, y, 0) + origin`, in mm."""

    drawing: Drawing
    rotation: Array
    origin: Array


@dataclass(frozen=True)
class Look:
    """Grey values, blur and noise of a rendered image."""

    ink: float = 30.0
    paper: float = 210.0
    background: float = 210.0
    """Grey value around the sheets."""
    blur: float = 0.7
    """Standard deviation of the lens's point spread function in pixels."""
    noise: float = 0.0
    """Standard deviation of a pixel's grey value."""
    black: float = 0.0
    """Grey value subtracted before clipping at 0; five times the noise makes a dark background plain black."""
    bits: int = 8


RETRO_REFLECTIVE = Look(ink=220.0, paper=0.0, background=0.0, noise=2.0, black=10.0)
"""Retro-reflective targets under a ring light: only the targets are bright."""


def render(size: Size, rays: Rays, scene: Sequence[PlacedDrawing], look: Look, rng: np.random.Generator) -> Picture:
    """Return the image (height, width) of a scene; later drawings cover earlier ones.

    Only the pixels near each drawing are computed. Edges are exact to about 0.001 px.
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


def _ray_grid(rays: Rays, u: npt.NDArray[np.generic], v: npt.NDArray[np.generic]) -> Array:
    """Return the directions (rows, columns, 3) of the pixels in columns u and rows v."""
    grid = np.stack(np.meshgrid(u, v), axis=-1).astype(float)
    return np.asarray(rays(grid.reshape(-1, 2))).reshape(grid.shape[:2] + (3,))


def _on_plane(directions: Array, placed: PlacedDrawing) -> Array:
    """Return plane coordinates (..., 2) in mm of directions (..., 3); infinite if a ray does not meet the plane."""
    into = directions @ placed.rotation
    start = placed.origin @ placed.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        length = start[2] / into[..., 2]
        at = length[..., None] * into[..., :2] - start[:2]
    at[~((length > 0) & np.isfinite(at).all(-1))] = np.inf
    return np.asarray(at)


def _box(coarse: Array, placed: PlacedDrawing) -> tuple[int, int, int, int] | None:
    """Return the columns and rows of the grid that enclose the sheet; None if it is out of sight."""
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


def _close_box(
    rays: Rays, coarse: Array, placed: PlacedDrawing, size: Size, around: int
) -> tuple[int, int, int, int] | None:
    """Return the box of pixels (u0, v0, u1, v1) that sheet and blur touch; None if it is outside the image."""
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


def _coverage(rays: Rays, placed: PlacedDrawing, box: tuple[int, int, int, int], blur: float) -> tuple[Field, Field]:
    """Return the shares of sheet and of ink in each pixel of a box (u0, v0, u1, v1), after the blur of the lens.

    Plane coordinates are computed at the pixels and interpolated in between, which is exact to 1e-4 px.
    """
    import cv2  # which takes longer to load than a job without images

    u0, v0, u1, v1 = box
    around = _around(blur)
    u, v = np.arange(u0 - around, u1 + around), np.arange(v0 - around, v1 + around)
    at = _on_plane(_ray_grid(rays, u, v), placed)
    # between a number and infinity, interpolation gives nan
    at[~np.isfinite(at)] = FAR
    fine = at.shape[1] * FINE, at.shape[0] * FINE
    x, y = (cv2.resize(np.ascontiguousarray(at[..., axis]), fine).astype(np.float32) for axis in (0, 1))
    left, top, right, bottom = placed.drawing.sheet
    sheet = inside(x - left) * inside(right - x) * inside(y - top) * inside(bottom - y)
    ink = sheet * placed.drawing.ink(x, y)
    paper, printed = (_pixels(part, blur) for part in (sheet, ink))
    inner = slice(around, -around)
    return paper[inner, inner], printed[inner, inner]


def _pixels(fine: Field, blur: float) -> Field:
    """Blur a finely sampled field and integrate it over pixels."""
    import cv2

    reach = 2 * int(np.ceil(4.5 * blur * FINE)) + 1
    soft = cv2.GaussianBlur(fine, (reach, reach), blur * FINE) if blur > 0 else fine
    rows, columns = fine.shape
    return np.asarray(soft.reshape(rows // FINE, FINE, columns // FINE, FINE).mean((1, 3)))
