"""Simulate measurements of a machine with rotary axes: the adjustment problem of its poses, read with true values.

The problem of poses that a machine without errors reads has all unknowns, priors and noise. With true values instead
of starting values it predicts the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import ReadBlock, priors
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.effects.estimates import true_values
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.instruments.axes.kinematics import ON_WORKPIECE, axes_of
from metrocli.instruments.frames import DistanceBetween
from metrocli.instruments.machine import TOOL
from metrocli.instruments.tracer import TRACER
from metrocli.instruments.tracker import TRACKER, polar
from metrocli.simulation import Simulation
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, machine_of
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.known_axes import known_axes
from metrocli.tasks.calibrate_machine.methods.lengths import first_read
from metrocli.tasks.calibrate_machine.methods.poses import (
    clock,
    in_degrees,
    poses_at,
    problem_at,
    sides_of,
    without_errors,
)
from metrocli.tasks.calibrate_machine.methods.probing import DISPLACEMENTS
from metrocli.tasks.calibrate_machine.methods.standstill import CARTESIAN
from metrocli.tasks.calibrate_machine.methods.targets import moved_by
from metrocli.tasks.calibrate_machine.problem import PLACES_OF_AXES, MachineProblem
from metrocli.tasks.calibrate_machine.settings import LENGTHS, PROBING, STANDSTILL, MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.truth import true_errors, truth_of, warmed
from metrocli.tasks.job import Job
from metrocli.tasks.shared.environment import air_of
from metrocli.tasks.shared.statistics import heading

_UNSAID = 0.5
"""Standard deviation of what is known without an uncertainty: listed places of balls and reflectors, tools [mm]"""
_MET, _ROUNDS = 1e-7, 20
"""A probe meets its ball within this [mm], in so many rounds at most"""
_TRIES = 8
"""Random poses for each one of a probe, which reaches its ball in some of them only"""


def simulated_turning(job: Job[Settings, Files], simulation: MachineSimulation, rng: np.random.Generator) -> Simulation:
    """Simulate the readings at the poses of a job, or at random ones; return files and true values.

    Raises InputError if no pose brings a probe to its ball.
    """
    settings = job.settings
    truth = truth_of(settings, simulation, rng)
    if job.files.machine is not None:
        known = known_axes(truth.machine, settings, job.files.machine)
        truth = replace(truth, blocks=known.drawn(truth.blocks, rng))
    turn = rotation_from_euler(rng.normal() * 0.05, rng.normal() * 0.05, rng.uniform(-np.pi, np.pi))
    tracker = poses.pose(turn, np.array(simulation.tracker))
    table, files = without_errors(settings, _poses(job, simulation, rng), job.files, tracker)
    problem = problem_at(settings, table, files)
    drawn = _drawn(problem, rng)
    machine = {name: block for name, block in warmed(truth, settings.scales, rng).blocks.items() if name != TOOL}
    instruments = _instruments(problem, drawn, files, tracker)
    reading = _Reading(job, table, problem.with_blocks({**drawn, **machine, **instruments}).with_effects(job.effects))
    file, written = {
        STANDSTILL: ("points.csv", reading.points),
        LENGTHS: ("lengths.csv", reading.lengths),
        PROBING: ("probing.csv", reading.probing),
    }[settings.method]
    true = {
        name: float(value)
        for block in (truth.blocks[name] for name in PLACES_OF_AXES if name in truth.blocks)
        for name, value in zip(block.columns, block.values[0], strict=True)
        if name in settings.estimated
    }
    tables = {file: in_degrees(written(rng)), "true_errors.csv": true_errors(settings, truth)}
    return Simulation(tables, true | true_values(reading.problem.model))


def _poses(job: Job[Settings, Files], simulation: MachineSimulation, rng: np.random.Generator) -> Table:
    """Return the poses of a job, or random ones, with times, sides, and temperatures if it gets warmer."""
    settings, files = job.settings, job.files
    machine, table = machine_of(settings), files.poses
    if table is None:
        shares = rng.random((len(machine.axes), simulation.points * (_TRIES if settings.method == PROBING else 1)))
        table = poses_at(settings, files, shares, 1.0 + 10 * simulation.error)
        if settings.method == PROBING:
            table = table.selected(np.arange(len(table)) < simulation.points)
    more = clock(simulation, len(table)) | table.conditions("t")
    names = [f"from_{axis.key}" for axis in machine.axes]
    more |= sides_of(names, commanded(machine, table), more["t"])
    return table.joined({heading(name): values for name, values in more.items() if name not in table})


def _drawn(problem: MachineProblem, rng: np.random.Generator) -> dict[str, Block]:
    """Return the blocks of a problem at random values within what is known of them: priors, calibrated distances."""
    drawn = dict(problem.blocks)
    for group in problem.groups:
        link = group.chain.links[0]
        if isinstance(link, ReadBlock):
            values = np.array(drawn[link.block].values)
            noise = rng.normal(size=group.observations.sigma.shape) * group.observations.sigma
            values[link.entries(group.observations.index[link.block])] += noise.T.ravel()
            drawn[link.block] = drawn[link.block].with_values(values)
    for name in (TOOL, ON_WORKPIECE):
        if name in drawn:
            unsaid = (problem.blocks[name].values == drawn[name].values) & drawn[name].free
            drawn[name] = drawn[name].with_values(drawn[name].values + unsaid * rng.normal(0, _UNSAID, unsaid.shape))
    return {**drawn, **_at_distances(problem, drawn, rng)}


def _at_distances(problem: MachineProblem, blocks: Mapping[str, Block], rng: np.random.Generator) -> dict[str, Block]:
    """Return points on the workpiece moved as little as possible to calibrated distances with their errors."""
    group = next(
        (distances for distances in problem.groups if isinstance(distances.chain.links[0], DistanceBetween)), None
    )
    if group is None:
        return {}
    given, block = group.observations, blocks[ON_WORKPIECE]
    read = group.with_observations(
        given.with_readings(given.readings + rng.normal(size=given.sigma.shape) * given.sigma)
    )
    near = priors(block, np.where(block.free, _UNSAID, np.nan), block.free)
    return {ON_WORKPIECE: adjust([block], [read, *near]).blocks[ON_WORKPIECE]}


def _instruments(problem: MachineProblem, drawn: Mapping[str, Block], files: Files, tracker: Array) -> dict[str, Block]:
    """Return tracker or stations at their true places; a station's dead path is that to its first reading."""
    instruments = {}
    if TRACKER in problem.blocks:
        instruments[TRACKER] = problem.blocks[TRACKER].with_values(tracker[None])
    stations = files.listed_stations
    if TRACER in problem.blocks and stations is not None:
        block, listed = problem.blocks[TRACER], stations.texts("station")
        values = drawn[TRACER].values - block.values
        values[:, :3] += stations.stacked("xyz")[[listed.index(name) for name in block.members]]
        values[:, 3] = block.values[:, 3]
        values[:, 4] += 1.0
        instruments[TRACER] = block.with_values(values)
    return instruments


