"""The adjustment problem that all methods of calibrate-machine build: machine, unknowns, tools, and checks of rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from typing import Self

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index, Mask, Values
from metrocli.effects.acting import NOMINAL
from metrocli.effects.correlated import with_all
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import POSITIONS, Undisturbed
from metrocli.instruments.axes.kinematics import LINKS, ON_WORKPIECE
from metrocli.instruments.axes.rotary import SPINDLE
from metrocli.instruments.machine import ANGLES, AXES, POSITION, SQUARENESS, TOOL, Machine
from metrocli.instruments.machine_path import SINCE, since_turn
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracer import AIR, POINT, STOP, TRACER
from metrocli.instruments.tracer import aspects as beam_aspects
from metrocli.instruments.tracker import LEG, TRACKER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.effects.machine import PAIRS
from metrocli.tasks.calibrate_machine.effects.turning import TILTED
from metrocli.tasks.calibrate_machine.iso230 import Run
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.lengths import PathNoise, with_noise
from metrocli.words import suggestion

SIDES = ("from_x", "from_y", "from_z")
"""Conditions: 1 where an axis last moved in its positive direction, -1 in its negative, 0 where it has not moved"""
ALL_SIDES = (*SIDES, "from_a", "from_b", "from_c")
_SIDE = "expected 1 after a move in the positive direction of the axis, -1 after one in the negative"


@dataclass(frozen=True)
class MachineProblem(Modelled):
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
    positioning_alone: bool = False
    """Whether only the positioning of single axes was read, so that nothing is known of the volume"""
    sees_bed: bool = False
    """Whether the instrument stands on the bed of a machine with rotary axes"""
    given: tuple[str, ...] = ()
    """Errors of the linear axes that an earlier calibration gives with their covariance"""
    listed_at: Array | None = None
    """Listed places of the stations of lengths, (stations, 3), nan where not listed; None for other readings"""
    stuck: tuple[str, ...] = ()
    """Readings that stay the same at different places, in words"""

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

    def with_effects(self, requests: Iterable[RequestedEffect]) -> Self:
        """Return the problem extended by the effects of a job.

        Blocks of effects that exist already keep their values, so that a relinearised problem continues from them.
        """
        requests = tuple(requests)
        if not requests:
            return self
        bare = {name: block for name, block in self.blocks.items() if name in BLOCKS}
        model = with_all(self.model.with_blocks(bare), requests)
        return self.with_model(
            model.with_blocks({name: self.blocks.get(name, model.blocks[name]) for name in model.blocks})
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
    letters = [letter.lower() for letter in (*AXES, *ANGLES) if f"axis {letter}" in blocks]
    balls = blocks[ON_WORKPIECE].members if ON_WORKPIECE in blocks else ()
    pairs = [pair for pair in (*PAIRS, *TILTED) if set(pair) <= set(letters)]
    # of two tables the one nearer to the bed tilts the other
    pairs = [pair for pair in pairs if pair in PAIRS or pair[::-1] in _tables(readings)]
    places = {
        "axis": Place(tuple(letters)),
        "pair": Place(tuple(pairs)),
        "ball": Place(balls, ON_WORKPIECE),
        "reversal": Place(REVERSALS),
        "tracer": Place(tracers, TRACER),
        "line": Place(blocks[LINE].members if LINE in blocks else (), LINE),
        "point": Place(tuple(points), POINT),
        "stop": Place(tuple(stops), STOP),
    }
    to = [link for link in readings.chain.links if isinstance(link, LINKS)]
    aspects = beam_aspects(Chain(tuple(to))) if tracers else {}
    return Model(blocks, (readings, *others), None, (readings.name,), places, aspects)


def _tables(readings: Group) -> str:
    """Return the letters of the axes on the workpiece's side of the bed, from the workpiece on."""
    machine = next((link.machine for link in readings.chain.links if isinstance(link, Undisturbed)), None)
    if machine is None:
        return ""
    return "".join(machine.axes[i].letter.lower() for i in machine.order[: machine.bed])


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


def tool_column(settings: Settings, tool: Index) -> dict[str, Values]:
    """Return the column with the names of tools (n,); none where the job has one tool without a name."""
    names = list(settings.tools)
    return {} if names == [""] else {"tool": np.array(names)[tool]}


def tools_used(settings: Settings, tool: Index) -> tuple[str, ...]:
    """Return the names of the tools that readings have, from the number of that of each (n,)."""
    names = list(settings.tools)
    return tuple(names[i] for i in np.unique(tool))


def conditions(
    machine: Machine, position: Array, table: Table | None = None, place: Array | None = None
) -> dict[str, Array]:
    """Return the conditions of readings: commanded position, and time, temperature and directions of approach if given.

    `place` (3, n) is the nominal place of the point that is read, unless it is the commanded position. Raises
    InputError if a direction of approach is not -1, 0 or 1.
    """
    columns = machine.conditions(position)
    if place is not None or not machine.only_turns:
        columns |= dict(zip(NOMINAL, position[:3] if place is None else place, strict=True))
    if table is not None:
        _refuse_sides(table)
        columns |= table.conditions("t", "temp", *ALL_SIDES)
        columns |= since_turns(position, columns)
    return columns


def since_turns(position: Array, given: Mapping[str, Array]) -> dict[str, Array]:
    """Return the distance of each axis since it turned, as conditions, from positions (3, n) in the order of travel.

    The order is that of the times in `given`, else that of the rows. Axes without sides, or with sides that
    contradict the order, are left out.
    """
    n = position.shape[1]
    order, since = np.argsort(given.get("t", np.arange(n)), kind="stable"), {}
    for axis, places in zip(POSITION, position[:, order], strict=False):
        side = given.get(f"from_{axis}")
        way = None if side is None else since_turn(np.diff(places, prepend=places[:1]), side[order])
        if way is not None:
            since[SINCE.format(axis=axis)] = way[np.argsort(order)]
    return since


def _refuse_sides(table: Table) -> None:
    faults = [
        table.fault_at(row, f"{name} = {table.numbers(name)[row]:g} is not a direction of approach", _SIDE)
        for name in ALL_SIDES
        if name in table
        for row in np.flatnonzero(~np.isin(table.numbers(name), (-1, 0, 1))).tolist()
    ]
    if faults:
        raise InputError(faults[:5])


PLACES_OF_AXES = (SQUARENESS, *(f"place of {letter}" for letter in ANGLES), SPINDLE)
"""Names of the blocks whose entries are estimates of the summary: how the axes lie"""
ERROR_BLOCKS = (*(f"axis {letter}" for letter in (*AXES, *ANGLES)), *PLACES_OF_AXES, TOOL)
"""Names of the blocks on which the predicted error of a point depends"""
NETWORK = "errors of the network"
"""Name of the block of errors that points have in common, where a network measured them"""
BLOCKS = (*ERROR_BLOCKS, TRACKER, LEG, LINE, TRACER, STOP, AIR, ON_WORKPIECE, NETWORK, *POSITIONS)
"""Names of the blocks of machine and instruments; all other blocks are effects"""
REVERSALS = ("xy", "xz", "yx", "yz", "zx", "zy")
"""Places of reversals: the axis that turns, and the axis along which the point is shifted"""
