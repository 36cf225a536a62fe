"""The true machine of a simulation: its random errors, and the readings it gives at commanded positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index
from metrocli.effects.model import Model
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.rotary import LOCATIONS, SPINDLE_NAMES, RotaryAxis, spindle_block
from metrocli.instruments.machine import SQUARENESS_NAMES, TOOL, Axis, Machine, errors_of, is_angle, squareness_block
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import error_blocks, machine_of
from metrocli.tasks.calibrate_machine.problem import conditions, model_of, since_turns
from metrocli.tasks.calibrate_machine.settings import MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.tables import grown
from metrocli.tasks.calibrate_machine.volume import grid_group, grid_of, spread_over, tips, without_rigid_motion
from metrocli.tasks.shared.part import Warm

_COMPONENTS = {Quantity.ERROR_MOTION: 6, Quantity.LENGTH: 1, Quantity.DISPLACEMENT: 1, Quantity.ANGLE: 1}
"""Components of a reading by what it reads; all others have three"""
_FINE = 401
_HARMONICS = 4
_TRAVEL = 600.0
"""Size of a machine without linear axes [mm]"""
_PLACES = 216
"""Places over which the error of a machine with rotary axes is averaged"""


@dataclass(frozen=True)
class TrueMachine:
    """A machine with its true errors."""

    machine: Machine
    """With as many knots as its errors need"""
    blocks: Mapping[str, Block]

    def error(self, position: Array, tool: Index) -> Array:
        """Return the error motion of the tool against the workpiece (mm, rad), (6, n), at positions (3, n)."""
        group = grid_group(self.machine, position, tool)
        return group.chain.predict(self.blocks, group.observations)

    def model(self, chain: Chain, more: Mapping[str, Block], flow: Flow) -> Model:
        """Return the forward model of the readings at the positions of a flow."""
        n = flow.position.shape[1]
        index = self.machine.index(flow.position) | {TOOL: flow.tool} | dict(flow.index)
        sizes = np.zeros((_COMPONENTS.get(chain.quantities[-1], 3), n))
        observations = Observations(
            sizes, np.ones(1), index, conditions=conditions(self.machine, flow.position) | dict(flow.conditions)
        )
        return model_of(
            {**self.blocks, **more}, Group("readings", chain, observations), points=flow.points, stops=flow.stops
        )


@dataclass(frozen=True)
class Flow:
    """Commanded positions in the order of travel, with tool, time and direction of approach."""

    position: Array
    """(3, n)"""
    tool: Index
    conditions: Mapping[str, Array]
    index: Mapping[str, Index] = field(default_factory=dict)
    points: tuple[str, ...] = ()
    """Names of the points, if effects may act on one of them"""
    stops: tuple[str, ...] = ()
    """Names of the stops of several lengths"""

    @classmethod
    def of(cls, position: Array, tool: Index, given: Mapping[str, Array]) -> Flow:
        """Return positions with their conditions: those given, and the ways since the axes turned."""
        return cls(position, tool, {**given, **since_turns(position, given)})


def truth_of(settings: Settings, simulation: MachineSimulation, rng: np.random.Generator) -> TrueMachine:
    """Return a machine with random errors, scaled so that the mean length of the error in the volume is as given.

    The mean is taken after the best shift and turn of the volume. Of rotary axes that are tested alone it is the
    size of the errors at 300 mm from them. Raises InputError for smooth errors of rotary axes.
    """
    machine = machine_of(settings)
    if simulation.smooth and machine.turns:
        raise InputError("simulation.smooth: errors of machines with rotary axes are straight between knots: remove it")
    if simulation.smooth:
        fine = (replace(axis, knots=np.linspace(axis.knots[0], axis.knots[-1], _FINE)) for axis in machine.axes)
        machine = replace(machine, axes=tuple(fine))
    travels = [float(np.ptp(axis.knots)) for axis in machine.axes if not axis.turns]
    lever = max(travels, default=_TRAVEL) / 2
    tables = {
        name: _drawn(axis, name, simulation.smooth, rng) for axis in machine.axes for name in errors_of(axis.letter)
    }
    tables = {name: table / (lever if is_angle(name) else 1.0) for name, table in tables.items()}
    places = {name: float(rng.normal()) / lever for name in SQUARENESS_NAMES}
    if machine.turns:
        names = (*LOCATIONS, *SPINDLE_NAMES)
        places |= {name: float(rng.normal()) / (lever if is_angle(name) else 1.0) for name in names}
    unit = TrueMachine(machine, blocks_of(settings, machine, tables, places))
    size = simulation.error / (_mean_angle(unit) * lever if settings.angular else _mean_error(unit))
    scaled = {name: table * size for name, table in tables.items()}
    return TrueMachine(
        machine, blocks_of(settings, machine, scaled, {name: value * size for name, value in places.items()})
    )


def _mean_error(truth: TrueMachine) -> float:
    """Return the mean length of the error in the volume after its best shift and turn [mm]."""
    machine = truth.machine
    grid = spread_over(machine, _PLACES) if machine.turns else grid_of(machine, (6, 6, 6))
    first = np.zeros(grid.shape[1], dtype=np.intp)
    error = without_rigid_motion(truth.error(grid, first), tips(machine, grid, first))
    return float(np.linalg.norm(error, axis=0).mean())


def _mean_angle(truth: TrueMachine) -> float:
    """Return the mean size of the errors of the angles of all axes [rad]."""
    tables = [truth.blocks[axis.block].values[:, axis.number + 3] for axis in truth.machine.axes]
    return float(np.abs(np.concatenate(tables)).mean())


def warmed(truth: TrueMachine, scales: Mapping[str, Warm], rng: np.random.Generator) -> TrueMachine:
    """Return a machine whose scales have their temperature at the measurement, drawn within its uncertainty."""
    blocks = dict(truth.blocks)
    for axis in truth.machine.axes:
        if axis.letter in scales:
            growth = scales[axis.letter].growth + rng.normal() * scales[axis.letter].std
            blocks[axis.block] = grown(axis, blocks[axis.block], growth)[0]
    return replace(truth, blocks=blocks)


def true_errors(settings: Settings, truth: TrueMachine) -> Table:
    """Return the true error tables, interpolated at the knots of the job."""
    parts = []
    for axis, fine in zip(machine_of(settings).axes, truth.machine.axes, strict=True):
        for k, name in enumerate(errors_of(axis.letter)):
            table = fine.from_raw[k] @ truth.blocks[fine.block].values[:, k]
            values = np.interp(axis.knots, fine.knots, table)
            none = np.full(len(values), np.nan)
            length, angle = (none, values) if is_angle(name) else (values, none)
            knots = {"error": [name] * len(values), "position [mm]": axis.knots}
            if truth.machine.turns:
                linear, turned = (none, axis.knots) if axis.turns else (axis.knots, none)
                knots |= {"position [mm]": linear, "angle [rad]": turned}
            parts.append(Table.of({**knots, "value [mm]": length, "turn [rad]": angle}))
    return Table.stack(parts)


def blocks_of(
    settings: Settings, machine: Machine, tables: Mapping[str, Array], places: Mapping[str, float]
) -> dict[str, Block]:
    """Return the blocks of a machine with given tables, squareness, locations of axes and angles of its spindle.

    Errors that the job does not estimate are zero. The tables are given at the knots: straightness relative to its
    end-point line, other errors zero at the reference position of the axis; those of rotary axes are gauged here.
    """
    wanted = settings.estimated
    kept = {name: table for name, table in tables.items() if name in wanted}
    blocks = [axis.block_of(kept, wanted) for axis in machine.axes]
    given = {name: value for name, value in places.items() if name in wanted}
    blocks.append(squareness_block(given, wanted))
    for at, axis in enumerate(machine.axes):
        if isinstance(axis, RotaryAxis):
            blocks[at] = axis.in_gauge(blocks[at])
            blocks.append(axis.location_block(given, wanted))
    if machine.turns:
        blocks.append(spindle_block(given, wanted))
    return {**error_blocks(machine, settings), **{block.name: block for block in blocks}}


def _drawn(axis: Axis, name: str, smooth: bool, rng: np.random.Generator) -> Array:
    """Return a random table in the gauge: a sum of harmonics if smooth, else a random walk from knot to knot."""
    u = (axis.knots - axis.knots[0]) / (axis.knots[-1] - axis.knots[0])
    if smooth:
        order = np.arange(1, _HARMONICS + 1)[:, None]
        phase = rng.uniform(0, 2 * np.pi, (_HARMONICS, 1))
        raw = (rng.normal(size=(_HARMONICS, 1)) / order * np.sin(np.pi * order * u + phase)).sum(axis=0)
    else:
        raw = rng.normal(size=len(u)).cumsum() / np.sqrt(len(u))
    if axis.straightness[errors_of(axis.letter).index(name)]:
        return np.asarray(raw - raw[0] - (raw[-1] - raw[0]) * u)
    return np.asarray(raw - np.interp(axis.reference, axis.knots, raw))
