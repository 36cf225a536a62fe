"""A location in the form that diagnosis needs, what readings of one pose share, and what no residual can show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.adjustment import adjust
from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.model.groups import Group
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate, PerReading
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.estimates import free_blocks
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.errors import InputError
from metrocli.instruments import launch_unit as lu
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit import KIND
from metrocli.tasks.locate_launch_unit.effects import EFFECTS
from metrocli.tasks.locate_launch_unit.solve import Located
from metrocli.tasks.shared.diagnosed import FOLDS, in_parts
from metrocli.tasks.shared.noise import JobNoise, job_noise
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of


def adjusted_job(located: Located) -> AdjustedJob:
    """Return an adjusted location in the form that diagnosis needs.

    Raises InputError for the methods of the paper, since they leave no residuals of the readings.
    """
    if located.problem is None or located.solution is None:
        raise InputError("only `method: adjustment` leaves residuals that can be diagnosed")
    groups = located.solution.groups
    model = with_conditions(replace(located.problem.model, blocks=located.solution.blocks, groups=groups))

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        kept = changed.kept(keep).groups
        return adjust(changed.blocks.values(), [group for group in kept if group.observations.count])

    when, poses = located.readings.conditions.get("t"), len(located.readings.names)
    parts = in_parts(np.arange(poses, dtype=float) if when is None else when, min(FOLDS, poses))
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        tuple(covariates(model)),
        (),
        {group.name: parts[_pose(group)] for group in model.readings},
        Delivered("place of the launch unit", lu.UNIT, (0, 1, 2), "um", "length"),
        refit,
        left_out=located.left_out,
        sharing=poses,
        made_together=("pose",),
    )


def covariates(model: Model) -> Iterator[Covariate]:
    """Yield the quantities with which an unknown effect could vary: time, temperature, encoder angles, and the beam."""
    groups = model.readings
    for name, key in (("t_s", ELAPSED), ("temp_degC", WARMING)):
        if all(key in group.observations.conditions for group in groups):
            yield Covariate(name, {group.name: group.observations.conditions[key] for group in groups})
            yield Covariate(name, {group.name: _moving(model, group, key) for group in groups}, together=True)
    if any(ELAPSED not in group.observations.conditions for group in groups):
        yield Covariate("order of the poses", {group.name: _pose(group).astype(float) for group in groups})
    encoders = {group.name: group.observations.readings[0] for group in groups if group.name != lu.DISTANCE}
    yield Covariate("encoder angle", encoders, angle=True)
    beams = {group.name: _beam(model, group) for group in groups}
    azimuth: PerReading = {name: np.arctan2(beam[1], beam[0]) for name, beam in beams.items()}
    yield Covariate("beam azimuth", azimuth, angle=True)
    yield Covariate("beam tilt", {name: np.arcsin(b[2] / np.linalg.norm(b, axis=0)) for name, b in beams.items()})
    yield Covariate("length_mm", {name: np.linalg.norm(beam, axis=0) for name, beam in beams.items()})


def _moving(model: Model, group: Group, condition: str) -> Array:
    """Return the change of readings if the unit moves along x, y, z in proportion to a condition, (3, n)."""
    along = group.observations.conditions[condition]
    touches = group.linear(model.blocks, frozenset({lu.UNIT})).touches
    return np.asarray((touches[0].jacobian[0, :3] * group.observations.stds[0]) * (along - along.mean()))


def _pose(group: Group) -> Index:
    return group.observations.index[lu.RECEIVER]


def _beam(model: Model, group: Group) -> Array:
    place = model.blocks[lu.UNIT].values[0, :3]
    return np.ascontiguousarray((model.blocks[lu.RECEIVER].values[_pose(group)] - place).T)


def noise_of(located: Located, model: str, factor: float) -> JobNoise | None:
    """Return the noise of a located unit; None for methods without residuals of all readings.

    Raises UndeterminedError for fewer than five poses if it is structured.
    """
    if located.solution is None or located.problem is None:
        return None
    pose = {group.name: group.observations.index[lu.RECEIVER] for group in located.used}
    estimates = (lu.UNIT, *free_blocks(located.problem.effects))
    return job_noise((located.solution, factor), model, lambda: Clusters(pose, "poses"), estimates)


_OFFSET = units.parse_quantity("10 um", "length")


def uncontrolled(receiver: Array, place: Array) -> Table:
    """Return what the place of the unit absorbs; `receiver` (n, 3) mm, `place` (3,) mm in the machine."""
    return table_of(_rows(receiver, place))


def _rows(receiver: Array, place: Array) -> Iterator[Hidden]:
    yield Hidden(
        "common scale of machine and distances (place of the unit, seen from the poses)",
        SCALE_WORDS,
        SCALE * float(np.linalg.norm(receiver - place, axis=1).max()),
        "temperature of the machine; a calibrated distance",
    )
    yield Hidden(
        "control point of the receiver along the spindle (place of the unit)",
        "10 um",
        _OFFSET,
        "the length of the receiver measured; it moves all poses alike",
    )
