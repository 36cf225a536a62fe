"""Motions of single joints, linear and rotary, with small errors, and how they vary with each parameter.

A motion takes a point from the tool's side of a joint to its workpiece side, `x -> M x + t`. By a parameter it changes
as `d(M x + t) = a x (M x + t) + v`, a turn a and a shift v on the workpiece side. The parameters are nine errors: E
(displacement), theta (angles, `Rz Ry Rx`) and a shift of the joint's line, each along x, y, z; then those of the
location of the line.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.derivatives import through
from metrocli.arrays import Array
from metrocli.frozen import dataclass

_EYE = np.eye(3)


@dataclass(frozen=True)
class JointMotion:
    """A motion of each reading, and its derivatives by the parameters."""

    rotation: Array
    """M, (3, 3, n)"""
    shift: Array
    """t, (3, n)"""
    turns: Array
    """a by each parameter, (3, parameters, n)"""
    shifts: Array
    """v by each parameter, (3, parameters, n)"""

    def of(self, point: Array) -> tuple[Array, Array]:
        """Return points (3, n) on the workpiece side, and their derivatives (3, parameters, n)."""
        moved = times(self.rotation, point) + self.shift
        return moved, crossed(self.turns, moved[:, None]) + self.shifts

    def back(self, point: Array) -> tuple[Array, Array]:
        """Return points (3, n) on the tool's side of points on the workpiece side, and their derivatives."""
        inverse = np.swapaxes(self.rotation, 0, 1)
        changed = crossed(self.turns, point[:, None]) + self.shifts
        return times(inverse, point - self.shift), -through(inverse, changed)


def slide(axis: int, position: Array, errors: Array, squareness: Array) -> JointMotion:
    """Return the motion of a linear joint along x, y or z: `Trans(s u + E) Rot(theta)`.

    u is (1, 0, 0), (-sin C0Y, cos C0Y, 0) or (sin B0Z, -sin A0Z cos B0Z, cos A0Z cos B0Z), with the squareness errors
    (A0Z, B0Z, C0Y) as its location. Its line has no place: a shift of it changes nothing.
    """
    n = len(position)
    (ca, cb, cc), (sa, sb, sc) = np.cos(squareness), np.sin(squareness)
    # x is the reference of squareness: its line defines the axis, y leans by C0Y only
    along = np.array([[1, 0, 0], [-sc, cc, 0], [sb, -sa * cb, ca * cb]])[axis]
    by_squareness = np.zeros((3, 3, 3))
    by_squareness[1, :, 2] = [-cc, -sc, 0]
    by_squareness[2, :, 0], by_squareness[2, :, 1] = [0, -ca * cb, -sa * cb], [cb, sa * sb, -ca * sb]
    rotation, about = turned(errors[3:6])
    shift = along[:, None] * position + errors[:3]
    turns, shifts = np.zeros((3, 12, n)), np.zeros((3, 12, n))
    turns[:, 3:6] = about
    shifts[:, :3] = _EYE[:, :, None]
    # the turn is about the shifted point and not about the origin: `a x (M x + t) + v` with `v = -a x t`
    shifts[:, 3:6] = -crossed(turns[:, 3:6], shift[:, None])
    shifts[:, 9:] = by_squareness[axis][:, :, None] * position
    return JointMotion(np.broadcast_to(rotation, (3, 3, n)), shift, turns, shifts)


def turn(axis: int, angle: Array, errors: Array, location: Array, place: tuple[Array, bool]) -> JointMotion:
    """Return the motion of a rotary joint about x, y or z through a point P, for a table and for a head.

    Table: `Trans(P) L R(u, s + e) D L^-1 Trans(-P)`; head: `Trans(P) L D R(u, s + e) L^-1 Trans(-P)`, with
    `D = Trans(E) Rot(theta)` and `L = Trans(o) Rot(w)`. The location is o and w, each along the two other axes, and e.
    `place` holds P, and whether the joint is a head.
    """
    at, head = place
    n, across = len(angle), [i for i in range(3) if i != axis]
    origin = np.array(at)[:, None] + errors[6:9]
    origin[across] += location[:2, None]
    tilt = np.zeros((3, 1))
    tilt[across] = location[2:4, None]
    frame, tilting = (np.broadcast_to(part, (3, 3, n)) for part in turned(tilt))
    spun, (own, about) = about_axis(axis, angle + location[4]), turned(errors[3:6])
    # errors are in axes that stand with the bed: on the tool's side of a table, on the workpiece's side of a head
    outer, inner = (own, spun) if head else (spun, own)
    around = frame if head else through(frame, spun)
    rotation = through(through(frame, through(outer, inner)), np.swapaxes(frame, 0, 1))
    away = times(around, errors[:3])
    spinning = (through(frame, own) if head else frame)[:, axis : axis + 1]
    turns, shifts, end = np.zeros((3, 14, n)), np.zeros((3, 14, n)), (origin + away)[:, None]
    shifts[:, :3] = around
    turns[:, 3:6] = through(around, np.broadcast_to(about, (3, 3, n)))
    shifts[:, 3:6] = -crossed(turns[:, 3:6], end)
    # a shift of the line moves it there and back: `s - M s`
    shifts[:, 6:9] = _EYE[:, :, None] - rotation
    shifts[:, 9:11] = shifts[:, 6:9][:, across]
    tilts = tilting[:, across]
    carried = through(rotation, tilts)
    turns[:, 11:13] = tilts - carried
    shifts[:, 11:13] = crossed(carried, end) - crossed(tilts, origin[:, None])
    turns[:, 13:] = spinning
    shifts[:, 13:] = -crossed(spinning, end if head else origin[:, None])
    return JointMotion(rotation, origin + away - times(rotation, origin), turns, shifts)


def turned(angles: Array) -> tuple[Array, Array]:
    """Return `Rz(c) Ry(b) Rx(a)` of angles (a, b, c), (3, n) -> (3, 3, n), and the axes of each angle as columns."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    zero, ones = np.zeros_like(ca), np.ones_like(ca)
    rotation = np.array(
        [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
            [-sb, cb * sa, cb * ca],
        ]
    )
    return rotation, np.array([[cc * cb, -sc, zero], [sc * cb, cc, zero], [-sb, zero, ones]])


def about_axis(axis: int, angle: Array) -> Array:
    """Return the rotation about x, y or z by angles (n,), (3, 3, n)."""
    angles = np.zeros((3, len(angle)))
    angles[axis] = angle
    return turned(angles)[0]


def times(matrix: Array, vector: Array) -> Array:
    """Return M v at each reading, (3, 3, n), (3, n) -> (3, n)."""
    return np.stack([row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2] for row in matrix])


def crossed(first: Array, second: Array) -> Array:
    """Return cross products along the first axis, (3, ..., n); `numpy.cross` takes longer to arrange its axes."""
    (a, b, c), (x, y, z) = first, second
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])
