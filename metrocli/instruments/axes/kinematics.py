"""The exact motion of a machine with rotary axes: a product of joints, with derivatives by every one of their errors.

A point is carried through the joints from its own body to that of the instrument, and the change at each joint through
the rotations of those that follow. So a chain of k joints costs k products, and all its derivatives k more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.chain import Chain, Link, LinkContext, Step
from metrocli.adjust.model.derivatives import through
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import vector_from_rotation
from metrocli.instruments.axes.error_motion import ErrorMotion, EstimatedPositions, ReachedPoint, Undisturbed
from metrocli.instruments.axes.joints import JointMotion, crossed, times, turned
from metrocli.instruments.axes.rotary import SPINDLE
from metrocli.instruments.machine import ROWS, SQUARENESS, TOOL, Machine

ON_WORKPIECE = "on workpiece"
"""Block of points fixed to the workpiece: balls that are probed, reflectors on a table"""
OF_WORKPIECE, OF_TOOL = "of workpiece", "of tool"
"""Conditions: the shares of a point on the workpiece and of one at the tool in a reading from the bed. They are 0 and
1, 1 and 0, or 1 and -1 for a ball against a probe."""
_Path = Sequence[tuple[int, bool]]
"""Numbers of axes from the instrument to a point, and whether each is passed from its workpiece side to its tool's"""


@dataclass(frozen=True)
class _Carried:
    """Points carried along a path of joints."""

    point: Array
    """(3, n)"""
    changes: Mapping[int, Array]
    """By number of an axis: derivatives by its nine errors and its location, (3, parameters, n)"""
    rotation: Array
    """Derivative by the point at the start, (3, 3, n)"""
    turns: Mapping[int, Array]
    """As `changes`, of the rotation: a small turn from the left"""

    def times(self, factor: Array) -> _Carried:
        """Return the points and their derivatives times factors (n,)."""
        changes = {axis: factor * change for axis, change in self.changes.items()}
        return _Carried(factor * self.point, changes, factor * self.rotation, self.turns)


def _carried(motions: Sequence[JointMotion], path: _Path, point: Array) -> _Carried:
    """Return a point (3, n) at the end of a path carried to its beginning."""
    passed = []
    for axis, back in reversed(path):
        motion = motions[axis]
        point, change = motion.back(point) if back else motion.of(point)
        own = np.swapaxes(motion.rotation, 0, 1) if back else motion.rotation
        # the inverse of a motion turns by `-M' a`
        passed.append((axis, change, own, -through(own, motion.turns) if back else motion.turns))
    rotation = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, point.shape[1]))
    changes, turns = {}, {}
    # backwards: what a joint changes is carried by the joints that follow it towards the beginning
    for axis, change, own, turning in reversed(passed):
        changes[axis], turns[axis] = through(rotation, change), through(rotation, turning)
        rotation = through(rotation, own)
    return _Carried(point, changes, rotation, turns)


def _left(machine: Machine) -> tuple[int, ...]:
    return machine.order[: machine.bed]


def _right(machine: Machine) -> tuple[int, ...]:
    return machine.order[machine.bed :]


