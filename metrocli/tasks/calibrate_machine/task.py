"""calibrate-machine: the 21 geometric errors of a machine with three linear axes, from a tracker or a 6-DoF laser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from metrocli.diagnosis.adjusted_job import Subject
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError
from metrocli.plan import Plan
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.diagnosis import subject
from metrocli.tasks.calibrate_machine.methods.on_the_fly import on_the_fly
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.calibrate_machine.plan import plan_of_path
from metrocli.tasks.calibrate_machine.problem import Problem
from metrocli.tasks.calibrate_machine.report import KIND, report
from metrocli.tasks.calibrate_machine.settings import ON_THE_FLY, SIX_DOF, STANDSTILL, Inputs, Settings
from metrocli.tasks.calibrate_machine.simulation import simulated
from metrocli.tasks.calibrate_machine.solve import solve
from metrocli.tasks.calibrate_machine.stops_plan import plan_of_lines, plan_of_points

SIMULATED = ("points", "track", "lines")
PLANNED = ("points", "path", "track", "lines")
SUMMARY = "geometric errors of a 3-axis machine from tracker or 6-DoF data"


def run(
    settings: Settings,
    points: Table | None = None,
    path: Table | None = None,
    track: Table | None = None,
    lines: Table | None = None,
    effects: Sequence[Wanted] = (),
) -> Result:
    """Find the errors; raises InputError, UndeterminedError or NotConvergedError."""
    if path is not None and track is not None:
        return report(on_the_fly(settings, path, track, effects), settings)
    problem = problem_of(settings, points, lines).with_effects(effects)
    return report(solve(problem, settings.outliers == "remove"), settings)


def problem_of(settings: Settings, points: Table | None, lines: Table | None) -> Problem:
    """Return the adjustment of a measurement that needs no alignment along a path."""
    if points is not None:
        return standstill(settings, points)
    if lines is not None:
        return six_dof(settings, lines)
    raise InputError(f"method {settings.method} has no readings")


def diagnosed(
    settings: Settings,
    points: Table | None = None,
    path: Table | None = None,
    track: Table | None = None,
    lines: Table | None = None,
    effects: Sequence[Wanted] = (),
) -> Subject:
    """Return the adjusted calibration as diagnosis sees it."""
    if path is not None and track is not None:
        return subject(on_the_fly(settings, path, track, effects))
    return subject(solve(problem_of(settings, points, lines).with_effects(effects), settings.outliers == "remove"))


def simulate(
    settings: Settings, options: SimulationOptions, effects: Sequence[Wanted] = (), **tables: Table
) -> Simulation:
    """Return the measurement of a machine with the random errors of `simulation:`, and with effects in it."""
    return simulated(settings, tables, effects, options.seed)


def plan(
    settings: Settings,
    points: Table | None = None,
    path: Table | None = None,
    track: Table | None = None,
    lines: Table | None = None,
    effects: Sequence[Wanted] = (),
) -> Plan:
    """Return what the job's path, points or lines will determine, and better ones; without its effects."""
    planned = {
        STANDSTILL: lambda: plan_of_points(settings, points),
        SIX_DOF: lambda: plan_of_lines(settings, lines),
        ON_THE_FLY: lambda: plan_of_path(settings, path),
    }[settings.method]()
    return replace(planned, warnings=(*planned.warnings, _WITHOUT)) if effects else planned


_WITHOUT = "the effects of the job are not in the plan: its uncertainties are those of the errors alone"


__all__ = ["KIND", "PLANNED", "SIMULATED", "SUMMARY", "Inputs", "Settings", "plan", "run", "simulate"]
