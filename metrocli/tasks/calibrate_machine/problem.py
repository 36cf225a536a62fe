"""The adjustment problem that all methods of calibrate-machine build: machine, unknowns, tools, and checks of rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from typing import Self

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, prior
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.acting import NOMINAL
from metrocli.effects.extension import extended
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import (
    AXES,
    POSITION,
    SQUARENESS,
    TOOL,
    Axis,
    ErrorMotion,
    Machine,
    ReachedPoint,
    axis_order,
    squareness_block,
    tool_block,
)
from metrocli.instruments.machine_path import SINCE, since_turn
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracer import AIR, POINT, STOP, TRACER
from metrocli.instruments.tracer import aspects as beam_aspects
from metrocli.instruments.tracker import LEG, TRACKER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.iso230 import Run
from metrocli.tasks.calibrate_machine.settings import AxisSettings, Settings
from metrocli.tasks.shared.lengths import PathNoise, with_noise
from metrocli.words import suggestion

SIDES = ("from_x", "from_y", "from_z")
"""Conditions: 1 where an axis last moved in its positive direction, -1 in its negative, 0 where it has not moved"""
_SIDE = "expected 1 after a move in the positive direction of the axis, -1 after one in the negative"
_OUTSIDE = 1e-3
"""Positions may be outside the range by this [mm]: rounding of the control"""
_SUPPORT = 0.02
"""A knot is supported if some reading gives it at least this interpolation weight"""


@dataclass(frozen=True)
class Problem(Modelled):
    """The adjustment problem of a machine calibration: model, readings, and what the report needs."""

    machine: Machine
    per_reading: Array
    """How much of the measurement each reading represents: its number of points or length of path, (n,)"""
    tools_used: tuple[str, ...]
    """Names of the tools that have readings"""
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, float] = field(default_factory=dict)
    """Additional statistics of the method, by name"""
    runs: tuple[Run, ...] = ()
    """Runs along single axes, for the figures of ISO 230-2"""
    noise: PathNoise | None = None
    """Standard deviations of lengths, which follow from the solution; None for other readings"""
    notes: tuple[str, ...] = ()
    """What was done with the readings, in sentences"""
    displacement_only: bool = False
    """Whether only positioning along single axes was read, so that nothing is known of the volume"""
    said: Array | None = None
    """Listed places of the stations of lengths, (stations, 3), nan where not listed; None for other readings"""

    @property
    def readings(self) -> Group:
        """The group of the readings."""
        return self.model.readings[0]

    @property
    def groups(self) -> tuple[Group, ...]:
        """All groups of observations: readings and priors."""
        return self.model.groups

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each reading in reports: point, leg, or line and place on it."""
        return tuple(" at ".join(parts) for parts in zip(*self.readings.observations.keys.values(), strict=True))

    def with_noise(self, noise: PathNoise, blocks: Mapping[str, Block]) -> Self:
        """Return the problem at the values of `blocks` with another noise of its lengths."""
        return replace(self, model=with_noise(self.model.with_blocks(blocks), self.readings.name, noise), noise=noise)

    def with_noise_times(self, factor: float) -> Self:
        """Return the problem with a factor on the declared noise of its readings."""
        if self.noise is not None:
            return self.with_noise(self.noise.times(factor), self.blocks)
        return self.with_model(self.model.with_group(self.readings.with_noise_times(factor)))

    def selected(self, keep: Mask) -> Self:
        """Return the problem with some of its readings."""
        model = self.model.with_group(self.readings.selected(keep))
        return replace(self, model=model, per_reading=self.per_reading[keep])

    def with_effects(self, wanted: Iterable[Wanted]) -> Self:
        """Return the problem extended by the effects of a job.

        Blocks of effects that exist already keep their values, so that a relinearised problem continues from them.
        """
        wanted = tuple(wanted)
        if not wanted:
            return self
        bare = {name: block for name, block in self.blocks.items() if name in BLOCKS}
        found = extended(self.model.with_blocks(bare), wanted)
        return self.with_model(
            found.with_blocks({name: self.blocks.get(name, found.blocks[name]) for name in found.blocks})
        )


