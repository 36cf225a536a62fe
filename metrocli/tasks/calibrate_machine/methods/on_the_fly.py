"""On-the-fly: a track without synchronisation, condensed along its path and linearised where the machine really was.

Only what lies across each leg is used (Sanders et al. 1.2.4-1.2.5). A point is taken for the commanded position at
which the predicted path passes it, so that the error along the path, which is not measured, does not enter: the
closest point of the commanded path is off by it. Within a cell, between the knots that a leg passes, all errors are
parabolas of the way, so three condensed points stand for all. Their weights are those of the directions across the
leg, `A C A'` with the beam's direction in C (eq. 8-9); the equation for W22 has the path's direction in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index, Observations
from metrocli.adjust.stream_condensation import Condensed, condense
from metrocli.effects.wanted import Wanted
from metrocli.errors import Fault, InputError
from metrocli.geometry import poses
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.tracker import LEG, TRACKER, TrackerNoise, leg_block, path_chain, tracker_block
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.methods.standstill import tracker_noise
from metrocli.tasks.calibrate_machine.methods.track import Track, cut
from metrocli.tasks.calibrate_machine.problem import (
    Problem,
    commanded,
    conditions,
    error_blocks,
    machine_of,
    model_of,
    must_support,
    tool_prior,
    tools_of,
)
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import Solved, solve, solved_again
from metrocli.tasks.calibrate_machine.volume import grid_group

READINGS = "path"
_SETTLED = 1e-4
"""Ways along the path that move by less than this [mm] are found: times a slope of 1 mrad it is 0.1 nm"""
_CELLS_IN_A_PERIOD = 8
_INSIDE = 1e-6
"""Points are taken to be inside their leg by this [mm]"""
_ROUNDS = 8
_WILD = 8.0
"""Points farther off than so many standard deviations are left out, where these are of the declared size"""


@dataclass(frozen=True)
class Measurement:
    """A track on its path."""

    machine: Machine
    path: Path
    track: Track
    noise: TrackerNoise
    cells: Array
    """Ways where cells begin"""
    settings: Settings
    effects: tuple[Wanted, ...] = ()


def on_the_fly(settings: Settings, path: Table, track: Table, effects: Sequence[Wanted] = ()) -> Solved:
    """Return the solved calibration; InputError where the track is not one of the path."""
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    legs = path_of(settings, machine, path)
    tool = tools_of(track, settings) if "tool" in track else None
    vectors = blocks[TOOL].values
    measured = cut(track, legs, vectors, tool, settings.corner)
    cells = legs.cells(machine, _longest_cell(effects))
    whole = Measurement(machine, legs, measured, tracker_noise(settings), cells, settings, tuple(effects))
    state: Mapping[str, Block] = {**blocks, TRACKER: tracker_block(measured.pose, settings.machine.tool_uncertainty)}
    return _settled(whole, state)


def _longest_cell(effects: Sequence[Wanted]) -> float:
    """Return how long a cell may be: an eighth of a period is a parabola."""
    periods = [float(one.values["period"]) for one in effects if "period" in one.values]
    return min(periods, default=np.inf) / _CELLS_IN_A_PERIOD


def path_of(settings: Settings, machine: Machine, table: Table) -> Path:
    """Return the legs of a list of vertices; InputError where there are none."""
    vertices = commanded(machine, table).T
    path = Path.of(vertices, tools_of(table, settings))
    if len(path.lengths) < 2:
        raise InputError([Fault("the path has fewer than two legs", table.file)])
    return path


def _settled(whole: Measurement, state: Mapping[str, Block]) -> Solved:
    """Linearise and solve again until no point moves along its leg any more."""
    solved = solve(problem_at(whole, state), False)
    whole = _without_wild(whole, solved.solution.blocks)
    way = np.full(whole.track.points.shape[1], np.inf)
    for _ in range(_ROUNDS):
        state = solved.solution.blocks
        before, way = way, ways(whole, state)
        solved = solved_again(solved, problem_at(whole, state))
        if np.abs(way - before).max() < _SETTLED:
            break
    return solved


def problem_at(whole: Measurement, state: Mapping[str, Block]) -> Problem:
    """Return the adjustment of the condensed track, linearised at a state."""
    path, track = whole.path, whole.track
    blocks = {**state, LEG: leg_block(_across(whole, state))}
    inside = np.clip(ways(whole, state), _INSIDE, path.lengths[track.leg] - _INSIDE)
    way = path.before[track.leg] + inside
    few = condense(way, _channels(whole, state), np.searchsorted(whole.cells, way, side="right"))
    leg = path.leg_of(whole.cells[np.clip(few.cell - 1, 0, None)])
    position = np.clip(path.at(leg, few.x - path.before[leg]), whole.machine.low[:, None], whole.machine.high[:, None])
    must_support(whole.machine, position, blocks)
    observations = _observations(whole, few, leg, position, blocks)
    names = list(whole.settings.tools)
    facts = {"condensed_points": len(few.x), "noise_in_cells": _noise_in_cells(few, observations)}
    readings = Group(READINGS, path_chain(whole.machine), observations)
    problem = Problem(
        model_of(blocks, readings, tool_prior(blocks, whole.settings)),
        whole.machine,
        few.weight,
        tuple(names[i] for i in np.unique(path.tool[leg])),
        track.warnings,
        {**track.facts, **facts},
    )
    return problem.with_effects(whole.effects)


def _across(whole: Measurement, state: Mapping[str, Block]) -> Array:
    """Return the directions across each leg in the tracker's frame, (legs, 2, 3)."""
    return np.asarray(whole.path.across @ poses.rotation_of(state[TRACKER].values[0]))


