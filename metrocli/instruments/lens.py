"""The lens: link from a point in the camera frame to an image point in pixels, with forward or backward distortion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass

RADIAL, RATIONAL = ("k1", "k2", "k3"), ("k4", "k5", "k6")
TANGENTIAL, PRISM = ("p1", "p2"), ("s1", "s2", "s3", "s4")
DISTORTION = (*RADIAL, *RATIONAL, *TANGENTIAL, *PRISM)
PARAMETERS = ("f", "fx", "fy", "aspect", "cx", "cy", "skew", *DISTORTION)
"""All lens parameters. With one focal length, `fx = f (1 + aspect)` and `fy = f`, else aspect is not used; skew adds
`fx skew y'` to u."""
PIXELS = ("f", "fx", "fy", "cx", "cy")
"""Parameters in pixels; all others have no unit."""


@dataclass(frozen=True)
class Distorted:
    """Distorted points of the plane Z = 1 with their derivatives."""

    x: Array
    y: Array
    by_x: tuple[Array, Array]
    """(dx'/dx, dy'/dx)"""
    by_y: tuple[Array, Array]
    terms: Mapping[str, tuple[Array | float, Array | float]]
    """(dx'/dk, dy'/dk) for each wanted parameter"""


def distort(x: Array, y: Array, k: Mapping[str, float], wanted: tuple[str, ...] = ()) -> Distorted:
    """Return the distorted points of the plane Z = 1 with derivatives by x, y and by the wanted parameters.

    - `x' = x R + 2 p1 x y + p2 (r2 + 2 x2) + s1 r2 + s2 r4`, and likewise y'
    - `R = (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)`

    Names and meaning of the parameters are those of OpenCV.
    """
    g = {name: k.get(name, 0.0) for name in DISTORTION}
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    top = 1 + r2 * (g["k1"] + r2 * (g["k2"] + r2 * g["k3"]))
    top_by = g["k1"] + r2 * (2 * g["k2"] + r2 * (3 * g["k3"]))
    radial, radial_by, below = top, top_by, None
    if any(name in wanted or np.any(k.get(name, False)) for name in RATIONAL):
        bottom = 1 + r2 * (g["k4"] + r2 * (g["k5"] + r2 * g["k6"]))
        below = 1 / bottom
        radial = top * below
        radial_by = (top_by - radial * (g["k4"] + r2 * (2 * g["k5"] + r2 * (3 * g["k6"])))) * below
    xd = x * radial + 2 * g["p1"] * xy + g["p2"] * (r2 + 2 * xx)
    yd = y * radial + g["p1"] * (r2 + 2 * yy) + 2 * g["p2"] * xy
    cross = 2 * xy * radial_by + 2 * (g["p1"] * x + g["p2"] * y)
    by_x = (radial + 2 * xx * radial_by + 2 * g["p1"] * y + 6 * g["p2"] * x, cross)
    by_y = (cross, radial + 2 * yy * radial_by + 6 * g["p1"] * y + 2 * g["p2"] * x)
    if any(np.any(k.get(name, False)) for name in PRISM):
        slope_x, slope_y = 2 * g["s1"] + 4 * g["s2"] * r2, 2 * g["s3"] + 4 * g["s4"] * r2
        xd, yd = xd + r2 * (g["s1"] + g["s2"] * r2), yd + r2 * (g["s3"] + g["s4"] * r2)
        by_x = (by_x[0] + x * slope_x, by_x[1] + x * slope_y)
        by_y = (by_y[0] + y * slope_x, by_y[1] + y * slope_y)
    return Distorted(xd, yd, by_x, by_y, _terms(x, y, radial, below, wanted))


def _terms(
    x: Array, y: Array, radial: Array, below: Array | None, wanted: tuple[str, ...]
) -> dict[str, tuple[Array | float, Array | float]]:
    r2 = x * x + y * y
    terms: dict[str, tuple[Array | float, Array | float]] = {}
    power = r2 if below is None else r2 * below
    for name in RADIAL:
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


def undistort(x: Array, y: Array, k: Mapping[str, float], steps: int = 30) -> tuple[Array, Array]:
    """Return the points whose distorted images are (x, y), by Newton's method; nan if the model has no inverse."""
    px, py = x / _plain(distort(x, y, k).x, x), y / _plain(distort(x, y, k).y, y)
    for _ in range(steps):
        d = distort(px, py, k)
        ex, ey = x - d.x, y - d.y
        (a, c), (b, e) = d.by_x, d.by_y
        determinant = a * e - b * c
        px, py = px + (e * ex - b * ey) / determinant, py + (a * ey - c * ex) / determinant
        if np.nanmax(np.abs(ex) + np.abs(ey), initial=0.0) < 1e-15:
            break
    left = distort(px, py, k)
    good = (np.abs(left.x - x) + np.abs(left.y - y) < 1e-9) & (
        left.by_x[0] * left.by_y[1] - left.by_x[1] * left.by_y[0] > 0
    )
    return np.where(good, px, np.nan), np.where(good, py, np.nan)


