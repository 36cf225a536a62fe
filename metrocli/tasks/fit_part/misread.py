"""Columns of coordinates that are read wrongly: exchanged, of the wrong sign, or in another unit.

A part with named surfaces may lie in any way, and surfaces have no limits: wrong points may fit as well as right ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from metrocli.arrays import Array, extents
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.tasks.fit_part.levels import Levels, robust_step
from metrocli.tasks.fit_part.nominals import OfSurfaces
from metrocli.tasks.fit_part.start import searched_pose
from metrocli.tasks.fit_part.stock import Stock

_BETTER = 5.0
"""Points are refused if another reading of them fits so many times better"""
_ROUGH = 3e-3
"""Scatter about the levels of raw parts at most, as a share of the extent; beyond it other units are tried"""
_THICKEST = 0.03
"""Overstock of raw parts at most, as a share of the extent"""
_ALIKE = 1.5
"""Readings fit alike within this ratio, and are nearer to the planes' points beyond it"""
_FLAT = 0.01
"""Ratio of the extents of a column and the others below which, or the reverse, their units may differ"""
_METRES = {1e-3: "mm in a column that is headed m", 1e3: "m in a column that is headed mm"}
_UNITS = _METRES | {
    25.4: "inches in a column that is headed mm",
    1 / 25.4: "mm in a column that is headed inches",
    10.0: "cm in a column that is headed mm",
    0.1: "mm in a column that is headed cm",
}
_SIGN = "turn the sign of one column of coordinates, or exchange two of them, whichever the file has wrong"
_MIRROR = np.array([-1.0, 1.0, 1.0])
_REFLECTIONS = np.array(
    [
        signed
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(signed := np.eye(3)[list(order)] * signs) < 0
    ]
)
"""Reflections that turn a cube into itself (24, 3, 3)"""


@dataclass(frozen=True)
class _Interpretation:
    """Points read in one way, and how they fit."""

    rms: float
    """Root mean square distance from the surfaces [mm]"""
    scatter: float
    """Standard deviation about the level of each surface [mm]"""
    off: float
    """How far the points of planes are from the point that the nominal gives of each [mm]"""
    extent: float
    """Largest extent of the points [mm]"""

    @property
    def relative(self) -> float:
        """Distance from the surfaces as a share of the extent: points that shrink to one place are near everything."""
        return self.rms / self.extent

    @property
    def is_rough(self) -> bool:
        """Whether the points scatter more than those of a raw part."""
        return self.scatter > _ROUGH * self.extent

    @property
    def is_thin(self) -> bool:
        """Whether the overstock is that of a raw part."""
        return self.relative < _THICKEST


