"""The lens: link from a point in the camera frame to an image point in pixels.

The distortion is a function of the ideal point (forward, fisheye) or of the measured point (backward).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.lenses.distortion import DISTORTION, TILT, Distorted, distort, undistort

PARAMETERS = ("f", "fx", "fy", "aspect", "cx", "cy", "skew", *DISTORTION)
"""All lens parameters. With one focal length, `fx = f (1 + aspect)` and `fy = f`, else aspect is not used; skew adds
`fx skew y'` to u."""
UNITS = {**dict.fromkeys(("f", "fx", "fy", "cx", "cy"), "px"), **dict.fromkeys(TILT, "rad")}
"""Units of the parameters that have one."""


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


def image_point(values: Mapping[str, float], x: Array, y: Array, fisheye: bool = False) -> tuple[Array, Array]:
    """Return (u, v) in pixels of points (x, y) of the plane before distortion; not for backward lenses."""
    fx, fy = focal(values)
    d = distort(x, y, values, (), fisheye)
    return fx * (d.x + values.get("skew", 0.0) * d.y) + values["cx"], fy * d.y + values["cy"]


def plane_point(values: Mapping[str, float], u: Array, v: Array) -> tuple[Array, Array]:
    """Return the point (x, y) of the plane at the image point (u, v); distortion is not removed."""
    fx, fy = focal(values)
    y = (v - values["cy"]) / fy
    return (u - values["cx"]) / fx - values.get("skew", 0.0) * y, y


def ideal_point(values: Mapping[str, float], u: Array, v: Array, convention: str = "forward") -> tuple[Array, Array]:
    """Return the point (x, y) of the plane at the image point (u, v), with distortion removed."""
    x, y = plane_point(values, u, v)
    if convention == "backward":
        d = distort(x, y, values)
        return d.x, d.y
    return undistort(x, y, values, fisheye=convention == "fisheye")


def direction(values: Mapping[str, float], u: Array, v: Array, convention: str = "forward") -> Array:
    """Return the vector (3, n), of any length, to what is seen at (u, v); nan where the lens has no inverse."""
    x, y = ideal_point(values, u, v, convention)
    if convention == "fisheye":
        return unit_vector(np.stack([x, y]))
    return np.stack([x, y, np.ones_like(x)])


def unit_vector(flat: Array) -> Array:
    """Return the unit vectors (3, n) of points (2, n) of the plane of a fisheye, the inverse of `equidistant`."""
    angle = np.hypot(*flat)
    across = np.sinc(angle / np.pi)  # sin(angle) / angle
    return np.stack([flat[0] * across, flat[1] * across, np.cos(angle)])


@dataclass(frozen=True)
class Projected:
    """Points of the camera in the plane before distortion."""

    x: Array
    y: Array
    by_z: tuple[Array, Array]
    """(dx/dZ, dy/dZ)"""
    scale: Array
    """x / X = y / Y"""
    bend: Array | None = None
    """dx/dX = scale + X X bend, dx/dY = X Y bend; None: 0"""


def rectilinear(point: Array) -> Projected:
    """Return the points `x = X/Z, y = Y/Z` of the plane Z = 1; nan behind the camera."""
    scale = 1 / np.where(point[2] > 0, point[2], np.nan)
    x, y = point[0] * scale, point[1] * scale
    return Projected(x, y, (-x * scale, -y * scale), scale)


_NEAR_AXIS = 0.02
"""Tangent of the angle below which the series of `bend` is more accurate than its closed form"""


def equidistant(point: Array) -> Projected:
    """Return the points of the plane at the distance of the angle from the axis, `atan2(hypot(X, Y), Z)`, up to pi."""
    x, y, z = point
    rho2 = x * x + y * y
    rho, length2 = np.sqrt(rho2), rho2 + z * z
    length2 = np.where(length2 > 0, length2, np.nan)
    near = rho < _NEAR_AXIS * z
    # nan straight behind the camera, where a point has no direction from the axis
    safe = np.where(near, 1.0, np.where(rho > 0, rho, np.nan))
    t2 = np.where(near, rho2, 0.0) / np.where(near, z * z, 1.0)
    # atan(t)/t: the closed form is 0/0 on the axis, and its `bend` loses all digits near it
    series = (1 - t2 * (1 / 3 - t2 * (1 / 5 - t2 * (1 / 7 - t2 / 9)))) / np.where(near, z, 1.0)
    scale = np.where(near, series, np.arctan2(rho, z) / safe)
    bent = -(2 / 3 - t2 * (4 / 5 - t2 * (6 / 7 - t2 * (8 / 9 - t2 * 10 / 11)))) / np.where(near, z, 1.0) ** 3
    bend = np.where(near, bent, (z / length2 - scale) / safe**2)
    return Projected(x * scale, y * scale, (-x / length2, -y / length2), scale, bend)


def _parameters(local: LinkContext, name: str) -> dict[str, Any]:
    """Return the lens parameters by name: numbers, or arrays (n,) if readings belong to different lenses."""
    rows = local.rows(name)
    # numbers where all readings have one lens: arithmetic with them costs less than with arrays of length 1
    values = rows[:, 0].tolist() if rows.shape[1] == 1 else rows
    return dict(zip(local.blocks[name].columns, values, strict=True))


def _wanted(local: LinkContext, name: str) -> tuple[str, ...]:
    """Return the names of the lens parameters whose derivatives are needed."""
    block = local.blocks[name]
    used = block.free.any(axis=0)
    return tuple(np.array(block.columns)[used].tolist()) if name in local.wanted else ()


@dataclass(frozen=True)
class Lens(OfBlock):
    """Link to the image of a point in the camera, with the distortion as a function of the ideal point (OpenCV)."""

    block: str = "lens"
    fisheye: bool = False
    """Whether the plane before distortion has the angle from the axis as radius, not its tangent"""
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return (u, v) [px] (2, n), with derivatives by the point (2, 3, n) and the parameters (2, size, n).

        Behind a camera that is not a fisheye it is nan. Without wanted blocks there are no derivatives.
        """
        block = local.blocks[self.block]
        k, wanted = _parameters(local, self.block), _wanted(local, self.block)
        fx, fy = focal(k)
        skew = k.get("skew", 0.0)
        flat = equidistant(value) if self.fisheye else rectilinear(value)
        d = distort(flat.x, flat.y, k, wanted, self.fisheye)
        uv = np.stack([fx * (d.x + skew * d.y) + k["cx"], fy * d.y + k["cy"]])
        if not local.wanted:
            return Step(uv)
        u_x, u_y = fx * (d.by_x[0] + skew * d.by_x[1]), fx * (d.by_y[0] + skew * d.by_y[1])
        v_x, v_y = fy * d.by_x[1], fy * d.by_y[1]
        by_point = np.stack([_by_point(flat, value, u_x, u_y), _by_point(flat, value, v_x, v_y)])
        by_lens = np.zeros((2, block.size, len(flat.x)))
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


def _by_point(flat: Projected, point: Array, by_x: Array, by_y: Array) -> Array:
    """Return the derivatives (3, n) by the point in the camera of what has these by x and y of the plane."""
    derivatives = np.stack([by_x * flat.scale, by_y * flat.scale, by_x * flat.by_z[0] + by_y * flat.by_z[1]])
    if flat.bend is not None:
        derivatives[:2] += (by_x * point[0] + by_y * point[1]) * flat.bend * point[:2]
    return derivatives


@dataclass(frozen=True)
class LensBackward(OfBlock):
    """Link to the image of a point in the camera, with the correction as a function of the measured point (Brown 1966).

    The corrected measured point `D(m)` is compared with the ideal point x: `value = reading - f (D(m) - x)`. So the
    residual is the one in the corrected image, in pixels.
    """

    block: str = "lens"
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: LinkContext) -> Step:
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
                    # skew enters twice: in the measured point, and here as the factor on the gap
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
