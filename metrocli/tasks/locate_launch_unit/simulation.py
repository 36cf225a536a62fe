"""Simulated alignments: the readings of the encoders when receiver and launch unit point at each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.requested import RequestedEffect
from metrocli.geometry.rotations import wrapped
from metrocli.instruments import launch_unit as lu
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit.problem import build
from metrocli.tasks.locate_launch_unit.readings import ANGLES, AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise, TrueLaunchUnit
from metrocli.tasks.shared.environment import Environment, air_of
from metrocli.tasks.shared.statistics import CONDITIONS, heading


def simulated(
    truth: TrueLaunchUnit,
    noise: LaunchUnitNoise,
    places: Table,
    rng: np.random.Generator,
    effects: Sequence[RequestedEffect] = (),
    environment: Environment | None = None,
) -> Simulation:
    """Return simulated encoder readings (and distances) at the listed places, with effects and noise, and the truth.

    Distances are as an instrument displays them with the air that it assumes.
    """
    readings, added = _exact(truth, noise, places, effects)
    angles = wrapped(readings.angles + rng.normal(size=readings.angles.shape) * noise.encoder)
    table = Table.of(
        {"pose [text]": readings.names, "x y z [mm]": readings.receiver, "spindle [rad]": readings.spindle}
    )
    table = table.joined({f"{' '.join(ANGLES)} [rad]": angles.T})
    if truth.distances:
        distance = readings.distance + rng.normal(size=len(readings.names)) * (noise.distance or 0.0)
        air = air_of(environment, places)
        read = distance if air is None else distance * (1 + rng.normal() * air.std) / air.towards
        table = table.joined({"distance [mm]": read})
    when = {heading(name): condition for name, condition in places.conditions(*CONDITIONS).items()}
    true = dict(zip("xyz", truth.place, strict=True)) | {"gamma": float(wrapped(truth.gamma))}
    return Simulation({"poses.csv": table.joined(when)}, true | added)


def _exact(
    truth: TrueLaunchUnit, noise: LaunchUnitNoise, places: Table, effects: Sequence[RequestedEffect]
) -> tuple[AlignedPoses, dict[str, float]]:
    """Return readings without noise, and the true values of their effects; vertical beams stay without effects."""
    receiver, spindle = places.stacked("xyz"), places.numbers("spindle")
    angles, distance = aligned(np.array(truth.place), truth.gamma, receiver, spindle)
    conditions = places.conditions("t", "temp")
    has = distance if truth.distances else np.full_like(distance, np.nan)
    names = tuple(places.texts("pose"))
    readings = AlignedPoses(names, receiver, np.zeros_like(receiver), spindle, angles, has, conditions)
    if not effects:
        return readings, {}
    problem = build(readings, noise)
    unit = problem.blocks[lu.UNIT].with_values(np.array([[*truth.place, truth.gamma]]))
    model = extended(problem.model.with_blocks({**problem.blocks, lu.UNIT: unit}), effects)
    for group in model.readings:
        read = has if group.name == lu.DISTANCE else angles[ANGLES.index(group.name)]
        read[group.observations.index[lu.RECEIVER]] = group.chain.predict(model.blocks, group.observations)[0]
    return readings, true_values(model)


def aligned(place: Array, gamma: float, receiver: Array, spindle: Array) -> tuple[Array, Array]:
    """Return the angles phi1..phi4 (4, n) and distances (n,) of units that point at each other (Kuprin et al. eq. 5).

    `phi1 = atan2(b) - gamma`, `phi2 = asin(bz/|b|)`, `phi3 = -phi2`, `phi4 = atan2(-b) - psi`, b from unit to receiver.
    """
    x, y, z = (receiver - place).T
    tilt = np.arctan2(z, np.hypot(x, y))
    angles = np.stack([np.arctan2(y, x) - gamma, tilt, -tilt, np.arctan2(-y, -x) - spindle])
    return angles, np.sqrt(x * x + y * y + z * z)