def model_of(
    blocks: Mapping[str, Block],
    readings: Group,
    others: Sequence[Group] = (),
    points: Sequence[str] = (),
    stops: Sequence[str] = (),
) -> Model:
    """Return the model of a machine with its readings and priors.

    `points` and `stops` are the names of those of lengths; the first stop stands for all that have one length.
    """
    tracers = blocks[TRACER].members if TRACER in blocks else ()
    places = {
        "axis": Place(POSITION),
        "pair": Place(PAIRS),
        "reversal": Place(REVERSALS),
        "tracer": Place(tracers, TRACER),
        "line": Place(blocks[LINE].members if LINE in blocks else (), LINE),
        "point": Place(tuple(points), POINT),
        "stop": Place(tuple(stops), STOP),
    }
    to = [link for link in readings.chain.links if isinstance(link, (ErrorMotion, ReachedPoint))]
    aspects = beam_aspects(Chain(tuple(to))) if tracers else {}
    return Model(blocks, (readings, *others), None, (readings.name,), places, aspects)


def machine_of(settings: Settings) -> Machine:
    """Return the machine with equally spaced knots that the settings describe."""
    given, rest = settings.machine.axes.given, AxisSettings((0.0, 100.0), 2)  # an axis not given stands still
    each = [(letter, given.get(letter, rest)) for letter in AXES]
    axes = tuple(Axis(letter, np.linspace(*axis.range, axis.knots)) for letter, axis in each)
    return Machine(axis_order(settings.machine.chain), (axes[0], axes[1], axes[2]))


def error_blocks(machine: Machine, settings: Settings) -> dict[str, Block]:
    """Return the blocks of error tables and squareness, all zero, and of the tool vectors.

    Raises InputError if no error is free: a straightness table of two knots is zero at both ends by definition.
    """
    blocks = [axis.block_of({}, settings.estimated) for axis in machine.axes]
    blocks.append(squareness_block({}, settings.estimated))
    if not any(block.free.any() for block in blocks):
        names = " ".join(settings.estimated)
        raise InputError(
            f"there is nothing to estimate: {names} with two knots is zero by definition; give the axis more knots"
        )
    tools = settings.tools
    blocks.append(tool_block(np.array(list(tools.values())), list(tools), settings.machine.tool_uncertainty))
    return {block.name: block for block in blocks}


def tool_prior(blocks: Mapping[str, Block], settings: Settings) -> tuple[Group, ...]:
    """Return the prior of the tool vectors with `tool_uncertainty`; empty if the vectors are exact."""
    block = blocks[TOOL]
    if not block.free.any():
        return ()
    sigma = np.full(block.values.shape, settings.machine.tool_uncertainty)
    return (prior(block, np.arange(len(sigma)), sigma),)


def tools_of(table: Table, settings: Settings) -> Index:
    """Return the number of the tool of each row, (n,).

    Raises InputError if a tool is not in the job, or if file and job do not agree on the number of tools.
    """
    names = list(settings.tools)
    if "tool" not in table:
        if len(names) > 1:
            text = "the job has several tools, but the file has no column 'tool'"
            raise InputError([table.fault(text, f"tools: {', '.join(names)}")])
        return np.zeros(len(table), dtype=np.intp)
    if names == [""]:
        used = sorted(set(table.texts("tool")))
        if len(used) > 1:
            text = f"the file has {len(used)} tools ({', '.join(used)}), but the job has one tool vector"
            raise InputError([table.fault(text, "give `machine: {tools: {T1: [...], T2: [...]}}`")])
        return np.zeros(len(table), dtype=np.intp)
    column = np.asarray(table.columns["tool"])
    unknown = [str(name) for name in np.unique(column) if name not in names]
    faults = [
        table.fault_at(
            int(np.argmax(column == name)), f"tool '{name}' is not among the job's tools", suggestion(name, names)
        )
        for name in unknown
    ]
    if faults:
        raise InputError(faults)
    order = np.argsort(names)
    return np.asarray(order[np.searchsorted(np.array(names)[order], column)], dtype=np.intp)


