"""Targets of a fit-part result: their coordinates in the part frame, and the pose of the fit as their common error.

The targets of a fitted part share the error of its pose, and errors of the network that measured them. The pose of
the part in the machine absorbs the rigid motion among these, so it is left out of the adjustment and added to that
pose. What is left, such as an error of scale, counts as an error of each target by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.result import Result
from metrocli.table import Table

FEWEST = 3


@dataclass(frozen=True)
class TargetList:
    """Targets with independent errors, and what they have in common."""

    table: Table
    common: Array | None = None
    """Covariance of a small shift and turn of the part frame, (6, 6); None for a list from a file"""


def target_list(targets: Table | Result) -> TargetList:
    """Return the targets of a list or of a fit-part result; raises InputError if the result has fewer than three."""
    if isinstance(targets, Table):
        return TargetList(targets)
    found = targets.tables["targets"]
    if len(found) < FEWEST:
        raise InputError(
            f"the fit-part result has {len(found)} targets, and a part needs {FEWEST}: name them in its job, "
            "e.g. `targets: [T*]`, or by the surface `target` in its points"
        )
    motion, rest = _common(targets)
    own = np.sqrt(np.einsum("nkk->nk", targets.arrays["targets_own"]) + (rest**2).sum(axis=2))
    columns = {name: found.columns[name] for name in ("target", "x", "y", "z")}
    columns |= {f"sigma_{axis}": own[:, k] for k, axis in enumerate("xyz")}
    units = {name: "mm" for name in columns if name != "target"}
    return TargetList(Table(columns, units, "the targets of the fit-part result"), motion)


def _common(result: Result) -> tuple[Array, Array]:
    """Return the covariance (6, 6) of the rigid motion `u + w x X` that all targets share, and what they share besides.

    That is the part of the factor `targets_common` (m, 3, k) that no rigid motion follows.
    """
    points, shared = result.tables["targets"].stacked(("x", "y", "z")), result.arrays["targets_common"]
    lever = float(np.sqrt((points**2).sum(axis=1).mean())) or 1.0
    by_motion = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), -cross_matrix(points) / lever], axis=2)
    motions = np.linalg.lstsq(by_motion.reshape(-1, 6), shared.reshape(-1, shared.shape[2]), rcond=None)[0]
    rest = shared - by_motion @ motions
    motions[3:] /= lever
    return motions @ motions.T, rest


def added_by_fit(common: Array, part: Array) -> Array:
    """Return what a common motion of the targets adds to the covariance of (x, y, z, alpha, beta, gamma), (6, 6).

    `part` (6,) is the pose of the part in the machine; a motion in the part frame is turned with the part.
    """
    turn = poses.rotation_of(part)
    change = np.zeros((6, 6))
    change[:3, :3] = change[3:, 3:] = turn
    change = poses.euler_form_by_step(part) @ change
    return np.asarray(change @ common @ change.T)
