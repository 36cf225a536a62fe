"""An adjusted network in the form that diagnosis needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution
from metrocli.arrays import Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate
from metrocli.effects.estimates import free_blocks
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION, FACE
from metrocli.tasks.adjust_network import KIND, usual
from metrocli.tasks.adjust_network.effects import MOVED, NO_MIRROR, NO_TIMES, STEERING
from metrocli.tasks.adjust_network.groups import GIVEN_POINTS, is_certified, is_sighting
from metrocli.tasks.adjust_network.noise import ideal
from metrocli.tasks.adjust_network.solve import AdjustedNetwork, refitted
from metrocli.tasks.shared.diagnosed import FOLDS, in_time
from metrocli.tasks.shared.lists import unless_without_noise
from metrocli.tasks.shared.noise import POINTS_IN_TIME, JobNoise, in_blocks, job_noise


def adjusted_job(solved: AdjustedNetwork) -> AdjustedJob:
    """Return an adjusted network in the form that diagnosis needs."""
    network = solved.network
    model = with_conditions(replace(network.model, blocks=solved.solution.blocks, groups=solved.solution.groups))

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return refitted(network.with_model(changed), keep)

    free = model.blocks[t.POINT].free.any()
    stations = next((name for name in (s.STATION, s.LEVELLED, t.TRACER) if name in model.blocks), t.POINT)
    timed = any("t" in group.observations.conditions for group in model.readings)
    places = model.places
    delivered = ("point coordinates", t.POINT) if free else ("places of the stations", stations)
    return AdjustedJob(
        KIND.name,
        model,
        tuple(usual.effects(network.readings)),
        tuple(covariates(model)),
        ("station",),
        {group.name: _folds(group) for group in model.readings},
        Delivered(*delivered, (0, 1, 2), "um", "length"),
        refit,
        noisier=("instrument",) if 1 < len(places["instrument"].names) < len(places["station"].names) else (),
        list_offset=solved.list_offset,
        left_out=len(solved.rejected),
        fewest=1,
        certified=frozenset(reading.name for reading in model.readings if is_certified(reading.name)),
        not_sought={STEERING: NO_MIRROR} | ({} if timed else {MOVED: NO_TIMES}),
        variations=_variations,
        noticed=(*network.readings.warnings, *unless_without_noise(network.readings.stuck, solved.solution.sigma0)),
    )


def covariates(model: Model) -> Iterator[Covariate]:
    """Yield the quantities with which an unknown effect on sightings could vary."""
    groups = [group for group in model.readings if is_sighting(group)]
    yield from in_time(groups)
    seen = {group.name: ideal(group, model.blocks) for group in groups}
    if seen:
        yield Covariate("azimuth", {name: values[AZIMUTH] for name, values in seen.items()}, angle=True)
        yield Covariate("elevation", {name: values[ELEVATION] for name, values in seen.items()})
        yield Covariate("distance_mm", {name: values[DISTANCE] for name, values in seen.items()})


def _folds(group: Group) -> Index:
    """Return the part of each reading, (n,): ten parts by points, so that all readings of a point are in one.

    Given coordinates are in none: without them the others may not determine the frame.
    """
    if group.name.startswith(GIVEN_POINTS):
        return np.full(group.observations.count, -1, dtype=np.intp)
    index = group.observations.index[t.POINT]
    # other readings go row by row: those of one point may be its only ones
    own = index if index.ndim == 1 else index[0]
    return np.asarray(own if is_sighting(group) else np.arange(len(own)), dtype=np.intp) % FOLDS


def _variations(model: Model, readings: Observations) -> Iterator[tuple[str, Observations]]:
    """Yield sightings as they would be in the other face."""
    face = readings.conditions.get(FACE)
    if face is not None and (face > 0).all():
        yield "in face 2", readings.with_conditions({FACE: -face})


def noise_of(solved: AdjustedNetwork, model: str, factor: float) -> JobNoise:
    """Return the noise of a solved network; raises UndeterminedError for fewer than ten points if it is structured."""
    blocks = solved.solution.blocks
    stations = [
        block for block in (s.STATION, s.LEVELLED, s.OVER, t.TRACER) if block in blocks and blocks[block].free.any()
    ]
    estimates = (*stations, *free_blocks(solved.network.effects))

    def clusters() -> Clusters:
        of = {group.name: in_blocks(group.observations.order) for group in solved.groups}
        return Clusters(of, POINTS_IN_TIME, grows=False, free=solved.network.datum is not None)

    return job_noise((solved.solution, factor), model, clusters, estimates, (t.POINT,))