def _plain(distorted: Array, ideal: Array) -> Array:
    """Return the ratio distorted / ideal, a first guess for inverting the distortion; 1 near the axis."""
    ratio = np.where(np.abs(ideal) > 1e-12, distorted / np.where(np.abs(ideal) > 1e-12, ideal, 1.0), 1.0)
    return np.where((ratio > 0.5) & (ratio < 2.0), ratio, 1.0)


def focal(values: Mapping[str, float]) -> tuple[float, float]:
    """Return (fx, fy) in pixels."""
    if "f" in values:
        return values["f"] * (1 + values.get("aspect", 0.0)), values["f"]
    return values["fx"], values["fy"]


def _focal_terms(values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the derivatives of (fx, fy) by each focal parameter in use."""
    if "f" in values:
        return {"f": (1 + values.get("aspect", 0.0), 1.0), "aspect": (values["f"], 0.0)}
    return {"fx": (1.0, 0.0), "fy": (0.0, 1.0)}


def image_point(values: Mapping[str, float], x: Array, y: Array) -> tuple[Array, Array]:
    """Return (u, v) in pixels of points (x, y) of the plane Z = 1 in the forward convention."""
    fx, fy = focal(values)
    d = distort(x, y, values)
    return fx * (d.x + values.get("skew", 0.0) * d.y) + values["cx"], fy * d.y + values["cy"]


def plane_point(values: Mapping[str, float], u: Array, v: Array) -> tuple[Array, Array]:
    """Return the point (x, y) of the plane Z = 1 at the image point (u, v); distortion is not removed."""
    fx, fy = focal(values)
    y = (v - values["cy"]) / fy
    return (u - values["cx"]) / fx - values.get("skew", 0.0) * y, y


def ideal_point(values: Mapping[str, float], u: Array, v: Array, convention: str = "forward") -> tuple[Array, Array]:
    """Return the point (x, y) of the plane Z = 1 at the image point (u, v), with distortion removed."""
    x, y = plane_point(values, u, v)
    if convention == "backward":
        d = distort(x, y, values)
        return d.x, d.y
    return undistort(x, y, values)


def _parameters(local: Local, name: str) -> dict[str, Any]:
    """Return the lens parameters by name: numbers, or arrays (n,) if readings belong to different lenses."""
    rows = local.rows(name)
    values = rows[:, 0].tolist() if rows.shape[1] == 1 else rows
    return dict(zip(local.blocks[name].columns, values, strict=True))


def _wanted(local: Local, name: str) -> tuple[str, ...]:
    """Return the names of the lens parameters whose derivatives are needed."""
    block = local.blocks[name]
    used = block.free.any(axis=0)
    return tuple(np.array(block.columns)[used].tolist()) if name in local.wanted else ()


@dataclass(frozen=True)
class Lens(OfBlock):
    """Link to the image of a point in the camera, with the distortion as a function of the ideal point (OpenCV)."""

    block: str = "lens"
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: Local) -> Step:
        """Return (u, v) [px] (2, n), with derivatives by the point (2, 3, n) and the parameters (2, size, n).

        Behind the camera it is nan. Without wanted blocks there are no derivatives.
        """
        block = local.blocks[self.block]
        k, wanted = _parameters(local, self.block), _wanted(local, self.block)
        fx, fy = focal(k)
        skew = k.get("skew", 0.0)
        inverse_z = 1 / np.where(value[2] > 0, value[2], np.nan)
        x, y = value[0] * inverse_z, value[1] * inverse_z
        d = distort(x, y, k, wanted)
        uv = np.stack([fx * (d.x + skew * d.y) + k["cx"], fy * d.y + k["cy"]])
        if not local.wanted:
            return Step(uv)
        u_x, u_y = fx * (d.by_x[0] + skew * d.by_x[1]), fx * (d.by_y[0] + skew * d.by_y[1])
        v_x, v_y = fy * d.by_x[1], fy * d.by_y[1]
        by_point = np.empty((2, 3, len(x)))
        for row, (by_x, by_y) in enumerate(((u_x, u_y), (v_x, v_y))):
            by_point[row, 0], by_point[row, 1] = by_x * inverse_z, by_y * inverse_z
            by_point[row, 2] = -(by_point[row, 0] * x + by_point[row, 1] * y)
        by_lens = np.zeros((2, block.size, len(x)))
        focals = _focal_terms(k)
        for place, name in enumerate(block.columns):
            if name not in wanted:
                continue
            if name in focals:
                by_lens[0, place], by_lens[1, place] = focals[name][0] * (d.x + skew * d.y), focals[name][1] * d.y
            elif name in ("cx", "cy"):
                by_lens[0 if name == "cx" else 1, place] = 1.0
            elif name == "skew":
                by_lens[0, place] = fx * d.y
            elif name in d.terms:
                term_x, term_y = d.terms[name]
                by_lens[0, place], by_lens[1, place] = fx * (term_x + skew * term_y), fy * term_y
        return Step(uv, by_point, {self.block: by_lens} if wanted else {})


@dataclass(frozen=True)
class LensBackward(OfBlock):
    """Link to the image of a point in the camera, with the correction as a function of the measured point (Brown 1966).

    The corrected measured point `D(m)` is compared with the ideal point x: `value = reading - f (D(m) - x)`. So the
    residual is the one in the corrected image, in pixels.
    """

    block: str = "lens"
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: Local) -> Step:
        """Return (u, v) [px] (2, n), with derivatives by the point (2, 3, n) and the parameters (2, size, n).

        Behind the camera it is nan. Without wanted blocks there are no derivatives.
        """
        block = local.blocks[self.block]
        k, wanted = _parameters(local, self.block), _wanted(local, self.block)
        fx, fy = focal(k)
        skew = k.get("skew", 0.0)
        u, v = local.observations.readings
        mx, my = plane_point(k, u, v)
        d = distort(mx, my, k, wanted)
        inverse_z = 1 / np.where(value[2] > 0, value[2], np.nan)
        x, y = value[0] * inverse_z, value[1] * inverse_z
        gap_x, gap_y = d.x - x, d.y - y
        uv = np.stack([u - fx * (gap_x + skew * gap_y), v - fy * gap_y])
        if not local.wanted:
            return Step(uv)
        by_point = np.zeros((2, 3, len(x)))
        by_point[0, 0], by_point[0, 1] = fx * inverse_z, fx * skew * inverse_z
        by_point[1, 1] = fy * inverse_z
        by_point[:, 2] = -(by_point[:, 0] * x + by_point[:, 1] * y)
        by_lens = np.zeros((2, block.size, len(x)))
        for place, name in enumerate(block.columns):
            if name in wanted:
                gap, scale = self._term(name, k, (mx, my), d), _focal_terms(k).get(name, (0.0, 0.0))
                by_lens[0, place] = -fx * (gap[0] + skew * gap[1]) - scale[0] * (gap_x + skew * gap_y)
                by_lens[1, place] = -fy * gap[1] - scale[1] * gap_y
                if name == "skew":
                    by_lens[0, place] -= fx * gap_y
        return Step(uv, by_point, {self.block: by_lens} if wanted else {})

    @staticmethod
    def _term(name: str, k: Mapping[str, float], measured: tuple[Array, Array], d: Distorted) -> tuple[Array, Array]:
        """Return the derivative of D(m) by a parameter, both direct and through the measured point m."""
        if name in d.terms:
            return np.asarray(d.terms[name][0]), np.asarray(d.terms[name][1])
        fx, fy = focal(k)
        skew = k.get("skew", 0.0)
        mx, my = measured
        zero = np.zeros_like(my)
        by_fx, by_fy = (-(mx + skew * my) / fx, zero), (skew * my / fy, -my / fy)
        changes = {"cx": (zero - 1 / fx, zero), "cy": (zero + skew / fy, zero - 1 / fy), "skew": (-my, zero)}
        for focal_name, (of_x, of_y) in _focal_terms(k).items():
            changes[focal_name] = (by_fx[0] * of_x + by_fy[0] * of_y, by_fy[1] * of_y)
        move_x, move_y = changes.get(name, (zero, zero))
        return d.by_x[0] * move_x + d.by_y[0] * move_y, d.by_x[1] * move_x + d.by_y[1] * move_y
