"""The estimates of an adjustment of image points, with their covariance: lens parameters, poses, effects."""

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
from metrocli.result import Estimate
from metrocli.table import Table

HIGH_CORRELATION = 0.95
"""Magnitude from which a correlation is reported"""
POSE_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
"""Units of x y z alpha beta gamma"""


@dataclass(frozen=True)
class Parameters:
    """Estimated parameters with their covariance, (k,) and (k, k)."""

    names: tuple[str, ...]
    values: Array
    covariance: Array
    units: tuple[str, ...]

    @property
    def std(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """The parameters one by one."""
        rows = zip(self.names, self.values.tolist(), self.std.tolist(), self.units, strict=True)
        return tuple(Estimate(*row) for row in rows)

    @property
    def correlation(self) -> Array:
        """Correlation matrix."""
        std = np.where(self.std > 0, self.std, 1.0)  # a fixed parameter correlates with none
        matrix: Array = self.covariance / std[:, None] / std
        return matrix

    def significance(self) -> Table:
        """Return each parameter with its expanded uncertainty U (k = 2).

        `p_value` of distortion, skew and aspect is the two-sided probability of a value this far from 0 by chance,
        `erfc(|x| / (sqrt(2) s))`.
        """
        std = np.where(self.std > 0, self.std, np.nan)
        by_chance = np.array([math.erfc(z / math.sqrt(2)) for z in np.abs(self.values / std)])
        # 0 is the value of no distortion; a focal length is far from 0 whatever it is
        neutral = np.isin(self.names, (*DISTORTION, "skew", "aspect"))
        p_values = np.where(neutral, by_chance, np.nan)
        columns = {"parameter [text]": self.names, "value": self.values, "std": self.std, "U": 2 * self.std}
        return Table.of({**columns, "unit [text]": self.units, "p_value [1]": p_values})

    def high_correlations(self) -> Table:
        """Return the pairs of parameters whose correlation exceeds HIGH_CORRELATION in magnitude."""
        matrix = self.correlation
        first, second = np.nonzero(np.triu(np.abs(matrix) > HIGH_CORRELATION, 1))
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
    placed = [("", solution.blocks[camera.TAPER].values[0])] if rig == "cmm" else []
    return parameters_of([""], placed, solution, delivered(rig, effects), effects)


def parameters_of(
    prefixes: Sequence[str],
    placed: Sequence[tuple[str, Array]],
    solution: Solution,
    blocks: Sequence[str],
    effects: Sequence[Added],
) -> Parameters:
    """Return the estimated parameters of each lens, then poses (6,), and the estimated effects.

    The names of each lens and of each of the `placed` poses begin with its prefix. `blocks` have all of these, in this
    order.
    """
    lens = solution.blocks[camera.LENS]
    entries = np.argwhere(lens.free).tolist()
    names = [f"{prefixes[i]}{lens.columns[k]}" for i, k in entries]
    units = [unit_of(lens.columns[k]) for _, k in entries]
    values, changes = [lens.values[lens.free]], [np.eye(len(entries))]
    for prefix, pose in placed:
        values.append(poses.euler_form(pose))
        changes.append(poses.euler_form_by_step(pose))
        names += [f"{prefix}{key}" for key in poses.EULER]
        units += POSE_UNITS
    from scipy.linalg import block_diag

    joint, added = solution.joint(blocks), estimates(effects, solution)
    return with_effects(names, np.concatenate(values), units, joint, block_diag(*changes), added)


def with_effects(
    names: Sequence[str], values: Array, units: Sequence[str], joint: Array, change: Array, added: Sequence[Estimate]
) -> Parameters:
    """Return parameters and behind them the estimates of effects.

    With `joint` Q (n, n), the covariance of all their steps, and `change` C (k, k), the derivatives of the k parameters
    by theirs, the covariance is `F Q F'`, F = diag(C, I).
    """
    from scipy.linalg import block_diag

    by_steps = block_diag(change, np.eye(len(joint) - len(change)))
    covariance = by_steps @ joint @ by_steps.T
    return Parameters(
        (*names, *(estimate.name for estimate in added)),
        np.concatenate([values, [estimate.value for estimate in added]]),
        (covariance + covariance.T) / 2,
        (*units, *(estimate.unit for estimate in added)),
    )


def pose_columns(values: Array, covariance: Array) -> dict[str, Array]:
    """Return x y z alpha beta gamma of poses (n, 6), each with its standard uncertainty, by heading.

    `covariance` (n, 6, 6) is that of the steps of each pose.
    """
    change = poses.euler_form_by_step(values)
    std = np.sqrt(np.maximum(np.einsum("vab,vbc,vac->va", change, covariance, change), 0.0))
    # adding 0 turns -0 into 0: the pose of a camera that is the frame itself has no sign
    columns = zip(poses.EULER, POSE_UNITS, (poses.euler_form(values) + 0.0).T, std.T, strict=True)
    return {f"{name} s_{name} [{unit}]": np.stack([value, s], axis=1) for name, unit, value, s in columns}
