"""A network of lengths as it is planned: where points and tracers will be, and the covariance that this gives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.blocks import Array
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.length_network import Network, NetworkSettings, network_of
from metrocli.tasks.length_readings import join
from metrocli.tasks.length_simulation import length_table


@dataclass(frozen=True)
class Layout:
    """Points and tracers of a measurement in which every tracer reads every point."""

    settings: NetworkSettings
    points: Table
    tracers: Table
    distances: Table | None = None
    """Calibrated distances between points"""

    @cached_property
    def network(self) -> Network:
        """The network with the lengths that will be read but for their noise; InputError for impossible places."""
        points, tracers = self.points.texts("point"), self.tracers.texts("tracer")
        distance = np.linalg.norm(self.points.stacked("xyz")[:, None] - self.tracers.stacked("xyz"), axis=2)
        if distance.size and distance.min() == 0:
            i, j = np.argwhere(distance == 0)[0]
            raise InputError(f"tracer {tracers[j]} stands where point {points[i]} is")
        bare = replace(self.tracers, columns={k: v for k, v in self.tracers.columns.items() if k != "dead_path"})
        lengths = length_table(points, tracers, distance)
        readings = join(lengths, self.points, bare, self.settings.measures == "absolute")
        places = np.column_stack([readings.said, np.zeros(len(tracers)), np.ones(len(tracers))])
        return network_of(self.settings, readings, places, lengths, self.distances)

    @cached_property
    def solution(self) -> Solution:
        """The covariance at the planned places."""
        network = self.network
        return covariance_at(network.blocks.values(), [network.lengths, *network.others], network.datum)

    @cached_property
    def covariances(self) -> Array:
        """Covariance of each point (points, 3, 3)."""
        return self.solution.known().members(t.POINT)

    def with_tracer(self, name: str, place: Array) -> Layout:
        """Return the layout with one more tracer of which nothing is known but about where it stands."""
        row = {"tracer": name, **dict(zip("xyz", place.tolist(), strict=True))}
        columns = {
            column: np.append(values, [row.get(column, np.nan)]) for column, values in self.tracers.columns.items()
        }
        return replace(self, tracers=replace(self.tracers, columns=columns, lines=()))


def worst_direction(covariances: Array) -> Array:
    """Return the standard uncertainty of each point in its worst direction, (n,), from (n, 3, 3)."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0)))


def root_mean_square(covariances: Array) -> float:
    """Return the standard uncertainty of a coordinate, root mean square over all points, from (n, 3, 3)."""
    return float(np.sqrt(max(np.einsum("mii->m", covariances).mean() / 3, 0.0)))
