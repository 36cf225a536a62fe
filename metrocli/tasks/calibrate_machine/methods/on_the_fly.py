"""on-the-fly: adjust a track without synchronisation, condensed along its path and relinearised at the solution.

Only the coordinates across each leg are used (Sanders et al. 1.2.4-1.2.5); the error along the path is not measured.
Each point is assigned to the commanded position at which the predicted path passes it. The closest point of the
commanded path would be off by the error along the path.

A cell is a piece of a leg between knots. Within a cell all errors are parabolas of the distance along the path, so that
three condensed points represent all its points. Their covariance across the leg is `A C A'`, with the direction of the
beam in C (eq. 8-9); the printed equation for W22 has the direction of the path in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.rounds import in_rounds
from metrocli.adjust.stream_condensation import Condensed, condense
from metrocli.arrays import Array, Index
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.tracker import LEG, TRACKER, TrackerNoise, leg_block, path_chain, tracker_block
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support, tool_prior
from metrocli.tasks.calibrate_machine.methods.track import Track, cut
from metrocli.tasks.calibrate_machine.problem import MachineProblem, conditions, model_of, tools_of, tools_used
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, solve, solved_again
from metrocli.tasks.calibrate_machine.volume import grid_group
from metrocli.words import counted

READINGS = "path"
_SETTLED = 1e-4
"""Relinearisation stops if no point moves along the path by more than this [mm]; with a slope of 1 mrad it is 0.1 nm"""
_CELLS_IN_A_PERIOD = 8
_INSIDE = 1e-6
"""Points are moved inside their leg by at least this [mm], so that each belongs to one cell"""
_ROUNDS = 7
_WILD = 8.0
"""Points farther off than this many standard deviations are left out; the median distance counts if it is larger"""


@dataclass(frozen=True)
class TrackMeasurement:
    """A track with its path, noise and cells."""

    machine: Machine
    path: Path
    track: Track
    noise: TrackerNoise
    cells: Array
    """Distances along the whole path at which cells begin, and its end [mm]"""
    settings: Settings
    effects: tuple[RequestedEffect, ...] = ()

    def with_noise_times(self, factor: float) -> TrackMeasurement:
        """Return the measurement with a factor on the declared noise of the tracker."""
        return replace(self, noise=self.noise.times(factor))


def measurement(
    settings: Settings, path: Table, track: Table, effects: Sequence[RequestedEffect] = ()
) -> TrackMeasurement:
    """Return a track aligned with its path; raises InputError if it does not match the path."""
    machine = machine_of(settings)
    legs = path_of(settings, machine, path)
    tool = tools_of(track, settings) if "tool" in track else None
    measured = cut(track, legs, error_blocks(machine, settings)[TOOL].values, tool, settings.corner)
    cells = legs.cells(machine, _longest_cell(effects))
    return TrackMeasurement(machine, legs, measured, settings.noise.of_tracker, cells, settings, tuple(effects))


def on_the_fly(whole: TrackMeasurement) -> AdjustedMachine:
    """Solve, and relinearise until no point moves along its leg."""
    settings = whole.settings
    tracker = tracker_block(whole.track.pose, settings.machine.tool_std)
    solved = solve(problem_at(whole, {**error_blocks(whole.machine, settings), TRACKER: tracker}), False)
    cut = _without_wild(whole, solved.solution.blocks)

    def at(state: Mapping[str, Block], before: Array) -> _Linearised:
        return _Linearised(state, ways(cut, state), before)

    def moved(here: _Linearised, again: AdjustedMachine) -> tuple[_Linearised, bool]:
        still = np.abs(here.way - here.before).max() < _SETTLED
        return (here, False) if still else (at(again.solution.blocks, here.way), True)

    begun = at(solved.solution.blocks, np.full(cut.track.points.shape[1], np.inf))
    return in_rounds(begun, lambda here: solved_again(solved, problem_at(cut, here.state)), moved, _ROUNDS)[1]


@dataclass(frozen=True)
class _Linearised:
    """A place of linearisation."""

    state: Mapping[str, Block]
    way: Array
    """Commanded distance of each point along its leg there, (n,)"""
    before: Array
    """The same at the place before"""


def _longest_cell(effects: Sequence[RequestedEffect]) -> float:
    """Return the longest cell for the periods of the effects: an eighth of a period is nearly a parabola."""
    periods = [float(effect.values["period"]) for effect in effects if "period" in effect.values]
    return min(periods, default=np.inf) / _CELLS_IN_A_PERIOD


def path_of(settings: Settings, machine: Machine, table: Table) -> Path:
    """Return the legs of a list of vertices; raises InputError if there are fewer than two."""
    vertices = commanded(machine, table).T
    path = Path.of(vertices, tools_of(table, settings))
    if len(path.lengths) < 2:
        raise InputError([Fault("the path has fewer than two legs", table.file)])
    return path


def problem_at(whole: TrackMeasurement, state: Mapping[str, Block]) -> MachineProblem:
    """Return the adjustment problem of the condensed track, linearised at the blocks of `state`."""
    path, track = whole.path, whole.track
    blocks = {**state, LEG: leg_block(_across(whole, state))}
    # a point on a vertex belongs to two legs: it is kept off both ends, in its own
    inside = np.clip(ways(whole, state), _INSIDE, path.lengths[track.leg] - _INSIDE)
    way = path.before[track.leg] + inside
    few = condense(way, _channels(whole, state), np.searchsorted(whole.cells, way, side="right"))
    leg = path.leg_of(whole.cells[np.clip(few.cell - 1, 0, None)])
    position = np.clip(path.at(leg, few.x - path.before[leg]), whole.machine.low[:, None], whole.machine.high[:, None])
    must_support(whole.machine, position, blocks)
    observations = _observations(whole, few, leg, position, blocks)
    facts = {"condensed_points": len(few.x), "noise_in_cells": _noise_in_cells(few, observations)}
    readings = Group(READINGS, path_chain(reach(whole.machine)), observations)
    problem = MachineProblem(
        model_of(blocks, readings, tool_prior(blocks, whole.settings)),
        whole.machine,
        few.weight,
        tools_used(whole.settings, path.tool[leg]),
        track.warnings,
        {**track.facts, **facts},
    )
    return problem.with_effects(whole.effects)


def _across(whole: TrackMeasurement, state: Mapping[str, Block]) -> Array:
    """Return two unit vectors across each leg in the tracker's frame, (legs, 2, 3)."""
    return np.asarray(whole.path.across @ poses.rotation_of(state[TRACKER].values[0]))