def _line(whole: Measurement, state: Mapping[str, Block]) -> tuple[Array, Array]:
    """Return the start and the direction of each leg as commanded, in the tracker's frame, (legs, 3) each."""
    pose = state[TRACKER].values[0]
    rotation = poses.rotation_of(pose)
    start = whole.path.start + state[TOOL].values[whole.path.tool] - pose[:3]
    return start @ rotation, whole.path.direction @ rotation


def _offset(whole: Measurement, state: Mapping[str, Block]) -> Array:
    """Return the two coordinates across each leg of its commanded line, (legs, 2)."""
    return np.asarray(np.einsum("lab,lb->la", _across(whole, state), _line(whole, state)[0]))


def _channels(whole: Measurement, state: Mapping[str, Block]) -> Array:
    """Return the coordinates of every point across its leg, from the commanded line; and time where there is one."""
    leg, points, time = whole.track.leg, whole.track.points, whole.track.time
    across = _across(whole, state)[leg]
    values = np.einsum("nab,bn->an", across, points) - _offset(whole, state)[leg].T
    return values if time is None else np.concatenate([values, time[None]])


def ways(whole: Measurement, state: Mapping[str, Block]) -> Array:
    """Return the commanded way along its leg at which the predicted path passes each point, (n,)."""
    start, direction = _line(whole, state)
    leg = whole.track.leg
    along = np.einsum("na,an->n", direction[leg], whole.track.points) - np.einsum("la,la->l", direction, start)[leg]
    marks, error = _errors_along(whole, state)
    return np.asarray(along - np.interp(along + _apart(whole.path, leg), marks, error[0]))


def _apart(path: Path, leg: Index) -> Array:
    """Return the way before a leg, with a gap of 1 mm between legs: the end of one is not the start of the next."""
    return np.asarray(path.before[leg] + leg)


def _errors_along(whole: Measurement, state: Mapping[str, Block]) -> tuple[Array, Array]:
    """Return ways (with gaps between legs) and the predicted error there: along the leg, and the two across, (3, m)."""
    path, low, high = whole.path, whole.cells[:-1], whole.cells[1:]
    way = np.stack([low, (low + high) / 2, high], axis=1)
    leg = np.repeat(path.leg_of(way[:, 1]), 3)
    along = way.ravel() - path.before[leg]
    group = grid_group(whole.machine, path.at(leg, along), path.tool[leg])
    error = group.chain.predict(state, group.observations)[:3]
    directions = np.concatenate([path.direction[:, None], path.across], axis=1)[leg]
    return along + _apart(path, leg), np.einsum("mab,bm->am", directions, error)


def _observations(
    whole: Measurement, few: Condensed, leg: Index, position: Array, blocks: Mapping[str, Block]
) -> Observations:
    path = whole.path
    start, direction = _line(whole, blocks)
    seen = (start[leg] + direction[leg] * (few.x - path.before[leg])[:, None]).T
    across = blocks[LEG].values[leg].reshape(-1, 2, 3)
    covariance = np.einsum("nab,bcn,ndc->adn", across, whole.noise.covariance(seen), across) / few.weight
    condition = conditions(position) | {
        f"from_{axis}": signs[leg] for axis, signs in zip("xyz", path.last_moves(), strict=True)
    }
    if len(few.values) > 2:
        condition["t"] = few.values[2]
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
    """Return the standard deviation of single points about the parabolas, over the declared one."""
    if few.dof <= 0 or observations.covariance is None:
        return float("nan")
    variance = np.einsum("aan->n", observations.covariance) * few.weight
    declared = float((variance * few.weight).sum() / few.weight.sum())
    return float(np.sqrt(few.misfit[:2].sum() / few.dof / declared))


def _without_wild(whole: Measurement, state: Mapping[str, Block]) -> Measurement:
    """Return the measurement without points that are off the predicted path."""
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
        f"{count} points of the track are off the predicted path by {_WILD:g} sigma, and are cut",
    )
    return replace(whole, track=replace(track.selected(keep), facts=facts, warnings=warnings))
