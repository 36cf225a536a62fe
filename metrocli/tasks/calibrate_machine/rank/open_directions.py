"""Combinations of errors that a measurement leaves open, and in words why, and what would close them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.decompositions import pivoted_qr
from metrocli.adjust.dense_jacobian import Unknowns
from metrocli.adjust.model.blocks import Block
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.axes.kinematics import OF_WORKPIECE, ON_WORKPIECE
from metrocli.instruments.machine import ANGLES, Machine
from metrocli.instruments.tracer import TRACER
from metrocli.tasks.calibrate_machine.problem import MachineProblem

_NAMED = 0.2
"""Errors with at least this share of the largest entry of a direction are named in it"""
_INVOLVED = 0.02
"""Errors with at least this share in any direction decide which sentence describes the case"""
_SCALES = {"EXX", "EYY", "EZZ"}


@dataclass(frozen=True)
class OpenDirections:
    """Open directions of the unknowns: combinations that the readings do not determine."""

    directions: Array
    """(unknowns, k), each of length 1 in units of `reach`"""
    reach: Array
    """Largest plausible size of each unknown, (unknowns,)"""
    unknowns: Unknowns
    blocks: Mapping[str, Block]
    names: tuple[str, ...]
    """Of all errors of the machine"""

    @cached_property
    def rows_of(self) -> Mapping[str, Index]:
        """Indices of the unknowns of each error, by its name."""
        columns = [column for _, _, column in self.unknowns.names(self.blocks)]
        return {name: np.array([i for i, column in enumerate(columns) if column == name], int) for name in self.names}

    def moved(self, group_rows: Array) -> Array:
        """Return the displacement that each direction causes at its full plausible size, (d*n, k)."""
        flat = group_rows.reshape(-1, self.unknowns.size)
        return np.asarray(flat @ (self.reach[:, None] * self.directions))

    def shares(self, directions: Array) -> dict[str, float]:
        """Return for each error its largest entry in the given directions, at most 1."""
        return {name: float(np.abs(directions[at]).max(initial=0.0)) for name, at in self.rows_of.items()}


def in_words(problem: MachineProblem, opened: OpenDirections, harmful: Array) -> str:
    """Return in words that combinations of errors (unknowns, k) move the tool but are not determined."""
    simple, count = _simple(harmful), harmful.shape[1]
    first = (
        f"the measurement does not determine {count} combinations of errors that move the tool in the volume:"
        if count > 1
        else "the measurement does not determine a combination of errors that moves the tool in the volume:"
    )
    known = list(_known(problem, opened, simple))
    if known:
        return "\n".join([first, *known])
    cure = cure_of(problem.blocks[TRACER].values[:, :3] if TRACER in problem.blocks else None)
    lines = [f"  {i + 1}: {_combination(opened, direction)}" for i, direction in enumerate(simple.T[:8])]
    more = [f"  and {count - 8} more"] if count > 8 else []
    return "\n".join(
        [
            first,
            *lines,
            *more,
            f"{cure}, use fewer knots, give the axes different knots, or leave errors out of `estimate`",
        ]
    )


def _known(problem: MachineProblem, opened: OpenDirections, directions: Array) -> Iterator[str]:
    """Yield a sentence for each cause that is known to leave directions open on machines with rotary axes."""
    shares = opened.shares(directions)
    largest = max(shares.values()) or 1.0
    names = {name for name, share in shares.items() if share > _INVOLVED * largest}
    machine = problem.machine
    tables = [machine.axes[i].letter for i in machine.order[: machine.bed]]
    if not machine.turns:
        return
    if ON_WORKPIECE in problem.blocks:
        yield from _few_points(_controlling(problem), machine, names)
    elif problem.sees_bed and tables:
        what = " and ".join(tables)
        yield (
            f"  an instrument on the bed does not see {what} turn under the tool: add reflectors on the workpiece "
            "(`inputs: reflectors`), or write `instrument: {on: workpiece}` if it stands there"
        )
    if names >= _SCALES:
        yield (
            "  EXX, EYY and EZZ share a scale with the places of the axes and of what is probed that no reading shows: "
            "one calibrated distance closes it (`inputs: distances`)"
        )


def _controlling(problem: MachineProblem) -> Block:
    """Return the points on the workpiece without those of which nothing is known but one reading."""
    points, (readings, *others) = problem.blocks[ON_WORKPIECE], problem.groups
    given = readings.observations
    seen = given.index[ON_WORKPIECE][given.conditions[OF_WORKPIECE] != 0]
    often = np.bincount(seen, minlength=len(points.members)) > 1
    if often.all() or not often.any() or any(ON_WORKPIECE in group.chain.blocks for group in others):
        return points
    return replace(
        points,
        values=points.values[often],
        free=points.free[often],
        members=tuple(np.array(points.members)[often].tolist()),
    )


def _few_points(points: Block, machine: Machine, names: set[str]) -> Iterator[str]:
    """Yield what points on the workpiece leave open where they are one, two, or on a line."""
    turning = [machine.axes[i].letter for i in machine.order[: machine.bed] if machine.axes[i].letter in ANGLES]
    touched = [letter for letter in turning if names & {f"E{angle}{letter}" for angle in ANGLES}]
    noun = points.noun or "ball"
    for letter in touched:
        angles = " ".join(f"E{angle}{letter}" for angle in ANGLES)
        shifts = " ".join(f"E{axis}{letter}" for axis in "XYZ")
        cure = f"three {noun}s that are not on one line, or `estimate: locations`"
        if len(points.members) == 1:
            yield f"  one {noun} does not determine {angles} beside {shifts} and the places of {letter}: {cure}"
        elif len(points.members) == 2 or line_of(points.values) is not None:
            what = f"two {noun}s do" if len(points.members) == 2 else f"{len(points.members)} {noun}s on one line do"
            yield f"  {what} not determine the turn about their line, a combination of {angles} at each angle: {cure}"


def _simple(directions: Array) -> Array:
    """Return directions that span the same space with few large entries each, by elimination with pivots."""
    _, _, order = pivoted_qr(directions.T)
    chosen = order[: directions.shape[1]]
    return np.asarray(directions @ np.linalg.inv(directions[chosen]))


def _combination(opened: OpenDirections, direction: Array) -> str:
    shares = opened.shares(direction[:, None])
    largest = max(shares.values()) or 1.0
    parts = sorted(
        ((share / largest, name) for name, share in shares.items() if share > _NAMED * largest), reverse=True
    )
    return ", ".join(name + _knots(opened, name, direction) for _, name in parts)


def _knots(opened: OpenDirections, name: str, direction: Array) -> str:
    """Return the knots at which an error takes part in a direction, as text; empty if all of them do."""
    at = opened.rows_of[name]
    members = [opened.unknowns.names(opened.blocks)[i][1] for i in at]
    size = np.abs(direction[at])
    moving = [member for member, part in zip(members, size, strict=True) if part > _NAMED * size.max()]
    if len(moving) == len(members) or members == [""]:
        return ""
    unit = "deg" if name[-1] in ANGLES else "mm"
    return f" at {', '.join(moving[:4])}{' ...' if len(moving) > 4 else ''} {unit}"


_FLAT = 0.02
"""Places whose spread square to a line or plane is below this share of their largest spread lie in it"""


def line_of(places: Array) -> Array | None:
    """Return the unit vector along the line on which places (n, 3) lie; None if they do not lie on one line."""
    spread, ways = _spread(places)
    if not spread[0] or spread[1] > _FLAT * spread[0]:
        return None
    way = ways[0]
    # a line has no sense: its largest component is made positive
    return np.asarray(way * np.sign(way[np.argmax(np.abs(way))]) + 0.0)


def stations_lie(places: Array) -> str:
    """Return in words how few stations (n, 3) there are, or that they lie on a line or in a plane; else empty."""
    if len(places) < 3:
        return "there is only one station" if len(places) == 1 else "there are only two stations"
    spread, _ = _spread(places)
    if spread[1] <= _FLAT * spread[0]:
        return f"the {len(places)} stations lie on one line"
    return f"the {len(places)} stations lie in one plane" if spread[2] <= _FLAT * spread[0] else ""


def cure_of(stations: Array | None) -> str:
    """Return what to measure where the errors in the volume are not determined; stations are None without lengths."""
    if stations is None:
        return "measure lines in other directions (`metrocli plan` proposes them)"
    lie = stations_lie(stations)
    cure = "add stations that see the tool from other directions (`metrocli plan` proposes them)"
    return f"{lie}: {cure}" if lie else cure


def _spread(places: Array) -> tuple[Array, Array]:
    _, spread, ways = np.linalg.svd(places - places.mean(axis=0))
    return np.concatenate([spread, np.zeros(3 - len(spread))]), ways
