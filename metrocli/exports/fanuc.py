"""Fanuc stored pitch error compensation: the positioning error of each axis in increments.

Data are integers in detection units times a magnification. Each is the change from the preceding point, counted from
the negative end; the sum is zero at the reference point (parameters 3620-3624; technical report A-77810E; parameter
manual B-63980EN p. 100). The running sum is rounded, not each increment, so that rounding errors do not accumulate. The
control outputs the compensation between two points; the model takes it as linear.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports.compensation import CompensationFormat, Texts
from metrocli.exports.error_tables import LETTERS, POSITIONING, TURN, ErrorTable, ErrorTables, unit_of
from metrocli.exports.volumetric import evenly
from metrocli.frozen import dataclass
from metrocli.words import listed

MOST_POINTS, MOST_STEP = 128, 7
"""Most points of an axis, and largest increment: increments are from -7 to 7"""
UNIT = 1e-3
"""Detection unit, mm or deg"""
_FILE = "pitch-error.txt"
_PARAMETER = re.compile(r"N(\d+)A(\d)P(\S+)")
_DATUM = re.compile(r"N1(\d{4})P(\S+)")


@dataclass(frozen=True)
class Pitch:
    """The compensation of one axis."""

    axis: str
    first: int
    """Number of the most negative point"""
    reference: int
    """Number of the point at machine position 0"""
    interval: float
    magnification: int
    increments: npt.NDArray[np.int64]
    """Increments from the most negative point on; the first is 0, of an axis that takes any turn that of 360 deg"""
    turn: bool = False
    """Whether it takes any turn"""

    @property
    def curve(self) -> ErrorTable:
        """The compensation over the machine position, mm, zero at the reference point."""
        numbers = np.arange(len(self.increments)) + self.first - self.reference
        total = np.cumsum(self.increments) * (self.magnification * UNIT)
        grid = np.asarray(numbers * self.interval, dtype=float)
        return ErrorTable(grid, total - np.interp(0.0, grid, total))


def carried(tables: ErrorTables) -> ErrorTables:
    """Return the positioning errors on an even grid through machine position 0, as the control needs it.

    Those that are nowhere half a detection unit are left out; raises InputError if all are.
    """
    held = tables.only(POSITIONING)
    even = {name: _even(name, curve) for name, curve in held.curves.items()}
    curves = {name: curve for name, curve in even.items() if np.abs(curve.values).max() >= UNIT / 2}
    small = [f"{name} is nowhere {UNIT / 2:g} {unit_of(name[2])}: left out" for name in even if name not in curves]
    if small and not curves:
        raise InputError(
            f"no positioning error is half a detection unit: {listed(list(even))} would be tables of zeros"
        )
    return replace(held, curves=curves, remarks=(*held.remarks, *small, *_remarks(held.curves, curves)))


def _remarks(before: Mapping[str, ErrorTable], after: Mapping[str, ErrorTable]) -> Iterator[str]:
    for name, curve in ((name, before[name]) for name in after):
        shift = curve.at(np.zeros(1))
        lost = float(np.abs(after[name].at(curve.positions) - curve.values + shift).max())
        if lost > UNIT / 2:
            size = f"{lost:.4f} {unit_of(name[2])}"
            yield f"{name}: no even grid contains its knots and 0; its corners are rounded by up to {size}"


def _even(name: str, curve: ErrorTable) -> ErrorTable:
    """Return the error, relative to its value at 0, on points a whole number of intervals from 0.

    If no even grid contains the knots and 0, the finest grid is used, which rounds the corners of the table. Raises
    InputError if the table has too many points.
    """
    if len(curve.positions) > MOST_POINTS:
        raise InputError(
            f"{name} has {len(curve.positions)} points; pitch error compensation takes at most {MOST_POINTS}"
        )
    grid = evenly(_with_zero(curve), MOST_POINTS) or _finest(curve)
    return ErrorTable(grid.positions, grid.values - grid.at(np.zeros(1)))


def _finest(curve: ErrorTable) -> ErrorTable:
    low, high = min(curve.positions[0], 0.0), max(curve.positions[-1], 0.0)
    step = (high - low) / (MOST_POINTS - 2)
    places = np.arange(math.floor(low / step), math.ceil(high / step) + 1) * step
    return ErrorTable(places, curve.at(places))


def _with_zero(curve: ErrorTable) -> ErrorTable:
    grid = np.union1d(curve.positions, [0.0])
    return ErrorTable(grid, curve.at(grid))


def _pitch(axis: str, curve: ErrorTable, first: int) -> Pitch:
    """Return the table of one axis, with enough points to keep increments small, and the smallest magnification.

    Raises InputError if a magnification above 100 is needed.
    """
    count = len(curve.positions) - 1
    best = curve
    for times in range(1, (MOST_POINTS - 1) // count + 1):
        grid = np.linspace(curve.positions[0], curve.positions[-1], count * times + 1)
        best = ErrorTable(grid, curve.at(grid))
        if np.abs(np.diff(_rounded(best, 1))).max() <= MOST_STEP:
            break
    largest = np.abs(np.diff(best.values)).max() / UNIT
    magnification = max(1, math.ceil(largest / MOST_STEP))
    while np.abs(np.diff(_rounded(best, magnification))).max() > MOST_STEP:
        magnification += 1
    if magnification > 100:
        raise InputError(
            f"E{axis}{axis} changes by {largest:.0f} um between points: this needs a magnification above 100"
        )
    step = (best.positions[-1] - best.positions[0]) / (len(best.positions) - 1)
    increments = np.diff(_rounded(best, magnification), prepend=_rounded(best, magnification)[0])
    return Pitch(axis, first, first - round(best.positions[0] / step), step, magnification, increments)


def _closed(pitch: Pitch) -> Pitch:
    """Return the table of an axis that takes any turn: its point at 0 has the value of that at 360 deg.

    The increments of a turn add up to zero, else errors would accumulate (parameter manual B-63980EN, p. 100).
    """
    increments = pitch.increments.copy()
    increments[0] = increments[-1]
    return replace(pitch, increments=increments, turn=True)


def _rounded(curve: ErrorTable, magnification: int) -> npt.NDArray[np.int64]:
    """Return the negative error in units of the magnified detection unit, each value rounded on its own."""
    return np.rint(-curve.values / (magnification * UNIT)).astype(np.int64)


def written(tables: ErrorTables) -> Texts:
    """Return one file with the parameters and increments of all axes; raises InputError if there is no table."""
    if not tables.curves:
        raise InputError("the result determines no positioning error: nothing for pitch error compensation")
    pitches: list[Pitch] = []
    for name, curve in tables.curves.items():
        first = pitches[-1].first + len(pitches[-1].increments) if pitches else 0
        pitch = _pitch(name[2], curve, first)
        pitches.append(_closed(pitch) if name[2] in tables.periodic else pitch)
    lines = [line for pitch in pitches for line in _lines(pitch)]
    return {_FILE: "\n".join(["%", *(f"({line})" for line in _head(pitches, tables.notes())), *lines, "%", ""])}


def _head(pitches: Sequence[Pitch], notes: list[str]) -> list[str]:
    """Return the comments, without parentheses, since comments of the control cannot be nested."""
    pitch, curve = pitches[0], pitches[0].curve
    rounded = ", ".join(
        f"{other.axis} {other.magnification * UNIT:g} {unit_of(other.axis).upper()}" for other in pitches
    )
    k, unit = int(np.argmax(np.abs(curve.values))), unit_of(pitch.axis).upper()
    return [
        *(line.upper() for line in notes),
        f"VALUE = MINUS THE ERROR, INCREMENTS COUNTED FROM THE NEGATIVE END, DETECTION UNIT {UNIT} {unit}",
        f"SUMS ARE ROUNDED TO {rounded}",
        "NO PUBLIC MANUAL CONFIRMS THE SIGN. TEST MOVE: AFTER REFERENCE RETURN GO TO "
        f"{pitch.axis} = {curve.positions[k]:.3f} {unit}. THE AXIS MUST MOVE BY {curve.values[k]:+.3f} {unit} MORE "
        "THAN WITHOUT COMPENSATION. IF NOT, CHANGE THE SIGN OF ALL INCREMENTS",
        "AFTER LOADING, SWITCH THE POWER OFF AND ON AND RETURN TO THE REFERENCE POINT",
    ]


def _lines(pitch: Pitch) -> list[str]:
    number = LETTERS.index(pitch.axis) + 1
    last = pitch.first + len(pitch.increments) - 1
    settings = {3620: pitch.reference, 3621: pitch.first, 3622: last, 3623: pitch.magnification}
    return [
        *(f"N{key}A{number}P{value}" for key, value in settings.items()),
        f"N3624A{number}P{pitch.interval:.6f}",
        *([f"N3625A{number}P{TURN:.6f}"] if pitch.turn else []),
        *(f"N1{pitch.first + k:04d}P{value:+d}" for k, value in enumerate(pitch.increments.tolist())),
    ]


def read(texts: Texts) -> list[Pitch]:
    """Return the table of each axis as the control stores it."""
    body = "\n".join(line for line in texts[_FILE].splitlines() if not line.startswith("("))
    data = {int(number): int(value) for number, value in _DATUM.findall(body)}
    settings = {(int(axis), int(key)): float(value) for key, axis, value in _PARAMETER.findall(body)}
    tables = []
    for axis in sorted({axis for axis, _ in settings}):
        reference, first, last, magnification = (round(settings[axis, key]) for key in (3620, 3621, 3622, 3623))
        increments = np.array([data[k] for k in range(first, last + 1)])
        tables.append(Pitch(LETTERS[axis - 1], first, reference, settings[axis, 3624], magnification, increments))
    return tables


def moved(held: Mapping[str, Pitch] | list[Pitch], commanded: Array) -> Array:
    """Return the movement (n, axes) by the control: the running sum of the increments."""
    moves = np.zeros(commanded.shape)
    for pitch in held.values() if isinstance(held, Mapping) else held:
        k = LETTERS.index(pitch.axis)
        moves[:, k] = pitch.curve.at(commanded[:, k])
    return moves


def coarseness(held: list[Pitch]) -> float:
    """Return the largest magnification: sums are rounded to this number of detection units."""
    return float(max(pitch.magnification for pitch in held))


CONTROL = CompensationFormat(written, read, moved, UNIT, coarseness, carried, turns=True)