@dataclass(frozen=True)
class _Reading:
    """Poses, and the problem with true values that predicts what is read there."""

    job: Job[Settings, Files]
    table: Table
    problem: MachineProblem

    def at(self, observations: Observations) -> Array:
        """Return the readings without noise."""
        return self.problem.readings.chain.predict(self.problem.blocks, observations)

    def points(self, rng: np.random.Generator) -> Table:
        """Return the poses with the points of the tracker, or with its polar readings."""
        seen = self.at(self.problem.readings.observations)
        seen = seen + self.job.settings.noise.of_tracker.drawn(seen, rng)
        simulation = self.job.settings.simulation
        listed = self.job.files.points
        if simulation is None or (not simulation.polar and (listed is None or "distance" not in listed)):
            return self.table.joined({" ".join(CARTESIAN) + " [mm]": seen.T})
        azimuth, elevation, distance = polar(seen)[0]
        read = {"distance [mm]": distance, "azimuth elevation [rad]": np.stack([azimuth, elevation], 1)}
        return self.table.without(*CARTESIAN).joined(read)

    def lengths(self, rng: np.random.Generator) -> Table:
        """Return the poses with the lengths that stations read in their air, zero at their first points."""
        problem, group = self.problem, self.problem.readings
        length, station = self.at(group.observations), group.observations.index[TRACER]
        length -= first_read(length[0], station)
        read = group.with_observations(group.observations.with_readings(length))
        sigma = group.observations.sigma if problem.noise is None else problem.noise(read, problem.blocks)
        air = air_of(self.job.settings.environment, self.table, "station")
        length = (length + rng.normal(size=length.shape) * sigma)[0]
        return self.table.joined({"length [mm]": length if air is None else length / air.towards})

    def probing(self, rng: np.random.Generator) -> Table:
        """Return the poses with the displacements of an R-test, or those in which a touch probe finds its balls."""
        settings, machine, observations = self.job.settings, self.problem.machine, self.problem.readings.observations
        position = commanded(machine, self.table)
        noise = rng.normal(size=observations.readings.shape) * observations.sigma
        if DISPLACEMENTS[0] in self.table or settings.sensor != "bed":
            read = self.at(observations) + noise
            own = np.einsum("abn,an->bn", axes_of(machine, position, settings.sensor), read)
            return self.table.joined({" ".join(DISPLACEMENTS) + " [mm]": own.T})
        for _ in range(_ROUNDS):
            gap = self.at(observations)
            position = moved_by(machine, position, gap)
            if np.abs(gap).max() < _MET:
                break
            there = machine.conditions(position)
            observations = observations.with_conditions(there).with_index(machine.index(position))
        else:
            text = "the probe does not reach the balls by X, Y and Z: give poses with the dx, dy, dz of an R-test"
            raise InputError([self.table.fault(text)])
        position = moved_by(machine, position, noise)
        linear = {f"{axis.key} [mm]": own for axis, own in zip(machine.axes, position, strict=True) if not axis.turns}
        return self.table.joined(linear)
