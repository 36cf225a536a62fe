"""lengths: build the adjustment of lengths from tracking interferometers in several stations.

The reflector is at the tool; each length is `l + l0 = s |p + d(p) + T - x0|` with d the error of the machine. One
interferometer that is moved has several stations (sequential multilateration).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Index, Observations
from metrocli.errors import InputError
from metrocli.instruments import tracer as t
from metrocli.instruments.machine import TOOL
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.methods.backwards import refuse_backwards
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
from metrocli.tasks.shared.environment import air_of, priors_of, unused
from metrocli.tasks.shared.known_places import sigmas
from metrocli.tasks.shared.lengths import PathNoise, scale_priors, stop_priors, stops_of
from metrocli.tasks.shared.pairs import told_apart
from metrocli.tasks.shared.tracer_places import Seen, places_of
from metrocli.words import nearest

READINGS = "lengths"


def lengths(settings: Settings, table: Table, stations: Table | None = None) -> Problem:
    """Return the adjustment problem.

    Raises InputError if the lengths do not belong to the commanded points, and UndeterminedError if a station reads too
    few of them.
    """
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    tool = tools_of(table, settings)
    position = commanded(machine, table)
    seen = _seen(table, stations, position + blocks[TOOL].values[tool].T)
    must_support(machine, position, blocks)
    names = np.array(table.texts("point"), dtype=str)
    points, point = np.unique(names, return_inverse=True)
    given = conditions(position, table)
    noise = PathNoise.of(settings.noise.of_lengths)
    stops = stops_of(visits(position, tool, point), given.get("t"))
    stop_block = t.stop_block(stops if noise.repeatability else np.zeros_like(stops))
    station_block = _stations(settings, seen)
    refuse_backwards(station_block.values[:, :3], seen)
    unknowns: dict[str, Block] = {**blocks, t.TRACER: station_block}
    index = machine.index(position) | {TOOL: tool, t.TRACER: seen.tracer, t.POINT: np.asarray(point, dtype=np.intp)}
    index[t.STOP] = stops
    if stop_block is not None:
        unknowns[t.STOP] = stop_block
    keys = {"point": tuple(names.tolist()), "station": tuple(table.texts("station"))}
    air = air_of(settings.environment, table, "station")
    if air is not None:
        unknowns[t.AIR], given[t.AIR] = air.block, air.ratio
    observations = Observations(
        seen.length[None] if air is None else (seen.length * air.towards)[None],
        np.array(noise.constant),
        index,
        keys=told_apart(keys, point * len(seen.tracers) + seen.tracer, given.get("t")),
        conditions=given | {t.ALONE: (stops == 0).astype(float)},
        components=("length",),
        unit="mm",
    )
    to = t.reach_of_machine(machine)
    readings = noise.at(Group(READINGS, t.chain(to, stop_block is not None, air is not None), observations), unknowns)
    others = (*_known(settings, seen, unknowns, noise), *priors_of(air))
    tools = list(settings.tools)
    return Problem(
        model_of(unknowns, readings, others, points.tolist(), stop_names(stops, names, given.get("t"))),
        machine,
        np.ones(len(table)),
        tuple(tools[i] for i in np.unique(tool)),
        unused(settings.environment, table),
        notes=() if air is None else (air.note,),
        noise=noise,
    )


def _known(settings: Settings, seen: Seen, unknowns: Mapping[str, Block], noise: PathNoise) -> tuple[Group, ...]:
    """Return the priors of tool vectors, stations, scales and stops."""
    stations = unknowns[t.TRACER]
    sigma = np.column_stack([seen.sigma, np.full((len(seen.tracers), 2), np.nan)])
    return (
        *tool_prior(unknowns, settings),
        *priors(stations, sigma, stations.free),
        *scale_priors(settings.scale, stations),
        *stop_priors(unknowns.get(t.STOP), noise.repeatability),
    )


def stop_names(stops: Index, points: np.typing.NDArray[np.str_], time: Array | None) -> list[str]:
    """Return the names of the stops of several lengths, by point and time; the first stands for all other stops."""
    found = [t.NO_STOP]
    if time is not None:
        first = np.unique(stops, return_index=True)[1][int((stops == 0).any()) :]
        found += [f"{points[row]} at {time[row]:g} s" for row in first]
    return found


def visits(position: Array, tool: Index, point: Index) -> Index:
    """Return a number for each commanded place with its tool and point, (n,)."""
    return np.unique(np.vstack([position, tool, point]), axis=1, return_inverse=True)[1].ravel()


def _seen(table: Table, stations: Table | None, reflector: Array) -> Seen:
    """Return the lengths by station, with reflectors (3, n) where the machine is commanded to.

    Raises InputError that names every station of a length that is not listed.
    """
    used = list(dict.fromkeys(table.texts("station")))
    column = np.array(table.texts("station"), dtype=str)
    known = used if stations is None else stations.texts("station")
    unlisted = [name for name in used if name not in known]
    if stations is not None and unlisted:
        raise InputError(
            [
                table.fault_at(
                    int(np.argmax(column == name)),
                    f"station '{name}' is not in {stations.file}",
                    f"did you mean '{near}'?" if (near := nearest(name, known)) else "",
                )
                for name in unlisted
            ]
        )
    order = [name for name in known if name in used]
    said = sigma = np.full((len(order), 3), np.nan)
    if stations is not None:
        rows = [known.index(name) for name in order]
        said, sigma = stations.stacked("xyz")[rows], sigmas(stations)[rows]
    number = {name: i for i, name in enumerate(order)}
    return Seen(
        tuple(order),
        np.array([number[name] for name in column.tolist()], dtype=np.intp),
        np.ascontiguousarray(reflector.T),
        table.numbers("length"),
        said,
        sigma,
        float(np.ptp(reflector, axis=1).max()) or 1.0,
        file=table.file,
        noun="station",
    )


def _stations(settings: Settings, seen: Seen) -> Block:
    free = np.ones((len(seen.tracers), 5), dtype=bool)
    free[:, :3] = seen.sigma != 0
    free[:, 4] = settings.scale is not None
    return t.tracer_block(places_of(seen), seen.tracers, free, seen.extent)
