"""The two poses of a flat board: seen from far away, a tilt and its mirror image look almost alike."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.model.blocks import Array, Block, Mask
from metrocli.adjust.model.groups import Group
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.instruments.camera import VIEW

_FAR = 0.2
"""Boards smaller than this share of their distance are checked; on nearer ones perspective decides."""
ALIKE = 4.0
"""A smaller difference of the sums of squares, in units of the declared variance, does not decide between the poses."""


@dataclass(frozen=True)
class Turned:
    """Views with the better of their two poses."""

    views: Block
    undecided: tuple[str, ...]
    """Images whose two poses differ but fit about equally well"""


def better_poses(blocks: dict[str, Block], images: Group, board: Array, normal: Array) -> Turned:
    """Return the views, each with its pose or with the mirrored one, whichever fits better with the lens held fixed.

    The mirror image of the board's normal n about the line of sight s is `2 (s n) s - n` (Schweighofer and Pinz 2006).
    `board` are the targets (m, 3) and `normal` is the normal of their plane, both in the frame of the board.
    """
    views = blocks[VIEW]
    extent = float(np.linalg.norm(np.ptp(board, axis=0)))
    middle = poses.apply(views.values, board.mean(axis=0))
    far = extent < _FAR * np.linalg.norm(middle, axis=1)
    if not far.any():
        return Turned(views, ())
    turned = replaced(views, _mirrored(views.values, middle, board.mean(axis=0), normal), far)
    held = [*(block.fixed() for name, block in blocks.items() if name != VIEW), turned]
    other = adjust(held, [images], None, Control(limit=30, covariance=False)).blocks[VIEW]
    here, there = (_costs({**blocks, VIEW: views_}, images) for views_ in (views, other))
    better = far & (there < here)
    apart = np.linalg.norm(poses.difference(views.values, other.values)[:, 3:], axis=1) > 0.1
    seen = np.isfinite(here) & np.isfinite(there)
    undecided = far & apart & (np.abs(np.where(seen, there, np.inf) - np.where(seen, here, 0.0)) < ALIKE)
    return Turned(replaced(views, other.values, better), tuple(np.array(views.members)[undecided].tolist()))


def replaced(views: Block, values: Array, chosen: Mask) -> Block:
    """Return the block with other values for the chosen members."""
    return views.with_values(np.where(chosen[:, None], values, views.values))


def _mirrored(values: Array, middle: Array, centre: Array, normal: Array) -> Array:
    rotation = poses.rotation_of(values)
    sight = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    now = rotation @ normal
    goal = 2 * (sight * now).sum(axis=1, keepdims=True) * sight - now
    axis = np.cross(now, goal)
    sine, cosine = np.linalg.norm(axis, axis=1), (now * goal).sum(axis=1)
    turn = axis / np.maximum(sine, 1e-12)[:, None] * np.arctan2(sine, cosine)[:, None]
    mirrored = rotation_from_vector(turn) @ rotation
    return poses.pose(mirrored, middle - mirrored @ centre)


def _costs(blocks: dict[str, Block], images: Group) -> Array:
    """Return the whitened sum of squares of each view; infinite if a point is behind the camera."""
    residual = images.observations.whitened(images.residuals(blocks))
    square = np.nan_to_num((residual**2).sum(axis=0), nan=np.inf)
    costs = np.bincount(images.observations.index[VIEW], square, len(blocks[VIEW].members))
    return np.asarray(costs, dtype=float)
