"""The machine that a job describes, with its unknowns, and the commanded positions of its readings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.arrays import Array, Mask
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.instruments.axes.chain import axis_order
from metrocli.instruments.axes.rotary import SPINDLE_NAMES, RotaryAxis, location_names, spindle_block, turning_axes
from metrocli.instruments.machine import (
    ANGLES,
    AXES,
    SQUARENESS_NAMES,
    TOOL,
    Axis,
    Machine,
    errors_of,
    squareness_block,
    tool_block,
)
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.machine_settings import AxisSettings, RotarySettings
from metrocli.tasks.calibrate_machine.settings import TURNING, Settings

_OUTSIDE = 1e-3
"""Positions may be outside the range by this [mm, deg]: rounding of the control"""
_GON = 0.9
"""A gon in degrees"""
_SUPPORT = 0.02
"""A knot is supported if some reading gives it at least this interpolation weight"""


def machine_of(settings: Settings) -> Machine:
    """Return the machine with equally spaced knots that the settings describe.

    Methods that read linear axes alone have it without its rotary axes, which are at rest; lines along rotary axes have
    it without the others.
    """
    machine, tools = settings.machine, np.array(list(settings.tools.values()))
    if settings.angular:
        named = machine.axes.turning.items()
        alone = tuple(_turning(name, axis, False) for name, axis in named if f"E{name}{name}" in settings.estimated)
        return Machine(tuple(range(len(alone))), alone, tools=tools)
    if not machine.turns or settings.method not in TURNING:
        given, rest = machine.axes.given, AxisSettings((0.0, 100.0), 2)  # an axis not given stands still
        axes = tuple(_linear(letter, given.get(letter, rest)) for letter in AXES)
        return Machine(axis_order(machine.chain), axes, tools=tools)
    letters = machine.letters
    bed = letters.index("b")
    linear = [_linear(letter, machine.axes.given[letter]) for letter in AXES if letter in letters]
    turning = [
        _turning(letter, machine.axes.turning[letter], letter in letters[bed:])
        for letter in ANGLES
        if letter in letters
    ]
    axes = (*linear, *turning)
    order = tuple([axis.letter for axis in axes].index(letter) for letter in letters if letter != "b")
    return Machine(order, axes, bed, tools)


def _linear(letter: str, axis: AxisSettings) -> Axis:
    return Axis(letter, np.linspace(*axis.range, axis.knots))


def _turning(letter: str, axis: RotarySettings, head: bool) -> RotaryAxis:
    knots = np.linspace(*axis.range, axis.knots)
    return RotaryAxis(letter, knots, axis.at or (0.0, 0.0, 0.0), axis.sense, axis.any_turn, head)


def error_names(machine: Machine) -> tuple[str, ...]:
    """Return the names of all errors of a machine: tables, squareness, locations with zero positions, spindle."""
    turning = [axis.letter for axis in turning_axes(machine)]
    tables = (name for axis in machine.axes for name in errors_of(axis.letter))
    places = (name for letter in turning for name in location_names(letter))
    return (*tables, *SQUARENESS_NAMES, *places, *(SPINDLE_NAMES if turning else ()))


def error_blocks(machine: Machine, settings: Settings) -> dict[str, Block]:
    """Return the blocks of error tables, squareness and locations, all zero, and of the tool vectors.

    Raises InputError if no error is free: a straightness table of two knots is zero at both ends by definition.
    """
    estimated = settings.estimated
    blocks = [axis.block_of({}, estimated) for axis in machine.axes]
    blocks.append(squareness_block({}, estimated))
    turning = turning_axes(machine)
    blocks += [axis.location_block({}, estimated) for axis in turning]
    if turning:
        blocks.append(spindle_block({}, estimated))
    if not any(block.free.any() for block in blocks):
        names = " ".join(estimated)
        raise InputError(
            f"there is nothing to estimate: {names} with two knots is zero by definition; give the axis more knots"
        )
    tools = settings.tools
    blocks.append(tool_block(np.array(list(tools.values())), list(tools), settings.machine.tool_std))
    return {block.name: block for block in blocks}


def commanded(machine: Machine, table: Table) -> Array:
    """Return commanded positions (axes, n), those of periodic axes within their range.

    Raises InputError if an axis has no column, a column no axis, or if a position is outside the range of its axis.
    """
    raise_if(_columns(machine, table))
    position = table.stacked([axis.key for axis in machine.axes]).T
    position = np.array([axis.wrapped(own) for axis, own in zip(machine.axes, position, strict=True)])
    margin = np.array([np.radians(_OUTSIDE) if axis.turns else _OUTSIDE for axis in machine.axes])
    low, high = (machine.low - margin)[:, None], (machine.high + margin)[:, None]
    outside = (position < low) | (position > high)
    each = zip(machine.axes, position, outside, strict=True)
    faults = [fault for axis, own, rows in each for fault in _faults_outside(axis, own, rows, table)]
    if faults and machine.turns and _fits_otherwise(machine, table):
        # a fault without row and hint: a task then tries what may be wrong in the file
        raise InputError([table.fault(f"{outside.sum()} positions are outside the ranges; first: {faults[0].message}")])
    raise_if(faults)
    return position


def _faults_outside(axis: Axis, position: Array, rows: Mask, table: Table) -> list[Fault]:
    """Return faults of the rows in which an axis stands outside its range."""
    span = f"{placed(axis, axis.knots[0], '')} to {placed(axis, axis.knots[-1])}"
    return table.faults_at(
        np.flatnonzero(rows),
        lambda row: f"{axis.key} = {placed(axis, position[row])} is outside the range of the axis, {span}",
        lambda row: _outside(axis, float(position[row]), table),
    )


def _fits_otherwise(machine: Machine, table: Table) -> bool:
    """Return whether all angles lie in the ranges of the axes if two are exchanged, in gon, or of the other sign."""
    turning = turning_axes(machine)
    read = [table.numbers(axis.key) for axis in turning]
    others = [read[::-1], [_GON * own for own in read]]
    others += [[-own if k == at else own for k, own in enumerate(read)] for at in range(len(read))]
    return any(all(map(_inside, turning, angles)) for angles in others)


def _inside(axis: RotaryAxis, angle: Array) -> bool:
    margin, own = np.radians(_OUTSIDE), axis.wrapped(angle)
    return bool(own.min() >= axis.knots[0] - margin and own.max() <= axis.knots[-1] + margin)


def _outside(axis: Axis, position: float, table: Table) -> str:
    """Return what to do about a position outside the range; a column of radians holds degrees if they then fit."""
    letter = axis.key
    if not isinstance(axis, RotaryAxis):
        return "the columns x, y, z hold the commanded positions"
    in_rad = table.headings.get(letter, "").endswith("_rad")
    as_degrees = in_rad and axis.knots[0] <= np.radians(position) <= axis.knots[-1]
    if as_degrees:
        return f"is it in degrees? then write `{letter}_deg`"
    wider = f"give {letter} a wider range"
    if abs(float(np.ptp(axis.knots)) - 2 * np.pi) < _OUTSIDE and not axis.periodic:
        return f"{wider}, or `periodic: true` if it takes any turn"
    # a control may count the same place from 0 to 360 degrees
    turned = [angle for angle in (position - 2 * np.pi, position + 2 * np.pi) if _inside(axis, np.array([angle]))]
    return f"write {placed(axis, turned[0])}, the same place, or {wider}" if turned else wider


def raise_if(faults: Iterable[Fault]) -> None:
    """Raise InputError with the faults, if there are any."""
    listed = list(faults)
    if listed:
        raise InputError(listed)


def _columns(machine: Machine, table: Table) -> Iterator[Fault]:
    letters = [axis.letter for axis in machine.axes]
    for letter in (*AXES, *ANGLES):
        unit = "mm" if letter in AXES else "deg"
        name = f"{letter.lower()}_{unit}"
        if letter in letters and letter.lower() not in table:
            yield table.fault(f"the column '{name}' is missing", "it holds the commanded position of the axis")
        elif letter not in letters and letter.lower() in table:
            text = f"the file has a column '{name}', but the chain of the machine has no {letter}"
            yield table.fault(text, f"add {letter} to `chain` and `axes`, or leave the column out")


def placed(axis: Axis, position: float, unit: str | None = None, decimals: int = 9) -> str:
    """Return a position of an axis as people write it: `12 mm`, `-90 deg`."""
    own = ("deg" if axis.turns else "mm") if unit is None else unit
    return f"{round(float(np.degrees(position)) if axis.turns else float(position), decimals) + 0.0:g} {own}".strip()


def must_support(machine: Machine, position: Array, blocks: Mapping[str, Block]) -> None:
    """Raise UndeterminedError if a free knot has no reading in the intervals next to it."""
    lines = []
    for axis, own in zip(machine.axes, position, strict=True):
        free: Mask = np.asarray(blocks[axis.block].free.any(axis=1))
        index, weight = axis.places(own)
        seen = np.zeros(len(axis.members))
        for knots, weights in zip(index[:2], weight[:2, 0], strict=True):
            np.maximum.at(seen, knots, weights)
        bare = np.flatnonzero(free & (seen < _SUPPORT))
        if bare.size:
            where = ", ".join(placed(axis, axis.members[i], "") for i in bare[:5]) + (" ..." if bare.size > 5 else "")
            knots = f"{len(axis.members)} knots of {axis.letter} (at {where} {placed(axis, 0.0)[2:]})"
            lines.append(
                f"no reading is near {bare.size} of the {knots}: give {axis.key} fewer knots, or measure there"
            )
    if lines:
        raise UndeterminedError("\n".join(lines))


def tool_prior(blocks: Mapping[str, Block], settings: Settings) -> tuple[Group, ...]:
    """Return the prior of the tool vectors with `tool_uncertainty`; empty if they are exact, or nothing is known."""
    block, std = blocks[TOOL], settings.machine.tool_std
    if not block.free.any() or not np.isfinite(std):
        return ()
    sigma = np.where(block.free, std, np.nan)
    return tuple(priors(block, sigma, block.free))