@dataclass(frozen=True)
class _OfMachine:
    """What the links through the joints of a machine share."""

    machine: Machine
    takes = Quantity.AXIS_ERRORS

    @property
    def blocks(self) -> tuple[str, ...]:
        """Blocks of the tables and locations of all axes, of the spindle, and of the tools."""
        axes = self.machine.axes
        places = dict.fromkeys(axis.location for axis in axes)
        return (*(axis.block for axis in axes), *places, SPINDLE, TOOL)

    def motions(self, value: Array, local: LinkContext) -> list[JointMotion]:
        """Return the motion of each axis at its errors and its location."""
        carried = []
        for number, axis in enumerate(self.machine.axes):
            position = local.observations.conditions[axis.coordinate]
            errors = np.array(np.broadcast_to(value[ROWS * number : ROWS * (number + 1)], (ROWS, len(position))))
            values = local.members(axis.block)
            for index, weight in zip(*axis.places(position), strict=True):
                errors[:6] += weight * values[index].T
            carried.append(axis.motion(position, errors, local.members(axis.location)[0]))
        return carried

    def tip(self, local: LinkContext) -> tuple[Array, Array, Array]:
        """Return the tip at the spindle (3, n), and its derivatives by the tool and by the spindle, (3, 3, n)."""
        n = local.observations.count
        turn, about = (np.broadcast_to(part, (3, 3, n)) for part in turned(local.members(SPINDLE)[0][:, None]))
        tip = times(turn, local.rows(TOOL))
        return tip, turn, crossed(about, tip[:, None])

    def derivatives(self, value: Array, local: LinkContext, changes: Mapping[int, Array]) -> Step:
        """Return the derivatives of a point by what disturbs the axes, by their tables and by their locations."""
        n, size = local.observations.count, len(next(iter(changes.values())))
        disturbed = np.zeros((size, len(value), n)) if self.machine.is_disturbed(value, local) else None
        by_block: dict[str, Array] = {}
        for number, change in changes.items():
            axis = self.machine.axes[number]
            if disturbed is not None:
                disturbed[:, ROWS * number : ROWS * (number + 1)] = change[:, :ROWS]
            if axis.block in local.wanted:
                weight = axis.places(local.observations.conditions[axis.coordinate])[1]
                by_block[axis.block] = weight[:, None] * change[:, :6]
            place = change[:, ROWS:]
            by_block[axis.location] = by_block[axis.location] + place if axis.location in by_block else place
        return Step(np.zeros(0), disturbed, by_block)


@dataclass(frozen=True)
class FromBed(_OfMachine):
    """Link to a point as seen from the bed: of the workpiece, of the tool, or a ball against a probe.

    `c_w B_w b + c_t B_t T`, B_t the product of the joints right of the bed with the turn of the spindle, B_w the
    inverse of that left of it; c_w and c_t are the conditions OF_WORKPIECE and OF_TOOL.
    """

    workpiece: bool = False
    """Whether some readings see a point on the workpiece"""
    gives = Quantity.POINT_IN_MACHINE

    @property
    def blocks(self) -> tuple[str, ...]:
        """Those of the machine, and of the points on the workpiece."""
        return (*super().blocks, *([ON_WORKPIECE] if self.workpiece else []))

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) with its derivatives."""
        given, motions = local.observations.conditions, self.motions(value, local)
        tip, by_tool, by_spindle = self.tip(local)
        of_tool = _carried(motions, [(axis, False) for axis in _right(self.machine)], tip).times(given[OF_TOOL])
        point, changes = of_tool.point, dict(of_tool.changes)
        by_block = {TOOL: through(of_tool.rotation, by_tool), SPINDLE: through(of_tool.rotation, by_spindle)}
        if self.workpiece:
            target = np.broadcast_to(local.rows(ON_WORKPIECE), tip.shape)
            path = [(axis, True) for axis in reversed(_left(self.machine))]
            of_workpiece = _carried(motions, path, target).times(given[OF_WORKPIECE])
            point = point + of_workpiece.point
            # axes are either left or right of the bed, so that no change of the tool is overwritten
            changes |= of_workpiece.changes
            by_block[ON_WORKPIECE] = of_workpiece.rotation
        if not changes:
            return Step(point, by_block=by_block)
        derivatives = self.derivatives(value, local, changes)
        return Step(point, derivatives.by_input, {**by_block, **derivatives.by_block})


@dataclass(frozen=True)
class OnWorkpiece(_OfMachine):
    """Link to the tip as seen from the workpiece: the product of all joints, with the turn of the spindle."""

    gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n) with its derivatives."""
        tip, by_tool, by_spindle = self.tip(local)
        carried = _carried(self.motions(value, local), [(axis, False) for axis in self.machine.order], tip)
        derivatives = self.derivatives(value, local, carried.changes)
        by_block = {TOOL: through(carried.rotation, by_tool), SPINDLE: through(carried.rotation, by_spindle)}
        return Step(carried.point, derivatives.by_input, {**by_block, **derivatives.by_block})


