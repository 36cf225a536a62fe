"""A machine with rotary axes, read from a result of calibrate-machine, and where its tip is on the workpiece."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.dense_jacobian import rows, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.instruments.axes.chain import chain_of
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.axes.rotary import RotaryAxis, spindle_block, turning_axes
from metrocli.instruments.machine import TOOL, Axis, Machine, squareness_block, tool_block
from metrocli.result import Result
from metrocli.table import Table
from metrocli.uncertainty.comparison import ENTRIES, TABLES

AXES = "rotary_axes"
"""Table of results that have rotary axes"""
_SLACK = 1e-6
"""A position beyond the range of an axis by less than this is rounding [mm, rad]"""


def turns(result: Result) -> bool:
    """Return whether a result is of a machine with rotary axes."""
    return AXES in result.tables


def tips(result: Result, commanded: Table, tool: Index) -> tuple[Array, Array, Array]:
    """Return tips on the workpiece (n, 3), with derivatives by the entries of all tables and by the tool vectors.

    They are (n, 3, entries) and (n, 3, 3). Raises InputError for a missing column, and for positions outside the axes.
    """
    machine = _machine(result)
    blocks, position = _blocks(result, machine), _position(machine, commanded)
    n = position.shape[1]
    index = machine.index(position) | {TOOL: tool}
    observed = Observations(np.zeros((3, n)), np.ones(1), index, conditions=machine.conditions(position))
    group = Group("reached", Chain(reach(machine).links), observed)
    unknowns = unknowns_of(blocks, [name for name in group.chain.blocks if name != TOOL])
    design, places = rows(group, blocks, unknowns), dict[tuple[str, str], int]()
    for i, (block, member, column) in enumerate(unknowns.names(blocks)):
        places[column, member if block.startswith("axis ") else ""] = i
    by_entry = np.zeros((n, 3, len(result.tables[ENTRIES])))
    for i, key in enumerate(_keys(result, machine)):
        if key in places:
            by_entry[:, :, i] = design[:, :, places[key]].T
    by_tool = np.zeros((n, 3, 3))
    for touch in group.linear(blocks, frozenset({TOOL})).touches:
        by_tool += np.moveaxis(touch.jacobian, -1, 0)
    return group.chain.predict(blocks, observed).T, by_entry, by_tool


def _machine(result: Result) -> Machine:
    """Return the machine of a result; raises InputError where rotary axes were tested alone, without a chain."""
    if "chain" not in result.statistics:
        tested = " ".join(result.tables[AXES].texts("axis"))
        raise InputError(f"the result has the positioning of {tested} alone: it does not predict where a tool is")
    letters = chain_of(str(result.statistics["chain"]))
    turning, tools = result.tables[AXES], result.tables["tools"]
    error, position = _listed(result)
    at = turning.stacked("xyz")
    axes: list[Axis] = [Axis(text, position[error == f"E{text}{text}"]) for text in result.tables["axes"].texts("axis")]
    for row, letter in enumerate(turning.texts("axis")):
        knots = position[error == f"E{letter}{letter}"]
        periodic, head = (bool(turning.columns[name][row]) for name in ("periodic", "head"))
        axes.append(RotaryAxis(letter, knots, tuple(at[row]), int(turning.numbers("sense")[row]), periodic, head))
    names = [axis.letter for axis in axes]
    order = tuple(names.index(letter) for letter in letters if letter != "b")
    return Machine(order, tuple(axes), letters.index("b"), tools.stacked("xyz"))


def _listed(result: Result) -> tuple[Array, Array]:
    """Return the names and the positions of all entries; nan for those without one."""
    entries = result.tables[ENTRIES]
    angle = entries.numbers("angle")
    return np.array(entries.texts("error")), np.where(np.isnan(angle), entries.numbers("position"), angle)


def _keys(result: Result, machine: Machine) -> list[tuple[str, str]]:
    """Return error and member of each entry; those of a last knot that is the first one have none."""
    error, position = _listed(result)
    members = {axis.letter: axis.block_of({}, ()).members for axis in machine.axes}
    count: dict[str, int] = {}
    keys = []
    for name, at in zip(error.tolist(), position.tolist(), strict=True):
        number = count.get(name, 0)
        count[name] = number + 1
        own = members.get(name[-1], ())
        # a full turn lists its first knot again at its end, which has no unknowns of its own
        member = "" if np.isnan(at) else own[number] if number < len(own) else "the first"
        keys.append((name, member))
    return keys


def _blocks(result: Result, machine: Machine) -> dict[str, Block]:
    """Return the blocks at the values of a result, all free; what is not determined is zero, as in the result."""
    values = {
        name.removeprefix(TABLES): np.nan_to_num(table.numbers("value"))
        for name, table in result.tables.items()
        if name.startswith(TABLES)
    }
    known = {estimate.name: estimate.value for estimate in result.estimates}
    blocks = [axis.block_of(values, ()) for axis in machine.axes]
    blocks += [axis.location_block(known, ()) for axis in turning_axes(machine)]
    blocks += [squareness_block(known, ()), spindle_block(known, ())]
    blocks.append(tool_block(machine.tools, result.tables["tools"].texts("tool"), 0.0))
    # all free, since their derivatives are wanted for the covariance of the result
    return {block.name: replace(block, free=np.array(True)) for block in blocks}


def _position(machine: Machine, commanded: Table) -> Array:
    """Return commanded positions (axes, n); raises InputError for a missing column and for one outside its axis."""
    faults: list[Fault] = []
    position = []
    for axis in machine.axes:
        name, unit = axis.key, "deg" if axis.turns else "mm"
        if name not in commanded:
            faults.append(commanded.fault(f"the column '{name}_{unit}' is missing", "the machine has this axis"))
            continue
        own = axis.wrapped(commanded.numbers(name))
        beyond = (own < axis.knots[0] - _SLACK) | (own > axis.knots[-1] + _SLACK)
        text = f"the commanded {name} is outside the calibrated axis"
        faults += commanded.faults_at(np.flatnonzero(beyond).tolist(), lambda _, text=text: text)  # type: ignore[misc]
        position.append(own)
    if faults:
        raise InputError(faults)
    return np.array(position)
