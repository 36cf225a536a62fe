"""lengths: build the adjustment of lengths from tracking interferometers in several stations.

The reflector is at the tool; each length is `l + l0 = s |p + d(p) + T - x0|` with d the error of the machine. One
interferometer that is moved has several stations (sequential multilateration).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.instruments import tracer as t
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.axes.rotary import gauge
from metrocli.instruments.machine import AXES, TOOL
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support
from metrocli.tasks.calibrate_machine.files import NO_FILES, Files
from metrocli.tasks.calibrate_machine.methods.targets import BED, targets, with_distances
from metrocli.tasks.calibrate_machine.problem import MachineProblem, conditions, model_of
from metrocli.tasks.calibrate_machine.settings import LENGTHS, Settings
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.calibrate_machine.volume import grid_group, grid_of, without_rigid_motion
from metrocli.tasks.shared.environment import air_of, priors_of, unused
from metrocli.tasks.shared.lengths import PathNoise, stop_priors, stops_of
from metrocli.tasks.shared.tracers import NOTHING_FITS, LengthsToTracers, observed, places_of, tracers_of

READINGS = "lengths"


def lengths(settings: Settings, table: Table, files: Files = NO_FILES) -> MachineProblem:
    """Return the adjustment problem.

    Raises InputError if the lengths do not belong to the commanded points, and UndeterminedError if a station reads too
    few of them.
    """
    if "length" not in table:
        raise InputError([table.fault("the column 'length_mm' is missing", "it holds what the interferometers read")])
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    position = commanded(machine, table)
    measured = with_distances(targets(settings, blocks, table, files.reflectors), files.distances)
    on = settings.instrument.on
    nominal = measured.places(machine, position, on)
    read_by = tracers_of(table, files.listed_stations, dict.fromkeys, "station")
    must_support(machine, position, blocks)
    names = np.array(table.texts("point"), dtype=str)
    points, point = np.unique(names, return_inverse=True)
    air = air_of(settings.environment, table, "station")
    given = conditions(machine, position, table, nominal if machine.turns else None)
    readings = observed(table, read_by, (points.tolist(), point), given, air)
    time = readings.conditions.get("t")
    stops = stops_of(visits(position, measured.tool, point), time)
    observations = replace(
        readings,
        index={**machine.index(position), **measured.index, **readings.index, t.STOP: stops},
        conditions={
            **readings.conditions,
            t.ALONE: (stops == 0).astype(float),
            **(measured.conditions if machine.turns else {}),
        },
    )
    places = np.ascontiguousarray(nominal.T)
    extent = float(np.ptp(places, axis=0).max()) or 1.0
    seen = LengthsToTracers(read_by, np.arange(len(table)), places, table.numbers("length"), extent, file=table.file)
    station_block = t.tracer_block(
        _places(seen), read_by.names, read_by.free(False, settings.scale is not None), extent
    )
    if not machine.turns:
        refuse_backwards(station_block.values[:, :3], seen)
    noise = PathNoise.of(settings.noise.of_lengths)
    stop_block = t.stop_block(stops) if noise.repeatability else None
    more = (station_block, stop_block, None if air is None else air.block)
    unknowns = {**blocks, **measured.blocks, **{block.name: block for block in more if block is not None}}
    chain = t.chain(reach(machine, on, measured.workpiece), stop_block is not None, air is not None)
    others = (
        *measured.others,
        *gauge(machine, unknowns),
        *read_by.known(station_block, settings.scale),
        *stop_priors(stop_block, noise.repeatability),
        *priors_of(air),
    )
    return MachineProblem(
        model_of(
            unknowns,
            noise.at(Group(READINGS, chain, observations), unknowns),
            others,
            points.tolist(),
            stop_names(stops, names, time),
        ),
        machine,
        np.ones(len(table)),
        measured.used(list(settings.tools)),
        unused(settings.environment, table),
        notes=() if air is None else (air.note,),
        noise=noise,
        listed_at=read_by.listed_at,
        sees_bed=machine.turns and on == BED,
    )


def _places(seen: LengthsToTracers) -> Array:
    """Return the places of the stations at the start; raises InputError if no place fits their lengths.

    Positions, chain, sense or `at` may be wrong: a fault without a hint lets a task try them.
    """
    try:
        return places_of(seen)
    except InputError as error:
        nothing = [(fault.hint or "").startswith(NOTHING_FITS) for fault in error.faults]
        faults = [
            replace(fault, message=f"{fault.message}; {fault.hint}", hint=None) if none else fault
            for fault, none in zip(error.faults, nothing, strict=True)
        ]
        raise InputError(faults) from error


def stop_names(stops: Index, points: np.typing.NDArray[np.str_], time: Array | None) -> list[str]:
    """Return the names of the stops of several lengths, by point and time; the first stands for all other stops."""
    names = [t.NO_STOP]
    if time is not None:
        first = np.unique(stops, return_index=True)[1][int((stops == 0).any()) :]
        names += [f"{points[row]} at {time[row]:g} s" for row in first]
    return names


def first_read(path: Array, station: Index) -> Array:
    """Return for each path (n,) the first one of its station, from which an interferometer counts, (n,)."""
    _, first, of = np.unique(station, return_index=True, return_inverse=True)
    return np.asarray(path[first][of])


def visits(position: Array, tool: Index, point: Index) -> Index:
    """Return a number for each commanded place with its tool and point, (n,)."""
    return np.unique(np.vstack([position, tool, point]), axis=1, return_inverse=True)[1].ravel()


_NEARER = 0.25
"""The median distance of stations from their list has to fall below this share of itself when they are mirrored"""


def refuse_backwards(measured: Array, seen: LengthsToTracers) -> None:
    """Raise InputError if places of stations (n, 3) are near their list only with one axis mirrored about its middle.

    The middle is that of the reflectors, which tools carry away from the axes.

    Only places listed without a standard uncertainty are compared: the others are kept.
    """
    listed_at, sigma = seen.tracers.listed_at, seen.tracers.sigma
    rough = np.isfinite(listed_at).all(axis=1) & np.isnan(sigma).all(axis=1)
    if not rough.any():
        return
    measured, listed_at = measured[rough], listed_at[rough]
    twice = seen.points.min(axis=0) + seen.points.max(axis=0)
    mirrored = [_miss(np.where(np.arange(3) == axis, twice - measured, measured), listed_at) for axis in range(3)]
    axis = int(np.argmin(mirrored))
    if mirrored[axis] < _NEARER * _miss(measured, listed_at):
        raise InputError([_fault(AXES[axis], _miss(measured, listed_at), mirrored[axis], seen.file)])


def _miss(measured: Array, listed_at: Array) -> float:
    return float(np.median(np.linalg.norm(measured - listed_at, axis=1)))


def _fault(axis: str, as_read: float, mirrored: float, file: str) -> Fault:
    text = (
        f"the lengths place the stations {as_read:.0f} mm from their list, "
        f"and {mirrored:.0f} mm from it if {axis} counts the other way"
    )
    return Fault(text, file, hint=f"reverse the sense of {axis.lower()} in this file, or in the list of the stations")


def unseen_senses(tables: Tables, settings: Settings) -> dict[str, float]:
    """Return the axes whose sense no length shows, each with the change of the error in the volume [mm].

    It is `max |S e(S x) - e(x)|` with the mirror S of the axis about its middle, without shift and rotation of the
    whole.
    """
    if settings.method != LENGTHS or settings.inputs.stations is not None or tables.machine.turns:
        return {}
    counts = settings.volume.counts()
    position = grid_of(tables.machine, counts)
    motion = _error(tables, position)
    vectors = tables.blocks[TOOL].values
    alike = np.ptp(vectors, axis=0) <= settings.machine.tool_std
    backwards = {axis: _mirrored(motion, counts, axis) for axis in np.flatnonzero(alike).tolist()}
    return {
        AXES[axis]: float(np.linalg.norm(without_rigid_motion(mirrored - motion, position), axis=0).max())
        for axis, mirrored in backwards.items()
    }


def _error(tables: Tables, position: Array) -> Array:
    """Return the error motion of the first tool at positions (3, n), (6, n)."""
    group = grid_group(tables.machine, position, 0)
    return group.chain.predict(tables.blocks, group.observations)


def _mirrored(motion: Array, counts: Sequence[int], axis: int) -> Array:
    """Return the error motion (6, n) on a grid of the machine of which an axis is mirrored about its middle."""
    mirrored = np.flip(motion.reshape(-1, *counts), axis + 1).reshape(motion.shape)
    mirrored[axis] *= -1
    return mirrored
