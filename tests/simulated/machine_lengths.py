"""Lengths of tracking interferometers to the tool of a machine, written without the engine: own formula, own draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from simulated import machine as sim

from metrocli.table import Table
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import AxesSettings, AxisSettings, MachineNoise, MachineSettings
from metrocli.tasks.calibrate_machine.settings import Settings

Array = sim.Array
STATIONS = np.array([[-300.0, -480, -420], [900, -440, -130], [820, 590, -490], [-270, 530, 40], [300, -740, 90]])
TWO = {"T1": (0.0, 0.0, 120.0), "T2": (80.0, 0.0, 60.0)}
NOISE = MachineNoise(constant=0.3e-3, proportional=1e-7)


def settings(
    tools: Mapping[str, Sequence[float]] = TWO,
    knots: tuple[int, int, int] = (5, 5, 5),
    noise: MachineNoise = NOISE,
    **more: object,
) -> Settings:
    axes = [AxisSettings((float(sim.LOW[i]), float(sim.HIGH[i])), knots[i]) for i in range(3)]
    vectors = {name: tuple(vector) for name, vector in tools.items()}
    machine = MachineSettings("wXbYZt", AxesSettings(*axes), tools=vectors)
    return Settings("lengths", machine, Inputs(lengths=sim.NOWHERE), noise, **more)


def measured(
    machine: sim.Machine,
    rng: np.random.Generator,
    n: int = 150,
    tools: Mapping[str, Sequence[float]] = TWO,
    stations: Array = STATIONS[:4],
    noise: MachineNoise = NOISE,
    repeatability: float = 0.0,
    together: bool = False,
) -> Table:
    """Each station reads n points, one station after the other; or all stations at each stop, if `together`."""
    position, which = sim.commands(rng, n), rng.integers(len(tools), size=n)
    vectors = np.array(list(tools.values()))[which]
    reached = position + vectors + sim.displacements(machine, position, vectors)
    m = len(stations)
    return_ = rng.normal(size=(1 if together else m, n, 3)) * repeatability
    path = np.linalg.norm(reached + return_ - stations[:, None], axis=2)
    sigma = np.sqrt((noise.constant or 0.0) ** 2 + (noise.proportional * path) ** 2)
    dead = rng.uniform(200, 900, (m, 1))
    length = path - dead + rng.normal(size=path.shape) * sigma
    time = np.broadcast_to(np.arange(n) * 5.0, (m, n)) + (0 if together else np.arange(m)[:, None] * 6.0 * n)
    names = np.array([f"P{i}" for i in range(n)])
    columns = {"point": np.tile(names, m), "station": np.repeat([f"S{i + 1}" for i in range(m)], n)}
    columns |= dict(zip("xyz", np.tile(position, (m, 1)).T, strict=True))
    columns |= {"length": length.ravel(), "t": time.ravel(), "tool": np.tile(np.array(list(tools))[which], m)}
    units = {**dict.fromkeys(("x", "y", "z", "length"), "mm"), "t": "s"}
    return Table(columns, units, "lengths.csv", tuple(range(2, m * n + 2)))


def listed(stations: Array, file: str = "stations.csv") -> Table:
    columns = {"station": np.array([f"S{i + 1}" for i in range(len(stations))])}
    columns |= dict(zip("xyz", stations.T, strict=True))
    return Table(columns, dict.fromkeys("xyz", "mm"), file, tuple(range(2, len(stations) + 2)))
