"""The parameters that result from a camera calibration, with their covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import estimates, free_blocks
from metrocli.effects.model import Added
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.lenses.distortion import DISTORTION
from metrocli.instruments.lenses.lens import UNITS
from metrocli.table import Table

HIGH = 0.95
"""Correlations larger than this in magnitude are reported."""
POSE_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
"""Units of x y z alpha beta gamma"""


@dataclass(frozen=True)
class Parameters:
    """Estimated parameters with their covariance."""

    names: tuple[str, ...]
    values: Array
    covariance: Array
    units: tuple[str, ...]

    @property
    def std(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix."""
        std = np.where(self.std > 0, self.std, 1.0)
        matrix: Array = self.covariance / std[:, None] / std
        return matrix

    def significance(self) -> Table:
        """Return each parameter with its expanded uncertainty U (k = 2).

        `p_value` of distortion, skew and aspect is the two-sided probability of a value this far from 0 by chance.
        """
        std = np.where(self.std > 0, self.std, np.nan)
        two_sided = np.array([math.erfc(z / math.sqrt(2)) for z in np.abs(self.values / std)])
        neutral = np.isin(self.names, (*DISTORTION, "skew", "aspect"))
        by_chance = np.where(neutral, two_sided, np.nan)
        columns = {"parameter [text]": self.names, "value": self.values, "std": self.std, "U": 2 * self.std}
        return Table.of({**columns, "unit [text]": self.units, "p_value": by_chance})

    def high_correlations(self) -> Table:
        """Return the pairs of parameters whose correlation exceeds HIGH in magnitude."""
        matrix = self.correlation
        first, second = np.nonzero(np.triu(np.abs(matrix) > HIGH, 1))
        names = np.array(self.names, dtype=str)
        return Table.of({"first": names[first], "second": names[second], "correlation": matrix[first, second]})


def unit_of(name: str) -> str:
    """Return the unit of a lens parameter."""
    return UNITS.get(name, "1")


def delivered(rig: str, effects: Sequence[Added] = ()) -> tuple[str, ...]:
    """Return the blocks of the estimates: lens, with rig cmm the pose of the camera, and effects."""
    return (camera.LENS, *((camera.TAPER,) if rig == "cmm" else ()), *free_blocks(effects))


def parameters(rig: str, solution: Solution, effects: Sequence[Added] = ()) -> Parameters:
    """Return the estimated lens parameters, with rig cmm the pose of the camera, and the estimated effects.

    The pose is that of the camera in the reference frame, as x y z alpha beta gamma.
    """
    lens = solution.blocks[camera.LENS]
    free = np.flatnonzero(lens.free[0])
    names = [lens.columns[i] for i in free]
    units = [unit_of(name) for name in names]
    values = lens.values[0, free]
    if rig == "cmm":
        values = np.concatenate([values, poses.euler_form(solution.blocks[camera.TAPER].values[0])])
        names += list(poses.EULER)
        units += POSE_UNITS
    added = estimates(effects, solution)
    matrix = solution.joint(delivered(rig, effects))
    if rig == "cmm":
        change = np.eye(len(matrix))
        pose = slice(len(free), len(free) + 6)
        change[pose, pose] = poses.euler_form_by_step(solution.blocks[camera.TAPER].values[0])
        matrix = change @ matrix @ change.T
    names += [estimate.name for estimate in added]
    units += [estimate.unit for estimate in added]
    values = np.concatenate([values, [estimate.value for estimate in added]])
    return Parameters(tuple(names), values, (matrix + matrix.T) / 2, tuple(units))
