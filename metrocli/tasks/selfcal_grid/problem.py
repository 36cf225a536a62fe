"""The adjustment of machine and artefact errors, from readings to blocks and groups with starting values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from metrocli.adjust.coupled_fields import FieldDesign, Fields
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry.poses import fit_pose
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.effects import AXES
from metrocli.tasks.selfcal_grid.readings import GridReadings, ball_name
from metrocli.tasks.shared.lists import distinguished, repeated
from metrocli.words import suggestion

_EXACT = 1e-2
"""Standard deviation of a datum condition written as a reading, relative to that of the readings"""
_DEPENDENT = 1e-9
"""Singular value of the open directions, relative to the largest, below which a direction repeats others"""
READINGS, LENGTHS = "views", "lengths"
"""Names of the groups: readings of the views, and calibrated distances between balls"""


@dataclass(frozen=True)
class GridProblem(Modelled):
    """A self-calibration ready to adjust."""

    grid: bg.Grid
    views: tuple[bg.View, ...]
    conditions: Mapping[str, Array]
    """The datum conditions of the fields, see `Fields`"""
    warnings: tuple[str, ...] = ()

    @cached_property
    def fields(self) -> Fields:
        """The coupled fields to adjust."""
        fields = bg.fields(self.grid, self.blocks, self.model.groups, self.scale_given)
        return replace(fields, conditions=self.conditions)

    def with_noise(self, noise: float) -> GridProblem:
        """Return the problem with another standard deviation of its readings."""
        observations = self.readings.observations
        readings = self.readings.with_observations(replace(observations, sigma=np.array(noise)))
        return self.with_model(self.model.with_group(readings))

    def with_noise_times(self, factor: float) -> GridProblem:
        """Return the problem with a factor on the noise of its readings."""
        return self.with_noise(self.noise * factor)

    def held(self, design: FieldDesign) -> GridProblem:
        """Return the problem with one datum condition for each direction of the fields that the design leaves open."""
        places = {name: design.partition.columns[name] for name in (bg.MACHINE, bg.ARTEFACT)}
        parts = [np.where(at >= 0, design.constraint[:, np.maximum(at, 0)], 0.0) for at in places.values()]
        _, sizes, rows = np.linalg.svd(
            np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1), full_matrices=False
        )
        # several open directions can have the same part in the fields: a condition twice would make the datum singular
        rows = rows[sizes > _DEPENDENT * sizes.max()]
        split = np.split(rows, [parts[0][0].size], axis=1)
        conditions = {name: part.reshape(-1, *at.shape) for (name, at), part in zip(places.items(), split, strict=True)}
        return replace(self, conditions=conditions)

    @property
    def model_with_datum(self) -> Model:
        """The model with its datum conditions as readings, for callers that do not know fields."""
        datum = bg.as_readings(self.conditions, _EXACT * self.noise)
        return replace(self.model, groups=(*self.model.groups, datum))

    def with_model(self, model: Model) -> Self:
        """Return the problem with a changed model; a datum written as readings is dropped from it."""
        groups = tuple(group for group in model.groups if group.name in (READINGS, LENGTHS))
        return replace(self, model=replace(model, groups=groups))

    @property
    def noise(self) -> float:
        """Standard deviation of a read coordinate [mm]."""
        return float(self.readings.observations.sigma.mean())

    @property
    def readings(self) -> Group:
        """The readings of the views."""
        return self.model.groups[0]

    @property
    def scale_given(self) -> bool:
        """Whether a length fixes the common scale."""
        return len(self.model.groups) > 1

    def warned(self, warnings: Sequence[str]) -> GridProblem:
        """Return the problem with further warnings."""
        return replace(self, warnings=(*self.warnings, *warnings))

    def only(self, keep: Mask) -> GridProblem:
        """Return the problem with some of its readings; sites, balls and views without readings are not unknowns."""
        readings = self.readings.selected(keep)
        blocks = dict(self.blocks)
        for name in (bg.MACHINE, bg.ARTEFACT, bg.VIEW):
            seen = np.zeros(len(blocks[name].members), dtype=bool)
            seen[readings.observations.index[name]] = True
            blocks[name] = replace(blocks[name], free=blocks[name].free & seen[:, None])
        known = np.asarray(blocks[bg.ARTEFACT].free.all(axis=1))
        others = [
            group.selected(np.asarray(known[group.observations.index[bg.ARTEFACT]].all(axis=0)))
            for group in self.model.groups[1:]
        ]
        groups = _present([readings, *others])
        conditions = _conditions_on(self.grid, blocks, scale_given=len(groups) > 1)
        return replace(self, model=replace(self.model, blocks=blocks, groups=groups), conditions=conditions)


def _present(groups: Sequence[Group]) -> tuple[Group, ...]:
    return tuple(group for group in groups if group.observations.count)


def _conditions_on(grid: bg.Grid, blocks: Mapping[str, Block], scale_given: bool) -> dict[str, Array]:
    """Return the datum conditions over the sites and balls that have readings."""
    seen = {name: np.asarray(blocks[name].free.all(axis=1)) for name in (bg.MACHINE, bg.ARTEFACT)}
    return {name: given * seen[name][None, :, None] for name, given in bg.datum(grid, scale_given).items()}


def build(readings: GridReadings, size: tuple[Index, float], noise: float, lengths: Table | None = None) -> GridProblem:
    """Return the adjustment with its starting values; size is (largest indices, pitch [mm]) of the grid."""
    half, pitch = size
    sites = np.empty_like(readings.balls)
    for n, view in enumerate(readings.views):
        rows = readings.at(n)
        sites[rows] = view.sites(readings.balls[rows])
    all_sites, site = np.unique(sites, axis=0, return_inverse=True)
    all_balls, ball = np.unique(readings.balls, axis=0, return_inverse=True)
    grid = bg.Grid(all_sites, all_balls, pitch, half)
    starts = np.array([_start(readings, n, pitch) for n in range(len(readings.views))])
    blocks = {
        bg.MACHINE: bg.field_block(bg.MACHINE, all_sites, "site"),
        bg.ARTEFACT: bg.field_block(bg.ARTEFACT, all_balls, "ball"),
        bg.VIEW: bg.view_block(readings.views, starts),
    }
    index = {bg.MACHINE: site.reshape(-1), bg.ARTEFACT: ball.reshape(-1), bg.VIEW: readings.view}
    observations = Observations(
        np.ascontiguousarray(readings.values.T),
        np.array(noise),
        index,
        keys=_keys(readings.table),
        conditions={
            **readings.table.conditions("t", "temp"),
            bg.HOLLOW: bg.hollow(readings.views, readings.view, readings.balls, pitch),
        },
        components=("x", "y", "z"),
        unit="mm",
    )
    groups = [Group(READINGS, bg.chain(readings.views, all_balls, pitch), observations)]
    if lengths is not None:
        groups.append(_lengths(lengths, readings.views, all_balls, pitch))
    present = _present(groups)
    places = {
        "view": Place(tuple(view.name for view in readings.views), bg.VIEW),
        "ball": Place(blocks[bg.ARTEFACT].members, bg.ARTEFACT),
        "axis": Place(AXES),
    }
    nominal = {bg.MACHINE: np.asarray(all_sites * pitch, dtype=float)}
    model = Model(blocks, present, measured=(READINGS,), places=places, nominal=nominal)
    return GridProblem(model, grid, readings.views, _conditions_on(grid, blocks, scale_given=len(present) > 1))


def _keys(table: Table) -> dict[str, tuple[str, ...]]:
    names = ["view", *"ijk", *(["repeat"] if "repeat" in table else [])]
    keys = {name: tuple(table.texts(name)) for name in names}
    again: dict[object, int] = {}
    same = np.array([again.setdefault(row, len(again)) for row in zip(*keys.values(), strict=True)])
    return distinguished(keys, same, table.numbers("t") if "t" in table else None)


def _start(readings: GridReadings, n: int, pitch: float) -> Array:
    """Return the mounting (6,) of a view by a rigid fit, as if machine and artefact had no errors."""
    rows, view = readings.at(n), readings.views[n]
    nominal: Array = np.asarray(view.sites(readings.balls[rows]) * pitch, dtype=float)
    return fit_pose(nominal, readings.values[rows])


def _lengths(table: Table, views: Sequence[bg.View], balls: Index, pitch: float) -> Group:
    """Return the calibrated distances as a group.

    Raises InputError if a ball or view has no readings, a distance cannot be that of its balls, or its standard
    uncertainty is not above zero.
    """
    ends = [np.rint(table.stacked([f"{name}{end}" for name in "ijk"])).astype(np.intp) for end in "12"]
    index = np.stack([bg.numbers_at(balls, end) for end in ends])
    faults = [
        table.fault_at(int(row), f"{ball_name(ends[end][row])} is not in the views")
        for end, row in np.argwhere(index < 0).tolist()
    ]
    nominal = np.linalg.norm(ends[0] - ends[1], axis=1) * pitch
    given, names = table.numbers("length"), [view.name for view in views]
    faults += [
        table.fault_at(
            row, f"the list has this length in row {before + 1}", "a length that counts twice is too certain"
        )
        for row, before in repeated(zip(*(map(tuple, end.tolist()) for end in ends), strict=True), given.tolist())
    ]
    for row in range(len(table)):
        if "view" in table and (written := table.texts("view")[row]) not in ["", *names]:
            faults.append(table.fault_at(row, f"view '{written}' has no readings", suggestion(written, names)))
        if nominal[row] == 0:
            faults.append(table.fault_at(row, f"a length from {ball_name(ends[0][row])} to itself"))
        if table.numbers("sigma")[row] <= 0:
            faults.append(table.fault_at(row, "the standard uncertainty of a length must be above zero"))
        if abs(given[row] - nominal[row]) > pitch / 4:
            faults.append(
                table.fault_at(row, f"the length is {given[row]:g} mm, but these balls are {nominal[row]:g} mm apart")
            )
    if faults:
        raise InputError(faults)
    keys = {f"{name}{end}": tuple(table.texts(f"{name}{end}")) for end in "12" for name in "ijk"}
    observations = Observations(
        given[None], table.numbers("sigma"), {bg.ARTEFACT: index}, keys=keys, components=("length",), unit="mm"
    )
    return Group(LENGTHS, Chain((bg.BallDistance(np.asarray(balls * pitch, dtype=float)),)), observations)
