"""Lengths of a machine from stations that read at once, whose carrier does not return to its places: plain formulas."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.hidden import machine
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.files import Inputs
from metrocli.tasks.calibrate_machine.machine_settings import AxesSettings, AxisSettings, MachineNoise, MachineSettings
from metrocli.tasks.calibrate_machine.settings import Settings

Array = npt.NDArray[np.float64]
CONSTANT, PROPORTIONAL = 2e-4, 2e-7
"""0.2 um and 0.2 um/m, in mm"""
AROUND = np.array([[-0.6, -0.7, 0.4], [1.6, -0.6, 1.1], [1.5, 1.7, 0.1], [-0.5, 1.6, 1.4], [0.5, -1.2, 1.7]])
"""Stations around the volume, as shares of it"""


@dataclass(frozen=True)
class Measurement:
    """Commanded points in the order of travel, stations, and lengths, (points, stations)."""

    at: Array
    tool: npt.NDArray[np.intp]
    t: Array
    stations: Array
    true: Array
    """Where the reflector would be without a scatter, (points, 3)"""
    dead: Array
    length: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def read(self, rng: np.random.Generator, scatter: float, noise: float = 1.0, alone: bool = False) -> Measurement:
        """Return it with lengths of a carrier that scatters from stop to stop; `alone`: a stop for each length."""
        n, m = len(self.at), len(self.stations)
        off = rng.normal(0, scatter, (n, m if alone else 1, 3))
        distance = np.linalg.norm(self.true[:, None] + off - self.stations, axis=2)
        sigma = np.sqrt(CONSTANT**2 + (PROPORTIONAL * distance) ** 2) * noise
        return replace(self, length=distance - self.dead + rng.normal(size=distance.shape) * sigma)

    def adjusted(self, repeatability: float | str | None = None, alone: bool = False) -> AdjustedJob:
        """Return it as the job that a user would give."""
        n, m = self.length.shape
        point, station = np.divmod(np.arange(n * m), m)
        t = self.t[point] + (1e5 * station if alone else 0)
        columns = {"point": np.char.add("P", point.astype(str)), "station": np.char.add("S", station.astype(str))}
        columns |= dict(zip("xyz", self.at[point].T, strict=True)) | {"length": self.length.ravel(), "t": t}
        columns["tool"] = np.array(list(machine.TOOLS))[self.tool[point]]
        axes = AxesSettings(*(AxisSettings((a, b), 4) for a, b in zip(machine.LOW, machine.HIGH, strict=True)))
        noise = MachineNoise(constant=CONSTANT, proportional=PROPORTIONAL, repeatability=repeatability)
        settings = Settings(
            "lengths", MachineSettings("wXbYZt", axes, tools=machine.TOOLS), Inputs(lengths=Path("-")), noise
        )
        return calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, lengths=Table(columns, {})))


def measurement(rng: np.random.Generator, count: int = 120, stations: int = 4) -> Measurement:
    """Return a machine with errors of some 50 um before so many stations, not read yet."""
    m = machine.measurement(rng, (4, count), noise=0.0)
    places = machine.LOW + (AROUND[:stations] + rng.normal(0, 0.05, (stations, 3))) * (machine.HIGH - machine.LOW)
    return Measurement(m.at, m.tool, m.t, places, m.read @ m.turn.T + m.place, rng.uniform(100, 400, stations))
