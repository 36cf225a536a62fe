"""A camera in a machine's spindle: from a point of the part to an image point (Mendikute et al. eq. 1-5, 21-27)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.allowance import take
from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix, nearest_rotation
from metrocli.instruments.camera import TAPER, TARGET, lens_link, of_first
from metrocli.instruments.frames import FromFrame, PointOf, ToFrame

PART, SPINDLE, COUPLING, MACHINE = "part", "spindle", "coupling", "machine"
"""Blocks: pose of the part in the machine, pose of the spindle in the machine at each exposure, clamping angle, and
what a calibration of the machine leaves open"""

_ANGLE_REACH = 0.5


@dataclass(frozen=True)
class Coupling(OfBlock):
    """Link from the spindle to the taper through the clamping angle: `X_taper = R_S(gamma_s)' X_spindle` (eq. 22)."""

    block: str = COUPLING
    takes = Quantity.POINT_IN_SPINDLE
    gives = Quantity.POINT_IN_TAPER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point in the taper, (3, n), with its derivatives by the point and by the angle."""
        angle = local.rows(self.block)[0]
        back = _coupling_rotation(angle)
        moved = np.stack(
            [back[0, 0] * value[0] + back[0, 1] * value[1], back[1, 0] * value[0] + back[1, 1] * value[1], value[2]]
        )
        by_angle = np.stack([-moved[1], moved[0], np.zeros_like(moved[2])])[:, None]
        return Step(moved, back, {self.block: by_angle})


def _coupling_rotation(angle: Array) -> Array:
    """Return R_S' = [[c, -s, 0], [s, c, 0], [0, 0, 1]], (3, 3, n), of angles (n,)."""
    c, s = np.cos(angle), np.sin(angle)
    zero, ones = np.zeros_like(c), np.ones_like(c)
    return np.array([[c, -s, zero], [s, c, zero], [zero, zero, ones]])


@dataclass(frozen=True)
class UncertainPoses:
    """Link for a spindle that stands off its pose (R, d) by what is not known of the machine, `(u, w) = F z`.

    To first order points are displaced by the opposite: `X -= u + w x (X - d)`.
    """

    spread: Array
    """F (exposures, 6, k)"""
    block: str = MACHINE
    takes = gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """The poses of the spindle, and the unknowns of the machine."""
        return (SPINDLE, self.block)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) relative to the spindle as it truly stands."""
        spread = np.moveaxis(self.spread[local.index(SPINDLE)], 0, -1)
        shift, turn = np.split(np.einsum("akn,k->an", spread, local.members(self.block)[0]), 2)
        lever, turned = value - local.rows(SPINDLE)[:3], np.moveaxis(cross_matrix(turn.T), 0, -1)
        by_unknown = -spread[:3] - np.cross(spread[3:], lever[:, None], axis=0)
        by_pose = np.concatenate([turned, np.zeros_like(turned)], axis=1)
        moved = value - shift - np.cross(turn, lever, axis=0)
        return Step(moved, np.eye(3)[:, :, None] - turned, {SPINDLE: by_pose, self.block: by_unknown})


def chain(*conventions: str, spread: Array | None = None) -> Chain:
    """Return the forward model of an image point; `spread` (exposures, 6, k) is that of the poses of the spindle.

    `conventions` has that of the lens of each camera.
    Where several cameras are fixed to each other, the pose in the taper is that of the first, and one more link leads
    to the camera.
    """
    return Chain(
        (
            PointOf(TARGET, Quantity.POINT_IN_PART),
            FromFrame(PART, Quantity.POINT_IN_PART, Quantity.POINT_IN_MACHINE),
            *([] if spread is None or not spread.shape[2] else [UncertainPoses(spread)]),
            ToFrame(SPINDLE, Quantity.POINT_IN_MACHINE, Quantity.POINT_IN_SPINDLE),
            Coupling(COUPLING),
            *of_first(ToFrame(TAPER, Quantity.POINT_IN_TAPER, Quantity.POINT_IN_CAMERA), len(conventions) > 1),
            lens_link(*conventions),
        )
    )


def part_block(pose: Array, extent: float, distance: float) -> Block:
    """Return the block with the pose of the part in the machine.

    Its plausible reach is the working distance and half a radian.
    """
    reach = np.array([max(extent, distance)] * 3 + [_ANGLE_REACH] * 3)
    return Block(PART, pose, poses.COLUMNS, reach=reach, space=Space.POSE)


def coupling_block(angle: float, free: bool) -> Block:
    """Return the block with the clamping angle [rad]."""
    return Block(COUPLING, np.array([[angle]]), ("gamma_s",), free=np.array(free), reach=np.array(_ANGLE_REACH))


def spindle_block(values: Array, exposures: Sequence[str]) -> Block:
    """Return the block with the commanded poses of the spindle, which are known."""
    return Block(SPINDLE, values, poses.COLUMNS, tuple(exposures), free=np.array(False), space=Space.POSE, noun="image")


def machine_blocks(spread: Array) -> list[Block]:
    """Return the block of what is not known of the machine, z of `UncertainPoses`, if there is any."""
    count = spread.shape[2]
    names = tuple(f"error {number}" for number in range(1, count + 1))
    return [Block(MACHINE, np.zeros((1, count)), names)] if count else []


def machine_priors(spread: Array) -> list[Group]:
    """Return what is known of it beforehand: mean 0 and variance 1."""
    return [prior(block, np.zeros(1, dtype=np.intp), np.ones((1, block.size))) for block in machine_blocks(spread)]


@dataclass(frozen=True)
class Rays:
    """Lines of sight in the machine, each with the point of the part that it observes."""

    origin: Array
    """(n, 3)"""
    direction: Array
    """Unit vectors (n, 3)"""
    point: Array
    """Observed points in the frame of the part (n, 3)"""


def rays(spindle: Array, camera: Array, angle: float, seen: Array, points: Array) -> Rays:
    """Return the lines of sight for a clamping angle.

    Spindle poses are (n, 6), the camera in the taper is (6,) or (n, 6), vectors `seen` in the camera (3, n).
    """
    held = camera_in_machine(spindle, angle, camera)
    direction = (poses.rotation_of(held) @ seen.T[:, :, None])[:, :, 0]
    return Rays(held[:, :3], direction / np.linalg.norm(direction, axis=1, keepdims=True), points)


def camera_in_machine(spindle: Array, angle: float, camera: Array) -> Array:
    """Return the poses (n, 6) of the camera in the machine, `R_CNC R_S R_cal`, `R_CNC R_S d_cal + d_CNC` (eq. 21)."""
    # the rotation itself, R_S: swapping the axes undoes the transpose that `_coupling_rotation` returns
    turn = poses.pose(np.swapaxes(_coupling_rotation(np.array([angle])), 0, 2)[0], np.zeros(3))
    held: Array = poses.compose(spindle, np.broadcast_to(poses.compose(turn, camera), spindle.shape))
    return held


def part_in_camera(part: Array, spindle: Array, angle: float, camera: Array) -> Array:
    """Return the poses (n, 6) that carry points of the part into the camera of each image (eq. 4)."""
    seen: Array = poses.compose(
        poses.inverse(camera_in_machine(spindle, angle, camera)), np.broadcast_to(part, spindle.shape)
    )
    return seen


def start_pose(lines: Rays, turns: int = 40, again: bool = True) -> tuple[Array, float]:
    """Return the pose of the part that brings its points nearest to their rays, and the remaining RMS angle [rad].

    The start is linear in the twelve entries of R and d: `(I - v v') (R X + d - c) = 0`. Then shift and rotation are
    improved alternately in object space (Lu, Hager and Mjolsness 2000, for several centres). If the linear start fails,
    rotations by multiples of 90 degrees are tried as well, with `again`.
    """
    best, misfit = _best(lines, _linear(lines)[None], turns)
    if again and misfit > _FAILED:
        from metrocli.instruments.camera_start import cube_rotations

        attempt, value = _best(lines, cube_rotations(), turns)
        best, misfit = (attempt, value) if value < misfit else (best, misfit)
    return best, misfit


_AS_LONG = 5
"""Steps of an adjustment that take as long as the turns towards one start"""
_FAILED = 0.01
"""Misfit [rad] too large to be explained by distortion: the start has failed"""


def _across(lines: Rays) -> Array:
    """Return I - v v' of each ray, (n, 3, 3)."""
    return np.eye(3) - lines.direction[:, :, None] * lines.direction[:, None, :]


