"""Convert lens parameters between conventions: forward and backward distortion, and the photogrammetric form in mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.lenses.distortion import DISTORTION, RADIAL, TANGENTIAL, TILT, distort, undistort
from metrocli.instruments.lenses.lens import focal, image_point, plane_point

_GRID = 33


@dataclass(frozen=True)
class Converted:
    """Parameters of the other convention, and their deviation from the given lens over the image."""

    values: Mapping[str, float]
    rms: float
    """RMS deviation over the image, px"""
    largest: float


def image_grid(image_size: Sequence[int], n: int = _GRID) -> tuple[Array, Array]:
    """Return (u, v) of n x n points that cover the image."""
    u, v = np.meshgrid(np.linspace(0, image_size[0] - 1, n), np.linspace(0, image_size[1] - 1, n))
    return u.ravel(), v.ravel()


def converted(values: Mapping[str, float], convention: str, image_size: Sequence[int]) -> Converted:
    """Return the parameters of the other convention that fit the lens best over the image, by least squares.

    Forward: `m = D_k(x)`, with m measured and x ideal in the plane Z = 1. Backward: `x = D_b(m)` (Brown 1966). Focal
    length and principal point stay the same; the problem is linear in the new coefficients k1 k2 k3 p1 p2.
    """
    u, v = image_grid(image_size)
    mx, my = plane_point(values, u, v)
    names = (*RADIAL, "p1", "p2")
    # both ways one map is wanted as a polynomial: its arguments come from the lens, its values are known
    if convention == "forward":
        ideal_x, ideal_y = undistort(mx, my, values)
        from_x, from_y, to_x, to_y = mx, my, ideal_x, ideal_y
    else:
        d = distort(mx, my, values)
        from_x, from_y, to_x, to_y = d.x, d.y, mx, my
    good = np.isfinite(from_x) & np.isfinite(to_x)
    terms = distort(from_x[good], from_y[good], {}, names).terms
    matrix = np.concatenate([np.stack([np.asarray(terms[name][axis]) for name in names], axis=1) for axis in (0, 1)])
    right = np.concatenate([(to_x - from_x)[good], (to_y - from_y)[good]])
    # r^2 to r^7 have columns of very different size
    scale = np.linalg.norm(matrix, axis=0)
    coefficients = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
    gap = (matrix @ coefficients - right).reshape(2, -1) * np.array(focal(values))[:, None]
    distance = np.sqrt((gap**2).sum(axis=0))
    others = {name: value for name, value in values.items() if name not in DISTORTION}
    return Converted(
        {**others, **dict(zip(names, coefficients.tolist(), strict=True))},
        float(np.sqrt((distance**2).mean())),
        float(distance.max()),
    )


@dataclass(frozen=True)
class Photogrammetric:
    """A lens in mm with image y upwards: principal distance c, principal point x0 y0, balanced distortion, affinity.

    A are the coefficients of the balanced radial distortion, B those of the tangential distortion, C the affinity:

    `x = x0 + xi (1 + A1 (r2 - R0^2) + A2 (r4 - R0^4) + A3 (r6 - R0^6)) + B1 (r2 + 2 xi^2) + 2 B2 xi yi + C1 xi
    + C2 yi`

    y likewise without C; xi = -c X/Z in mm (Brown 1971, as used in close-range photogrammetry).
    """

    names: tuple[str, ...]
    values: Array
    units: tuple[str, ...]
    by_lens: Array
    """Derivatives by the lens parameters in their order, (names, lens parameters)"""
    reference_radius: float
    """R0 in mm"""


_PHOTO = ("c", "x0", "y0", "A1", "A2", "A3", "B1", "B2", "C1", "C2")
_PHOTO_UNITS = ("mm", "mm", "mm", "1/mm^2", "1/mm^4", "1/mm^6", "1/mm", "1/mm", "1", "1")


def photogrammetric(
    values: Mapping[str, float], pixel_size: float, image_size: Sequence[int], r0: float
) -> Photogrammetric:
    """Return the photogrammetric form of a forward lens without rational or prism terms, with its derivatives.

    c follows from `f = c g`, `g = 1 - A1 R0^2 - A2 R0^4 - A3 R0^6`, `k_i = A_i c^(2i) / g`. The derivatives are
    differences of this closed form.
    """
    names = tuple(values)
    at = np.array([values[name] for name in names])

    def form(x: Array) -> Array:
        return _photo(dict(zip(names, x.tolist(), strict=True)), pixel_size, image_size, r0)

    step = np.maximum(np.abs(at), 1e-3) * 1e-6
    by_lens = np.stack([(form(at + h) - form(at - h)) / (2 * h[i]) for i, h in enumerate(np.diag(step))], axis=1)
    return Photogrammetric(_PHOTO, form(at), _PHOTO_UNITS, by_lens, r0)


def _photo(values: Mapping[str, float], pixel: float, image_size: Sequence[int], r0: float) -> Array:
    fx, fy = focal(values)
    f = fy * pixel
    k = [values.get(name, 0.0) for name in RADIAL]
    # c depends on itself through R0; the iteration contracts, since distortion is a small part of c
    c = f
    for _ in range(50):
        q = (r0 / c) ** 2
        c = f * (1 + k[0] * q + k[1] * q**2 + k[2] * q**3)
    g = f / c
    radial = [k[i] * g / c ** (2 * i + 2) for i in range(3)]
    x0 = (values["cx"] - (image_size[0] - 1) / 2) * pixel
    y0 = -(values["cy"] - (image_size[1] - 1) / 2) * pixel
    b1, b2 = values.get("p2", 0.0) * g / c, -values.get("p1", 0.0) * g / c
    c1, c2 = (fx / fy - 1) * g, -values.get("skew", 0.0) * g
    return np.array([c, x0, y0, *radial, b1, b2, c1, c2])


def projection_range(values: Mapping[str, float], image_size: Sequence[int], fisheye: bool = False) -> float | None:
    """Return the image radius [px] up to which the image radius of a lens grows with the field angle; not backward.

    Beyond it the model folds over (or has a pole) and must not be used. Returns None if it lies outside the image.
    """
    fx, fy = focal(values)
    corners = np.array(
        [[0, 0], [image_size[0] - 1, 0], [0, image_size[1] - 1], [image_size[0] - 1, image_size[1] - 1]], dtype=float
    )
    reach = float(np.hypot((corners[:, 0] - values["cx"]) / fx, (corners[:, 1] - values["cy"]) / fy).max())
    # far beyond the image: a strong barrel images points of several times the radius of a corner into it
    x = np.linspace(0, np.pi if fisheye else 10 * reach, 20001)
    radial = {name: values.get(name, 0.0) for name in (*RADIAL, "k4", "k5", "k6")}
    d = distort(x, np.zeros_like(x), radial, (), fisheye)
    falling = np.flatnonzero(np.diff(d.x) <= 0)
    if not falling.size or d.x[: falling[0] + 1].max() > reach:
        return None
    plain = {**values, **dict.fromkeys((*TANGENTIAL, *TILT), 0.0)}
    u, _ = image_point(plain, x[falling[:1]], np.zeros(1), fisheye)
    return float(u[0] - values["cx"])
