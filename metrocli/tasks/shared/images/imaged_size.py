"""The size of targets in the images, a reading that controls their declared diameter.

The diameter enters the correction of eccentricity and leaves no residual there: pose and lens absorb most of
a wrong one. But each image shows how large its targets are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.errors import InputError
from metrocli.units import format_quantity
from metrocli.words import listed

SIZE = "size"
"""Condition of a reading: the radius [px] of the circle with the area of its imaged ellipse; nan if it is not known"""
_EDGE = 0.25
"""Systematic error [px] of an imaged radius: the threshold of an edge, spread ink, blur"""
_PRINT = 0.02
"""Systematic error of a printed radius, as a share"""
_ONE_SIZE = 0.2
"""Scatter of the ratios, as a share, above which poses and not the diameter are wrong"""
_LEVEL = 4.0
"""Standard uncertainties of the median ratio that are allowed beside the systematic errors"""


def check_diameters(group: Group, predicted: Array, radius: Array) -> None:
    """Raise InputError if imaged targets contradict their declared diameters or each other, in all or single images.

    `predicted` (n,) px are the radii of circles with the area of the imaged targets, by pose, lens and `radius` (n,)
    mm. The median of `q = measured / predicted` is compared with 1. It may differ by 0.25 px of the imaged radius, 2 %,
    and four standard uncertainties of a median, `1.25 * 1.48 MAD / sqrt(n)`. One image is compared with the median of
    all, by the scatter of all.
    """
    observations = group.observations
    size = observations.conditions.get(SIZE)
    known = np.isfinite(size) & (predicted > 0) & np.isfinite(radius) if size is not None else np.zeros(0, dtype=bool)
    if size is None or not known.any():
        return
    ratio, expected, edge = size[known] / predicted[known], 2 * radius[known], _EDGE / predicted[known]
    middle = float(np.median(ratio))
    scatter = 1.48 * float(np.median(np.abs(ratio - middle)))
    allowed = _PRINT + float(np.median(edge)) + _LEVEL * 1.25 * scatter / np.sqrt(len(ratio))
    if scatter > _ONE_SIZE * middle + float(np.median(edge)):
        raise InputError(
            f"the imaged sizes of the targets fit no one diameter: they scatter by {100 * scatter / middle:.2g} %. "
            "The images do not show the list of targets as it is read: are columns exchanged, mirrored or in another "
            "unit?"
        )
    if abs(middle - 1) > allowed:
        found = middle * float(np.median(expected))
        spread = found * (allowed + float(np.median(edge)) * (1 / middle - 1))
        declared = np.unique(expected)
        sizes = listed([format_quantity(value, "mm") for value in declared.tolist()], 3)
        raise InputError(
            f"the images show targets of {found:.3g} mm diameter (to {spread:.2g} mm), where {sizes} is declared: "
            "correct the diameter of the pattern or radius_mm of the targets (or the pitch or coordinates that scale "
            "them); `eccentricity: ignore` does not use it"
        )
    for what in ("image", "target"):
        of = np.asarray(observations.keys[what])[known]
        _check_each(ratio / middle, of, edge + _PRINT + _LEVEL * scatter, what)


def allowed_share(predicted: Array) -> Array:
    """Return the share of its radius by which an imaged target may be off without contradiction, by its size [px]."""
    return np.asarray(_PRINT + _EDGE / np.maximum(predicted, _EDGE))


def _check_each(ratio: Array, of: np.ndarray[tuple[int], np.dtype[np.str_]], allowed: Array, what: str) -> None:
    """Raise InputError for the images, or targets, in which the median size differs from that of the others."""
    names, which = np.unique(of, return_inverse=True)
    if len(names) < 3:
        return
    middle = np.array([np.median(ratio[which == k]) for k in range(len(names))])
    bound = np.array([np.median(allowed[which == k]) for k in range(len(names))])
    odd = np.flatnonzero(np.abs(middle - 1) > 2 * bound)
    if odd.size:
        worst: Sequence[str] = [f"{names[k]} ({middle[k]:.3g} times)" for k in odd]
        raise InputError(
            f"the imaged size of targets, over their diameter, differs from all others in {what} {listed(worst, 5)}: "
            "another target was found there, or its diameter is another; `eccentricity: ignore` does not use diameters"
        )
