"""Stations and points that lengths alone place: their mirror image in the plane of the other ends may fit as well."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.instruments import tracer as t
from metrocli.tasks.adjust_network.groups import LENGTHS
from metrocli.tasks.adjust_network.problem import Network
from metrocli.tasks.shared.mirror import Mirrored, mirrored, must_be_decided, of_points, of_tracers


def decided_places(network: Network, solution: Solution) -> tuple[Mirrored, ...]:
    """Return stations and points with a second place that fits alike, where listed places decide between both.

    Raises UndeterminedError where no list decides.
    """
    group = next((group for group in solution.groups if group.name == LENGTHS), None)
    if group is None or t.TRACER not in solution.blocks:
        return ()
    stations, points = network.readings.stations, network.readings.points
    noise = max(1.0, float(np.nan_to_num(solution.sigma0, nan=1.0)))
    listed = stations.listed[[stations.names.index(name) for name in solution.blocks[t.TRACER].members]]
    places = mirrored(of_tracers(solution, group, listed), noise)
    alone = np.ones(points.count, dtype=bool)
    # other readings of a point show on which side it is
    for other in solution.groups:
        if other is not group and t.POINT in other.observations.index:
            alone[other.observations.index[t.POINT]] = False
    if alone.any():
        places += mirrored(of_points(solution, group, points.listed).selected(alone), noise)
    must_be_decided(places)
    return tuple(places)
