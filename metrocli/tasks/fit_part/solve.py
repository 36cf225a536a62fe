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
from metrocli.tasks.fit_part import contradiction as c
from metrocli.tasks.fit_part import readings as r
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
from metrocli.tasks.fit_part.settings import NominalFile, PartStart, Settings
from metrocli.tasks.fit_part.start import searched_pose, unturned
from metrocli.tasks.fit_part.stock import Stock
from metrocli.tasks.fit_part.uncertainty import Sensitivity
from metrocli.tasks.shared.part import Part

_EVENER = 0.5
"""Ratio of the variations of the overstock below which a surface is taken as turned over"""
_LAID_ON = 1000
"""Points that are laid on without a search, at most"""


@dataclass(frozen=True)
class Prepared:
    """A job whose files fit together."""

    nominal: OfSurfaces | OfMesh
    readings: r.PartReadings
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
    part = ideal(nominal, settings.nominal_unit)
    of_mesh = isinstance(part, OfMesh)
    names = () if isinstance(part, OfMesh) else part.names
    readings = r.read(settings, points, names, of_mesh)
    if isinstance(part, OfMesh):
        must_be_of_one_size(part.triangles, readings.surface_points.points, settings.nominal_unit)
    return Prepared(part, readings, start_of(settings.start), settings.part)


def start_of(start: PartStart) -> Array:
    """Return the pose into the part frame (6,) that a job gives."""
    at = np.array([getattr(start, name) for name in poses.EULER])
    return poses.inverse(poses.pose_from_euler(at[:3], at[3:]))


def solve(settings: Settings, prepared: Prepared) -> FittedPart:
    """Return the fitted part.

    Raises InputError for surfaces turned over, UndeterminedError if the points leave the pose open or no pose has the
    minimum overstock, NotConvergedError.
    """
    nominal, places = prepared.nominal, prepared.readings.surface_points
    rough = _rough(prepared)
    surface = prepared.readings.surface
    even = robust_levels(nominal, places.points, surface, rough, places.sigma)
    used = ~even.outlying if settings.outliers == "remove" else np.ones(len(places.points), dtype=bool)
    stock = even.stock.of(used)
    name, minimum = settings.overstock.aim, settings.overstock.minimum
    open_motions = c.must_be_determined(stock, even.to_part, name)
    # points that leave a motion open fit in whatever way they are read
    other: tuple[str, ...] = ()
    if isinstance(nominal, OfSurfaces) and surface is not None and not open_motions:
        other = tuple(misread(nominal, even, prepared.start))
    turned = reversed_surfaces(stock, nominal, even.to_part) if isinstance(nominal, OfSurfaces) else []
    highest, largest, holding = max_least_overstock_of_many(stock, even.to_part)
    if not c.feasible(largest, minimum):
        contradictions = c.contradictions(stock, minimum, highest)
        wrong_side = c.wrong_side(turned) if turned else c.all_inside(even.level, isinstance(nominal, OfMesh))
        hint = other[0] if other else wrong_side
        raise c.refuse(contradictions, places.of(used).names, minimum, largest, hint)
    # a negative minimum allows for missing material, and surfaces without it look the same
    doubts = [c.wrong_side(turned)] if turned else []
    if doubts and minimum >= 0:
        raise InputError(doubts[0])
    if name == MOST and not np.isfinite(largest):
        raise UndeterminedError("the least overstock has no limit: no surface faces the others; use another aim")
    # nearer to what is sought than the largest least overstock, where they are allowed: no motion, and the even fit
    near = {LEAST_MOTION: (prepared.start, even.to_part), EVEN: (even.to_part,)}.get(name, ())
    begin = next((to_part for to_part in near if _has_the_minimum(stock, minimum, to_part)), highest)
    aim, fitted = fitted_part(stock, name, minimum, (begin, largest, holding), prepared.start)
    sense = sensitivity_with_exchanges(fitted, aim, prepared.start, places.of(used).places)
    warnings = (*prepared.readings.warnings, *open_motions, *doubts)
    doubted = (*other, *r.far_targets(prepared.readings, fitted.to_part))
    return FittedPart(
        prepared, even, used, stock, aim, fitted, min(minimum, largest), largest, sense, warnings, doubted
    )


def _has_the_minimum(stock: Stock, minimum: float, to_part: Array) -> bool:
    """Return whether a pose (6,) leaves the minimum everywhere."""
    # far from a mesh each point costs a long search, and one of a thousand mostly answers
    some = stock.of(np.random.default_rng(1).permutation(len(stock.measured))[:_LAID_ON])
    return all(bool(points.at(to_part).overstock.min() >= minimum) for points in (some, stock))


def _rough(prepared: Prepared) -> Array:
    """Return the pose (6,) from which the levels are sought.

    Points that leave a motion open wander along it in the search, until other surfaces are the nearest. So where
    surfaces are found, some points are first laid on without the search, and that pose is kept if it is open.
    """
    nominal, places, surface = prepared.nominal, prepared.readings.surface_points, prepared.readings.surface
    if surface is None:
        n = len(places.points)
        some = np.random.default_rng(1).permutation(n)[:_LAID_ON]
        pose = unturned(nominal, places.points, prepared.start)
        laid = robust_levels(nominal, places.points[some], None, pose, places.sigma[some])
        if c.open_motions(laid.stock, laid.to_part):
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
