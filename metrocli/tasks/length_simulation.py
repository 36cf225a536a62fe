"""Simulated lengths: what tracers read of a mover that is not where it says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.errors import InputError
from metrocli.instruments.tracer import COLUMNS
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.length_network import NetworkSettings

if TYPE_CHECKING:
    from metrocli.table import Values


class Truth(Protocol):
    """What is true of the mover and the tracers."""

    @property
    def mover_error(self) -> float:
        """Standard deviation of each coordinate"""

    @property
    def mover_scale(self) -> float:
        """How much too long the mover reads distances"""

    @property
    def tracer_error(self) -> float:
        """Standard deviation of the places that are written as approximate"""


def simulated(
    settings: NetworkSettings, truth: Truth, points: Table, tracers: Table, rng: np.random.Generator
) -> Simulation:
    """Return lengths to the points where they really are, from tracers at the places listed.

    The mover's readings are the list of points; the points themselves are off by its error. Interferometers are set to
    zero at the first point; scales are off by their uncertainty.
    """
    nominal, places = points.stacked("xyz"), tracers.stacked("xyz")
    if len(nominal) == 0 or len(places) == 0:
        raise InputError("simulation: there are no points or no tracers")
    centre = nominal.mean(axis=0)
    actual = centre + (nominal - centre) / (1 + truth.mover_scale)
    actual = actual + rng.normal(0.0, 1.0, actual.shape) * truth.mover_error
    distance = np.linalg.norm(actual[:, None] - places, axis=2)
    spread = 0.0 if settings.scale is None else settings.scale.uncertainty
    scale = 1 + rng.normal(0.0, 1.0, len(places)) * spread
    dead = np.zeros(len(places)) if settings.measures == "absolute" else scale * distance[0]
    sigma = np.sqrt(settings.noise.constant**2 + (settings.noise.proportional * distance) ** 2)
    reading = scale * distance - dead + rng.normal(0.0, 1.0, distance.shape) * sigma
    said = places + rng.normal(0.0, 1.0, places.shape) * truth.tracer_error
    names = tracers.texts("tracer")
    files = {
        "lengths.csv": length_table(points.texts("point"), names, reading),
        "tracers.csv": _listed("tracer", names, said),
        "true_points.csv": _listed("point", points.texts("point"), actual),
    }
    values = np.column_stack([places, dead, scale])
    true = {f"{name}.{column}": float(values[i, k]) for i, name in enumerate(names) for k, column in enumerate(COLUMNS)}
    return Simulation(files, true)


def length_table(points: list[str], tracers: list[str], reading: Array) -> Table:
    """Return readings (points, tracers) as a file of lengths has them."""
    n, m = reading.shape
    columns: dict[str, Values] = {
        "point": np.repeat(np.array(points), m),
        "tracer": np.tile(np.array(tracers), n),
        "length": reading.ravel(),
    }
    return Table(columns, {"length": "mm"})


def _listed(key: str, names: list[str], places: Array) -> Table:
    columns: dict[str, Values] = {key: np.array(names)}
    columns |= {axis: places[:, i] for i, axis in enumerate("xyz")}
    return Table(columns, dict.fromkeys("xyz", "mm"))
