"""A splined camera of mrcal as a fisheye with a smooth shift over the image, as the lens model spline has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import Knots, KnownShape
from metrocli.errors import InputError
from metrocli.imports.camera_fields import ReadCamera, camera_of, must_be_numbers
from metrocli.imports.lines import TextLines
from metrocli.instruments.lenses.conventions import image_grid
from metrocli.instruments.lenses.forms import LensForm, nearest_to
from metrocli.instruments.lenses.lens import equidistant, image_point
from metrocli.instruments.lenses.stereographic import StereographicGrid, raised, straightest
from metrocli.units.people import two_digits

WITHIN = 0.05
"""Largest difference [px] of a camera that is read"""
_ENOUGH = 0.1
"""Share of it, below which no more knots are tried"""
_COLUMNS = (8, 12, 18, 27, 40)
_BASE = LensForm("fisheye", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "s1", "s3"), True)
_POINTS = 101
"""Along each axis, at which the shift is fitted"""


def splined(lines: TextLines, grid: StereographicGrid, intrinsics: Sequence[str], size: Sequence[str]) -> ReadCamera:
    """Return the camera of a splined model by its intrinsics: fx, fy, cx, cy, then the shift of each knot.

    Raises InputError for a lens that has no direction for a point of its image, and for one that is farther than
    WITHIN from what the lens model spline can be.
    """
    from scipy.sparse import csr_array

    must_be_numbers(lines, {f"intrinsics {k}": number for k, number in enumerate(intrinsics, 1)})
    core, shifts = np.array(intrinsics[:4], dtype=float), np.array(intrinsics[4:], dtype=float).reshape(-1, 2)
    named = dict(zip(("fx", "fy", "cx", "cy"), intrinsics[:4], strict=True))
    read = camera_of(lines, "mrcal", _BASE, size, named)
    if not (core[:2] > 0).all():
        raise InputError([lines.fault(f"fx and fy are {intrinsics[0]} and {intrinsics[1]}", None, "expected pixels")])
    dense, other = (np.stack(image_grid(read.size, n)) for n in (_POINTS, _POINTS - 30))
    at, checked = (raised(grid.unshifted((uv - core[2:, None]) / core[:2, None], shifts)) for uv in (dense, other))
    lost = int((~np.isfinite(at)).any(axis=0).sum())
    start = {**dict.fromkeys(_BASE.terms, 0.0), **dict(zip(named, core.tolist(), strict=True))}
    base = None if lost else nearest_to(at, dense, _BASE, start)
    if base is None or not np.isfinite(checked).all():
        message = f"the model folds over: {lost} of {dense.shape[1]} points of its image have no direction"
        raise InputError([lines.fault(message, None, "expected a model that is valid over the image")])

    lens = dict(base.values)

    def imaged(seen: Array) -> Array:
        flat = equidistant(seen)
        return np.stack(image_point(lens, flat.x, flat.y, fisheye=True))

    # beyond the image the shift is that of its border: a base lens that is smaller by a little keeps all points inside
    centre = np.array([[lens["cx"]], [lens["cy"]]])
    off = imaged(at) - centre
    room = np.where(off > 0, np.array(read.size)[:, None] - 1 - centre, centre)
    # without that, corners of a lens with 3 px between base and image were off by 0.03 px (docs/decisions/267)
    smaller = min(1.0, float((room / np.maximum(np.abs(off), 1e-9)).min()))
    lens |= {"fx": lens["fx"] * smaller, "fy": lens["fy"] * smaller}
    within, shape, gap = imaged(at), None, np.zeros(0)
    for columns in _COLUMNS:
        knots = Knots(read.size, (columns, max(4, round(columns * read.size[1] / read.size[0]))))
        shape = KnownShape(knots, straightest(csr_array(knots.basis(within)), knots.counts, dense - within).T)
        gap = np.hypot(*(imaged(checked) + shape.at(imaged(checked)) - other))
        if gap.max() <= _ENOUGH * WITHIN:
            break
    difference = (
        f"rms {two_digits(float(np.sqrt((gap**2).mean())))} px, largest difference {two_digits(float(gap.max()))} px"
    )
    if gap.max() > WITHIN:
        hint = f"expected a lens that the model spline is within {WITHIN:g} px of: {difference} over the image"
        raise InputError([lines.fault(f"{grid.name} is not smooth enough", None, hint)])
    note = f"a fisheye with a shift on {knots.counts[0]} by {knots.counts[1]} knots is {grid.name}: {difference}"
    return replace(read, values={name: repr(value) for name, value in lens.items()}, shape=shape, notes=(note,))
