"""Distortion of a lens: functions of the plane that its projection maps directions to, and their inverse."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass

RADIAL, RATIONAL = ("k1", "k2", "k3"), ("k4", "k5", "k6")
TANGENTIAL, PRISM, TILT = ("p1", "p2"), ("s1", "s2", "s3", "s4"), ("tau_x", "tau_y")
DISTORTION = (*RADIAL, *RATIONAL, *TANGENTIAL, *PRISM, *TILT)
OF_FISHEYE = (*RADIAL, "k4", *TANGENTIAL, *PRISM, *TILT)
"""A fisheye has no rational terms: k4 is the fourth of its radial ones"""

_Terms = dict[str, tuple[Array | float, Array | float]]


@dataclass(frozen=True)
class Distorted:
    """Distorted points of the plane with their derivatives."""

    x: Array
    y: Array
    by_x: tuple[Array, Array]
    """(dx'/dx, dy'/dx)"""
    by_y: tuple[Array, Array]
    terms: Mapping[str, tuple[Array | float, Array | float]]
    """(dx'/dk, dy'/dk) for each wanted parameter"""


def distort(
    x: Array, y: Array, k: Mapping[str, float], wanted: tuple[str, ...] = (), fisheye: bool = False
) -> Distorted:
    """Return the distorted points of the plane with derivatives by x, y and by the wanted parameters.

    - `x' = x R + 2 p1 x y + p2 (r2 + 2 x2) + s1 r2 + s2 r4`, and likewise y'
    - `R = (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)`
    - fisheye: `R = 1 + k1 r2 + k2 r4 + k3 r6 + k4 r8`
    - then the tilt of the sensor by tau_x, tau_y

    Names and meaning of the parameters are those of OpenCV.
    """
    g = {name: k.get(name, 0.0) for name in DISTORTION}
    radials = (*RADIAL, "k4") if fisheye else RADIAL
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    last, last_by = (r2 * g["k4"], r2 * (4 * g["k4"])) if fisheye else (0.0, 0.0)
    top = 1 + r2 * (g["k1"] + r2 * (g["k2"] + r2 * (g["k3"] + last)))
    top_by = g["k1"] + r2 * (2 * g["k2"] + r2 * (3 * g["k3"] + last_by))
    radial, radial_by, below = top, top_by, None
    # the denominator is left out where it is 1: most lenses have no rational terms, and the division costs
    if not fisheye and any(name in wanted or _acts(k, name) for name in RATIONAL):
        bottom = 1 + r2 * (g["k4"] + r2 * (g["k5"] + r2 * g["k6"]))
        below = 1 / bottom
        radial = top * below
        radial_by = (top_by - radial * (g["k4"] + r2 * (2 * g["k5"] + r2 * (3 * g["k6"])))) * below
    xd = x * radial + 2 * g["p1"] * xy + g["p2"] * (r2 + 2 * xx)
    yd = y * radial + g["p1"] * (r2 + 2 * yy) + 2 * g["p2"] * xy
    cross = 2 * xy * radial_by + 2 * (g["p1"] * x + g["p2"] * y)
    by_x = (radial + 2 * xx * radial_by + 2 * g["p1"] * y + 6 * g["p2"] * x, cross)
    by_y = (cross, radial + 2 * yy * radial_by + 6 * g["p1"] * y + 2 * g["p2"] * x)
    if any(_acts(k, name) for name in PRISM):
        slope_x, slope_y = 2 * g["s1"] + 4 * g["s2"] * r2, 2 * g["s3"] + 4 * g["s4"] * r2
        xd, yd = xd + r2 * (g["s1"] + g["s2"] * r2), yd + r2 * (g["s3"] + g["s4"] * r2)
        by_x = (by_x[0] + x * slope_x, by_x[1] + x * slope_y)
        by_y = (by_y[0] + y * slope_x, by_y[1] + y * slope_y)
    flat = Distorted(xd, yd, by_x, by_y, _terms(x, y, radial, below, wanted, radials))
    tilts = any(name in wanted or _acts(k, name) for name in TILT)
    return _tilted(flat, k, wanted) if tilts else flat


def _acts(k: Mapping[str, float | Array], name: str) -> bool:
    value = k.get(name, 0.0)
    # for plain numbers `np.any` takes as long as the arithmetic with a few points
    return value != 0.0 if isinstance(value, float) else bool(np.any(value))


def _terms(
    x: Array, y: Array, radial: Array, below: Array | None, wanted: tuple[str, ...], radials: tuple[str, ...]
) -> _Terms:
    r2 = x * x + y * y
    terms: _Terms = {}
    power = r2 if below is None else r2 * below
    for name in radials:
        if name in wanted:
            terms[name] = (x * power, y * power)
        power = power * r2
    if below is not None:
        power = -radial * r2 * below
        for name in RATIONAL:
            if name in wanted:
                terms[name] = (x * power, y * power)
            power = power * r2
    if "p1" in wanted:
        terms["p1"] = (2 * x * y, r2 + 2 * y * y)
    if "p2" in wanted:
        terms["p2"] = (r2 + 2 * x * x, 2 * x * y)
    prism: tuple[tuple[Array | float, Array | float], ...] = ((r2, 0.0), (r2 * r2, 0.0), (0.0, r2), (0.0, r2 * r2))
    for name, term in zip(PRISM, prism, strict=True):
        if name in wanted:
            terms[name] = term
    return terms


def _tilted(d: Distorted, k: Mapping[str, float], wanted: tuple[str, ...]) -> Distorted:
    """Return the points on a sensor that is turned by tau_x about x, then by tau_y about y.

    The homography of OpenCV's tilted model, multiplied out. c and s are cosine and sine.

    `x' = cx x / w`, `y' = (cy y - sx sy x) / w`, `w = sy x - cy sx y + cy cx`
    """
    (cx, sx), (cy, sy) = ((np.cos(k.get(name, 0.0)), np.sin(k.get(name, 0.0))) for name in TILT)
    below = 1 / (sy * d.x - cy * sx * d.y + cy * cx)
    x, y = cx * d.x * below, (cy * d.y - sx * sy * d.x) * below

    def change(top_x: Array | float, top_y: Array | float, bottom: Array | float) -> tuple[Array, Array]:
        return (top_x - x * bottom) * below, (top_y - y * bottom) * below

    by_flat = (change(cx, -sx * sy, sy), change(0.0, cy, -cy * sx))

    def carried(pair: tuple[Array | float, Array | float]) -> tuple[Array, Array]:
        (x_x, y_x), (x_y, y_y) = by_flat
        return x_x * pair[0] + x_y * pair[1], y_x * pair[0] + y_y * pair[1]

    terms: _Terms = {name: carried(pair) for name, pair in d.terms.items()}
    if "tau_x" in wanted:
        terms["tau_x"] = change(-sx * d.x, -cx * sy * d.x, -cy * (cx * d.y + sx))
    if "tau_y" in wanted:
        terms["tau_y"] = change(0.0, -sy * d.y - sx * cy * d.x, cy * d.x + sy * (sx * d.y - cx))
    return Distorted(x, y, carried(d.by_x), carried(d.by_y), terms)


def undistort(
    x: Array, y: Array, k: Mapping[str, float], steps: int = 30, fisheye: bool = False
) -> tuple[Array, Array]:
    """Return the points whose distorted images are (x, y), by Newton's method; nan if the model has no inverse."""
    first = distort(x, y, k, (), fisheye)
    # the ratio at the given point, once: the distortion there is nearly that at the point sought
    px, py = x / _plain(first.x, x), y / _plain(first.y, y)
    # a point that is the image of none runs away until its numbers overflow
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(steps):
            d = distort(px, py, k, (), fisheye)
            ex, ey = x - d.x, y - d.y
            (a, c), (b, e) = d.by_x, d.by_y
            determinant = a * e - b * c
            px, py = px + (e * ex - b * ey) / determinant, py + (a * ey - c * ex) / determinant
            if np.nanmax(np.abs(ex) + np.abs(ey), initial=0.0) < 1e-15:
                break
        left = distort(px, py, k, (), fisheye)
        # a positive determinant too: beyond a fold Newton finds a point of the wrong branch with a residual of 0
        good = (np.abs(left.x - x) + np.abs(left.y - y) < 1e-9) & (
            left.by_x[0] * left.by_y[1] - left.by_x[1] * left.by_y[0] > 0
        )
    return np.where(good, px, np.nan), np.where(good, py, np.nan)


def _plain(distorted: Array, ideal: Array) -> Array:
    """Return the ratio distorted / ideal, a first guess for inverting the distortion; 1 near the axis."""
    ratio = np.where(np.abs(ideal) > 1e-12, distorted / np.where(np.abs(ideal) > 1e-12, ideal, 1.0), 1.0)
    return np.where((ratio > 0.5) & (ratio < 2.0), ratio, 1.0)
