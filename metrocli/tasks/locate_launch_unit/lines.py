"""The lines that an interferometer can measure from its launch unit, and NC programs that move the receiver along them.

Lines are parallel to axes and face diagonals; the programs keep clear of the unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, permutations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import wrapped
from metrocli.instruments.launch_unit import direction
from metrocli.nc_program import Block, Dwell, Feed, Rapid, Stop, program, written
from metrocli.units import find_unit

AXES = "xyz"
_VERTICAL = 1e-9
"""Horizontal part of a unit vector below which a beam is vertical"""
_INSIDE = 1e-9
"""Tolerance for rounding at the end of an axis, as a share of the range"""
_ROUNDING = 1e-3
"""Excess over the range of an axis, or lack of clearance, that is rounding [mm]"""


@dataclass(frozen=True)
class ReceiverLine:
    """Receiver positions along one beam through the unit, from the low to the high end of the axes."""

    name: str
    """x, y, z, xy, yz or xz"""
    beam: Array
    """Direction from the unit to the receiver, (3,)"""
    points: Array
    """Receiver positions, (n, 3)"""
    position: Array
    """Position of the axis, (n,); for a diagonal, the distance from where it enters the machine's volume"""
    distance: Array
    """Distance from the unit, (n,)"""


@dataclass(frozen=True)
class Reach:
    """Limits on receiver positions, in mm."""

    box: Array
    """Lowest and highest position of the axes, (3, 2)"""
    step: float
    """Distance between points of a line"""
    nearest: float
    """Least distance from the unit"""
    farthest: float
    """Largest distance from the unit"""


def along(name: str, box: Array) -> Array:
    """Return the unit vector of an axis, or of a face diagonal from the low to the high corner, (3,)."""
    vector = np.array([np.ptp(box[i]) if axis in name else 0.0 for i, axis in enumerate(AXES)])
    return np.asarray(vector / np.linalg.norm(vector))


def measurable(place: Array, names: Sequence[str], reach: Reach) -> tuple[list[ReceiverLine], dict[str, str]]:
    """Return the lines through the unit that hold two or more points, and the reason why each other line does not.

    A line runs on one side of the unit, the one with more points. Points are `step` apart, counted from where the line
    enters the volume.
    """
    lines, refused = [], {}
    for name in names:
        vector = along(name, reach.box)
        first, last = _inside(place, vector, reach.box)
        if not first < last:
            refused[name] = _outside(place, name, reach.box)
            continue
        grid = first + reach.step * np.arange(np.floor((last - first) / reach.step * (1 + _INSIDE)) + 1)
        sides = {sign: (sign * grid >= reach.nearest) & (sign * grid <= reach.farthest) for sign in (1.0, -1.0)}
        sign = max(sides, key=lambda sign: int(sides[sign].sum()))
        chosen = grid[sides[sign]]
        if len(chosen) < 2:
            refused[name] = "fewer than two points are far enough from the unit and within the axes"
            continue
        points = np.clip(place + chosen[:, None] * vector, *reach.box.T)
        position = points[:, AXES.index(name)] if len(name) == 1 else chosen - first
        lines.append(ReceiverLine(name, sign * vector, points, position, np.abs(chosen)))
    return lines, refused


def _inside(place: Array, vector: Array, box: Array) -> tuple[float, float]:
    """Return the first and last t of `place + t vector` in the box; the first is not below the last if it misses."""
    moving = vector != 0
    rest = ~moving
    if ((place < box[:, 0] - _ROUNDING) | (place > box[:, 1] + _ROUNDING))[rest].any():
        return 0.0, 0.0
    ends = (box[moving] - place[moving, None]) / vector[moving, None]
    return float(ends.min(axis=1).max()), float(ends.max(axis=1).min())


def _outside(place: Array, name: str, box: Array) -> str:
    off = [
        f"{axis} = {place[i]:.1f} mm of the unit is outside {box[i, 0]:g} ... {box[i, 1]:g} mm"
        for i, axis in enumerate(AXES)
        if axis not in name and not box[i, 0] <= place[i] <= box[i, 1]
    ]
    return "; ".join(off) or "the line through the unit misses the volume"


def commanded(beam: Array, gamma: float, psi: float) -> Mapping[str, float]:
    """Return the encoder angles [rad] that aim both units along a beam; the azimuth of a vertical beam is set to 0."""
    level = float(np.hypot(beam[0], beam[1]))
    azimuth = float(np.arctan2(beam[1], beam[0])) if level > _VERTICAL else 0.0
    tilt = float(np.arctan2(beam[2], level))
    phi1, phi4 = wrapped(np.array([azimuth - gamma, azimuth + np.pi - psi]))
    return {"phi1": float(phi1), "phi2": tilt, "phi3": -tilt, "phi4": float(phi4)}


