"""Eccentricity of circular targets, and their imaged size, which controls the declared diameter.

Perspective and lens distortion both move the centre of a circle's image. The measured centre (of the fitted ellipse, or
of the grey values) agrees with the centroid of the imaged disc to measurement accuracy. This centroid is computed from
the rim of the target as the forward model images it. So the correction holds for any tilt, distance, distortion and
chain of frames. The diameter enters it and leaves no residual there, but each image shows how large its targets are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.instruments.camera import TARGET
from metrocli.tasks.shared.uncontrolled import Hidden
from metrocli.units import format_quantity
from metrocli.words import listed

_RIM = 16
"""Corners of the polygon that replaces the rim; its centroid is that of the disc to 1e-6 px"""
_ROUNDS = 3
"""Rounds of correction and adjustment"""


def shift(group: Group, blocks: Mapping[str, Block], radius: Array) -> Array:
    """Return the measured centre minus the image of the centre, (2, n) px.

    Targets are discs with `radius` (targets,) mm parallel to the xy plane of the list of targets. The centroid is that
    of the polygon of imaged rim points; a target without radius has shift 0.
    """
    return imaged(group, blocks, radius)[0]


def imaged(group: Group, blocks: Mapping[str, Block], radius: Array) -> tuple[Array, Array]:
    """Return the shift as `shift` does, and the radius (n,) px of the circle with the area of the imaged disc."""
    targets = blocks[TARGET]
    turn = np.arange(_RIM) * (2 * np.pi / _RIM)
    offsets = (
        np.stack([np.cos(turn), np.sin(turn), np.zeros(_RIM)], axis=1)[:, None, :] * np.nan_to_num(radius)[:, None]
    )
    # through the whole chain: the formula for the centre of an ellipse leaves distortion out
    # (docs/decisions/008-eccentricity-by-the-rim.md)
    rim = np.stack(
        [
            group.chain.predict({**blocks, TARGET: targets.with_values(targets.values + offset)}, group.observations)
            for offset in offsets
        ]
    )
    centre = group.chain.predict(blocks, group.observations)
    u, v = np.moveaxis(rim - centre, 1, 0)
    u_next, v_next = np.roll(u, -1, axis=0), np.roll(v, -1, axis=0)
    cross = u * v_next - u_next * v
    # shoelace formula about the image of the centre, so that the centroid is the shift itself
    area = cross.sum(axis=0)
    whole = np.abs(area) > 1e-12
    moved = np.stack([((u + u_next) * cross).sum(axis=0), ((v + v_next) * cross).sum(axis=0)])
    # `area` is twice that of the polygon, which is smaller than the disc by sin(a) / a, a the angle between corners
    angle = 2 * np.pi / _RIM
    size = np.sqrt(np.abs(area) / 2 * angle / np.sin(angle) / np.pi)
    return np.where(whole, moved / np.where(whole, 3 * area, 1.0), 0.0), size


def corrected(
    group: Group, blocks: Mapping[str, Block], others: tuple[Group, ...], datum: Datum | None, radius: Array
) -> tuple[Group, dict[str, Block]]:
    """Return the group with readings corrected for eccentricity, and the blocks adjusted to them.

    The correction depends on the solution, so the two are computed in turn. Raises InputError if the images contradict
    the declared radii (`metrocli/tasks/shared/images/eccentricity.py`).
    """
    measured = group.observations.readings
    # without correction first: the imaged sizes need poses, and poses are hardly moved by eccentricity
    state = dict(adjust(blocks.values(), [group, *others], datum, StoppingRule(limit=15, covariance=False)).blocks)
    # before it is used: a diameter of ten times moves a part by millimetres and leaves no residual
    check_diameters(group, imaged(group, state, radius)[1], radius[group.observations.index[TARGET]])
    for _ in range(_ROUNDS):
        moved = measured - shift(group, state, radius)
        group = group.with_observations(replace(group.observations, readings=moved))
        state = dict(adjust(state.values(), [group, *others], datum, StoppingRule(limit=15, covariance=False)).blocks)
    return group, state


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
    # robust against targets that were taken for others: 1.48 MAD is the standard deviation of a normal sample
    scatter = 1.48 * float(np.median(np.abs(ratio - middle)))
    # a test and not an observation, since prints have systematic errors (docs/decisions/055-imaged-size.md)
    allowed = _PRINT + float(np.median(edge)) + _LEVEL * 1.25 * scatter / np.sqrt(len(ratio))
    if scatter > _ONE_SIZE * middle + float(np.median(edge)):
        raise InputError(
            f"the imaged sizes of the targets fit no one diameter: they scatter by {100 * scatter / middle:.2g} %. "
            "The images do not show the list of targets as it is read: are columns exchanged, mirrored or in another "
            "unit?"
        )
    if abs(middle - 1) > allowed:
        diameter = middle * float(np.median(expected))
        # the edge is a fixed width in px: of a larger image of the target it is a smaller share
        spread = diameter * (allowed + float(np.median(edge)) * (1 / middle - 1))
        declared = np.unique(expected)
        sizes = listed([format_quantity(value, "mm") for value in declared.tolist()], 3)
        raise InputError(
            f"the images show targets of {diameter:.3g} mm diameter (to {spread:.2g} mm), where {sizes} is declared: "
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


_UNSEEN = 0.05
"""Error of a radius that is assumed where no image shows the targets"""


def diameters(group: Group, blocks: Mapping[str, Block], radius: Array) -> Iterator[Hidden]:
    """Yield what a wrong diameter of the targets hides, if their eccentricity is corrected by it.

    The correction s [px] grows with the square of the radius r. A relative error q of r moves a reading by `2 q s` px.
    That is `2 q s r / r'` mm at the target, r' [px] the imaged radius.
    """
    shift, size = imaged(group, blocks, radius)
    at_target = radius[group.observations.index[TARGET]]
    seen = group.observations.conditions.get(SIZE)
    shown = seen is not None and bool(np.isfinite(seen).any())
    share = allowed_share(size) if shown else np.full(len(size), _UNSEEN)
    moved = 2 * share * np.linalg.norm(shift, axis=0) * at_target / np.where(size > 0, size, np.inf)
    yield Hidden(
        "diameter of the targets (places of targets by their eccentricity)",
        "2 % and 0.25 px of the imaged radius" if shown else "5 % of the radius",
        float(np.nanmax(moved, initial=0.0)),
        "the diameter measured on the targets" if shown else "images in place of observations, which show the size",
    )
