"""Quantities of image jobs on which effects of one's own can act."""

from __future__ import annotations

from functools import partial

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import PLACE, TIMED, Acting, Variable, components, condition, point, seen_from
from metrocli.instruments.camera import LENS

WHERE = ("image", "target")
_UV, _PX = ("u", "v"), ("px", "px")
_RADIUS = condition("radius", "mm", "radius")


def _off_centre(value: Array, local: Local) -> Array:
    rows = local.rows(LENS)
    columns = local.blocks[LENS].columns
    return value - rows[[columns.index("cx"), columns.index("cy")]]


def _by_centre(local: Local, by_off: Array) -> Array:
    """Return the derivatives (1, size, n) by the lens of a variable with derivatives (1, 2, n) by the offset."""
    columns = local.blocks[LENS].columns
    by_lens = np.zeros((1, len(columns), by_off.shape[2]))
    by_lens[:, columns.index("cx")], by_lens[:, columns.index("cy")] = -by_off[:, 0], -by_off[:, 1]
    return by_lens


def _off(number: int, value: Array, local: Local) -> Step:
    by_off = np.zeros((1, 2, 1))
    by_off[0, number] = 1.0
    return Step(_off_centre(value, local)[number : number + 1], by_off, {LENS: _by_centre(local, by_off)})


def _from_centre(value: Array, local: Local) -> Step:
    off = _off_centre(value, local)
    size = np.maximum(np.hypot(*off), 1e-300)
    by_off = (off / size)[None]
    return Step(size[None], by_off, {LENS: _by_centre(local, by_off)})


IMAGE = Acting(
    "image",
    Quantity.IMAGE_POINT,
    _PX,
    _UV,
    (
        *components(_UV, _PX),
        *TIMED,
        *PLACE,
        _RADIUS,
        *(Variable(f"off_{name}", "px", partial(_off, number), (LENS,)) for number, name in enumerate(_UV)),
        Variable("from_centre", "px", _from_centre, (LENS,)),
    ),
    WHERE,
)
"""The image point; off_u, off_v and from_centre count from the principal point"""


def image_point(name: str, quantity: Quantity) -> Acting:
    """Return a point on its way to the image as a place to act."""
    return point(name, quantity, WHERE, _RADIUS, *seen_from())
