"""Simulated lengths from tracers to points that differ from the mover's readings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.model import Model, Place
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError
from metrocli.instruments import tracer as t
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.multilaterate.layout import PlannedPoints
from metrocli.tasks.multilaterate.problem import LENGTHS
from metrocli.tasks.multilaterate.settings import LengthSimulation, Settings
from metrocli.tasks.shared.environment import Air, air_of
from metrocli.tasks.shared.lengths import LengthNoise, PathNoise, shared_at_stops, stops_of
from metrocli.tasks.shared.lists import listed_places, matched
from metrocli.tasks.shared.statistics import CONDITIONS, heading


def simulated(
    settings: Settings,
    truth: LengthSimulation,
    planned: PlannedPoints,
    effects: Sequence[RequestedEffect],
    rng: np.random.Generator,
) -> Simulation:
    """Return lengths from tracers at their listed places to the true points, with effects and noise.

    The list of points holds the mover's readings; the true points differ from them by the mover's error.
    Interferometers are set to zero at the first point. The errors of the scales are drawn from their uncertainty,
    and so are the error that they share and that of the air.
    """
    nominal, places = planned.points.stacked("xyz"), planned.tracers.stacked("xyz")
    if len(nominal) == 0 or len(places) == 0:
        raise InputError("simulation: there are no points or no tracers")
    centre = nominal.mean(axis=0)
    actual = centre + (nominal - centre) / (1 + truth.mover_scale)
    actual = actual + rng.normal(0.0, 1.0, actual.shape) * truth.mover_error
    distance = np.linalg.norm(actual[:, None] - places, axis=2)
    spread = 0.0 if settings.scale is None else settings.scale.uncertainty
    scale = 1 + rng.normal(0.0, 1.0, len(places)) * spread
    if settings.scale is not None and settings.scale.common:
        scale += rng.normal() * settings.scale.common
    dead = np.zeros(len(places)) if settings.measures == "absolute" else scale * distance[0]
    stations = np.column_stack([places, dead, scale])
    design = planned.design(truth)
    air = air_of(settings.environment, design, "tracer")
    model = _model(design, planned, actual, stations, air, 0.0 if air is None else rng.normal() * air.std)
    model = extended(model, effects)
    observations = model.groups[0].observations
    path = distance[observations.index[t.POINT], observations.index[t.TRACER]]
    sigma = np.sqrt(settings.noise.constant**2 + (settings.noise.proportional * path) ** 2)
    reading = model.groups[0].chain.predict(model.blocks, observations)[0] + rng.normal(0.0, 1.0, path.shape) * sigma
    reading = reading + _returns(settings.noise, observations, actual, places, rng)
    reading = reading if air is None else reading / air.towards
    listed_at = places + rng.normal(0.0, 1.0, places.shape) * truth.tracer_error
    when = {heading(name): condition for name, condition in design.conditions(*CONDITIONS).items()}
    lengths = Table.of({**{name: design.columns[name] for name in ("point", "tracer")}, "length [mm]": reading, **when})
    names = planned.tracers.texts("tracer")
    files = {
        "lengths.csv": lengths,
        "tracers.csv": listed_places("tracer", names, listed_at),
        "true_points.csv": listed_places("point", planned.points.texts("point"), actual),
    }
    return Simulation(files, _named(names, stations) | true_values(model))


def _returns(
    noise: LengthNoise, observations: Observations, points: Array, places: Array, rng: np.random.Generator
) -> Array | float:
    """Return how much the mover's return to its places changes each length, (n,); 0 without a repeatability."""
    size = PathNoise.of(noise)
    if not size.repeatability or size.std is not None:
        return 0.0
    point, tracer = observations.index[t.POINT], observations.index[t.TRACER]
    stops = stops_of(point, observations.conditions.get("t"))
    beam = points[point] - places[tracer]
    own = rng.normal(0.0, size.repeatability, beam.shape)
    deviation = shared_at_stops(own, stops, size.repeatability, rng)
    return np.asarray((beam * deviation).sum(axis=1) / np.linalg.norm(beam, axis=1))


def _named(names: Sequence[str], stations: Array) -> dict[str, float]:
    return {
        f"{name}.{column}": float(stations[i, k]) for i, name in enumerate(names) for k, column in enumerate(t.COLUMNS)
    }


def _model(
    design: Table, planned: PlannedPoints, points: Array, stations: Array, air: Air | None, error: float
) -> Model:
    """Return the forward model of the design at the truth, `error` that of the air; its readings are zero."""
    names, tracers = planned.points.texts("point"), planned.tracers.texts("tracer")
    index = {t.POINT: matched(design, "point", names, "the points")}
    index[t.TRACER] = matched(design, "tracer", tracers, "the tracers")
    conditions = design.conditions("t", "temp")
    if air is not None:
        conditions[t.AIR] = air.ratio
    observations = Observations(np.zeros((1, len(design))), np.ones(1), index, conditions=conditions)
    point = t.point_block(points, names, False, 1.0)
    tracer = t.tracer_block(stations, tracers, np.zeros(stations.shape, dtype=bool), 1.0)
    places = {"point": Place(tuple(names), t.POINT), "tracer": Place(tuple(tracers), t.TRACER)}
    group = Group(LENGTHS, t.chain(in_air=air is not None), observations)
    nominal = {t.POINT: planned.points.stacked("xyz")}
    blocks = {t.POINT: point, t.TRACER: tracer}
    if air is not None:
        blocks[t.AIR] = air.block.with_values(np.array([[error]]))
    return Model(blocks, (group,), None, (LENGTHS,), places, t.aspects(t.reach()), nominal=nominal)
