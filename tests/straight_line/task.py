"""What the tests' kind does with a job."""

from __future__ import annotations

import os
import signal

import numpy as np

from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.plan import Plan
from metrocli.result import Estimate, Result, ShownTable
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.job import Job, Task
from straight_line import KIND
from straight_line.settings import Files, Settings


def run(job: Job[Settings, Files]) -> Result:
    """Fit `y = slope x + offset`."""
    settings, readings = job.settings, job.files.readings
    x, y = readings.numbers("x"), readings.numbers("y")
    if settings.labels.get("fail") == "diverge":
        raise NotConvergedError("the adjustment did not converge after 10 iterations")
    if settings.labels.get("fail") == "bug":
        raise ZeroDivisionError("a planted defect")
    if settings.labels.get("fail") == "interrupt":
        raise KeyboardInterrupt
    if settings.labels.get("fail") == "terminate":
        signal.raise_signal(signal.SIGTERM)
    if settings.labels.get("fail") == "exit":
        os._exit(9)
    if np.ptp(x) == 0:
        raise UndeterminedError("slope, offset: all points have the same x; measure at another x")
    design = np.stack([x, np.ones_like(x)], axis=1)
    noise = 1.0 if isinstance(settings.noise, str) else settings.noise
    covariance = noise**2 * np.linalg.inv(design.T @ design)
    slope, offset = covariance @ design.T @ y / noise**2
    residual = y - design @ np.array([slope, offset])
    sigma0 = float(np.sqrt((residual**2).sum() / max(len(y) - 2, 1)) / noise)
    std = np.sqrt(np.diag(covariance))
    table = Table(
        {"point": np.array(readings.texts("point")), "residual": residual, "normalised": residual / noise},
        {"residual": "mm"},
    )
    return Result(
        KIND.name,
        "",
        (Estimate("slope", float(slope), float(std[0]), "rad"), Estimate("offset", float(offset), float(std[1]), "mm")),
        covariance,
        {
            "observations": len(y),
            "unknowns": 2,
            "dof": len(y) - 2,
            "sigma0": sigma0,
            "rms": {"mm": float(residual.std())},
        },
        {"residuals": table},
        shown=(ShownTable("residuals"),),
        notes=("the line is taken as straight",),
    )


def compare(job: Job[Settings, Files]) -> Table:
    """Say how a constant and a line fit."""
    y = job.files.readings.numbers("y")
    return Table({"model": np.array(["constant"]), "rms": np.array([float(y.std())])}, {"rms": "mm"})


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Give readings of the line y = 0.001 x + 2 mm."""
    x = np.arange(5.0)
    noise = 0.0 if isinstance(job.settings.noise, str) else job.settings.noise
    y = 0.001 * x + 2 + np.random.default_rng(options.seed).normal(scale=noise, size=5)
    table = Table({"point": np.array([f"p{k}" for k in range(5)]), "x": x, "y": y}, {"x": "mm", "y": "mm"})
    pictures = [("img/a.png", lambda: np.zeros((4, 5), dtype=np.uint8))] if options.images else []
    return Simulation({"readings.csv": table}, {"slope": 0.001, "offset": 2.0}, pictures)


def plan(job: Job[Settings, Files]) -> Plan:
    """Say how well five readings at x = 0 ... 4 mm determine a line."""
    x = np.arange(5.0)
    noise = 1.0 if isinstance(job.settings.noise, str) else job.settings.noise
    std = noise / float(np.sqrt(((x - x.mean()) ** 2).sum()))
    return Plan(
        KIND.name,
        ("five readings determine the line",),
        (Estimate("slope", 0.001, std, "rad"),),
        {"places": Table({"x": x}, {"x": "mm"})},
        {"program.nc": "G1 X0\n"},
        ("the stylus is not in the plan",),
        shown=(ShownTable("places"),),
    )


TASK = Task(Files, run, plan=plan, simulate=simulate, answers={"compare": compare})
