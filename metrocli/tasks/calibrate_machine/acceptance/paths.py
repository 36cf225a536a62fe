"""Kinematic tests of machines with rotary axes: the range of the tip against the workpiece along listed paths.

The paths are the user's, such as those of ISO 10791-6. The range is predicted from tables and locations, and measured
where an R-test has readings at all positions of a path.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.kinematics import OF_TOOL, ON_WORKPIECE, axes_of
from metrocli.instruments.machine import TOOL, Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.ranges import Profile, draws
from metrocli.tasks.calibrate_machine.described import commanded
from metrocli.tasks.calibrate_machine.problem import tools_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.calibrate_machine.volume import predict

_SAME = 1e-4
"""Positions of a path and of a reading are the same within this [mm, rad]"""
_FAR = 1e6
"""Distance by which the readings of two tools are moved apart, so that none is taken for that of another [mm]"""


def paths(
    tables: Tables, solved: AdjustedMachine, settings: Settings, factor: float, listed: Table | None
) -> dict[str, Table]:
    """Return the ranges along each path in the axes of the workpiece with U (k = 2), and the error at each position.

    The predicted range is that of the error of the tip, with its U from tables and locations. The measured one adds the
    residuals of an R-test, where it followed the path; `factor` is the noise of its readings over the declared one.
    Raises InputError if positions are out of range, or if a path has one position.
    """
    if listed is None:
        return {}
    machine, names = tables.machine, np.array(listed.texts("path"))
    position, tool = commanded(machine, listed), tools_of(listed, settings)
    _refuse_short(listed, names)
    error, design = _predicted(tables, position, tool)
    measured = error + _residuals_at(solved, machine, position, tool)
    drawn, sigma = draws(tables.raw), factor * (settings.noise.probing or 0.0)
    rows = []
    for name in dict.fromkeys(names.tolist()):
        at = np.flatnonzero(names == name)
        noise = np.eye(len(at)) * sigma
        read = draws(noise**2) if np.isfinite(measured[0, at]).all() else np.full((1, len(at)), np.nan)
        for axis in range(3):
            predicted = Profile(error[axis, at], design[axis, at], drawn).range_with_u()
            followed = Profile(measured[axis, at], np.eye(len(at)), read).range_with_u()
            rows.append((name, "xyz"[axis], *predicted, *followed))
    columns = list(zip(*rows, strict=True))
    return {
        "paths": Table.of(
            {
                "path": columns[0],
                "direction": columns[1],
                "range U_range [mm]": np.array(columns[2:4]).T,
                "measured U_measured [mm]": np.array(columns[4:]).T,
            }
        ),
        "path_errors": Table.of(
            {
                "path": names,
                **machine.columns(position),
                "ex ey ez [mm]": error.T,
                "measured_x measured_y measured_z [mm]": measured.T,
            }
        ),
    }


def _refuse_short(listed: Table, names: np.typing.NDArray[np.str_]) -> None:
    path_names, count = np.unique(names, return_counts=True)
    if (count < 2).any():
        name = str(path_names[np.argmin(count)])
        row = int(np.argmax(names == name))
        raise InputError([listed.fault_at(row, f"path {name} has one position", "a path has two positions or more")])


def _predicted(tables: Tables, position: Array, tool: Index) -> tuple[Array, Array]:
    """Return the error of the tip (3, n), and its derivatives by the unknowns (3, n, unknowns)."""
    error = np.zeros((3, position.shape[1]))
    design = np.zeros((3, position.shape[1], tables.unknowns.size))
    for number in np.unique(tool).tolist():
        at = tool == number
        predicted, derivatives = predict(
            tables.machine, tables.blocks, (tables.unknowns, tables.raw), position[:, at], number
        )
        error[:, at], design[:, at] = predicted.error, derivatives
    return error, design


@dataclass(frozen=True)
class _Probed:
    """The residuals of an R-test, in the axes of the workpiece."""

    position: Array
    """(axes, n)"""
    tool: Index
    residuals: Array
    """(3, n)"""


def _residuals_at(solved: AdjustedMachine, machine: Machine, position: Array, tool: Index) -> Array:
    """Return what the reading at each position of paths shows beyond the prediction (3, n); nan without a reading."""
    from scipy.spatial import cKDTree

    probed, residuals = _probed(solved, machine), np.full((3, position.shape[1]), np.nan)
    if probed is not None:
        readings = np.vstack([probed.position, _FAR * probed.tool]).T
        distance, nearest = cKDTree(readings).query(np.vstack([position, _FAR * tool]).T, p=np.inf)
        followed = distance <= _SAME
        residuals[:, followed] = probed.residuals[:, nearest[followed]]
    return residuals


def _probed(solved: AdjustedMachine, machine: Machine) -> _Probed | None:
    """Return the residuals of probing as errors of the tip on the workpiece; None for other readings."""
    observations = solved.problem.readings.observations
    if ON_WORKPIECE not in observations.index or (observations.conditions[OF_TOOL] >= 0).any():
        return None
    position = np.stack([observations.conditions[axis.coordinate] for axis in machine.axes])
    # the reading is ball less probe in the axes of the bed, the error is that of the probe against the workpiece
    in_workpiece = np.einsum("abn,an->bn", axes_of(machine, position, "workpiece"), solved.residuals.values)
    return _Probed(position, observations.index[TOOL], -in_workpiece)
