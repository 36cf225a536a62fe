"""A kind of job for the tests of the house: a straight line through readings, small enough to check by hand."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.plan import Plan
from metrocli.result import Estimate, Result
from metrocli.settings import (
    Choice,
    Either,
    FileOf,
    Flag,
    ImageFiles,
    ListOf,
    MapOf,
    Number,
    Quantity,
    Section,
    TableFile,
    Text,
    Whole,
    setting,
)
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import TEXT, Column, Columns, Table

KIND = "straight-line"
SUMMARY = "a straight line through readings"
SIMULATED = ("readings",)
READINGS = Columns((Column("point", TEXT), Column("x", "length"), Column("y", "length")), key=("point",))


@dataclass(frozen=True)
class Known:
    """A slope known from elsewhere."""

    slope: float = setting(Quantity("slope"), "known slope")


@dataclass(frozen=True)
class Inputs:
    """Files of the job."""

    readings: Path = setting(TableFile(READINGS), "readings")
    known: Path | None = setting(FileOf(results=(KIND,), section=Known), "slope from elsewhere", default=None)
    images: tuple[Path, ...] = setting(ImageFiles(), "pictures", default=())


@dataclass(frozen=True)
class Limits:
    """Limits of the fit."""

    range: tuple[float, float] = setting(ListOf(Quantity("length"), length=2), "range of x")
    robust: bool = setting(Flag(), "reweight", default=False)


@dataclass(frozen=True)
class Settings:
    """A straight line through readings."""

    inputs: Inputs = setting(Section(Inputs), "files")
    noise: float | str = setting(Either(Quantity("length", positive=True), Choice("estimated")), "noise of y")
    estimate: tuple[str, ...] = setting(
        ListOf(Choice("slope", "offset"), distinct=True), "what to estimate", default=("slope", "offset")
    )
    limits: Limits | None = setting(Section(Limits), "limits", default=None)
    iterations: int = setting(Whole(minimum=1, maximum=50), "most iterations", default=10)
    weight: float = setting(Number(above=0), "a factor", default=1.0)
    alpha: float = setting(Quantity("expansion"), "expansion", default=0.0)
    labels: Mapping[str, str] = setting(MapOf(Text()), "labels of points", default={})

    def faults(self) -> Iterable[tuple[str, str]]:
        """Two keys that do not go together."""
        if self.iterations == 1 and self.limits is not None and self.limits.robust:
            yield "limits.robust", "reweighting needs more than one iteration"


def run(settings: Settings, readings: Table, **others: object) -> Result:
    """Fit `y = slope x + offset`."""
    x, y = readings.numbers("x"), readings.numbers("y")
    if settings.labels.get("fail") == "diverge":
        raise NotConvergedError("the adjustment did not converge after 10 iterations")
    if settings.labels.get("fail") == "bug":
        raise ZeroDivisionError("a planted defect")
    if settings.labels.get("fail") == "interrupt":
        raise KeyboardInterrupt
    if settings.labels.get("fail") == "terminate":
        signal.raise_signal(signal.SIGTERM)
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
        KIND,
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
        shown=("residuals",),
        notes=("the line is taken as straight",),
    )


def compare(settings: Settings, readings: Table, **others: object) -> Table:
    """Say how a constant and a line fit."""
    y = readings.numbers("y")
    return Table({"model": np.array(["constant"]), "rms": np.array([float(y.std())])}, {"rms": "mm"})


def simulate(settings: Settings, options: SimulationOptions, **inputs: object) -> Simulation:
    """Give readings of the line y = 0.001 x + 2 mm."""
    x = np.arange(5.0)
    noise = 0.0 if isinstance(settings.noise, str) else settings.noise
    y = 0.001 * x + 2 + np.random.default_rng(options.seed).normal(scale=noise, size=5)
    table = Table({"point": np.array([f"p{k}" for k in range(5)]), "x": x, "y": y}, {"x": "mm", "y": "mm"})
    pictures = [("img/a.png", lambda: np.zeros((4, 5), dtype=np.uint8))] if options.images else []
    return Simulation({"readings.csv": table}, {"slope": 0.001, "offset": 2.0}, pictures)


PLANNED = ("readings",)


def plan(settings: Settings, **inputs: object) -> Plan:
    """Say how well five readings at x = 0 ... 4 mm determine a line."""
    x = np.arange(5.0)
    noise = 1.0 if isinstance(settings.noise, str) else settings.noise
    std = noise / float(np.sqrt(((x - x.mean()) ** 2).sum()))
    return Plan(
        KIND,
        ("five readings determine the line",),
        (Estimate("slope", 0.001, std, "rad"),),
        {"places": Table({"x": x}, {"x": "mm"})},
        {"program.nc": "G1 X0\n"},
        ("the stylus is not in the plan",),
        shown=("places",),
    )
