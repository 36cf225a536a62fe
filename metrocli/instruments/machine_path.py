"""A path of straight legs in a machine's volume, divided into cells in which errors are parabolas of the distance."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.machine import Machine

SPEED = "speed_{axis}"
"""Condition of a reading in motion: speed of an axis as commanded [mm/s]"""
SINCE = "since_{axis}"
"""Condition: distance that an axis has travelled since it turned [mm]; infinite where it has not turned yet"""
_ACCELERATION = 1000.0
"""Acceleration of the simulated machine [mm/s^2]"""
_REST = 0.5
"""Rest of the machine at each vertex [s]"""
_OVERSHOT = 0.1
"""Largest share of moves that may contradict their side; with more the order is not that of travel"""
_SAME = 1e-6
"""Vertices closer together than this [mm] are the same"""


@dataclass(frozen=True)
class Path:
    """Legs in order of travel.

    The distance along the path is counted through all legs; moves between a change of the tool are left out.
    """

    start: Array
    """(legs, 3)"""
    end: Array
    tool: Index
    """(legs,)"""
    vertex: Index
    """Number in the list of vertices at which each leg starts"""

    @staticmethod
    def of(vertices: Array, tool: Index) -> Path:
        """Return the legs that join consecutive vertices (n, 3) of one tool (n,)."""
        moved = np.linalg.norm(np.diff(vertices, axis=0), axis=1) > _SAME
        legs = np.flatnonzero(moved & (tool[1:] == tool[:-1]))
        return Path(vertices[legs], vertices[legs + 1], tool[legs], legs)

    @cached_property
    def lengths(self) -> Array:
        """Length of each leg, (legs,)."""
        return np.asarray(np.linalg.norm(self.end - self.start, axis=1))

    @cached_property
    def direction(self) -> Array:
        """Unit vectors along the legs, (legs, 3)."""
        return np.asarray((self.end - self.start) / self.lengths[:, None])

    @cached_property
    def before(self) -> Array:
        """Distance along the path at the start of each leg, (legs,)."""
        return np.asarray(np.cumsum(self.lengths) - self.lengths)

    @property
    def length(self) -> float:
        """Total length of all legs."""
        return float(self.lengths.sum())

    @cached_property
    def across(self) -> Array:
        """Return two unit vectors across each leg, (legs, 2, 3)."""
        # the axis that the leg has least of, so that the cross product is long
        least = np.eye(3)[np.argmin(np.abs(self.direction), axis=1)]
        first = np.cross(self.direction, least)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return np.stack([first, np.cross(self.direction, first)], axis=1)

    def at(self, leg: Index, along: Array) -> Array:
        """Return the points at distances along their legs, (3, n)."""
        return np.asarray(self.start[leg].T + self.direction[leg].T * along)

    def leg_of(self, way: Array) -> Index:
        """Return the leg at each distance along the path."""
        return np.clip(np.searchsorted(self.before, way, side="right") - 1, 0, len(self.lengths) - 1)

    def sampled(self, count: int) -> tuple[Array, Index, Array]:
        """Return about `count` equally spaced points: distance along the path, leg, and place (3, n)."""
        each = np.maximum(np.round(count * self.lengths / self.length).astype(int), 2)
        leg = np.repeat(np.arange(len(each)), each)
        number = np.arange(len(leg)) - np.repeat(np.cumsum(each) - each, each)
        along = (number + 0.5) / each[leg] * self.lengths[leg]
        return self.before[leg] + along, leg, self.at(leg, along)

    def cells(self, machine: Machine, longest: float = np.inf) -> Array:
        """Return the ascending boundaries of cells: where a leg begins, an axis passes a knot, or the path ends.

        They are distances along the path. Further boundaries between them keep every cell shorter than `longest`.
        """
        marks = [self.before]
        if np.isfinite(longest):
            marks.append(np.linspace(0.0, self.length, int(np.ceil(self.length / longest)) + 1))
        for axis in machine.axes:
            speed, start = self.direction[:, axis.number, None], self.start[:, axis.number, None]
            with np.errstate(divide="ignore", invalid="ignore"):
                along = (axis.knots - start) / speed
            inside = (along > _SAME) & (along < self.lengths[:, None] - _SAME)
            marks.append((along + self.before[:, None])[inside])
        return np.unique(np.concatenate([*marks, [self.length]]))

    def speeds(self, leg: Index, along: Array, time: Array) -> Array:
        """Return the speed of points along their legs, (n,), in order of time: differences of their neighbours."""
        near = np.arange(len(leg))
        stays = np.diff(leg) == 0
        before, after = near.copy(), near.copy()
        # only neighbours on the same leg: across a vertex the distance along it begins anew
        before[1:] -= stays
        after[:-1] += stays
        passed = time[after] - time[before]
        return np.asarray(np.divide(along[after] - along[before], passed, out=np.zeros(len(leg)), where=passed > 0))

    def axis_speeds(self, leg: Index, speed: Array) -> dict[str, Array]:
        """Return the speeds of the axes, (n,) each, as conditions of readings with a speed along their legs."""
        return {SPEED.format(axis=axis): speed * part for axis, part in zip("xyz", self.direction[leg].T, strict=True)}

    def since_turns(self, leg: Index, along: Array) -> dict[str, Array]:
        """Return the distance of each axis since it turned at distances along legs, (n,) each, as conditions."""
        ways = {}
        for axis, side, part in zip("xyz", self.last_moves(), self.direction.T, strict=True):
            after = since_turn(part * self.lengths, side)
            if after is not None:
                ways[SINCE.format(axis=axis)] = after[leg] - np.abs(part[leg]) * (self.lengths[leg] - along)
        return ways

    def last_moves(self) -> Array:
        """Return the sign of the last movement of each axis on each leg, (3, legs); 0 where it has not moved yet."""
        return np.stack([last_sides(np.where(np.abs(part) > _SAME, part, 0.0)) for part in self.direction.T])


def since_turn(moves: Array, side: Array) -> Array | None:
    """Return how far an axis has travelled since it turned, after each of its moves (n,), with their sides (n,).

    It turns where the side changes, and is infinite before; an axis of side 0 stands still, or has not moved yet. After
    a move that contradicts its side the axis went farther and came back, nobody knows how far: the distance is infinite
    up to the next change of side. None if more than a tenth of the moves do so.
    """
    held, numbers = last_sides(side), np.arange(len(moves))
    against = moves * held < 0
    if against.sum() > _OVERSHOT * np.count_nonzero(moves):
        return None
    starts = np.flatnonzero((held[:-1] != 0) & (np.diff(held) != 0)) + 1
    way, turn = np.concatenate([[0.0], np.cumsum(np.abs(moves))]), np.searchsorted(starts, numbers, side="right")
    since = way[1:] - np.concatenate([[-np.inf], way[starts]])[turn]
    lost = np.maximum.accumulate(np.where(against, numbers, -1))
    return np.where(lost >= np.concatenate([[0], starts])[turn], np.inf, since)


def last_sides(moves: Array) -> Array:
    """Return the sign of the last of the moves of an axis that is not 0, after each of them (n,); 0 before it moves."""
    last = np.maximum.accumulate(np.where(moves != 0, np.arange(len(moves)), 0))
    return np.asarray(np.sign(moves)[last])


def travelled(path: Path, feeds: Array, sampling: float) -> tuple[Index, Array, Array]:
    """Return leg, distance along it and time at equal time steps, each (n,).

    The machine accelerates to the feed and brakes on each leg, and rests at each vertex.
    """
    # a leg too short for the feed: it accelerates over its first half and brakes over the second
    ramp = np.minimum(feeds / _ACCELERATION, np.sqrt(path.lengths / _ACCELERATION))
    top = ramp * _ACCELERATION
    moving = path.lengths / top + ramp
    begins = np.cumsum(moving + _REST) - moving
    time = np.arange(0.0, begins[-1] + moving[-1] + _REST, sampling)
    leg = np.clip(np.searchsorted(begins, time, side="right") - 1, 0, len(begins) - 1)
    since = np.clip(time - begins[leg], 0.0, moving[leg])
    left = np.minimum(since, moving[leg] - since)
    ramped = np.minimum(left, ramp[leg])
    early = ramped**2 * _ACCELERATION / 2 + np.maximum(left - ramp[leg], 0.0) * top[leg]
    # the second half is the mirror of the first
    along = np.where(since <= moving[leg] / 2, early, path.lengths[leg] - early)
    return leg, along, time
