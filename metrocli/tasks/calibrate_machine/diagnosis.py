"""A solved machine calibration in the form that diagnosis works on, and what its readings share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.model.blocks import Space
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution
from metrocli.arrays import Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.acting import NOMINAL
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import ELAPSED, WARMING, Effect
from metrocli.effects.estimates import free_blocks
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.geometry import poses
from metrocli.instruments.axes.error_motion import ReachedPoint
from metrocli.instruments.axes.kinematics import LINKS
from metrocli.instruments.axes.rotary import RotaryAxis, turning_axes
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracer import TRACER, beams
from metrocli.instruments.tracker import LEG, TRACKER
from metrocli.tasks.calibrate_machine import KIND
from metrocli.tasks.calibrate_machine.effects import OF_BALLS, OF_LENGTHS, OF_LINES, OF_MACHINES
from metrocli.tasks.calibrate_machine.problem import ALL_SIDES, ERROR_BLOCKS, PLACES_OF_AXES
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, refitted
from metrocli.tasks.shared.diagnosed import FOLDS, in_parts, of_beam
from metrocli.tasks.shared.lists import unless_without_noise
from metrocli.tasks.shared.noise import POINTS_IN_TIME, JobNoise, count, in_blocks, job_noise

_NO_STOPS = "the machine does not stop at the readings"
_PIECES = "the readings are averages over pieces of the path longer than a pitch; a job may name it with its period"


def adjusted_job(solved: AdjustedMachine) -> AdjustedJob:
    """Return a solved calibration with the covariates, held-out parts and refit that diagnosis needs."""
    problem = solved.problem.with_blocks(solved.solution.blocks)
    model = with_conditions(problem.model)
    group = model.readings[0]

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return refitted(replace(problem, model=changed.kept(keep)))

    return AdjustedJob(
        KIND.name,
        model,
        _effects_on(model),
        tuple(covariates(model)),
        ("tracer",) if TRACER in model.blocks else (),
        {group.name: _parts(group)},
        _delivered(problem.machine, model),
        refit,
        noisier=tuple(kind for kind in ("line", "ball") if model.places[kind].index in group.observations.index),
        left_out=len(solved.rejected),
        made_together=("leg",) if _condensed(group) else (),
        variations=lambda model, readings: () if _condensed(group) else _variations(model, readings),
        sharing=count(clusters_of(solved).of[group.name]),
        not_sought=dict(_not_sought(group)),
        noticed=unless_without_noise(problem.stuck, solved.solution.sigma0),
    )


def _delivered(machine: Machine, model: Model) -> Delivered:
    """Return what a calibration is for: the displacements of its tables, else the places of its rotary axes."""
    with_tables = [axis for axis in machine.axes if model.blocks[axis.block].free.any()]
    places = [axis.location for axis in turning_axes(machine)]
    if not with_tables and places:
        return Delivered("places of the rotary axes", places[0], (0, 1), "um", "length", tuple(places[1:]))
    first, *others = (axis.block for axis in machine.axes)
    if machine.only_turns and not any(model.blocks[axis.block].free[:, :3].any() for axis in machine.axes):
        angles = {axis.block: axis.from_raw[3:] for axis in machine.axes}
        return Delivered("error tables", first, (3, 4, 5), "arcsec", "angle", tuple(others), angles)
    tables = {axis.block: axis.from_raw[:3] for axis in machine.axes}
    return Delivered("error tables", first, (0, 1, 2), "um", "length", tuple(others), tables)


def _not_sought(group: Group) -> Iterator[tuple[str, str]]:
    """Yield the effects that condensed pieces of a path do not show, each with the reason."""
    if _condensed(group):
        yield from ((machine.name, _PIECES) for machine in OF_MACHINES if machine.space is Space.WAVE)
        yield from ((machine.name, _NO_STOPS) for machine in OF_MACHINES if machine.throughout)


def _effects_on(model: Model) -> tuple[Effect, ...]:
    """Return the effects on the machine, and those on what reads it: stations, a laser, or a tracker."""
    if TRACER in model.blocks:
        return OF_LENGTHS
    if LINE in model.blocks:
        return OF_LINES
    return OF_MACHINES if TRACKER in model.blocks or LEG in model.blocks else OF_BALLS


def _condensed(group: Group) -> bool:
    """Whether the readings are condensed pieces of a path: they average out waves shorter than a piece."""
    return "leg" in group.observations.keys


def _variations(model: Model, readings: Observations) -> Iterator[tuple[str, Observations]]:
    """Yield readings as they would be from the other side in each axis, and with each other tool."""
    for axis in (side.removeprefix("from_") for side in ALL_SIDES):
        came = readings.conditions.get(f"from_{axis}")
        if came is not None:
            yield f"from the other side in {axis}", readings.with_conditions({f"from_{axis}": -came})
    for number, name in enumerate(model.blocks[TOOL].members):
        if (readings.index[TOOL] != number).all():
            yield f"with tool {name}", readings.with_index({TOOL: np.full(readings.count, number)})


def covariates(model: Model) -> Iterator[Covariate]:
    """Yield the variables on which an unknown effect may depend: time, place, and distance and azimuth of the beam."""
    group = model.readings[0]
    conditions, name = group.observations.conditions, group.name
    if ELAPSED in conditions:
        yield Covariate("t_s", {name: conditions[ELAPSED]}, periodic=True)
    else:
        order = np.arange(group.observations.count, dtype=float)
        yield Covariate("order of the readings", {name: order}, periodic=True)
    if NOMINAL[0] in conditions:
        position = np.stack([conditions[axis] for axis in NOMINAL])
        yield Covariate("place in the machine", {name: position})
    joined = (link for link in group.chain.links if isinstance(link, LINKS) and not isinstance(link, ReachedPoint))
    axes = {axis.letter: axis for link in joined for axis in link.machine.axes}
    for axis in (moved for moved in axes.values() if isinstance(moved, RotaryAxis)):
        yield Covariate(f"{axis.key}_deg", {name: conditions[axis.coordinate]}, angle=axis.periodic)
    if WARMING in conditions:
        yield Covariate("temp_degC", {name: conditions[WARMING]})
    if TRACER in model.blocks:
        to = Chain(tuple(link for link in group.chain.links if isinstance(link, LINKS)))
        yield from of_beam(group, beams(to, model.blocks, group.observations))
    if TRACKER in model.blocks:
        seen = poses.apply(poses.inverse(model.blocks[TRACKER].values[0]), position.T).T
        yield Covariate("distance from the tracker", {name: np.linalg.norm(seen, axis=0)})
        yield Covariate("azimuth of the beam", {name: np.arctan2(seen[1], seen[0])}, angle=True)


def _parts(group: Group) -> Index:
    """Return for each reading the number of its held-out part, (n,): ten parts by time, or by legs of a path."""
    if _condensed(group):
        legs = np.unique(np.array(group.observations.keys["leg"], dtype=int), return_inverse=True)[1]
        return np.asarray(legs % FOLDS)
    return in_parts(group.observations.order, FOLDS)


def noise_of(solved: AdjustedMachine, model: str, factor: float) -> JobNoise:
    """Return the noise of a solved calibration.

    Raises UndeterminedError for fewer than five lines or legs, or ten points, if it is structured.
    """
    blocks = solved.solution.blocks
    tools = (TOOL,) if blocks[TOOL].free.any() else ()
    delivered = tuple(name for name in ERROR_BLOCKS if name in blocks and blocks[name].free.any())
    places = (name for name in PLACES_OF_AXES if name in blocks)
    estimates = (*places, *tools, *free_blocks(solved.problem.effects))
    return job_noise((solved.solution, factor), model, lambda: clusters_of(solved), estimates, delivered)


def clusters_of(solved: AdjustedMachine) -> Clusters:
    """Return which readings may share errors: those of one line (six-dof), of one leg, or of successive points."""
    readings = solved.problem.readings
    observations = readings.observations
    for block, over in ((LINE, "lines"), (LEG, "legs of the path")):
        if block in observations.index:
            return Clusters({readings.name: observations.index[block]}, over)
    return Clusters({readings.name: in_blocks(observations.order)}, POINTS_IN_TIME)
