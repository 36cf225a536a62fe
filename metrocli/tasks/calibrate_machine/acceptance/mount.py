"""Where two rotary axes pass each other, as the instrument on the bed sees it: the invariant point of a mount."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.instruments.axes.joints import turned
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import Machine
from metrocli.instruments.tracker import TRACKER
from metrocli.table import Table

MOUNT = "mount"
_STEP = 1e-4
"""Step of the derivatives, as a share of an unknown's plausible size"""


def mount(machine: Machine, solution: Solution) -> dict[str, Table]:
    """Return the point of the axis next to the bed that is nearest to the other axis, and how the two lie.

    It is in the frame of the instrument: `x y z` with the distance of the axes (`offset`, along the first axis cross
    the other at position 0) and the angle between them, each with its standard uncertainty. Empty for other machines
    than those of two rotary heads and no linear axis.
    """
    axes = [machine.axes[i] for i in machine.order]
    turning = [axis for axis in axes if isinstance(axis, RotaryAxis)]
    if len(axes) != 2 or len(turning) != 2 or machine.bed != 0 or TRACKER not in solution.blocks:
        return {}
    first, other = turning
    names = tuple(name for name in (TRACKER, first.location, other.location) if solution.blocks[name].free.any())
    value, by_unknown = _with_derivatives(lambda blocks: _passing(blocks, first, other), solution.blocks, names)
    std = np.sqrt(np.einsum("ik,kl,il->i", by_unknown, solution.joint(names), by_unknown))
    return {
        MOUNT: Table.of(
            {
                "axes": [f"{first.letter} {other.letter}"],
                "x y z [mm]": value[None, :3],
                "sx sy sz [mm]": std[None, :3],
                "offset [mm]": value[3:4],
                "s_offset [mm]": std[3:4],
                "angle [rad]": value[4:],
                "s_angle [rad]": std[4:],
            }
        )
    }


def _passing(blocks: Mapping[str, Block], first: RotaryAxis, other: RotaryAxis) -> Array:
    """Return the point of the first axis nearest to the other (3,) in the instrument's frame, offset and angle."""
    (start, along), (to, across) = (_line(axis, blocks[axis.location].values[0]) for axis in (first, other))
    normal = np.cross(along, across)
    size = np.linalg.norm(normal)
    # start + s along + d normal / |normal| = to + t across
    s, _, d = np.linalg.solve(np.stack([along, -across, normal / size], axis=1), to - start)
    point = poses.apply(poses.inverse(blocks[TRACKER].values[0]), (start + s * along)[None])[0]
    return np.array([*point, d, np.arctan2(size, along @ across)])


def _line(axis: RotaryAxis, location: Array) -> tuple[Array, Array]:
    """Return a point of an axis and its direction, in the machine with all axes at 0."""
    across = [i for i in range(3) if i != axis.number]
    origin, tilt = np.array(axis.at), np.zeros((3, 1))
    origin[across] += location[:2]
    tilt[across, 0] = location[2:4]
    return origin, turned(tilt)[0][:, axis.number, 0]


def _with_derivatives(
    of: Callable[[Mapping[str, Block]], Array], blocks: Mapping[str, Block], names: tuple[str, ...]
) -> tuple[Array, Array]:
    """Return a function of blocks and its derivatives by their free entries, (values, unknowns)."""
    columns = []
    for name in names:
        block = blocks[name]
        for row, column in np.argwhere(block.free):
            step = np.zeros(block.values.shape)
            step[row, column] = size = _STEP * float(np.minimum(block.reach[column], 1.0))
            ends = [
                of({**blocks, name: replace(block, values=block.space.moved(block.values, way * step))})
                for way in (1, -1)
            ]
            columns.append((ends[0] - ends[1]) / (2 * size))
    return of(blocks), np.stack(columns, axis=1)