@dataclass(frozen=True)
class TipMotion(_OfMachine):
    """Link to the error (6, n) of the tip against the workpiece: displacement, and rotation, in the workpiece's axes.

    The displacement is against the tip of the machine without errors and with the listed tool vectors.
    """

    gives = Quantity.ERROR_MOTION

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the motion with its derivatives."""
        tip, by_tool, by_spindle = self.tip(local)
        carried = _carried(self.motions(value, local), [(axis, False) for axis in self.machine.order], tip)
        position = np.stack([local.observations.conditions[axis.coordinate] for axis in self.machine.axes])
        nominal, axes = nominal_tip(self.machine, position, self.machine.tools[local.index(TOOL)].T)
        # the actual axes of the tool against the nominal ones, so that errors alone are left
        turn = through(through(carried.rotation, by_tool), np.swapaxes(axes, 0, 1))
        angles = vector_from_rotation(np.moveaxis(turn, -1, 0)).T
        changes = {axis: np.concatenate([change, carried.turns[axis]]) for axis, change in carried.changes.items()}
        derivatives = self.derivatives(value, local, changes)
        n, about = tip.shape[1], turned(local.members(SPINDLE)[0][:, None])[1]
        by_block = {
            TOOL: np.concatenate([through(carried.rotation, by_tool), np.zeros((3, 3, n))]),
            SPINDLE: np.concatenate(
                [through(carried.rotation, part) for part in (by_spindle, np.broadcast_to(about, (3, 3, n)))]
            ),
        }
        return Step(
            np.concatenate([carried.point - nominal, angles]),
            derivatives.by_input,
            {**by_block, **derivatives.by_block},
        )


def nominal_tip(machine: Machine, position: Array, vector: Array) -> tuple[Array, Array]:
    """Return tips on the workpiece (3, n) at commanded positions (axes, n) without errors, and the axes of the tool.

    The axes are the columns of (3, 3, n). `vector` are the tool vectors, (3, n) or (3, 1).
    """
    path, tip = [(axis, False) for axis in machine.order], np.broadcast_to(vector, (3, position.shape[1]))
    carried = _carried(_without_errors(machine, position), path, tip)
    return carried.point, carried.rotation


def seen_from_bed(machine: Machine, position: Array, place: Array, tool: bool) -> Array:
    """Return points (3, n) of the tool, or of the workpiece, as a machine without errors shows them to the bed."""
    path = [(i, False) for i in _right(machine)] if tool else [(i, True) for i in reversed(_left(machine))]
    return _carried(_without_errors(machine, position), path, place).point


def _without_errors(machine: Machine, position: Array) -> list[JointMotion]:
    """Return the motion of each axis at commanded positions (axes, n) without errors."""
    none = np.zeros((ROWS, position.shape[1]))
    places = {axis.location: np.zeros(3 if axis.location == SQUARENESS else 5) for axis in machine.axes}
    return [axis.motion(at, none, places[axis.location]) for axis, at in zip(machine.axes, position, strict=True)]


def motion(machine: Machine) -> tuple[Link, ...]:
    """Return the links to the error of the tip against the workpiece."""
    return (Undisturbed(machine), TipMotion(machine) if machine.turns else ErrorMotion(machine))


def reach(
    machine: Machine, seen_from: str = "workpiece", workpiece: bool = False, estimated: Sequence[str] = ()
) -> Chain:
    """Return the chain to a reflector at the tool of a machine, or with `workpiece` to some on the workpiece too.

    Where axes turn it decides what the instrument stands on, the bed or the workpiece; `estimated` are the letters of
    axes whose positions are unknowns.
    """
    if not machine.turns:
        return Chain((Undisturbed(machine), ErrorMotion(machine), ReachedPoint()))
    to = FromBed(machine, workpiece) if seen_from == "bed" else OnWorkpiece(machine)
    given = [EstimatedPositions(machine, tuple(estimated))] if estimated else []
    return Chain((Undisturbed(machine), *given, to))


LINKS = (Undisturbed, EstimatedPositions, ErrorMotion, ReachedPoint, FromBed, OnWorkpiece)
"""The links of a machine on the way to a point"""


def axes_of(machine: Machine, position: Array, body: str) -> Array:
    """Return the axes of the bed, the tool or the workpiece in those of the bed, (3, 3, n), without errors."""
    n = position.shape[1]
    if body == "bed":
        return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n))
    directions = [np.repeat(np.eye(3)[:, k : k + 1], n, axis=1) for k in range(3)]
    # points minus the origin are directions: shifts of the joints fall out
    origin = seen_from_bed(machine, position, np.zeros((3, n)), body == "tool")
    return np.stack(
        [seen_from_bed(machine, position, direction, body == "tool") - origin for direction in directions], axis=1
    )
