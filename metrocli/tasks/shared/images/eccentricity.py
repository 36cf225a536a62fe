"""Eccentricity of circular targets: the centre of a circle's image is not the image of its centre.

Perspective and lens distortion both move it. The measured centre (of the fitted ellipse, or of the grey values) agrees
with the centroid of the imaged disc to measurement accuracy. This centroid is computed from the rim of the target as
the forward model images it. So the correction holds for any tilt, distance, distortion and chain of frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.instruments.camera import TARGET
from metrocli.tasks.shared.images.imaged_size import check_diameters

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
    the declared radii (`metrocli/tasks/shared/images/imaged_size.py`).
    """
    measured = group.observations.readings
    state = dict(adjust(blocks.values(), [group, *others], datum, Control(limit=15, covariance=False)).blocks)
    check_diameters(group, imaged(group, state, radius)[1], radius[group.observations.index[TARGET]])
    for _ in range(_ROUNDS):
        moved = measured - shift(group, state, radius)
        group = group.with_observations(replace(group.observations, readings=moved))
        state = dict(adjust(state.values(), [group, *others], datum, Control(limit=15, covariance=False)).blocks)
    return group, state
