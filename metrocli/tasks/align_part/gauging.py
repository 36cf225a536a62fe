"""Points of the part predicted in the machine; `metrocli verify` holds them against what is measured there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.table import Table
from metrocli.uncertainty.predicted import COMMON, CORE, POINTS_COVARIANCE

if TYPE_CHECKING:
    from metrocli.table import Values


def predicted_points(
    points: Table, pose: Array, covariance: Array, growth: float = 0.0
) -> tuple[Table, dict[str, Array]]:
    """Return the table `points` in the machine, and the arrays of its covariance.

    `X_machine = R (1 + g) X + d`, with `dX_machine = u + w x R X + R X dg` for a step (u, w) of the pose (6,).
    `covariance` (6 + k, 6 + k) is of x, y, z, alpha, beta, gamma and k unknowns that g sums up; to it a point adds its
    own sigma, if it has one.
    """
    listed = points.stacked(("x", "y", "z"))
    places = listed * (1 + growth)
    turn = poses.rotation_of(pose)
    by_step = np.concatenate([np.tile(np.eye(3), (len(places), 1, 1)), -cross_matrix(places @ turn.T)], axis=2)
    by_growth = np.repeat((listed @ turn.T)[:, :, None], len(covariance) - 6, axis=2)
    common = np.concatenate([by_step @ np.linalg.inv(poses.euler_form_by_step(pose)), by_growth], axis=2)
    own = (points.numbers("sigma", 0.0) ** 2)[:, None, None] * np.eye(3)
    whole = common @ covariance @ np.swapaxes(common, 1, 2) + own
    std = np.sqrt(np.einsum("nkk->nk", whole))
    at = poses.apply(pose, places)
    columns: dict[str, Values] = {"point": np.array(points.texts("point"), dtype=str)}
    columns |= {axis: at[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"s{axis}": std[:, k] for k, axis in enumerate("xyz")}
    units = {name: "mm" for name in columns if name != "point"}
    return Table(columns, units), {POINTS_COVARIANCE: whole, COMMON: common, CORE: covariance}
