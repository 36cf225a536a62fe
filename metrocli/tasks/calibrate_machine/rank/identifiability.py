"""Find which of the 21 errors a measurement determines: rank, undetermined combinations, and worst amplification.

The Jacobian alone decides, so that this also works for planned readings. A direction of the unknowns is open if its
standard uncertainty would exceed every plausible size (1 mm, 1 mrad). Open directions that do not move the measured
tools anywhere in the volume are harmless: some tables are held at zero, and others are determined only together with
them. If an open direction moves a measured tool in the volume, there is no result (UndeterminedError).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.decompositions import pivoted_qr, thin_svd
from metrocli.adjust.dense_jacobian import Unknowns, normal_matrix, unit_noise, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import POSITIONS
from metrocli.instruments.axes.rotary import Combinations
from metrocli.instruments.machine import ANGLES, TOOL, Machine, errors_of
from metrocli.instruments.tracer import AIR, STOP
from metrocli.tasks.calibrate_machine.described import error_names
from metrocli.tasks.calibrate_machine.methods.targets import met_again
from metrocli.tasks.calibrate_machine.problem import NETWORK, MachineProblem
from metrocli.tasks.calibrate_machine.rank.open_directions import OpenDirections, in_words
from metrocli.tasks.calibrate_machine.tables import Determination
from metrocli.tasks.calibrate_machine.volume import rows_over_volume

_HARMLESS = 1e-4
"""An open direction is harmless if it moves the tool by less than this [mm] at its full plausible size: 0.1 um"""
_TOUCHED = 1e-6
"""Largest entry of a table in the open directions below which the table counts as determined"""


@dataclass(frozen=True)
class Identifiability:
    """Which errors a measurement determines, and its worst ratio of volume error to misfit."""

    problem: MachineProblem
    opened: OpenDirections
    blocks: Mapping[str, Block]
    """The blocks of unknowns, with undetermined entries held at zero"""
    held: tuple[str, ...]
    """Names of the errors with entries held at zero, as they were chosen"""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all errors of the machine."""
        return error_names(self.problem.machine)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the errors that have tables."""
        return tuple(name for axis in self.problem.machine.axes for name in errors_of(axis.letter))

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.opened.unknowns.size

    @property
    def rank(self) -> int:
        """Number of combinations of them that are determined."""
        return self.unknowns - len(self.opened.directions.T)

    @cached_property
    def status(self) -> Mapping[str, Determination]:
        """Whether an error is determined, by its name."""
        shares = self.opened.shares(self.opened.directions)
        statuses = {name: _status(name, shares, self.held, self.opened.blocks) for name in self.names}
        return statuses | {
            name: Determination.GIVEN for name in self.problem.given if statuses[name] == Determination.DETERMINED
        }

    @cached_property
    def partners(self) -> Mapping[str, tuple[str, ...]]:
        """For each error that is not determined on its own, the errors with which it is combined."""
        combined = (Determination.TOGETHER, Determination.UNDETERMINED)
        return {name: _partners(name, self.opened) for name in self.names if self.status[name] in combined}

    @cached_property
    def ratio(self) -> float:
        """Largest ratio of the volume's error to the misfit of the readings, both root mean square."""
        return worst_ratio(self.problem.with_blocks(self.blocks))

    @cached_property
    def open_tools(self) -> tuple[str, ...]:
        """Tools of the job whose error cannot be predicted, since it depends on undetermined errors."""
        tools = self.opened.blocks[TOOL].members[: len(self.problem.machine.tools)]  # then come reflectors
        return tuple(
            tool for tool in tools if np.abs(_moved(self.problem, self.opened, tool)).max(initial=0.0) > _HARMLESS
        )

    @property
    def zeros(self) -> tuple[str, ...]:
        """Estimated positions that no reading shows: they stay as given, and say where their axis is 0."""
        names = [name for name in POSITIONS if name in self.blocks]
        held = {name: self.opened.blocks[name].free & ~self.blocks[name].free for name in names}
        return tuple(
            f"{name[-1]} at {self.blocks[name].members[row]}" for name in names for row in np.flatnonzero(held[name])
        )

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the errors that are held at zero."""
        return tuple(name for name, status in self.status.items() if status == Determination.UNDETERMINED)

    @property
    def together(self) -> tuple[str, ...]:
        """Names of the errors that are determined only together with those held at zero."""
        return tuple(name for name, status in self.status.items() if status == Determination.TOGETHER)


def identify(problem: MachineProblem) -> Identifiability:
    """Return which errors the measurement determines.

    Raises UndeterminedError if an open direction moves a measured tool in the volume.
    """
    blocks = problem.blocks
    names = [name for name, block in blocks.items() if block.free.any() and name not in (STOP, NETWORK)]
    unknowns = unknowns_of(blocks, names)
    reach = unknowns.reach(blocks)
    matrix = normal_matrix(at_knots(problem), blocks, unknowns)
    values, vectors = np.linalg.eigh(matrix * reach[:, None] * reach)
    # in units of what is plausible: below 1 a combination is known worse than without any reading
    # (docs/tasks/calibrate-machine.md)
    opened = OpenDirections(vectors[:, values < 1.0], reach, unknowns, blocks, error_names(problem.machine))
    _refuse_harmful(problem, opened)
    held, undetermined = _hold(opened, problem.machine)
    return Identifiability(problem, opened, held, undetermined)


def at_knots(problem: MachineProblem) -> tuple[Group, ...]:
    """Return the groups of a problem as if all rotary axes had stood at the knots below, and again at those above.

    Axes whose tables are not estimated stand where they stood. Tables are straight between knots, but levers turn. So
    readings between knots seem to determine, by hundreds of micrometres, what no such readings at knots determine, and
    the error of the interpolation is magnified as much.
    """
    machine, blocks = problem.machine, problem.blocks
    turning = [axis for axis in machine.axes if axis.turns and blocks[axis.block].free.any()]
    readings = problem.readings
    others = tuple(group for group in problem.groups if group.name != readings.name)
    if not turning:
        return problem.groups
    copies = []
    # the nearest knot alone is not enough: it may have two reflectors where its neighbours have the third
    # (docs/decisions/191-rank-at-the-knots.md)
    for side in (0, 1):
        given, index = dict(readings.observations.conditions), dict(readings.observations.index)
        for axis in turning:
            given[axis.coordinate] = axis.members[axis.places(given[axis.coordinate])[0][side]]
        given |= met_again(problem.machine, readings.observations, given, problem.blocks)
        index |= problem.machine.index(np.stack([given[axis.coordinate] for axis in problem.machine.axes]))
        copies.append(replace(readings, observations=replace(readings.observations, conditions=given, index=index)))
    return (*copies, *others)


def _moved(problem: MachineProblem, opened: OpenDirections, tool: str) -> Array:
    """Return the displacement of a tool over the volume by each open direction, (3 n, k)."""
    return opened.moved(rows_over_volume(problem.machine, problem.blocks, tool, opened.unknowns))


def _refuse_harmful(problem: MachineProblem, opened: OpenDirections) -> None:
    if opened.directions.shape[1] == 0:
        return
    moved = np.concatenate([_moved(problem, opened, tool) for tool in problem.tools_used])
    _, sizes, mix = thin_svd(moved)
    count = int((sizes / np.sqrt(len(moved)) > _HARMLESS).sum())
    if count:
        raise UndeterminedError(in_words(problem, opened, opened.directions @ mix[:count].T))


def _hold(opened: OpenDirections, machine: Machine) -> tuple[dict[str, Block], tuple[str, ...]]:
    """Return the blocks with undetermined entries held at zero, and the names of the errors held.

    Errors are held in a fixed order of preference: first angles, of the axis nearest to the tool first.
    """
    directions, blocks, undetermined = opened.directions, dict(opened.blocks), []
    names = opened.unknowns.names(opened.blocks)
    # positions come first: one that no reading shows is the zero of its axis, and no error of the machine
    positions = np.flatnonzero([block in POSITIONS for block, _, _ in names])
    for name, at in [("", positions), *((name, opened.rows_of[name]) for name in _preference(machine))]:
        if directions.shape[1] == 0 or at.size == 0 or np.abs(directions[at]).max() < _TOUCHED:
            continue
        chosen, directions = _taken(directions, at)
        for i in chosen:
            block, member, column = names[i]
            free = np.array(blocks[block].free)
            free[blocks[block].members.index(member), blocks[block].column(column)] = False
            blocks[block] = replace(blocks[block], free=free)
        undetermined += [name] if name else []
    return blocks, tuple(undetermined)


def _preference(machine: Machine) -> list[str]:
    near_first = [machine.axes[i].letter for i in reversed(machine.order)]
    angles = [name for axis in near_first for name in errors_of(axis) if name[1] in ANGLES]
    rest = [name for axis in near_first for name in errors_of(axis) if name[1] not in ANGLES]
    known = {*angles, *rest}
    places = [name for name in error_names(machine) if name not in known]
    if not machine.turns:
        return [*angles, *rest, *places]
    return [*angles, *sorted(places, key=lambda name: name[-1] != "S"), *rest]


def _taken(directions: Array, at: Index) -> tuple[Index, Array]:
    """Return the entries of an error to hold at zero, and the directions that then remain open."""
    part = directions[at]
    # the pivots are the entries that the open directions move most: held at 0, they close as many as they can
    _, triangle, order = pivoted_qr(part.T)
    size = np.abs(np.diag(triangle))
    rank = int((size > _TOUCHED).sum())
    _, _, right = np.linalg.svd(part)
    # what is left of them moves none of these entries
    rest = directions @ right[rank:].T
    return at[order[:rank]], rest


def _status(
    name: str, shares: Mapping[str, float], undetermined: Sequence[str], blocks: Mapping[str, Block]
) -> Determination:
    block = next(block for block in blocks.values() if name in block.columns)
    if not block.free[:, block.column(name)].any():
        return Determination.NOT_ESTIMATED
    if name in undetermined:
        return Determination.UNDETERMINED
    return Determination.TOGETHER if shares[name] > _TOUCHED else Determination.DETERMINED


def _partners(name: str, opened: OpenDirections) -> tuple[str, ...]:
    """Return the errors that are combined with an error in the open directions."""
    at = opened.rows_of[name]
    _, sizes, mix = thin_svd(opened.directions[at])
    moving = opened.directions @ mix[sizes > _TOUCHED].T
    shares = opened.shares(moving)
    return tuple(other for other, share in shares.items() if other != name and share > _TOUCHED)


_ROUNDING = 1e-12
"""Share of the largest square below which one is rounding"""
_LOOSE = 1e6
"""Factor on the standard deviations of conditions that makes their weights like those of readings of 1 mm"""


def worst_ratio(problem: MachineProblem) -> float:
    """Return the largest ratio of the error in the volume to the misfit of the readings, both root mean square.

    `max |G v| / |J v|` over all errors v that the tables can describe. G maps v to the error in the volume after the
    best rigid motion, J to the readings after the fit of the tracker's frame. Errors that an earlier calibration gives,
    or only a prior holds, such as the index of the air, stay. Returns inf if J does not see what moves the tool.
    """
    blocks = {
        name: replace(block, free=block.free & ~np.isin(block.columns, list(problem.given)))
        for name, block in problem.blocks.items()
    }
    names = [name for name, block in blocks.items() if block.free.any() and name not in (TOOL, STOP, AIR, NETWORK)]
    unknowns = unknowns_of(blocks, names)
    if unknowns.size == 0:
        return 0.0
    weight = problem.per_reading / problem.per_reading.sum()
    unit = _angles_as_lengths(problem)[:, None] / np.sqrt(weight)
    # conditions of tables with weights like those of readings, which saves digits
    conditions = [group for group in problem.groups if isinstance(group.chain.links[0], Combinations)]
    loose = [group.with_noise_times(_LOOSE) for group in conditions]
    path = normal_matrix([unit_noise(problem.readings, unit), *loose], blocks, unknowns)
    volume = volume_matrix(problem, unknowns)
    # columns of one size: shifts in mm and turns in rad differ by many decades
    scale = 1 / np.sqrt(np.maximum(np.diag(path), 1e-300))
    values, vectors = np.linalg.eigh(path * scale[:, None] * scale)
    unseen, moves = values < _ROUNDING * values[-1], volume * scale[:, None] * scale
    # what only a list holds, such as the turn of all reflectors with the stations, is seen by no reading
    if np.abs(vectors[:, unseen].T @ moves @ vectors[:, unseen]).max(initial=0.0) > _ROUNDING * np.trace(moves):
        return float("inf")
    root = vectors[:, ~unseen] / np.sqrt(values[~unseen])
    return float(np.sqrt(max(np.linalg.eigvalsh(root.T @ moves @ root)[-1], 0.0)))


def _angles_as_lengths(problem: MachineProblem) -> Array:
    """Return the size of each component that counts as 1 mm; for angles the lever is half the volume's diagonal."""
    lever, names = problem.machine.diagonal / 2, problem.readings.observations.components
    return np.array([1 / lever if name in ("ea", "eb", "ec") else 1.0 for name in names])


def volume_matrix(problem: MachineProblem, unknowns: Unknowns) -> Array:
    """Return the matrix (unknowns, unknowns) of the mean square displacement in the volume as a quadratic form.

    The mean is over the volume and the measured tools, without rigid motion.
    """
    machine, blocks = problem.machine, problem.blocks
    grids = np.concatenate([rows_over_volume(machine, blocks, tool, unknowns) for tool in problem.tools_used], axis=1)
    flat = grids.reshape(-1, unknowns.size)
    return np.asarray(flat.T @ flat / grids.shape[1])
