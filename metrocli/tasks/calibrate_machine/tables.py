"""The error tables of a machine with the covariance of all their entries, and the tables beside them.

The gauge of the tables: straightness is zero at both ends, all others are zero at the reference position.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

import numpy as np

from metrocli.adjust.dense_jacobian import Unknowns, covariance_of, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import POSITIONS
from metrocli.instruments.axes.kinematics import ON_WORKPIECE
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import ANGLES, AXES, SQUARENESS, TOOL, Axis, Machine, errors_of, is_angle
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracer import TRACER
from metrocli.instruments.tracker import TRACKER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.problem import ERROR_BLOCKS, PLACES_OF_AXES
from metrocli.tasks.shared.part import Warm
from metrocli.tasks.shared.statistics import columns_with_std
from metrocli.units import internal_unit


class Determination(StrEnum):
    """What the readings determine of an error."""

    DETERMINED = "determined"
    TOGETHER = "together"
    """Only combined with errors that are held at zero"""
    UNDETERMINED = "undetermined"
    """Held at zero"""
    NOT_ESTIMATED = "not estimated"
    GIVEN = "given"
    """By an earlier calibration, with its covariance"""


NO_SCALES: Mapping[str, Warm] = {}
"""Axes whose scales have 20 degC, or a temperature that the job does not give"""


def unit_of(name: str) -> str:
    """Return the internal unit of an error."""
    return internal_unit("angle" if is_angle(name) else "length")


@dataclass(frozen=True)
class Tables:
    """Values of all tables at their knots, of locations and squareness, with their covariance."""

    machine: Machine
    blocks: Mapping[str, Block]
    unknowns: Unknowns
    raw: Array
    """Covariance of the unknowns (raw values), (size, size)"""
    entries: tuple[tuple[str, float], ...]
    """Error and position of each entry; the position is nan for squareness and locations, which come last"""
    values: Array
    covariance: Array
    """Covariance of the entries, (n, n)"""

    def rows_of(self, name: str) -> list[int]:
        """Return which entries are those of an error."""
        return [i for i, (error, _) in enumerate(self.entries) if error == name]

    def of(self, name: str) -> tuple[Array, Array, Array]:
        """Return position, value and standard uncertainty of an error."""
        at = self.rows_of(name)
        position = np.array([self.entries[i][1] for i in at])
        return position, self.values[at], np.sqrt(np.maximum(np.diag(self.covariance)[at], 0.0))


def tables_of(machine: Machine, solution: Solution, scales: Mapping[str, Warm] = NO_SCALES) -> Tables:
    """Return the tables of a solution, and propagate the covariance of the unknowns to their entries.

    An axis in `scales` has the positioning of its scale at 20 degC: `E - g (x - x_r)`, g the growth of the scale and
    x_r the reference of the table. This adds `u(g)^2 (x - x_r)(x - x_r)'` to the covariance.
    """
    blocks = dict(solution.blocks)
    unknowns = unknowns_of(blocks, [name for name in ERROR_BLOCKS if name in blocks])
    raw = covariance_of(solution, unknowns)
    for axis in machine.axes:
        if axis.letter in scales:
            scale = scales[axis.letter]
            blocks[axis.block], away = grown(axis, blocks[axis.block], -scale.growth)
            by_growth = unknowns.spread(axis.block, np.eye(unknowns.size))[:, axis.number].T @ away
            raw = raw + scale.std**2 * np.outer(by_growth, by_growth)
    parts = [_axis_entries(axis, blocks[axis.block], unknowns) for axis in machine.axes]
    places = [name for name in (*PLACES_OF_AXES[1:], SQUARENESS) if name in blocks]
    square = [unknowns.spread(name, np.eye(unknowns.size))[0] for name in places]
    names = [column for name in places for column in blocks[name].columns]
    entries = [entry for part in parts for entry in part[0]] + [(name, float("nan")) for name in names]
    maps = np.concatenate([*(part[2] for part in parts), *square])
    values = np.concatenate([*(part[1] for part in parts), *(blocks[name].values[0] for name in places)])
    return Tables(machine, blocks, unknowns, raw, tuple(entries), values, maps @ raw @ maps.T)


def grown(axis: Axis, block: Block, growth: float) -> tuple[Block, Array]:
    """Return the raw values of an axis whose scale has grown, and their derivative by the growth, (knots,).

    The raw positioning is held at 0 at the knot nearest to the reference.
    """
    away = axis.knots - axis.knots[np.argmin(np.abs(axis.knots - axis.reference))]
    values = block.values.copy()
    values[:, axis.number] += growth * away
    return block.with_values(values), away


def _axis_entries(axis: Axis, block: Block, unknowns: Unknowns) -> tuple[list[tuple[str, float]], Array, Array]:
    """Return the entries of an axis, their values, and how they depend on the unknowns (entries, unknowns)."""
    spread = unknowns.spread(axis.block, np.eye(unknowns.size))
    names = errors_of(axis.letter)
    entries = [(name, float(knot)) for name in names for knot in axis.knots]
    values = np.concatenate([axis.from_raw[k] @ block.values[:, k] for k in range(6)])
    return entries, values, np.concatenate([axis.from_raw[k] @ spread[:, k] for k in range(6)])


def least_squares_squareness(tables: Tables) -> tuple[Array, Array]:
    """Return A0Z, B0Z, C0Y between least-squares lines of the straightness tables, (3,), and their covariance, (3, 3).

    The entries of the solution are the angles between end-point lines. A least-squares line of EXY with slope s turns
    Y towards +X by s, which reduces C0Y by s.
    """
    change = np.zeros((3, len(tables.entries)))
    if sum(not axis.turns for axis in tables.machine.axes) < len(AXES):
        return tables.values[-3:], tables.covariance[-3:, -3:]
    for row, terms in enumerate(
        ((("EYZ", -1.0), ("EZY", -1.0)), (("EXZ", 1.0), ("EZX", 1.0)), (("EXY", -1.0), ("EYX", -1.0)))
    ):
        change[row, len(tables.entries) - 3 + row] = 1.0
        for name, sign in terms:
            position = tables.of(name)[0]
            centred = position - position.mean()
            change[row, tables.rows_of(name)] += sign * centred / (centred**2).sum()
    return change @ tables.values, change @ tables.covariance @ change.T


def tool_names(blocks: Mapping[str, Block]) -> list[str]:
    """Return the names of the tools for reports; a tool without a name is called "tool"."""
    return [name or "tool" for name in blocks[TOOL].members]


def linear_axes(machine: Machine) -> Table:
    """Return the linear axes with their range and knots."""
    linear = [(i, axis) for i, axis in enumerate(machine.axes) if not axis.turns]
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
