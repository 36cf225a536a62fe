"""Plan stations and points of lengths: the least uncertainty over the volume in a given time, or the shortest time.

All candidates read the same points. A station's own place and dead path are eliminated from its normal matrix, so the
matrices of stations add, and each is proportional to the number of points. The next station is the one that leaves the
least mean variance in the volume (greedy choice).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from metrocli.adjust.dense_jacobian import Unknowns, normal_matrix, rows, unknowns_of
from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments.machine import POSITION, TOOL, Machine
from metrocli.instruments.tracer import TRACER
from metrocli.nc_program import Block as NcBlock
from metrocli.nc_program import Stop, program
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.lengths import lengths
from metrocli.tasks.calibrate_machine.plans.planned import PLACES, REST, judged, planned, worth_of
from metrocli.tasks.calibrate_machine.plans.stops import all_over, visits_with_tools
from metrocli.tasks.calibrate_machine.problem import ERROR_BLOCKS, MachineProblem, tools_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.volume import grid_group, grid_of, without_rigid_motion
from metrocli.tasks.shared.lists import listed_places
from metrocli.units import roughly

_TRIED = 150
"""Points for each tool with which candidates are compared"""
_FEWEST, _MOST = 60, 5000
"""Fewest and most points that a station reads with each tool"""
_AROUND = (-0.5, 0.5, 1.5)
_HEIGHTS = (0.0, 0.5, 1.0)
"""Candidates beside the volume, as shares of its size"""
_STATIONS = 8
"""Most stations"""


@dataclass(frozen=True)
class _Choice:
    """Stations in the order of their choice, with what they cost and give."""

    stations: tuple[int, ...]
    points: int
    """For each tool, read from each station"""
    uncertainty: float
    time: float


def plan_of_stations(settings: Settings, table: Table | None, listed: Table | None) -> Plan:
    """Return what the job's lengths will determine, and propose stations and points.

    The candidates are the listed stations, or places all around the volume. Raises UndeterminedError if the time is too
    short for three stations.
    """
    wanted, machine = settings.plan, machine_of(settings)
    own = []
    if table is not None:
        held = Files(stations=listed)
        own = judged(f"the lengths of the job: {len(table)}", settings, lambda: lengths(settings, table, held))
    candidates = _beside(machine) if listed is None else listed.stacked("xyz")
    names = [f"S{i + 1}" for i in range(_STATIONS)] if listed is None else listed.texts("station")
    choice = _chosen(settings, candidates)
    chosen = [names[i] for i in choice.stations] if listed is not None else names[: len(choice.stations)]
    places = candidates[list(choice.stations)]
    points = all_over(settings, choice.points)
    worth = worth_of(settings, _problem(settings, points, places, chosen))
    stations = listed_places("station", chosen, places)
    notes = [
        *own,
        f"proposed: {len(chosen)} stations, each reads {len(points)} points, {choice.time / 3600:.1f} h",
    ]
    figures = (
        Estimate("stations", float(len(chosen)), 0.0, "1"),
        Estimate("points", float(len(points)), 0.0, "1"),
        Estimate("uncertainty", choice.uncertainty, 0.0, "mm"),
        Estimate("duration", choice.time, 0.0, "s"),
    )
    warnings = []
    if wanted.uncertainty is not None and choice.uncertainty > wanted.uncertainty:
        warnings.append(
            f"the best stations leave {roughly(choice.uncertainty, 'um')} in the volume, more than "
            f"{roughly(wanted.uncertainty, 'um')}: allow more time, or measure with less noise"
        )
    files: dict[str, Table | str] = {
        "stations.csv": stations,
        "points.csv": points,
        "points.nc": _program(settings, points, chosen),
    }
    return planned(notes, figures, worth, files, warnings)


def _beside(machine: Machine) -> Array:
    """Return candidates all around the volume, at three heights, (n, 3)."""
    shares = [(x, y, z) for z in _HEIGHTS for x in _AROUND for y in _AROUND if (x, y) != (0.5, 0.5)]
    return np.asarray(machine.low + np.array(shares) * (machine.high - machine.low))


def _chosen(settings: Settings, candidates: Array) -> _Choice:
    wanted = settings.plan
    choices = list(_in_turn(settings, candidates))
    if not choices:
        raise UndeterminedError(
            f"{wanted.time / 3600:.1f} h are too short for three stations with {_FEWEST} points for each tool: "
            "give `plan: {time: ...}` more, or use fewer knots"
        )
    enough = [
        choice for choice in choices if wanted.uncertainty is not None and choice.uncertainty <= wanted.uncertainty
    ]
    if enough:
        return min(enough, key=lambda choice: choice.time)
    return min(choices, key=lambda choice: choice.uncertainty)


def _in_turn(settings: Settings, candidates: Array) -> Iterator[_Choice]:
    """Yield the greedy choice of 3, 4, ... stations, each with the points that time or uncertainty ask for."""
    table, wanted = all_over(settings, _TRIED), settings.plan
    matrices, volume, reach = _matrices(settings, table, candidates)
    tools, step = len(settings.tools), _time_of_a_point(table, wanted.feed)
    chosen: list[int] = []
    known, left = np.diag(reach**-2.0), set(range(len(candidates)))
    while left and len(chosen) < _STATIONS:
        variances = {i: float(np.einsum("ab,ba->", np.linalg.inv(known + matrices[i]), volume)) for i in sorted(left)}
        best = min(variances, key=lambda i: variances[i])
        chosen, known, left = [*chosen, best], known + matrices[best], left - {best}
        most = int((wanted.time / len(chosen) - wanted.setup) / (step * tools)) - 8
        if len(chosen) < 3 or most < _FEWEST:
            continue
        points = min(most, _MOST)
        unit = float(np.sqrt(variances[best] * (_TRIED + 8)))
        if wanted.uncertainty is not None:
            points = min(max(int(np.ceil((unit / wanted.uncertainty) ** 2)) - 8, _FEWEST), points)
        time = len(chosen) * (wanted.setup + (points + 8) * tools * step)
        yield _Choice(tuple(chosen), points, unit / np.sqrt(points + 8), time)


def _matrices(settings: Settings, table: Table, candidates: Array) -> tuple[list[Array], Array, Array]:
    """Return the normal matrix of the errors for each candidate, that of the volume, and the reach of the errors."""
    matrices = []
    for place in candidates:
        problem = _problem(settings, table, place[None], ["S"])
        names = [name for name in ERROR_BLOCKS if name in problem.blocks and name != TOOL]
        unknowns = unknowns_of(problem.blocks, [*names, TRACER])
        whole = normal_matrix([problem.readings], problem.blocks, unknowns)
        errors = unknowns_of(problem.blocks, names)
        n = errors.size
        matrices.append(whole[:n, :n] - whole[:n, n:] @ np.linalg.solve(whole[n:, n:], whole[n:, :n]))
    return matrices, _volume(settings, problem, errors), errors.reach(problem.blocks)


def _volume(settings: Settings, problem: MachineProblem, errors: Unknowns) -> Array:
    """Return the mean square error vector over the grid of the volume, without rigid motion, as a quadratic form."""
    position = grid_of(problem.machine, settings.volume.counts())
    total = np.zeros((errors.size, errors.size))
    for tool in range(len(settings.tools)):
        moved = rows(grid_group(problem.machine, position, tool), problem.blocks, errors)
        flat = without_rigid_motion(moved, position).reshape(-1, errors.size)
        total += flat.T @ flat
    return np.asarray(total / (position.shape[1] * len(settings.tools)))


def _time_of_a_point(table: Table, feed: float) -> float:
    moves = np.linalg.norm(np.diff(table.stacked(POSITION), axis=0), axis=1)
    return float(moves.mean() / feed + REST)


def _problem(settings: Settings, points: Table, places: Array, names: list[str]) -> MachineProblem:
    """Return the adjustment of lengths from stations to all points, on a machine without errors."""
    vectors = np.array(list(settings.tools.values()))[tools_of(points, settings)]
    reflector, n = points.stacked(POSITION) + vectors, len(points)
    path = np.concatenate([np.linalg.norm(reflector - place, axis=1) for place in places])
    again = np.tile(np.arange(n), len(places))
    every = replace(points.selected(again), file="lengths.csv")
    table = every.joined({"station": np.repeat(np.array(names), n), "length [mm]": path - path[0]})
    listed = replace(listed_places("station", names, places), file="stations.csv")
    return lengths(settings, table, Files(stations=listed))


def _program(settings: Settings, points: Table, stations: list[str]) -> str:
    blocks: list[NcBlock] = []
    for station in stations:
        blocks.append(Stop(f"set the interferometer up at {station}"))
        blocks += visits_with_tools(settings, points)
    remarks = [*PLACES, "a reading in each dwell"]
    return program("metrocli lengths for calibrate-machine", remarks, blocks, settings.plan.control)
