"""NC programs that move the receiver along the measuring lines and keep clear of the launch unit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, permutations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.nc_program import Block, Dwell, Feed, Rapid, Stop, program, written
from metrocli.tasks.locate_launch_unit.lines import AXES, ReceiverLine, commanded
from metrocli.units import find_unit

_ROUNDING = 1e-3
"""Tolerance of the clearance for rounding [mm]"""


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
