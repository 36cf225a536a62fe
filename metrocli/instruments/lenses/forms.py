"""Lens models of other programs: the names of their parameters here, in their order, and the nearest one to a lens.

Sources: OpenCV, calib3d and fisheye; ROS REP 104; COLMAP, Camera Models; Kalibr, Supported models; mrcal, Lens models;
Metashape manual, appendix Camera models; MATLAB, cameraIntrinsics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.lenses.conventions import Converted, image_grid
from metrocli.instruments.lenses.lens import Lens, direction, focal

_TWO, _ONE = ("fx", "fy", "cx", "cy"), ("f", "cx", "cy")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
"""OpenCV's order"""
_ANGULAR = ("k1", "k2", "k3", "k4")


@dataclass(frozen=True)
class LensForm:
    """A lens model as a program has it."""

    name: str
    terms: tuple[str, ...]
    """Its parameters in its order"""
    fisheye: bool = False

    @property
    def title(self) -> str:
        """Return its name, with the number of coefficients where several models share it."""
        count = len(self.terms) - len(_TWO)
        return f"{self.name} with {count} coefficients" if self.name == "opencv" else self.name

    def holds(self, lens: Mapping[str, float], convention: str) -> bool:
        """Return whether the lens is exactly one of this model."""
        fx, fy = focal(lens)
        # a coefficient of 0 is not an obstacle: the form images the same
        rest = (name for name, value in lens.items() if value and name not in ("f", "fx", "fy", "aspect"))
        same = convention == ("fisheye" if self.fisheye else "forward")
        return same and (fx == fy or "fx" in self.terms) and all(name in self.terms for name in rest)

    def of(self, lens: Mapping[str, float]) -> dict[str, float]:
        """Return the values of its parameters that a lens has, by name; 0 where it has none."""
        fx, fy = focal(lens)
        values = {**lens, "f": fy, "fx": fx, "fy": fy}
        return {name: values.get(name, 0.0) for name in self.terms}


@dataclass(frozen=True)
class Program:
    """The lens models of a program."""

    forms: tuple[LensForm, ...]
    """Those with fewer parameters first"""
    pixel: float = 0.0
    """Coordinates of the centre of the first pixel"""


def _opencv(name: str, *lengths: int) -> tuple[LensForm, ...]:
    return tuple(LensForm(name.format(n), (*_TWO, *_COEFFICIENTS[:n])) for n in lengths)


def _fisheye(name: str) -> LensForm:
    return LensForm(name, (*_TWO, *_ANGULAR), True)


PROGRAMS: Mapping[str, Program] = {
    "opencv": Program((*_opencv("opencv", 4, 5, 8, 12, 14), LensForm("fisheye", (*_TWO, "skew", *_ANGULAR), True))),
    "ros": Program((*_opencv("plumb_bob", 5), *_opencv("rational_polynomial", 8), _fisheye("equidistant"))),
    "colmap": Program(
        (
            LensForm("SIMPLE_PINHOLE", _ONE),
            LensForm("PINHOLE", _TWO),
            LensForm("SIMPLE_RADIAL", (*_ONE, "k1")),
            LensForm("SIMPLE_RADIAL_FISHEYE", (*_ONE, "k1"), True),
            LensForm("RADIAL", (*_ONE, "k1", "k2")),
            LensForm("RADIAL_FISHEYE", (*_ONE, "k1", "k2"), True),
            *_opencv("OPENCV", 4),
            _fisheye("OPENCV_FISHEYE"),
            *_opencv("FULL_OPENCV", 8),
            LensForm("THIN_PRISM_FISHEYE", (*_TWO, "k1", "k2", "p1", "p2", "k3", "k4", "s1", "s3"), True),
        ),
        pixel=0.5,
    ),
    "kalibr": Program((LensForm("none", _TWO), *_opencv("radtan", 4), _fisheye("equidistant"))),
    "mrcal": Program((LensForm("LENSMODEL_PINHOLE", _TWO), *_opencv("LENSMODEL_OPENCV{}", 4, 5, 8, 12))),
    "metashape": Program(
        (
            LensForm("frame", (*_TWO, "skew", "k1", "k2", "k3", "p1", "p2")),
            LensForm("fisheye", (*_TWO, "skew", *_ANGULAR, "p1", "p2"), True),
        ),
        pixel=0.5,
    ),
    "matlab": Program((LensForm("cameraIntrinsics", (*_TWO, "skew", "k1", "k2", "k3", "p1", "p2")),), pixel=1.0),
}


LENGTHS = "lengths in mm"
"""Comment of exported files in whose format the poses of several cameras have no unit"""


def nearest(
    lens: Mapping[str, float],
    convention: str,
    image_size: Sequence[int],
    form: LensForm,
    unshifted: Callable[[Array], Array] = np.asarray,
) -> Converted | None:
    """Return the lens of a form that images directions most alike, by least squares over a grid of the image.

    `unshifted` takes image points (2, n) to those of the lens, where it has a shape besides. None where a direction
    that the lens sees has no image in this form.
    """
    uv = np.stack(image_grid(image_size))
    at = unshifted(uv)
    seen = direction(lens, at[0], at[1], convention)
    known = np.isfinite(seen[0])
    start = form.of(lens)
    # the coefficients of the other convention mean something else, and may put a fold between start and solution
    if form.fisheye != (convention == "fisheye"):
        start |= {name: 0.0 for name in start if name not in ("f", *_TWO)}
    return nearest_to(seen[:, known], uv[:, known], form, start) if known.any() else None


def nearest_to(seen: Array, uv: Array, form: LensForm, start: Mapping[str, float]) -> Converted | None:
    """Return the lens of a form that images directions (3, n) nearest to (2, n) px, as `nearest`."""
    from scipy.optimize import least_squares

    def step(values: Array) -> Step:
        block = Block("lens", values[None], form.terms)
        return Lens(fisheye=form.fisheye).step(
            seen, LinkContext({"lens": block}, Observations(uv, np.ones(1), {}), frozenset({"lens"}))
        )

    if not np.isfinite(step(np.array(list(start.values()))).value).all():
        return None

    def gaps(values: Array) -> Array:
        # a huge gap and not nan: least_squares stops at nan, and so steps back instead
        gap: Array = np.nan_to_num((step(values).value - uv).ravel(), nan=1e9)
        return gap

    def slopes(values: Array) -> Array:
        by_lens = step(values).by_block["lens"]
        slope: Array = np.nan_to_num(np.concatenate([by_lens[0].T, by_lens[1].T]))
        return slope

    fit = least_squares(gaps, list(start.values()), slopes, method="lm", x_scale="jac", xtol=1e-15, ftol=1e-15)
    distance = np.hypot(*gaps(fit.x).reshape(2, -1))
    values = dict(zip(form.terms, fit.x.tolist(), strict=True))
    return Converted(values, float(np.sqrt((distance**2).mean())), float(distance.max()))
