"""Tables of a result of calibrate-machine beside the error tables: rotary axes, targets, tracker, stations, lines."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.instruments.axes.error_motion import POSITIONS
from metrocli.instruments.axes.kinematics import ON_WORKPIECE
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import ANGLES, Machine
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracer import TRACER
from metrocli.instruments.tracker import TRACKER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.shared.statistics import columns_with_std


def linear_axes(machine: Machine) -> Table:
    """Return the linear axes with their range and knots."""
    linear = [(i, axis) for i, axis in enumerate(machine.axes) if not isinstance(axis, RotaryAxis)]
    return Table.of(
        {
            "axis": [axis.letter for _, axis in linear],
            "low [mm]": [axis.knots[0] for _, axis in linear],
            "high [mm]": [axis.knots[-1] for _, axis in linear],
            "knots": [len(axis.knots) for _, axis in linear],
            "reference [mm]": [axis.reference for _, axis in linear],
            "place": [machine.order.index(i) + 1 for i, _ in linear],
        }
    )


def rotary_axes(machine: Machine) -> dict[str, Table]:
    """Return the rotary axes with a point of their nominal line, if there are any."""
    turning = [(i, axis) for i, axis in enumerate(machine.axes) if isinstance(axis, RotaryAxis)]
    if not turning:
        return {}
    columns = {
        "axis": [axis.letter for _, axis in turning],
        "low high [rad]": np.array([[axis.knots[0], axis.knots[-1]] for _, axis in turning]),
        "knots": [len(axis.knots) for _, axis in turning],
        "reference [rad]": [axis.reference for _, axis in turning],
        "place": [machine.order.index(i) + 1 for i, _ in turning],
        "x y z [mm]": np.array([axis.at for _, axis in turning]),
        "sense": [axis.sense for _, axis in turning],
        "head": [axis.head for _, axis in turning],
        "periodic": [axis.periodic for _, axis in turning],
    }
    return {"rotary_axes": Table.of(columns)}


def entries(tables: Tables) -> Table:
    """Return the error and the position of each entry of `tables_covariance`."""
    error, position = [entry for entry, _ in tables.entries], np.array([entry for _, entry in tables.entries])
    if not tables.machine.turns:
        return Table.of({"error": error, "position [mm]": position})
    turns = np.array([name[-1] in ANGLES for name in error])
    linear, turned = np.where(turns, np.nan, position), np.where(turns, position, np.nan)
    return Table.of({"error": error, "position [mm]": linear, "angle [rad]": turned})


def on_workpiece(solution: Solution) -> dict[str, Table]:
    """Return the places of balls or reflectors on the workpiece, at position 0 of all axes."""
    if ON_WORKPIECE not in solution.blocks:
        return {}
    block = solution.blocks[ON_WORKPIECE]
    std = solution.std(ON_WORKPIECE) if block.free.any() else np.zeros(block.values.shape)
    table = Table.of({block.noun: block.members, "x y z [mm]": block.values, "sx sy sz [mm]": std})
    return {f"{block.noun}s": table}


def tracker(solution: Solution) -> dict[str, Table]:
    if TRACKER not in solution.blocks:
        return {}
    block, std = solution.blocks[TRACKER], solution.std(TRACKER)[0]
    units = ["mm"] * 3 + ["rad"] * 3
    columns = {"parameter": block.columns, "value": block.values[0], "std": std, "unit": units}
    return {"tracker": Table.of(columns)}


def positions(solution: Solution) -> dict[str, Table]:
    """Return how far rotary axes turned beyond their positions, where these are estimated."""
    names = [name for name in POSITIONS if name in solution.blocks]
    if not names:
        return {}
    blocks, std = [solution.blocks[name] for name in names], [solution.std(name)[:, 0] for name in names]
    columns = {
        "axis": [block.name[-1] for block in blocks for _ in block.members],
        "position [text]": [member for block in blocks for member in block.members],
        "beyond [rad]": np.concatenate([block.values[:, 0] for block in blocks]),
        "std [rad]": np.concatenate(std),
    }
    return {"positions": Table.of(columns)}


def stations(solution: Solution) -> dict[str, Table]:
    """Return the place, dead path and scale of each station of lengths."""
    if TRACER not in solution.blocks:
        return {}
    block, std = solution.blocks[TRACER], solution.std(TRACER)
    values = {"x y z dead_path [mm]": block.values[:, :4], "scale": block.values[:, 4]}
    spread = {"sx sy sz s_dead_path [mm]": std[:, :4], "s_scale": std[:, 4]}
    return {"stations": Table.of({"station": block.members, **values, **spread})}


def lines(solution: Solution) -> dict[str, Table]:
    """Return the misalignment of each six-dof line: offsets of the channels, and slopes across the beam."""
    if LINE not in solution.blocks:
        return {}
    block = solution.blocks[LINE]
    units = ["mm" if name in ("ex", "ey", "ez") else "rad" for name in block.columns]
    return {"lines": Table.of({"line": block.members, **columns_with_std(block, solution.std(LINE), units)})}
