"""calibrate-machine: the 21 geometric errors of a machine with three linear axes, from a tracker or a 6-DoF laser."""

from __future__ import annotations

from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.machine_report import KIND, report
from metrocli.tasks.machine_settings import Inputs, Settings
from metrocli.tasks.machine_solve import solve
from metrocli.tasks.machine_standstill import standstill

SIMULATED = ("points", "track", "lines")
SUMMARY = "geometric errors of a 3-axis machine from tracker or 6-DoF data"


def run(settings: Settings, points: Table | None = None, **_: Table) -> Result:
    """Find the errors; raises InputError, UndeterminedError or NotConvergedError."""
    assert points is not None
    return report(solve(standstill(settings, points), settings.outliers == "remove"), settings)


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "run"]
