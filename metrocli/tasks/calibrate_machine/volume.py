"""The error of the tool over the volume, predicted from the tables with its uncertainty, and its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.dense_jacobian import Unknowns, rows
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments.axes.kinematics import motion, nominal_tip
from metrocli.instruments.machine import TOOL, Machine

_POINTS = 300
"""Number of points at which the error in the volume is evaluated"""


def grid_of(machine: Machine, counts: Sequence[int]) -> Array:
    """Return a regular grid over the ranges of all axes, (axes, n)."""
    lines = [np.linspace(low, high, n) for low, high, n in zip(machine.low, machine.high, counts, strict=True)]
    return np.stack([part.ravel() for part in np.meshgrid(*lines, indexing="ij")])


def spread_over(machine: Machine, count: int) -> Array:
    """Return positions spread evenly but irregularly over all ranges, (axes, n): the sequence of Halton (1960)."""
    return np.asarray(
        machine.low[:, None] + (machine.high - machine.low)[:, None] * shares_spread(len(machine.axes), count)
    )


def shares_spread(axes: int, count: int) -> Array:
    """Return `spread_over` as shares of the ranges, (axes, n)."""
    numbers = np.arange(1, count + 1)
    return np.stack([_radical_inverse(numbers, base) for base in (2, 3, 5, 7, 11)[:axes]])


def _radical_inverse(numbers: Index, base: int) -> Array:
    result, factor, left = np.zeros(len(numbers)), 1.0, numbers.copy()
    while left.any():
        factor /= base
        result += factor * (left % base)
        left = left // base
    return result


def grid_group(machine: Machine, position: Array, tool: int | Index) -> Group:
    """Return the observations of the error motion of a tool at commanded positions (axes, n).

    `tool` is the number of one tool, or one number for each position.
    """
    n = position.shape[1]
    index = machine.index(position) | {TOOL: np.full(n, tool)}
    observations = Observations(np.zeros((6, n)), np.ones(1), index, conditions=machine.conditions(position))
    return Group("volume", Chain(motion(machine)), observations)


def tips(machine: Machine, position: Array, tool: int | Index) -> Array:
    """Return where the tool is on the workpiece at commanded positions (axes, n), (3, n), up to a shift."""
    if not machine.turns:
        return position
    return nominal_tip(machine, position, np.atleast_2d(machine.tools[tool]).T)[0]


def rigid_motions(position: Array) -> Array:
    """Return an orthonormal basis, (3*n, 6), of the small rigid motions of points (3, n)."""
    n = position.shape[1]
    centred = position - position.mean(axis=1, keepdims=True)
    motions = np.zeros((3, n, 6))
    motions[:, :, :3] = np.eye(3)[:, None]
    motions[:, :, 3:] = -np.moveaxis(cross_matrix(centred.T), 0, 1) / max(np.abs(centred).max(), 1.0)
    basis, _ = np.linalg.qr(motions.reshape(3 * n, 6))
    return np.asarray(basis)


def without_rigid_motion(motion_rows: Array, position: Array) -> Array:
    """Return the displacement part, (3, n, ...), of rows (6, n, ...) with the best-fit small rigid motion removed."""
    flat = motion_rows[:3].reshape(3 * position.shape[1], -1)
    basis = rigid_motions(position)
    left = flat - basis @ (basis.T @ flat)
    return np.asarray(left.reshape(motion_rows[:3].shape))


@dataclass(frozen=True)
class ToolErrors:
    """Predicted errors of a tool at commanded positions."""

    error: Array
    """(3, n)"""
    covariance: Array
    """(3, 3, n)"""

    @property
    def std(self) -> Array:
        """Standard uncertainties, (3, n)."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("aan->an", self.covariance), 0.0)))


def predict(
    machine: Machine, blocks: Mapping[str, Block], known: tuple[Unknowns, Array], position: Array, tool: int
) -> tuple[ToolErrors, Array]:
    """Return the predicted error at positions (3, n), and its Jacobian by the unknowns, (3, n, unknowns).

    `known` holds the unknowns and their covariance.
    """
    unknowns, covariance = known
    group = grid_group(machine, position, tool)
    error = group.chain.predict(blocks, group.observations)[:3]
    design = rows(group, blocks, unknowns)[:3]
    spread = np.einsum("anp,bnp->abn", design @ covariance, design)
    return ToolErrors(error, spread), design


def rows_over_volume(machine: Machine, blocks: Mapping[str, Block], tool: str, unknowns: Unknowns) -> Array:
    """Return the Jacobian of a tool's displacement over the volume, (3, n, unknowns), without rigid motion.

    Rotary axes stand at their knots, where errors that are known only together cancel exactly.
    """
    position = np.array(
        [axis.nearest(own) for axis, own in zip(machine.axes, spread_over(machine, _POINTS), strict=True)]
    )
    group = grid_group(machine, position, blocks[TOOL].members.index(tool))
    number = blocks[TOOL].members.index(tool)
    return without_rigid_motion(rows(group, blocks, unknowns), tips(machine, position, number))