def _linear(lines: Rays) -> Array:
    across = _across(lines)
    centre = lines.point.mean(axis=0)
    local = lines.point - centre
    scale = float(np.abs(local).max()) or 1.0
    local = local / scale
    matrix = np.concatenate([across * local[:, k, None, None] for k in range(3)] + [across], axis=2).reshape(-1, 12)
    right = (across @ lines.origin[:, :, None]).ravel()
    # a cut-off: a flat part leaves the column of R along its normal open
    solved = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
    entries = solved[:9].reshape(3, 3).T
    columns = np.linalg.norm(entries, axis=0)
    # that column is the cross product of the others
    if columns.min() < 1e-6 * max(columns.max(), 1e-300):
        entries[:, int(columns.argmin())] = np.cross(
            entries[:, (columns.argmin() + 1) % 3], entries[:, (columns.argmin() + 2) % 3]
        ) / max(columns.max(), 1e-300)
    return nearest_rotation(entries)


def _best(lines: Rays, rotations: Array, turns: int) -> tuple[Array, float]:
    """Return the pose with the smallest misfit reached from any of the rotations (k, 3, 3), and this misfit."""
    take(_AS_LONG)
    across = _across(lines)
    # pinv: parallel rays leave the shift along them open
    gain = np.linalg.pinv(across.sum(axis=0))
    local = lines.point - lines.point.mean(axis=0)
    for _ in range(turns):
        turned = lines.point @ np.swapaxes(rotations, 1, 2)
        shift = np.einsum("nab,knb->ka", across, lines.origin - turned) @ gain
        seen = turned + shift[:, None]
        goal = seen - np.einsum("nab,knb->kna", across, seen - lines.origin)
        rotations = nearest_rotation(np.swapaxes(goal - goal.mean(axis=1, keepdims=True), 1, 2) @ local)
    gap = lines.point @ np.swapaxes(rotations, 1, 2) + shift[:, None] - lines.origin
    depth = (gap * lines.direction).sum(axis=2)
    off = np.linalg.norm(np.einsum("nab,knb->kna", across, gap), axis=2)
    misfit = np.sqrt(((off / np.where(depth > 0, depth, 1.0)) ** 2).mean(axis=1))
    # a pose behind the camera fits the lines as well as one in front
    misfit[(depth <= 0).any(axis=1)] = np.inf
    best = int(np.argmin(misfit))
    return poses.pose(rotations[best], shift[best]), float(misfit[best])
