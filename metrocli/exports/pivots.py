"""Where the rotary axes of a machine lie, as controls take it, with a test move that shows each sign.

An axis passes through P + o in the direction (1 + w x) u, in machine coordinates with all axes at 0. P and u are
nominal, o and w are location errors, u the turn of the tool against the workpiece (ISO 841): a table itself turns
against it. Nothing is written of what the readings do not determine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import euler_from_rotation, rotation_from_euler
from metrocli.instruments.axes.joints import turn
from metrocli.instruments.axes.rotary import location_names
from metrocli.instruments.machine import ANGLES, ROWS
from metrocli.result import Result

Texts = dict[str, str]
_CONVENTION = "positions are of the tool against the workpiece (ISO 841): a table itself turns by minus its position"


@dataclass(frozen=True)
class Pivot:
    """A rotary axis as found."""

    letter: str
    place: Array
    """(3,) mm, machine coordinates with all axes at 0"""
    std: Array
    """(3,); 0 along the axis, where its place has no meaning"""
    direction: Array
    """(3,)"""
    direction_std: Array
    head: bool
    sense: int
    nominal: Array
    location: Array
    """Location errors and zero position, (5,)"""
    tilt: Array
    """Turn of its direction against the nominal one, about x, y and z, (3,) rad"""
    order: int
    """Its place in the chain, from the workpiece on"""

    def moved(self, ball: Array, angle: float, known: Array) -> Array:
        """Return by how much a ball at a place misses the tip after a turn under tip control, in the bed's axes, (3,).

        The tip is at the ball at 0. The control turns its target about the axis with the location (5,) that it knows,
        the machine turns the ball, or the tip, about the true one.
        """
        axis, point, none = ANGLES.index(self.letter), ball[:, None], np.zeros((ROWS, 1))
        commanded = np.array([self.sense * angle])
        true, start, listed = (
            turn(axis, at, none, location, (self.nominal, self.head))
            for at, location in ((commanded, self.location), (0 * commanded, self.location), (commanded, known))
        )
        ends = [motion.of(point)[0] if self.head else motion.back(point)[0] for motion in (true, start, listed)]
        miss = ends[0] - ends[2] - (ends[1] - point)
        return np.asarray((-miss if self.head else miss)[:, 0])

    def known(self, directions: bool) -> Array:
        """Return the location that a control knows after the compensation, with the directions of axes or without."""
        return np.where([True, True, directions, directions, True], self.location, 0.0)


def wanted(result: Result) -> bool:
    """Return whether the job estimates where the rotary axes lie."""
    named = {estimate.name for estimate in result.estimates}
    for key in ("undetermined", "together"):
        named |= set(str(result.statistics.get(key, "")).split())
    return any(name in named for letter in ANGLES for name in location_names(letter)[:4])


def pivots(result: Result) -> list[Pivot]:
    """Return the rotary axes in their order from workpiece to tool.

    Raises InputError if the result has none, or does not determine where they lie.
    """
    if "rotary_axes" not in result.tables:
        raise InputError("the result has no rotary axes: this format needs a result of calibrate-machine with some")
    known = {estimate.name: estimate for estimate in result.estimates}
    open_ones = set(f"{result.statistics.get('undetermined', '')} {result.statistics.get('together', '')}".split())
    table, axes = result.tables["rotary_axes"], []
    lacking: list[str] = []
    for row, letter in enumerate(table.texts("axis")):
        names = location_names(letter)
        lacking += [name for name in names[:4] if name in open_ones or name not in known]
        across = [i for i in range(3) if ANGLES[i] != letter]
        value = np.array([known[name].value if name in known else 0.0 for name in names])
        spread = np.array([known[name].std if name in known else 0.0 for name in names])
        nominal = np.array([table.numbers(axis)[row] for axis in "xyz"])
        off, std, tilt, tilt_std = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        off[across], std[across], tilt[across], tilt_std[across] = value[:2], spread[:2], value[2:4], spread[2:4]
        along = np.eye(3)[ANGLES.index(letter)]
        axes.append(
            Pivot(
                letter,
                nominal + off,
                std,
                along + np.cross(tilt, along),
                np.abs(np.cross(tilt_std, along)),
                bool(table.columns["head"][row]),
                int(table.numbers("sense")[row]),
                nominal,
                value,
                tilt,
                int(table.numbers("place")[row]),
            )
        )
    if lacking:
        raise InputError(
            f"the readings do not determine {' '.join(lacking)}: nothing is written of where the axes lie; "
            "see /errors of the result for what is known only together"
        )
    return sorted(axes, key=lambda pivot: pivot.order)


def _test_moves(result: Result, axes: Sequence[Pivot], directions: bool) -> list[str]:
    """Return for each axis what a ball shows before and after the compensation."""
    ball = _ball(result)
    control = "tip control (TCPM, TRAORI, G43.4) on"
    lines = [f"test move: the tip on a ball at {_vector(ball)} mm, {control}, one axis from 0 to 90 deg;"]
    lines.append("  the ball minus the tip, in the axes of the bed:")
    for pivot in axes:
        before, after = (pivot.moved(ball, np.pi / 2, known) for known in (np.zeros(5), pivot.known(directions)))
        lines.append(f"  {pivot.letter}: {_vector(1e3 * before, 1)} um before, {_vector(1e3 * after, 1)} um after")
    return lines


def _ball(result: Result) -> Array:
    """Return the first ball or reflector on the workpiece, else a point 100 mm beside the axes."""
    for name in ("balls", "reflectors"):
        if name in result.tables:
            return np.array([result.tables[name].numbers(axis)[0] for axis in "xyz"])
    table = result.tables["rotary_axes"]
    return np.array([table.numbers(axis)[0] for axis in "xyz"]) + 100.0


def _vector(values: Array, digits: int = 4) -> str:
    return "(" + ", ".join(f"{x:.{digits}f}" for x in values.tolist()) + ")"


def _head(result: Result, axes: Sequence[Pivot], comment: str, directions: bool = True) -> list[str]:
    lines = [
        f"rotary axes of the chain {result.statistics.get('chain', '')}",
        "place and direction: actual, machine coordinates in mm with all axes at 0",
        _CONVENTION,
        *(
            f"{pivot.letter} counts the other way, as its `sense: -1` in the job states"
            for pivot in axes
            if pivot.sense < 0
        ),
        *_test_moves(result, axes, directions),
    ]
    return [f"{comment} {line}" for line in lines]


def kinematics(result: Result) -> Texts:
    """Return the lines of the axes as a table, and as a text with the test move."""
    axes = pivots(result)
    heading = "axis,side,sense,x_mm,y_mm,z_mm,sx_mm,sy_mm,sz_mm,ux,uy,uz,s_ux,s_uy,s_uz"
    rows = [
        ",".join(
            [
                pivot.letter,
                "head" if pivot.head else "table",
                str(pivot.sense),
                *(f"{x:.6f}" for x in (*pivot.place, *pivot.std)),
                *(f"{x:.9f}" for x in (*pivot.direction, *pivot.direction_std)),
            ]
        )
        for pivot in axes
    ]
    return {"kinematics.csv": "\n".join([*_head(result, axes, "#"), heading, *rows, ""])}


def siemens_trafo5(result: Result) -> Texts:
    """Return machine data of the 5-axis transformation (types 24, 40, 56; commissioning manual 6FC5397-1DP40, 21.7).

    V1 is the axis next to the bed, of a head and a table the head. The chains of vectors are closed. A table is
    entered with its direction reversed.
    """
    axes = pivots(result)
    if len(axes) != 2:
        raise InputError("the 5-axis transformation needs two rotary axes")
    tables, heads = [pivot for pivot in axes if not pivot.head], [pivot for pivot in axes if pivot.head]
    zero = np.zeros(3)
    if len(heads) == 2:
        (first, second), number = heads, 24
        joint, tool = second.place - first.place, zero - second.place
        offsets = {"PART_OFFSET": -(joint + tool), "JOINT_OFFSET": joint, "BASE_TOOL": tool}
    elif len(tables) == 2:
        (second, first), number = tables, 40
        base, joint = first.place - zero, second.place - first.place
        offsets = {"BASE_TOOL": base, "JOINT_OFFSET_PART": joint, "PART_OFFSET": -(base + joint)}
    else:
        (first,), (second,), number = heads, tables, 56
        offsets = {
            "JOINT_OFFSET": first.place,
            "BASE_TOOL": -first.place,
            "JOINT_OFFSET_PART": second.place,
            "PART_OFFSET": -second.place,
        }
    lines = _head(result, axes, ";")
    lines.append(f"$MC_TRAFO_TYPE_1={number}")
    for name, vector in offsets.items():
        lines += [f"$MC_TRAFO5_{name}_1[{k}]={value:.5f}" for k, value in enumerate(vector.tolist())]
    for name, axis in (("AXIS1", first), ("AXIS2", second)):
        turned = axis.direction * (1 if axis.head else -1) * axis.sense
        lines += [f"$MC_TRAFO5_{name}_1[{k}]={value:.9f}" for k, value in enumerate(turned.tolist())]
    return {"trafo5.ini": "\n".join([*lines, ""])}


def linuxcnc(result: Result) -> Texts:
    """Return the HAL lines of xyzac-trt-kins or xyzbc-trt-kins (LinuxCNC, src/emc/kinematics/trtfuncs.c).

    These modules know a table C on a tilting table A or B, and no directions. Without conventional directions both
    axes count against ISO 841.
    """
    axes = pivots(result)
    letters = "".join(pivot.letter for pivot in axes)
    if letters not in ("CA", "CB") or any(pivot.head for pivot in axes):
        raise InputError("LinuxCNC's trt kinematics are for a table C on a tilting table A or B")
    carried, tilting = axes
    if carried.sense != tilting.sense:
        raise InputError("LinuxCNC's trt kinematics count both axes as ISO 841, or both the other way")
    module = f"xyz{tilting.letter.lower()}c-trt-kins"
    across = 1 if tilting.letter == "A" else 0
    pins = {f"{axis}-rot-point": value for axis, value in zip("xyz", carried.place.tolist(), strict=True)}
    pins[f"{'xyz'[across]}-offset"] = float(tilting.place[across] - carried.place[across])
    pins["z-offset"] = float(tilting.place[2] - carried.place[2])
    lines = [
        *_head(result, axes, "#", directions=False),
        "# the control counts as ISO 841 with the pin conventional-directions at 1 (pull request 3482)",
        "# tool-offset is the length of the tool; directions of the axes (EA0C, EB0C ...) have no pins",
        f"setp {module}.conventional-directions {int(carried.sense > 0)}",
        *(f"setp {module}.{name} {value:.5f}" for name, value in pins.items()),
    ]
    return {"kinematics.hal": "\n".join([*lines, ""])}


def fanuc(result: Result) -> Texts:
    """Return parameters 19680 ff. of a Fanuc control: type, points and vectors of the axes, senses (cncmanuals 609)."""
    axes = pivots(result)
    tables, heads = [pivot for pivot in axes if not pivot.head], [pivot for pivot in axes if pivot.head]
    kind = 12 if not heads else 2 if not tables else 21
    lines = [*_head(result, axes, ";", directions=False), f"N19680 P{kind}"]
    # 0: the part that moves turns right-handed as the axis counts up, as a head does; a table does not
    lines += [
        f"N{number} P{int(pivot.head != (pivot.sense > 0))}"
        for number, pivot in zip((19684, 19689), _by_master(axes), strict=False)
    ]
    if tables:
        first = tables[-1]
        lines += _numbered(19700, first.place)
        lines += _numbered(19703, tables[0].place - first.place) if len(tables) == 2 else []
    if heads:
        last = heads[-1]
        lines += _numbered(19709, last.place)
        lines += _numbered(19712, heads[0].place - last.place) if len(heads) == 2 else []
    return {"fanuc-kinematics.txt": "\n".join([*lines, ""])}


def _by_master(axes: Sequence[Pivot]) -> list[Pivot]:
    """Return the axes, the one next to the bed first."""
    return [*(pivot for pivot in axes if pivot.head), *(pivot for pivot in reversed(axes) if not pivot.head)]


def _numbered(first: int, vector: Array) -> list[str]:
    return [f"N{first + k} P{value:.5f}" for k, value in enumerate(vector.tolist())]


def heidenhain(result: Result) -> Texts:
    """Return the transformations before each rotary axis, from the bed on, each in the coordinates of the one before.

    A location is a turn in the axes of the machine: the turn of the axis before is taken out of it and of the shift.
    """
    axes = pivots(result)
    lines = [*_head(result, axes, ";"), "; side;axis;dX;dY;dZ;turn A;turn B;turn C [deg]"]
    for side in ("table", "head"):
        place, turned = np.zeros(3), np.eye(3)
        for axis in (pivot for pivot in _by_master(axes) if pivot.head == (side == "head")):
            own = rotation_from_euler(*axis.tilt)
            shift = ";".join(f"{x:.5f}" for x in (turned.T @ (axis.place - place)).tolist())
            turns = np.degrees(euler_from_rotation(turned.T @ own))
            lines.append(f"{side};{axis.letter};{shift};" + ";".join(f"{x:.6f}" for x in turns.tolist()))
            place, turned = axis.place, own
    return {"heidenhain-kinematics.txt": "\n".join([*lines, ""])}


OF_CONTROLS = {"fanuc": fanuc, "heidenhain": heidenhain, "linuxcnc": linuxcnc}
"""Formats of compensation tables that hold the lines of rotary axes too"""
