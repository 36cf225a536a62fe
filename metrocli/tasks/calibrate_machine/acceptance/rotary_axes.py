"""Rotary axes: their error motion as ISO 230-7 names it, and where two of them pass each other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.axes.joints import turned
from metrocli.instruments.axes.rotary import RotaryAxis, turning_axes
from metrocli.instruments.machine import ANGLES, AXES, Machine, errors_of
from metrocli.instruments.tracker import TRACKER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.ranges import Profile, draws
from metrocli.tasks.calibrate_machine.tables import Tables

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


@dataclass(frozen=True)
class _Motion:
    """A motion of the turning part as a combination of the entries of tables."""

    axis: str
    name: str
    direction: str
    errors: tuple[str, ...]
    unit: str
    weights: Array
    """Of the tables of `errors` at each knot, (knots, errors)"""


def rotary_motion(tables: Tables, known: Collection[str]) -> dict[str, Table]:
    """Return the range of each error motion of the rotary axes with U (k = 2), of the errors that are known.

    The motion is that of the turning part: E of a head, -E of a table. In a rotating sensitive direction, that of a
    tool or a workpiece that turns with it, it is `E_X cos s + E_Y sin s` with the turn s of the turning part. Constants
    and what turns once are the place of the axis and the centring of the ball; the tables do not have them.
    Source: ISO 230-7:2015, 3.5 (radial, axial, tilt error motion; fixed and rotating sensitive direction).
    """
    motions = [
        motion for axis in turning_axes(tables.machine) for motion in _motions(axis) if set(motion.errors) <= set(known)
    ]
    if not motions:
        return {}
    rows = [_range(tables, motion) for motion in motions]
    columns = {
        "axis": [motion.axis for motion in motions],
        "motion": [motion.name for motion in motions],
        "direction": [motion.direction for motion in motions],
        "errors": [" ".join(motion.errors) for motion in motions],
        "unit": [motion.unit for motion in motions],
    }
    return {"rotary_motion": Table.of({**columns, "low high range U_range": np.array(rows)})}


def _motions(axis: RotaryAxis) -> Iterator[_Motion]:
    """Yield the motions of an axis: radial and tilt in both fixed directions and in the rotating one, and axial."""
    i, n = axis.number, len(axis.knots)
    sign = 1.0 if axis.head else -1.0
    turn = sign * axis.sense * axis.knots
    j, k = (i + 1) % 3, (i + 2) % 3
    rotating = sign * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for name, kinds, unit in (("radial", AXES, "mm"), ("tilt", ANGLES, "rad")):
        for across in (j, k):
            yield _Motion(
                axis.letter, name, kinds[across], (f"E{kinds[across]}{axis.letter}",), unit, np.full((n, 1), sign)
            )
        both = tuple(f"E{kinds[across]}{axis.letter}" for across in (j, k))
        yield _Motion(axis.letter, name, "rotating", both, unit, rotating)
    yield _Motion(axis.letter, "axial", AXES[i], (errors_of(axis.letter)[i],), "mm", np.full((n, 1), sign))


def _range(tables: Tables, motion: _Motion) -> tuple[float, float, float, float]:
    """Return the least and the largest value of a motion over the knots, its range, and U of this."""
    at = np.array([tables.rows_of(name) for name in motion.errors]).T
    values = (motion.weights * tables.values[at]).sum(axis=1)
    each = np.zeros((len(values), at.size))
    for knot, weights in enumerate(motion.weights):
        each[knot, knot * at.shape[1] : (knot + 1) * at.shape[1]] = weights
    covariance = each @ tables.covariance[np.ix_(at.ravel(), at.ravel())] @ each.T
    profile = Profile(values, np.eye(len(values)), draws(covariance))
    return float(values.min()), float(values.max()), *profile.range_with_u()