def _line(whole: TrackMeasurement, state: Mapping[str, Block]) -> tuple[Array, Array]:
    """Return the start and the direction of each leg as commanded, in the tracker's frame, (legs, 3) each."""
    pose = state[TRACKER].values[0]
    rotation = poses.rotation_of(pose)
    start = whole.path.start + state[TOOL].values[whole.path.tool] - pose[:3]
    return start @ rotation, whole.path.direction @ rotation


def _offset(whole: TrackMeasurement, state: Mapping[str, Block]) -> Array:
    """Return the coordinates of each commanded line across its leg, (legs, 2)."""
    return np.asarray(np.einsum("lab,lb->la", _across(whole, state), _line(whole, state)[0]))


def _channels(whole: TrackMeasurement, state: Mapping[str, Block]) -> Array:
    """Return two coordinates of each point across its leg, from the commanded line, its conditions, and its speed."""
    leg, points, conditions = whole.track.leg, whole.track.points, whole.track.conditions
    across = _across(whole, state)[leg]
    values = np.einsum("nab,bn->an", across, points) - _offset(whole, state)[leg].T
    given = [*conditions.values()]
    if "t" in conditions:
        given.append(whole.path.speeds(leg, ways(whole, state), conditions["t"]))
    return np.concatenate([values, *(condition[None] for condition in given)])


def ways(whole: TrackMeasurement, state: Mapping[str, Block]) -> Array:
    """Return the commanded distance along its leg at which the predicted path passes each point, (n,)."""
    start, direction = _line(whole, state)
    leg = whole.track.leg
    along = np.einsum("na,an->n", direction[leg], whole.track.points) - np.einsum("la,la->l", direction, start)[leg]
    marks, error = _errors_along(whole, state)
    return np.asarray(along - np.interp(along + _apart(whole.path, leg), marks, error[0]))


