"""A network of lengths as it is planned: where points and tracers will be, and the covariance that this gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.solution import Solution
from metrocli.effects.model import extended
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.multilaterate.design import Pace, Planned
from metrocli.tasks.multilaterate.problem import Network, NetworkSettings, network_of
from metrocli.tasks.multilaterate.readings import join, matched


class PlanSettings(NetworkSettings, Protocol):
    """The settings that a plan needs."""

    @property
    def simulation(self) -> Pace | None:
        """How time and temperature go on"""


@dataclass(frozen=True)
class Layout:
    """A planned measurement as it will be adjusted."""

    settings: PlanSettings
    planned: Planned
    distances: Table | None = None
    """Calibrated distances between points"""
    effects: Sequence[Wanted] = ()

    @cached_property
    def network(self) -> Network:
        """The network with the lengths that will be read but for their noise; InputError for impossible places."""
        points, tracers = self.planned.points, self.planned.tracers
        design = self.planned.design(self.settings.simulation)
        ends = matched(design, "point", points.texts("point"), points.file or "the list of points")
        starts = matched(design, "tracer", tracers.texts("tracer"), tracers.file or "the list of tracers")
        distance = np.linalg.norm(points.stacked("xyz")[ends] - tracers.stacked("xyz")[starts], axis=1)
        for i in np.flatnonzero(distance == 0)[:1]:
            raise InputError(f"tracer {design.texts('tracer')[i]} stands where point {design.texts('point')[i]} is")
        lengths = replace(design, columns={**design.columns, "length": distance})
        bare = replace(tracers, columns={k: v for k, v in tracers.columns.items() if k != "dead_path"})
        readings = join(lengths, points, bare, self.settings.measures == "absolute")
        places = np.column_stack([readings.said, np.zeros(len(readings.said)), np.ones(len(readings.said))])
        network = network_of(self.settings, readings, places, lengths, self.distances)
        return network.with_model(extended(network.model(), self.effects)) if self.effects else network

    @cached_property
    def solution(self) -> Solution:
        """The covariance at the planned places."""
        network = self.network
        return covariance_at(network.blocks.values(), [network.lengths, *network.others], network.datum)

    @property
    def names(self) -> list[str]:
        """The points that are read."""
        members, seen = self.network.blocks[t.POINT].members, self.network.seen
        return [name for name, n in zip(members, seen, strict=True) if n]

    @property
    def places(self) -> Array:
        """Where the points that are read will be (points, 3)."""
        return self.network.nominal[self.network.seen > 0]

    @cached_property
    def covariances(self) -> Array:
        """Covariance of each point that is read (points, 3, 3)."""
        return self.solution.known().members(t.POINT)[self.network.seen > 0]

    def with_tracer(self, name: str, place: Array) -> Layout:
        """Return the layout with one more tracer of which nothing is known but about where it stands."""
        return replace(self, planned=self.planned.with_tracer(name, place))


def worst_direction(covariances: Array) -> Array:
    """Return the standard uncertainty of each point in its worst direction, (n,), from (n, 3, 3)."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariances)[:, -1], 0.0)))


def root_mean_square(covariances: Array) -> float:
    """Return the standard uncertainty of a coordinate, root mean square over all points, from (n, 3, 3)."""
    return float(np.sqrt(max(np.einsum("mii->m", covariances).mean() / 3, 0.0)))