def misread(nominal: OfSurfaces, even: Levels, start: Array) -> Iterator[str]:
    """Yield a doubt for each other reading of the points (in another unit, mirrored) that fits as well.

    `even` has the points with the levels of their surfaces. Raises InputError if another reading fits far better.
    """
    measured, surface = even.stock.measured, even.stock.surface

    def at(points: Array, to_part: Array) -> _Interpretation:
        local = Stock(nominal, points, surface).at(to_part)
        _, deviation = robust_step(local.rows, local.overstock, surface, len(nominal.names))
        off = nominal.off_centre(local.points, surface)
        return _Interpretation(_rms(local.overstock), _rms(deviation), off, float(extents(points).max()))

    def read_with(factors: Array, seed: int = 1, rotations: Array | None = None) -> _Interpretation:
        points = factors * measured
        return at(points, searched_pose(nominal, points, surface, start, seed, rotations))

    given, turned = at(measured, even.to_part), poses.rotation_of(even.to_part)
    # the even pose has a level for a surface that the search of other readings lays on
    laid_on = read_with(np.ones(3), rotations=turned[None])
    given = min(given, laid_on, key=lambda fit: fit.rms)
    # a part that fits as its own mirror image does so across planes that its surfaces have: a short search finds it
    across = None if given.is_rough else _REFLECTIONS @ turned * _MIRROR
    mirrored = read_with(_MIRROR, rotations=across)
    if given.is_rough:
        # another search: a pose that was not found would speak against the points as they are
        given = min(given, read_with(np.ones(3), seed=2), key=lambda fit: fit.rms)
    _refuse_mirror_image(given, mirrored)
    others = [
        (words, read_with(factors)) for words, factors in _other_units(measured, given.is_rough or not given.is_thin)
    ]
    _refuse_other_unit(given, others)
    alike = [(words, other) for words, other in others if _alike_and_nearer(other, given)]
    for words, other in sorted(alike, key=lambda pair: pair[1].off)[:1]:
        yield (
            f"multiplied by {words}, the points fit the surfaces as well ({other.rms:.3g} mm, root mean square), and "
            f"are nearer to the `point` of the planes ({other.off:.3g} mm) than as they are ({given.off:.3g} mm). "
            "Points on an opposite surface would decide"
        )
    if _alike_and_nearer(mirrored, given):
        yield (
            f"a mirror image of the points fits the surfaces as well ({mirrored.rms:.3g} mm, root mean square), and is "
            f"nearer to the `point` of the planes ({mirrored.off:.3g} mm) than the points as they are ({given.off:.3g} "
            f"mm). If the file is wrong, {_SIGN}. Points on an opposite surface would decide"
        )


def _refuse_mirror_image(given: _Interpretation, mirrored: _Interpretation) -> None:
    """Raise InputError if a mirror image of the points fits far better."""
    # with levels of their own, opposite surfaces fit on the wrong sides; without, thick overstock hides the rest
    rounding = 1e-6 * given.extent
    better = max(given.rms / (mirrored.rms + rounding), given.scatter / (mirrored.scatter + rounding))
    if better > _BETTER and mirrored.is_thin and not mirrored.is_rough:
        raise InputError(
            f"the points are a mirror image of the part: mirrored, they lie {mirrored.rms:.3g} mm from its surfaces "
            f"(root mean square) and scatter by {mirrored.scatter:.3g} mm, as they are {given.rms:.3g} mm and "
            f"{given.scatter:.3g} mm; {_SIGN}"
        )


def _refuse_other_unit(given: _Interpretation, others: list[tuple[str, _Interpretation]]) -> None:
    """Raise InputError if the points fit far better in another unit."""
    for words, other in sorted(others, key=lambda pair: pair[1].relative)[:1]:
        # in mm as well: a column that grows makes the extent larger, and all else a smaller share of it
        far_better = other.relative * _BETTER < given.relative and other.rms * _BETTER < given.rms
        if far_better and other.is_thin and not other.is_rough:
            raise InputError(
                f"multiplied by {words}, the points fit: they then lie {other.rms:.3g} mm from their surfaces (root "
                f"mean square), and {given.rms:.3g} mm as they are"
            )


def _other_units(measured: Array, doubted: bool) -> Iterator[tuple[str, Array]]:
    """Yield words and factors (3,) of other units: all where the fit is doubted, else those of a flat column."""
    size = np.maximum(extents(measured), 1e-9)  # a column of zeros is flat as well
    for column, name in enumerate("xyz"):
        others = np.delete(size, column).max()
        for factor, unit in _METRES.items():
            ratio = size[column] / others
            was, would_be = (max(value, 1 / value) for value in (ratio, ratio * factor))
            if doubted or (was > 1 / _FLAT > would_be):
                yield f"{factor:g} in {name} ({unit})", np.where(np.arange(3) == column, factor, 1.0)
    if doubted:
        for factor, unit in _UNITS.items():
            yield f"{factor:.4g} ({unit})", np.full(3, factor)


def _alike_and_nearer(other: _Interpretation, given: _Interpretation) -> bool:
    return other.is_thin and other.relative < _ALIKE * given.relative and other.off * _ALIKE < given.off


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
