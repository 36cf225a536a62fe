"""Simulated alignments: what the encoders read when receiver and launch unit look at each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.geometry.angles import wrapped
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.launch_problem import NoiseSettings
from metrocli.tasks.launch_readings import ANGLES

if TYPE_CHECKING:
    from metrocli.table import Values


class Truth(Protocol):
    """Where the unit truly is."""

    @property
    def place(self) -> tuple[float, ...]:
        """x, y, z [mm]"""

    @property
    def gamma(self) -> float:
        """Its set-up angle [rad]"""

    @property
    def distances(self) -> bool:
        """Whether distances are read"""


def simulated(truth: Truth, noise: NoiseSettings, places: Table, rng: np.random.Generator) -> Simulation:
    """Return the poses of a measurement at the listed places, with noise."""
    receiver, spindle = places.stacked("xyz"), places.numbers("spindle")
    angles, distance = aligned(np.array(truth.place), truth.gamma, receiver, spindle)
    angles = wrapped(angles + rng.normal(size=angles.shape) * noise.encoder)
    columns: dict[str, Values] = {"pose": np.array(places.texts("pose"))}
    columns |= {axis: receiver[:, i] for i, axis in enumerate("xyz")}
    columns |= {"spindle": spindle} | dict(zip(ANGLES, angles, strict=True))
    units = dict.fromkeys("xyz", "mm") | dict.fromkeys(("spindle", *ANGLES), "rad")
    if truth.distances:
        columns["distance"] = distance + rng.normal(size=distance.shape) * (noise.distance or 0.0)
        units["distance"] = "mm"
    conditions = {"t": "s", "temp": "degC"}
    columns |= {name: places.numbers(name) for name in conditions if name in places}
    units |= {name: unit for name, unit in conditions.items() if name in places}
    true = dict(zip("xyz", truth.place, strict=True)) | {"gamma": float(wrapped(truth.gamma))}
    return Simulation({"poses.csv": Table(columns, units)}, true)


def aligned(place: Array, gamma: float, receiver: Array, spindle: Array) -> tuple[Array, Array]:
    """Return the angles phi1..phi4 (4, n) and distances (n,) of units that look at each other (Kuprin et al. eq. 5).

    `phi1 = atan2(b) - gamma`, `phi2 = asin(bz/|b|)`, `phi3 = -phi2`, `phi4 = atan2(-b) - psi`, b from unit to receiver.
    """
    x, y, z = (receiver - place).T
    tilt = np.arctan2(z, np.hypot(x, y))
    angles = np.stack([np.arctan2(y, x) - gamma, tilt, -tilt, np.arctan2(-y, -x) - spindle])
    return angles, np.sqrt(x * x + y * y + z * z)
