"""Covariance of the reduced unknowns: in the datum of the eliminated block, and with what considered blocks bring."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.datum import Frame
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.schur.layout import Layout, considered_covariance
from metrocli.adjust.schur.normals import Normals


def widened(inverse: Array, layout: Layout) -> Array:
    """Return a covariance of the free columns, made symmetric, with zeros for the considered ones."""
    widened = np.zeros((layout.width, layout.width))
    widened[: layout.free, : layout.free] = (inverse + inverse.T) / 2
    return widened


def in_eliminated_datum(frame: Frame, normals: Normals, inverse: Array) -> Array:
    """Return the reduced covariance in a datum of inner constraints on the eliminated block.

    With `h = H e = -A r + sum H_i n_i`, `A = sum H_i W_i`, n_i the noise of member i of covariance D_i^-1:
    `r' = (I + E A) r - E sum H_i n_i`.
    """
    free = len(inverse)
    found = [part.moments(frame.constraint(part.members)) for part in normals.parts]
    e = frame.reduced[:free]
    coupled, gram = (np.sum([one[i] for one in found], axis=0) for i in (0, 1))
    transform = np.eye(free) + e @ coupled[:, :free]
    return np.asarray(transform @ inverse @ transform.T + e @ gram @ e.T)


def with_considered(blocks: Mapping[str, Block], layout: Layout, matrix: Array, noise_only: Array) -> Array:
    """Add what the considered blocks bring: `K = S_ff^-1 S_fc`, `Q_ff + K C K'`, `Q_fc = -K C`."""
    free = layout.free
    if free == layout.width:
        return noise_only
    joint = noise_only.copy()
    given = considered_covariance(blocks, layout)
    sensitivity = noise_only[:free, :free] @ matrix[:free, free:]
    joint[:free, :free] += sensitivity @ given @ sensitivity.T
    joint[:free, free:] = -sensitivity @ given
    joint[free:, :free] = joint[:free, free:].T
    joint[free:, free:] = given
    return joint