def across(beam: Array) -> tuple[Array, Array, float]:
    """Return the unit vectors beside and above a beam, and cos(tilt), the turn of the beam per turn of the base."""
    aim = commanded(beam, 0.0, 0.0)
    azimuth, tilt, quarter = aim["phi1"], aim["phi2"], np.pi / 2
    beside = direction(np.array(azimuth + quarter), np.array(0.0))
    return beside, direction(np.array(azimuth), np.array(tilt + quarter)), float(np.cos(tilt))


@dataclass(frozen=True)
class ProgramMotion:
    """Feed, dwell and clearance of a program, and the control for which it is written."""

    feed: float
    """[mm/s]"""
    dwell: float
    """Standstill at each point [s]"""
    clearance: float
    """Least distance of a rapid from the unit [mm]"""
    park: Array
    """Position where programs begin and end, (3,)"""
    control: str


def farthest_corner(place: Array, box: Array) -> Array:
    """Return the corner of the volume farthest from the unit, (3,)."""
    return np.where(np.abs(box[:, 0] - place) > np.abs(box[:, 1] - place), box[:, 0], box[:, 1])


def route(start: Array, end: Array, place: Array, clearance: float) -> list[Array] | None:
    """Return the corners of a path of single-axis moves that keeps clear of the unit, or None if none exists."""
    for order in permutations(range(3)):
        corners = [start]
        for axis in order:
            corner = corners[-1].copy()
            corner[axis] = end[axis]
            corners.append(corner)
        legs = pairwise(corners)
        if all(_distance(place, a, b) >= clearance - _ROUNDING for a, b in legs):
            return corners[1:]
    return None


def _distance(place: Array, a: Array, b: Array) -> float:
    """Return the distance of a place from the straight segment between two points."""
    length = float((b - a) @ (b - a))
    share = np.clip((place - a) @ (b - a) / length, 0.0, 1.0) if length else 0.0
    return float(np.linalg.norm(place - a - share * (b - a)))


def line_program(line: ReceiverLine, values: Array, psi: float, motion: ProgramMotion) -> str | None:
    """Return the program of a line for the unit at x y z gamma, or None if no path keeps clear of the unit."""
    place = values[:3]
    there = route(motion.park, line.points[0], place, motion.clearance)
    back = route(line.points[-1], motion.park, place, motion.clearance)
    if there is None or back is None:
        return None
    message = f"drive by hand to {_words(motion.park)}, clear of the unit, then start"
    blocks = [Stop(message), *_blocks(line, there, back, motion)]
    return program(f"line {line.name}", _remarks(line, values, psi), blocks, motion.control)


def _remarks(line: ReceiverLine, values: Array, psi: float) -> list[str]:
    degree = find_unit("deg", "angle")
    aim = commanded(line.beam, float(values[3]), psi)
    angle = {name: f"{name.upper()} = {round(degree.outside(value), 5) + 0.0:.5f} deg" for name, value in aim.items()}
    return [
        "positions of the receiver's control point in the machine frame of the location",
        f"launch unit at {_words(values[:3])}",
        f"{len(line.points)} points, {line.distance.min():.3f} to {line.distance.max():.3f} mm from the unit",
        f"set the launch unit to {angle['phi1']}, {angle['phi2']}",
        f"set the receiver to {angle['phi3']}, {angle['phi4']}, spindle locked at {degree.outside(psi):.5f} deg",
    ]


def _words(point: Array) -> str:
    return " ".join(f"{axis.upper()}{value:.3f}" for axis, value in zip(AXES, point, strict=True))


def _blocks(line: ReceiverLine, there: list[Array], back: list[Array], motion: ProgramMotion) -> Iterator[Block]:
    yield Feed(_axes(motion.park), motion.feed)
    yield from _rapids(motion.park, there)
    for point in line.points:
        yield Feed(_axes(point), motion.feed)
        yield Dwell(motion.dwell)
    yield from _rapids(line.points[-1], back)


def _rapids(start: Array, corners: list[Array]) -> Iterator[Rapid]:
    at = _axes(start)
    for corner in map(_axes, corners):
        # computed on two ways, equal coordinates may differ in their last digit: no move that the program cannot state
        moved = {axis: value for axis, value in corner.items() if written(value) != written(at[axis])}
        if moved:
            yield Rapid(moved)
        at = corner


def _axes(point: Array) -> dict[str, float]:
    return dict(zip(AXES, point.tolist(), strict=True))
