"""The functions of fit-part, and the solution of its fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Mask
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.triangles import Triangles
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_part import contradiction
from metrocli.tasks.fit_part.draws import sensitivity_with_exchanges
from metrocli.tasks.fit_part.fit import (
    EVEN,
    LEAST_MOTION,
    MOST,
    SLACK,
    PoseCriterion,
    PoseFit,
    criterion_of,
    fit,
    max_least_overstock_of_many,
)
from metrocli.tasks.fit_part.ideal import ideal, must_be_of_one_size
from metrocli.tasks.fit_part.levels import Levels, robust_levels
from metrocli.tasks.fit_part.misread import misread
from metrocli.tasks.fit_part.nominals import OfMesh, OfSurfaces
from metrocli.tasks.fit_part.readings import PartReadings, far_targets, read
from metrocli.tasks.fit_part.settings import NominalFile, PartStart, Settings
from metrocli.tasks.fit_part.start import searched_pose, unturned
from metrocli.tasks.fit_part.stock import Stock
from metrocli.tasks.fit_part.uncertainty import Sensitivity
from metrocli.tasks.shared.part import Part

_EVENER = 0.5
"""Ratio of the variations of the overstock below which a surface is taken as turned over"""
_FEW = 1000
"""Points that are tried before all, at most: to lay them on without a search, and to compare with the minimum"""


@dataclass(frozen=True)
class Prepared:
    """A job whose files fit together."""

    nominal: OfSurfaces | OfMesh
    readings: PartReadings
    start: Array
    """Pose into the part frame that the job gives (6,)"""
    part: Part | None = None
    """The raw part at the measurement of its points"""


@dataclass(frozen=True)
class FittedPart:
    """A fitted part."""

    prepared: Prepared
    levels: Levels
    used: Mask
    """Which surface points take part in the fit (n,)"""
    stock: Stock
    """Of the points that take part"""
    aim: PoseCriterion
    fit: PoseFit
    minimum: float
    """Least overstock that the job asks for [mm]; with the aim `most` the fit keeps a larger one"""
    largest: float
    """Largest possible least overstock [mm], inf without limit"""
    sensitivity: Sensitivity
    warnings: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def prepare(settings: Settings, nominal: NominalFile | Triangles, points: Table | Result) -> Prepared:
    """Return ideal part and readings of a job; raises InputError with what is wrong with the files."""
    geometry = ideal(nominal, settings.nominal_unit)
    if isinstance(geometry, OfMesh):
        readings = read(settings, points, (), of_mesh=True)
        must_be_of_one_size(geometry.triangles, readings.surface_points.points, settings.nominal_unit)
    else:
        readings = read(settings, points, geometry.names, of_mesh=False)
    return Prepared(geometry, readings, start_of(settings.start), settings.part)


def start_of(start: PartStart) -> Array:
    """Return the pose into the part frame (6,) that a job gives."""
    values = np.array([getattr(start, name) for name in poses.EULER])
    # the job gives the pose of the part in the frame of the points
    return poses.inverse(poses.pose_from_euler(values[:3], values[3:]))


def solve(settings: Settings, prepared: Prepared) -> FittedPart:
    """Return the fitted part.

    Raises InputError for surfaces turned over, UndeterminedError if the points leave the pose open or no pose has the
    minimum overstock, NotConvergedError.
    """
    nominal, places, surface = prepared.nominal, prepared.readings.surface_points, prepared.readings.surface
    levels = robust_levels(nominal, places.points, surface, _rough(prepared), places.sigma)
    used = ~levels.outlying if settings.outliers == "remove" else np.ones(len(places.points), dtype=bool)
    stock = levels.stock.of(used)
    name, minimum = settings.overstock.aim, settings.overstock.minimum
    open_motions = contradiction.must_be_determined(stock, levels.to_part, name)
    # points that leave a motion open fit in whatever way they are read
    doubts: tuple[str, ...] = ()
    if isinstance(nominal, OfSurfaces) and surface is not None and not open_motions:
        doubts = tuple(misread(nominal, levels, prepared.start))
    turned = reversed_surfaces(stock, nominal, levels.to_part) if isinstance(nominal, OfSurfaces) else []
    wrong_side = (contradiction.wrong_side(turned),) if turned else ()
    highest, largest, duals = max_least_overstock_of_many(stock, levels.to_part)
    if not contradiction.feasible(largest, minimum):
        contradictions = contradiction.contradictions(stock, minimum, highest)
        all_inside = contradiction.all_inside(levels.level, isinstance(nominal, OfMesh))
        hint = (*doubts, *wrong_side, all_inside)[0]
        raise contradiction.refuse(contradictions, places.of(used).names, minimum, largest, hint)
    # a negative minimum allows for missing material, and surfaces without it look the same
    if wrong_side and minimum >= 0:
        raise InputError(wrong_side[0])
    if name == MOST and not np.isfinite(largest):
        raise UndeterminedError("the least overstock has no limit: no surface faces the others; use another aim")
    # no motion and the even fit are nearer to what is sought than the largest least overstock, if they keep the minimum
    near = {LEAST_MOTION: (prepared.start, levels.to_part), EVEN: (levels.to_part,)}.get(name, ())
    begin = next((to_part for to_part in near if _has_the_minimum(stock, minimum, to_part)), highest)
    aim, fitted = fitted_part(stock, name, minimum, (begin, largest, duals), prepared.start)
    return FittedPart(
        prepared=prepared,
        levels=levels,
        used=used,
        stock=stock,
        aim=aim,
        fit=fitted,
        minimum=min(minimum, largest),
        largest=largest,
        sensitivity=sensitivity_with_exchanges(fitted, aim, prepared.start, places.of(used).places),
        warnings=(*prepared.readings.warnings, *open_motions, *wrong_side),
        doubts=(*doubts, *far_targets(prepared.readings, fitted.to_part)),
    )


def _has_the_minimum(stock: Stock, minimum: float, to_part: Array) -> bool:
    """Return whether a pose (6,) leaves the minimum everywhere."""
    # far from a mesh each point costs a long search, and a thousand points mostly have one that is too low
    some = stock.of(np.random.default_rng(1).permutation(len(stock.measured))[:_FEW])
    return all(bool(points.at(to_part).overstock.min() >= minimum) for points in (some, stock))


def _rough(prepared: Prepared) -> Array:
    """Return the pose (6,) from which the levels are sought.

    Points that leave a motion open wander along it in the search, until other surfaces are the nearest. So where
    surfaces are found, some points are first laid on without the search, and that pose is kept if it is open.
    """
    nominal, places, surface = prepared.nominal, prepared.readings.surface_points, prepared.readings.surface
    if surface is None:
        n = len(places.points)
        some = np.random.default_rng(1).permutation(n)[:_FEW]
        pose = unturned(nominal, places.points, prepared.start)
        laid = robust_levels(nominal, places.points[some], None, pose, places.sigma[some])
        if contradiction.open_motions(laid.stock, laid.to_part):
            return laid.to_part
    return searched_pose(nominal, places.points, surface, prepared.start)


def fitted_part(
    stock: Stock, name: str, minimum: float, begin: tuple[Array, float, Array], start: Array
) -> tuple[PoseCriterion, PoseFit]:
    """Return the fit of an aim from a pose, and from the largest least overstock and its duals.

    For the aim `most` the pose is that of the largest least overstock.
    """
    to_part, largest, duals = begin
    if name != MOST:
        aim = criterion_of(stock, name, min(minimum, largest), start)
        return aim, fit(stock, aim, to_part)
    aim = criterion_of(stock, name, largest - SLACK, start)
    even = fit(stock, aim, to_part)
    # of a linear programme the gradient is 0: its duals alone have to balance
    held = np.abs(even.local.rows.T @ duals).max()
    return aim, replace(even, duals=duals, optimality=float(held))


def reversed_surfaces(stock: Stock, nominal: OfSurfaces, to_part: Array) -> list[str]:
    """Return the names of surfaces with whose material on the other side the overstock is far more even."""
    given = _variation(stock, to_part)
    return [
        nominal.names[surface]
        for surface in np.unique(stock.surface).tolist()
        if _variation(Stock(nominal.reversed(surface), stock.measured, stock.surface), to_part) < _EVENER * given
    ]


def _variation(stock: Stock, to_part: Array) -> float:
    """Return the standard deviation of the overstock after two steps towards the least one [mm]."""
    for _ in range(2):
        local = stock.at(to_part)
        rows = local.rows - local.rows.mean(axis=0)
        to_part = local.moved(to_part, -np.linalg.lstsq(rows, local.overstock - local.overstock.mean(), rcond=1e-6)[0])
    return float(stock.at(to_part).overstock.std())