def commanded(machine: Machine, table: Table) -> Array:
    """Return commanded positions (3, n); raises InputError if one is outside the range of its axis."""
    position = table.stacked(POSITION).T
    low, high = machine.low[:, None] - _OUTSIDE, machine.high[:, None] + _OUTSIDE
    outside = (position < low) | (position > high)
    faults = [
        table.fault_at(
            int(row),
            f"{POSITION[axis]} = {position[axis, row]:g} mm is outside the range of the axis, "
            f"{machine.low[axis]:g} to {machine.high[axis]:g} mm",
            "the columns x, y, z hold the commanded positions",
        )
        for axis, row in zip(*np.nonzero(outside), strict=True)
    ]
    if faults:
        more = [table.fault(f"and {len(faults) - 5} more such rows")] if len(faults) > 5 else []
        raise InputError(faults[:5] + more)
    return position


def must_support(machine: Machine, position: Array, blocks: Mapping[str, Block]) -> None:
    """Raise UndeterminedError if a free knot has no reading in the intervals next to it."""
    told = []
    for axis in machine.axes:
        free: Mask = np.asarray(blocks[axis.block].free.any(axis=1))
        index, weight = axis.places(position[axis.number])
        seen = np.zeros(len(axis.knots))
        for knots, weights in zip(index[:2], weight[:2, 0], strict=True):
            np.maximum.at(seen, knots, weights)
        bare = np.flatnonzero(free & (seen < _SUPPORT))
        if bare.size:
            where = ", ".join(f"{axis.knots[i]:g}" for i in bare[:5]) + (" ..." if bare.size > 5 else "")
            told.append(
                f"no reading is near {bare.size} of the {len(axis.knots)} knots of {axis.letter} (at {where} mm): "
                f"give {axis.letter.lower()} fewer knots, or measure there"
            )
    if told:
        raise UndeterminedError("\n".join(told))


def conditions(position: Array, table: Table | None = None) -> dict[str, Array]:
    """Return the conditions of readings: commanded position, and time, temperature and directions of approach if given.

    Raises InputError if a direction of approach is not -1, 0 or 1.
    """
    found = dict(zip((*POSITION, *NOMINAL), (*position, *position), strict=True))
    if table is not None:
        _refuse_sides(table)
        found |= table.conditions("t", "temp", *SIDES)
        found |= since_turns(position, found)
    return found


def since_turns(position: Array, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return the distance of each axis since it turned, as conditions, from positions (3, n) in the order of travel.

    The order is that of the times in `given`, else that of the rows. Axes without sides, or with sides that
    contradict the order, are left out.
    """
    n = position.shape[1]
    order, found = np.argsort(given.get("t", np.arange(n)), kind="stable"), {}
    for axis, places in zip(POSITION, position[:, order], strict=True):
        side = given.get(f"from_{axis}")
        way = None if side is None else since_turn(np.diff(places, prepend=places[:1]), side[order])
        if way is not None:
            found[SINCE.format(axis=axis)] = way[np.argsort(order)]
    return found


def _refuse_sides(table: Table) -> None:
    faults = [
        table.fault_at(row, f"{name} = {table.numbers(name)[row]:g} is not a direction of approach", _SIDE)
        for name in SIDES
        if name in table
        for row in np.flatnonzero(~np.isin(table.numbers(name), (-1, 0, 1))).tolist()
    ]
    if faults:
        raise InputError(faults[:5])


ERROR_BLOCKS = ("axis X", "axis Y", "axis Z", SQUARENESS, TOOL)
"""Names of the blocks on which the predicted error of a point depends"""
BLOCKS = (*ERROR_BLOCKS, TRACKER, LEG, LINE, TRACER, STOP, AIR)
"""Names of the blocks of machine and instruments; all other blocks are effects"""
PAIRS = ("xy", "xz", "yz")
REVERSALS = ("xy", "xz", "yx", "yz", "zx", "zy")
"""Places of reversals: the axis that turns, and the axis along which the point is shifted"""
