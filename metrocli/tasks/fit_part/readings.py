"""The measured points of a raw part: surface points with their surfaces, and coded targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from fnmatch import fnmatchcase

import numpy as np

from metrocli import units
from metrocli.arrays import Array, Index, Mask, extents
from metrocli.errors import Fault, InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_part.settings import Settings
from metrocli.tasks.shared.lists import sigmas
from metrocli.tasks.shared.part import growth_of
from metrocli.uncertainty.predicted import PredictedPlaces, independent, points_of
from metrocli.words import counted, listed, suggestion

TARGET_WORD = "target"
"""Word in the column `surface` that marks a coded target"""

_OFF_PART = 1.0
"""Distance from the box of the points, as a share of its extent, beyond which a target is not on a fixture beside it"""
_FEW = 0.25
"""Share of the targets up to which those are wrong"""


@dataclass(frozen=True)
class Points:
    """Measured points with their joint covariance."""

    names: tuple[str, ...]
    places: PredictedPlaces

    @property
    def points(self) -> Array:
        """(n, 3) mm."""
        return self.places.values

    @property
    def covariance(self) -> Array:
        """Covariance of each point (n, 3, 3) mm^2."""
        return self.places.covariance

    def of(self, rows: Mask) -> Points:
        """Return some of the points."""
        names = tuple(name for name, kept in zip(self.names, rows.tolist(), strict=True) if kept)
        return Points(names, self.places.of(rows))

    @property
    def sigma(self) -> Array:
        """Root mean square standard deviation of the coordinates of each (n,)."""
        return np.asarray(np.sqrt(np.einsum("nkk->n", self.covariance) / 3))


@dataclass(frozen=True)
class PartReadings:
    """The points of a raw part."""

    surface_points: Points
    surface: Index | None
    """Surface of each surface point (n,), None if it has to be found"""
    targets: Points
    growth: Mapping[str, float] = field(default_factory=dict)
    """Growth of the part from 20 degC, empty if the points are as they were measured"""
    warnings: tuple[str, ...] = ()


def read(settings: Settings, points: Table | Result, names: tuple[str, ...], of_mesh: bool) -> PartReadings:
    """Return the points of a job; `names` are those of the ideal surfaces.

    Coded targets are the points that `targets:` names and those with the surface `target`. Where others name their
    surface, a point without one is a target if no point is named as one; else it is left out, or belongs to a surface
    of the mesh. Raises InputError with every fault.
    """
    table = points.tables.get("points") if isinstance(points, Result) else points
    if table is None:
        raise InputError("the result among the inputs has no table of points: a camera needs `rig: network`")
    with all_faults() as each:
        with each():
            measured = _points(settings, points, table)
        with each():
            target = _chosen_targets(settings, table)
        with each():
            surfaces = _written_surfaces(settings, table, () if of_mesh else names)
    named = np.array([bool(name) and name != TARGET_WORD for name in surfaces])
    target |= np.array([name == TARGET_WORD for name in surfaces])
    warnings, left_out = [], np.zeros(len(surfaces), dtype=bool)
    if named.any() and not target.any():
        target = ~named
    elif named.any() and not of_mesh:
        left_out = ~named & ~target
    if left_out.any():
        rest = measured.of(left_out).names
        warnings.append(
            f"{counted(len(rest), 'point', 'are')} neither on a surface nor among `targets` and left out: "
            f"{listed(rest, 5)}"
        )
    if of_mesh and named.any():
        warnings.append("the surfaces named for the points are not used: the triangles of a mesh have no names")
    surface = None
    if named.any() and not of_mesh:
        number = {name: n for n, name in enumerate(names)}
        surface = np.array([number.get(name, 0) for name in surfaces], dtype=np.intp)[~target & ~left_out]
    if (target | left_out).all():
        raise InputError([table.fault("there is no point of a surface", "name surfaces in the column `surface`")])
    if not measured.covariance.any():
        warnings.append(
            "the points are taken as exact: give a column sigma_mm, or `noise: 0.05 mm`, to get uncertainties"
        )
    growth = _growth(settings, points)
    return PartReadings(measured.of(~target & ~left_out), surface, measured.of(target), growth, tuple(warnings))


def far_targets(readings: PartReadings, to_part: Array) -> list[str]:
    """Return which targets are neither on the part nor on a fixture beside it, if most are."""
    targets, points = readings.targets, poses.apply(to_part, readings.surface_points.points)
    if not targets.names:
        return []
    at = poses.apply(to_part, targets.points)
    beyond = np.maximum(np.maximum(points.min(axis=0) - at, at - points.max(axis=0)), 0.0)
    away = np.linalg.norm(beyond, axis=1)
    far = away > _OFF_PART * extents(points).max()
    # many that are far off, or all, stand on something else
    if not far.any() or far.all() or far.sum() > max(_FEW * len(away), 1):
        return []
    each = [f"{targets.names[i]} by {units.sized(away[i], 'length')}" for i in np.flatnonzero(far).tolist()]
    return [f"targets lie far outside the part: {listed(each, 5)}; correct their coordinates, or leave them out"]


def _growth(settings: Settings, points: Table | Result) -> dict[str, float]:
    """Return the growth of the part from 20 degC that the points are free of, by this job or by that of the points."""
    if settings.part is not None:
        return settings.part.facts
    return growth_of(points) if isinstance(points, Result) else {}


def _points(settings: Settings, points: Table | Result, table: Table) -> Points:
    """Return all points, at 20 degC where the job has the temperature of the part.

    The middle of the points stays, so that the growth moves neither the pose nor the overstock of a part far from the
    origin. Raises InputError for points that are at 20 degC already.
    """
    if settings.part is not None and isinstance(points, Result) and growth_of(points):
        raise InputError("part: the points of the result are at 20 degC already: its own job has `part:`; leave it out")
    measured = _measured(settings, points, table)
    if settings.part is None:
        return measured
    return Points(measured.names, settings.part.of_places(measured.places, measured.points.mean(axis=0)))


def _measured(settings: Settings, points: Table | Result, table: Table) -> Points:
    names = tuple(table.texts("point"))
    if isinstance(points, Result):
        return Points(names, points_of(points))
    sigma = sigmas(table, settings.noise or 0.0)
    unknown = np.flatnonzero(np.isnan(sigma).any(axis=1))
    if unknown.size and settings.noise is None:
        raise InputError(
            table.faults_at(
                unknown,
                lambda row: f"point '{names[row]}' has no standard deviation",
                lambda row: "fill sigma_mm, or give `noise: 0.05 mm` for such points",
            )
        )
    sigma = np.where(np.isnan(sigma), settings.noise or 0.0, sigma)
    return Points(names, independent(table.stacked(("x", "y", "z")), sigma[:, :, None] ** 2 * np.eye(3)))


def _chosen_targets(settings: Settings, table: Table) -> Mask:
    names = table.texts("point")
    chosen = np.zeros(len(names), dtype=bool)
    faults = []
    for pattern in settings.targets:
        rows = np.array([fnmatchcase(name, pattern) for name in names])
        chosen |= rows
        if not rows.any():
            faults.append(
                Fault(f"targets: no point has the name '{pattern}'", table.file, hint=suggestion(pattern, names))
            )
    if faults:
        raise InputError(faults)
    return chosen


def _written_surfaces(settings: Settings, table: Table, known: tuple[str, ...]) -> list[str]:
    """Return the surface that the file gives for each point, or the job, which wins; empty without one."""
    names = table.texts("point")
    written = list(table.texts("surface", ""))
    faults = []
    for surface, patterns in settings.surfaces.items():
        if known and surface not in known:
            faults.append(
                Fault(f"surfaces: the ideal part has no surface '{surface}'", hint=suggestion(surface, known))
            )
        for pattern in patterns:
            rows = [row for row, name in enumerate(names) if fnmatchcase(name, pattern)]
            if not rows:
                faults.append(Fault(f"surfaces: no point has the name '{pattern}'", table.file))
            for row in rows:
                written[row] = surface
    wrong = [row for row, name in enumerate(written) if known and name and name != TARGET_WORD and name not in known]
    if "surface" in table:
        faults += table.faults_at(
            wrong,
            lambda row: f"the ideal part has no surface '{written[row]}'",
            lambda row: suggestion(written[row], [*known, TARGET_WORD]),
        )
    if faults:
        raise InputError(faults)
    return written