def _apart(path: Path, leg: Index) -> Array:
    """Return the distance along the path to the start of a leg, with gaps of 1 mm between the legs.

    The gaps keep the end of a leg apart from the start of the next, where the errors differ.
    """
    return np.asarray(path.before[leg] + leg)


def _errors_along(whole: TrackMeasurement, state: Mapping[str, Block]) -> tuple[Array, Array]:
    """Return distances along the path (with gaps between legs), (m,), and the predicted error there, (3, m).

    The rows are the error along the leg and its two components across the leg.
    """
    path, low, high = whole.path, whole.cells[:-1], whole.cells[1:]
    way = np.stack([low, (low + high) / 2, high], axis=1)
    leg = np.repeat(path.leg_of(way[:, 1]), 3)
    along = way.ravel() - path.before[leg]
    group = grid_group(whole.machine, path.at(leg, along), path.tool[leg])
    error = group.chain.predict(state, group.observations)[:3]
    directions = np.concatenate([path.direction[:, None], path.across], axis=1)[leg]
    return along + _apart(path, leg), np.einsum("mab,bm->am", directions, error)


def _observations(
    whole: TrackMeasurement, few: Condensed, leg: Index, position: Array, blocks: Mapping[str, Block]
) -> Observations:
    path = whole.path
    start, direction = _line(whole, blocks)
    seen = (start[leg] + direction[leg] * (few.x - path.before[leg])[:, None]).T
    across = blocks[LEG].values[leg].reshape(-1, 2, 3)
    covariance = np.einsum("nab,bcn,ndc->adn", across, whole.noise.covariance(seen), across) / few.weight
    condition = conditions(whole.machine, position) | {
        f"from_{axis}": signs[leg] for axis, signs in zip("xyz", path.last_moves(), strict=True)
    }
    condition |= path.since_turns(leg, few.x - path.before[leg])
    given = iter(few.values[2:])
    condition |= dict(zip(whole.track.conditions, given, strict=False))
    for speed in given:
        condition |= path.axis_speeds(leg, speed)
    return Observations(
        few.values[:2] + _offset(whole, blocks)[leg].T,
        np.ones(1),
        whole.machine.index(position) | {TOOL: path.tool[leg], LEG: leg},
        covariance=covariance,
        keys={"leg": tuple((leg + 1).astype(str).tolist())},
        conditions=condition,
        components=("a", "b"),
        unit="mm",
    )


def _noise_in_cells(few: Condensed, observations: Observations) -> float:
    """Return the standard deviation of single points about the parabolas of the cells, divided by the declared one."""
    if few.dof <= 0 or observations.covariance is None:
        return float("nan")
    variance = np.einsum("aan->n", observations.covariance) * few.weight
    declared = float((variance * few.weight).sum() / few.weight.sum())
    return float(np.sqrt(few.misfit[:2].sum() / few.dof / declared))


def _without_wild(whole: TrackMeasurement, state: Mapping[str, Block]) -> TrackMeasurement:
    """Return the measurement without points that are far from the predicted path."""
    track = whole.track
    marks, error = _errors_along(whole, state)
    at = ways(whole, state) + _apart(whole.path, track.leg)
    off = _channels(whole, state)[:2] - np.stack([np.interp(at, marks, row) for row in error[1:]])
    size = np.sqrt((off**2).sum(axis=0))
    declared = whole.noise.lateral(np.sqrt((track.points**2).sum(axis=0)))
    keep = size < _WILD * np.maximum(declared, float(np.median(size)))
    if keep.all():
        return whole
    count = int((~keep).sum())
    facts = {**track.facts, "cut_off_path": count, "points_used": int(keep.sum())}
    warnings = (
        *track.warnings,
        f"{counted(count, 'point')} of the track removed: farther than {_WILD:g} sigma from the predicted path",
    )
    return replace(whole, track=replace(track.selected(keep), facts=facts, warnings=warnings))
