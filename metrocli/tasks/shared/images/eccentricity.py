"""Eccentricity of circular targets: the centre of a circle's image is not the image of its centre.

Perspective and lens distortion both move it. The centre that is measured (of the fitted ellipse, or of the grey values)
is, to the accuracy of a measurement, the centroid of the imaged disc; so the reading is corrected by what the forward
model itself says of the rim: exact for any tilt, distance, distortion and chain of frames.
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

_RIM = 16
"""Corners of the polygon that stands for the rim; its centroid is that of the disc to 1e-6 px"""
_ROUNDS = 3


def shift(group: Group, blocks: Mapping[str, Block], radius: Array) -> Array:
    """Return measured centre minus image of the centre, (2, n) px.

    Targets are discs of `radius` (targets,) mm lying in z = const.
    """
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
    return np.where(whole, moved / np.where(whole, 3 * area, 1.0), 0.0)


def corrected(
    group: Group, blocks: Mapping[str, Block], others: tuple[Group, ...], datum: Datum | None, radius: Array
) -> tuple[Group, dict[str, Block]]:
    """Return the group with readings freed of eccentricity, and blocks that fit them.

    The shift depends on the solution, so both are found in turn.
    """
    measured = group.observations.readings
    state = dict(blocks)
    for _ in range(_ROUNDS):
        moved = measured - shift(group, state, radius)
        group = group.with_observations(replace(group.observations, readings=moved))
        state = dict(adjust(state.values(), [group, *others], datum, Control(limit=15, covariance=False)).blocks)
    return group, state
