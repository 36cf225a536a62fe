"""The uncertainty of a fitted part, and the errors that no residual of it can show."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.tasks.fit_part.fit import MOST, PoseCriterion, PoseFit
from metrocli.uncertainty.predicted import PredictedPlaces

_SLIGHT = 1e-6
"""Weight of evenness beside the largest least overstock"""
_DEPENDENT = 1e-13
"""Singular value, relative to the largest, of active points that hold the pose twice: a rounding error"""


@dataclass(frozen=True)
class Sensitivity:
    """How the points move the fitted pose."""

    by_point: Array
    """Derivative of the step of the pose by each measured point (n, 6, 3)"""
    own: Array
    """Covariance of the step of the pose from the points' own errors (6, 6)"""
    by_common: Array
    """Derivative of the step by the errors that points share (6, k)"""
    core: Array
    """Covariance of these (k, k)"""
    drawn: bool = False
    """Whether it comes from fits to points with drawn errors"""

    @property
    def covariance(self) -> Array:
        """Covariance of the step of the pose (6, 6)."""
        return self.own + self.by_common @ self.core @ self.by_common.T


def sensitivity(fit: PoseFit, criterion: PoseCriterion, start: Array, places: PredictedPlaces) -> Sensitivity:
    """Return the sensitivity of a fit to the measured points, and the covariance from theirs.

    `start` (6,) is the pose into the part frame before the fit.
    """
    local, n = fit.local, len(fit.local.points)
    active = np.flatnonzero(fit.duals > 0)
    hessian = (
        fit.hessian
        if criterion.name != MOST
        else _SLIGHT * criterion.objective(local).hessian - local.curvature(fit.duals)
    )
    system = _system(hessian, local.rows[active], criterion.name == MOST)
    # the conditions of the optimum by each point: the gradient, and the overstock of the active points
    by_point = np.zeros((n, len(system), 3))
    by_point[:, :6] = gradient_by_point(fit, criterion, start)
    duals = len(system) - len(active) + np.arange(len(active))
    by_point[active, duals] = local.shape.normal[active] @ poses.rotation_of(fit.to_part)
    inverse = np.linalg.pinv(system, rcond=_DEPENDENT)
    step = -(inverse[:6] @ by_point)
    own = np.einsum("nia,nab,njb->ij", step, places.own, step, optimize=True)
    by_common = np.einsum("nia,nak->ik", step, places.common, optimize=True)
    return Sensitivity(step, (own + own.T) / 2, by_common, places.core)


def gradient_by_point(fit: PoseFit, criterion: PoseCriterion, start: Array) -> Array:
    """Return the derivative of the gradient of the Lagrangian by the measured points, (n, 6, 3)."""
    local, n = fit.local, len(fit.local.points)
    turn, before = poses.rotation_of(fit.to_part), poses.rotation_of(start)
    weight = _SLIGHT if criterion.name == MOST else 1.0
    gradient, changed = np.zeros((n, 6, 3)), -fit.duals
    if criterion.before is not None:
        moves = local.points - criterion.before
        gradient += np.swapaxes(local.movement, 1, 2) @ (turn - before) / n
        gradient[:, 3:] -= cross_matrix(moves) @ turn / (local.lever * n)
    else:
        centred = local.overstock - local.overstock.mean()
        along = local.shape.normal @ turn
        gradient += weight * (local.rows - local.rows.mean(axis=0))[:, :, None] * along[:, None, :] / n
        changed = changed + weight * centred / n
    return gradient + changed[:, None, None] * _rows_by_place(fit) @ turn


def _rows_by_place(fit: PoseFit) -> Array:
    """Return the derivative of each row of the overstock by its point in the part frame, (n, 6, 3)."""
    local = fit.local
    arms = cross_matrix(local.points - local.centre)
    turning = (arms @ local.shape.bend - cross_matrix(local.shape.normal)) / local.lever
    return np.concatenate([local.shape.bend, turning], axis=1)


def _system(hessian: Array, active: Array, with_level: bool) -> Array:
    """Return the matrix of the conditions of an optimum: step, least overstock where it is sought, duals."""
    m, level = len(active), int(with_level)
    size = 6 + level + m
    system = np.zeros((size, size))
    system[:6, :6] = hessian
    system[:6, 6 + level :] = -active.T
    system[6 + level :, :6] = active
    if with_level:
        # the least overstock is the seventh unknown: the duals add up to 1, and the points that hold it have just it
        system[6, 7:] = 1.0
        system[7:, 6] = -1.0
    return system


def pose_by_step(fit: PoseFit) -> Array:
    """Return the derivative of the pose of the part (x, y, z, alpha, beta, gamma) by a step of the fit, (6, 6).

    A step turns the part frame the other way: `dr = -R w`, `dd = -R (u - w x c)`.
    """
    local = fit.local
    part = poses.inverse(fit.to_part)
    turn = poses.rotation_of(part)
    by_step = np.zeros((6, 6))
    by_step[:3, :3] = -turn
    by_step[:3, 3:] = -turn @ cross_matrix(local.centre) / local.lever
    by_step[3:, 3:] = -turn / local.lever
    return poses.euler_form_by_step(part) @ by_step
