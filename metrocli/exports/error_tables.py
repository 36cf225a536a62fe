"""The geometric errors of a machine in the form of compensation tables: functions of one axis, and products of two.

The positioning of rotary axes is in degrees, as controls have it, and in the count of the axis.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import field, replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table

AXES = "XYZ"
LETTERS = AXES + "ABC"
POSITIONING = tuple(f"E{letter}{letter}" for letter in LETTERS)
"""Errors of the positioning of each axis"""
TURN = 360.0
"""[deg]"""
SIGN = "sign: actual minus commanded"
LEVERS = (
    ("A", "Y", "Z", -1), ("A", "Z", "Y", 1), ("B", "X", "Z", 1),
    ("B", "Z", "X", -1), ("C", "X", "Y", -1), ("C", "Y", "X", 1),
)  # fmt: skip
"""Terms of theta x L: rotation, direction of the error, component of the lever, sign"""
SQUARENESS = (("C0Y", "Y", "X", -1), ("B0Z", "Z", "X", 1), ("A0Z", "Z", "Y", -1))
"""Terms of squareness: name, axis that moves, direction of the error, sign"""


@dataclass(frozen=True)
class ErrorTable:
    """A function of the position of one axis, linear between positions and constant beyond them."""

    positions: Array
    """(n,) mm or deg, ascending"""
    values: Array
    """(n,) mm, rad, or deg of rotary axes; a factor of a product may have another unit"""
    std: Array | None = None

    def at(self, where: Array) -> Array:
        """Return the interpolated values at positions."""
        return np.interp(where, self.positions, self.values)

    def times(self, factor: float) -> ErrorTable:
        """Return the curve multiplied by a number."""
        return ErrorTable(self.positions, self.values * factor)

    def plus(self, other: ErrorTable) -> ErrorTable:
        """Return the sum of two curves on the positions of both, so that it is exact."""
        grid = np.union1d(self.positions, other.positions)
        return ErrorTable(grid, self.at(grid) + other.at(grid))


@dataclass(frozen=True)
class Product:
    """An error `angle(position of one axis) * (position of another)` in one direction."""

    angle: ErrorTable
    """Signed, rad"""
    moves: str
    """The axis that the angle depends on"""
    lever: str
    """The axis whose position is the lever"""
    direction: str


@dataclass(frozen=True)
class ErrorTables:
    """Errors of a machine with three linear axes, in the names of ISO 230-1, each actual minus commanded."""

    curves: Mapping[str, ErrorTable]
    """EXX, EYX, ... (mm) and EAX, ... (rad), over the position of the axis of their last letter; EAA, EBB, ECC (deg)"""
    squareness: Mapping[str, float]
    """C0Y, B0Z and A0Z, rad"""
    order: str = "XYZ"
    """The axes from the workpiece to the tool"""
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Tool vector for which the tables hold, mm"""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest position of each axis, mm; taken from the curves if not given"""
    squareness_std: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    """Errors that the measurement did not determine; no file contains them."""
    together: tuple[str, ...] = ()
    """Errors that are determined only together with those left out; they hold only for the tool of the measurement"""

    reversal: Mapping[str, float] = field(default_factory=dict)
    """Width of the backlash by axis, mm; half of it is added to the error after a move in the positive direction"""
    remarks: tuple[str, ...] = ()
    """Remarks for the files, such as what the format cannot hold"""
    periodic: str = ""
    """Letters of the rotary axes that take any turn; their tables go from 0 to 360 deg with one value at both"""

    def notes(self) -> list[str]:
        """Return the notes for the comments of every file: sign, errors left out, validity, backlash and remarks."""
        lines = [SIGN]
        if self.left_out:
            lines.append("not determined by the measurement, and left out: " + " ".join(self.left_out))
        if self.together:
            tool = " ".join(f"{offset:g}" for offset in self.tool)
            lines.append(f"valid only for the tool {tool} mm of the measurement: " + " ".join(self.together))
        back = [
            f"backlash of {axis}, {width:.{digits_of(axis)}f} {unit_of(axis)}, is not in these tables"
            for axis, width in self.reversal.items()
        ]
        return [*lines, *back, *self.remarks]

    def only(self, curves: Iterator[str] | tuple[str, ...], squareness: bool = False) -> ErrorTables:
        """Return the tables with only some of the curves, with or without squareness."""
        kept = {name: self.curves[name] for name in curves if name in self.curves}
        return replace(self, curves=kept, squareness=self.squareness if squareness else {})

    def of_one_axis(self) -> dict[tuple[str, str], ErrorTable]:
        """Return the errors that depend on the position of one axis, by (axis that moves, direction of the error).

        Each is the sum of the table itself, the angles with the tool vector as lever, and the squareness.
        """
        tables: dict[tuple[str, str], ErrorTable] = {}
        for moves, direction, curve in self._parts():
            key = (moves, direction)
            tables[key] = tables[key].plus(curve) if key in tables else curve
        return tables

    def _parts(self) -> Iterator[tuple[str, str, ErrorTable]]:
        for name, curve in self.curves.items():
            if name[1] in AXES or name in POSITIONING:
                yield name[2], name[1], curve
        for rotation, direction, lever, sign in LEVERS:
            offset = self.tool[AXES.index(lever)]
            for moves in AXES:
                angle = self.curves.get(f"E{rotation}{moves}")
                if angle is not None and offset:
                    yield moves, direction, angle.times(sign * offset)
        for name, moves, direction, sign in SQUARENESS:
            angle_of = self.squareness.get(name, 0.0)
            if angle_of:
                grid = self.span(moves)
                yield moves, direction, ErrorTable(grid, sign * angle_of * grid)

    def products(self) -> list[Product]:
        """Return the errors that depend on two axes: angles with an axis nearer to the tool as lever."""
        return [
            Product(self.curves[f"E{rotation}{moves}"].times(sign), moves, lever, direction)
            for moves in AXES
            for rotation, direction, lever, sign in LEVERS
            if f"E{rotation}{moves}" in self.curves and self.order.index(lever) > self.order.index(moves)
        ]

    def span(self, axis: str) -> Array:
        """Return the lowest and the highest position of an axis, (2,) mm."""
        if axis in self.ranges:
            return np.array(self.ranges[axis])
        grid = next((curve.positions for name, curve in self.curves.items() if name[2] == axis), np.zeros(1))
        return np.array([grid[0], grid[-1]])

    def at(self, commanded: Array) -> Array:
        """Return the error at commanded positions: the rigid-body model to first order.

        Both are (n, 3) mm, or with rotary axes (n, 6) mm and deg.
        """
        error = np.zeros(commanded.shape)
        for (moves, direction), curve in self.of_one_axis().items():
            error[:, LETTERS.index(direction)] += curve.at(commanded[:, LETTERS.index(moves)])
        for product in self.products():
            angle = product.angle.at(commanded[:, AXES.index(product.moves)])
            error[:, AXES.index(product.direction)] += angle * commanded[:, AXES.index(product.lever)]
        return error


def unit_of(axis: str) -> str:
    """Return the unit of the positions of an axis in the files of controls."""
    return "mm" if axis in AXES else "deg"


def digits_of(axis: str) -> int:
    """Return the decimals of its errors in sentences."""
    return 4 if axis in AXES else 6


def has(result: Result) -> bool:
    """Return whether a result has error tables."""
    return any(name.startswith("tables/") for name in result.tables)


def of(result: Result) -> ErrorTables:
    """Return the determined error tables of a result of calibrate-machine; raises InputError for any other result."""
    named = {name.removeprefix("tables/"): table for name, table in result.tables.items() if name.startswith("tables/")}
    if not named:
        why = "this format needs a result of calibrate-machine"
        why = "its job does not estimate any" if "axes" in result.tables else why
        raise InputError(f"the result has no error tables; {why}")
    axes = result.tables["axes"]
    places = dict(zip(axes.texts("axis"), axes.numbers("place").tolist(), strict=True))
    ranges = dict(
        zip(places, zip(axes.numbers("low").tolist(), axes.numbers("high").tolist(), strict=True), strict=True)
    )
    left_out, together = (tuple(str(result.statistics.get(key, "")).split()) for key in ("undetermined", "together"))
    curves = {
        name: ErrorTable(table.numbers("position"), table.numbers("value"), table.numbers("std"))
        for name, table in named.items()
        if name not in left_out and name[2] in AXES
    }
    known = {
        estimate.name: estimate
        for estimate in result.estimates
        if estimate.name in _SQUARENESS_NAMES and estimate.name not in left_out
    }
    return ErrorTables(
        curves,
        {name: estimate.value for name, estimate in known.items()},
        "".join(sorted(places, key=lambda axis: places[axis])),
        _tool(result),
        ranges,
        squareness_std={name: estimate.std for name, estimate in known.items()},
        left_out=left_out,
        together=together,
        reversal=reversal_of(result),
        remarks=(*(f"NOT FIT FOR USE: {doubt}" for doubt in result.doubts), *_others(result)),
    )


_EFFECT = re.compile(r"effects/(.+)/parameters")
_BACKLASH = {f"backlash.{axis.lower()}": axis for axis in LETTERS}


def _effects(result: Result) -> dict[str, Table]:
    """Return the parameters of the effects in a result by their names, such as `backlash.x`."""
    matches = {name: _EFFECT.fullmatch(name) for name in result.tables}
    return {match[1]: result.tables[name] for name, match in matches.items() if match}


def reversal_of(result: Result) -> dict[str, float]:
    """Return the width of the backlash by axis [mm, rad]."""
    tables = {_BACKLASH.get(name): table for name, table in _effects(result).items()}
    return {axis: float(table.numbers("value")[0]) for axis, table in tables.items() if axis}


def _others(result: Result) -> list[str]:
    """Return a remark on effects in the result that error tables cannot hold."""
    names = [name for name in _effects(result) if name not in _BACKLASH]
    return [f"estimated in the result, but not in these tables: {' '.join(names)}"] if names else []


_SQUARENESS_NAMES = tuple(name for name, *_ in SQUARENESS)


def _tool(result: Result) -> tuple[float, float, float]:
    """Return the vector of the first measured tool, for which the tables hold; (0, 0, 0) if the result has no tools."""
    if "tools" not in result.tables:
        return (0.0, 0.0, 0.0)
    table = result.tables["tools"]
    first = int(np.argmax(np.asarray(table.columns["measured"], dtype=bool))) if "measured" in table else 0
    x, y, z = (float(table.numbers(axis)[first]) for axis in ("x", "y", "z"))
    return x, y, z
