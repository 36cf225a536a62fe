"""Columns of coordinates that are read wrongly: exchanged, of the wrong sign, or in another unit.

A part with named surfaces may lie in any way, and surfaces have no limits: wrong points may fit as well as right ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Index, extents
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.tasks.fit_part.start import Sought, found

_BETTER = 5.0
"""Coordinates that are read otherwise are refused as given if they fit so many times better so"""
_ROUGH = 3e-3
"""Distance from the surfaces, as a share of the extent, above which other units are tried: raw parts have less"""
_NEARER = 1.5
"""A mirror image that fits alike, within this ratio, is named if it is so many times nearer to the planes' points"""
_COLUMNS = {"x": (0,), "y": (1,), "z": (2,), "x, y and z": (0, 1, 2)}
_MIRROR = np.array([-1.0, 1.0, 1.0])


def misread(nominal: Sought, measured: Array, surface: Index, start: Array, to_part: Array) -> Iterator[str]:
    """Yield a doubt about points (n, 3) at a pose (6,) that a mirror image fits as well.

    Raises InputError if points that are read otherwise fit far better.
    """
    rms, off = _fit(nominal, measured, surface, to_part)

    def read_so(factors: Array) -> tuple[float, float]:
        points = factors * measured
        return _fit(nominal, points, surface, found(nominal, points, surface, start))

    mirrored, nearer = read_so(_MIRROR)
    sign = "turn the sign of one column of coordinates, or exchange two of them, whichever the file has wrong"
    rough = _ROUGH * extents(measured).max()
    if rms > rough:
        # another search: a pose that was not found would speak against the points as they are
        rms = min(rms, _fit(nominal, measured, surface, found(nominal, measured, surface, start, seed=2))[0])
    if mirrored * _BETTER < rms and mirrored < rough:
        raise InputError(
            f"the points are a mirror image of the part: mirrored, they lie {mirrored:.3g} mm from its surfaces (root "
            f"mean square), and {rms:.3g} mm as they are; {sign}"
        )
    if rms > rough:
        for name, columns in _COLUMNS.items():
            for factor, unit in ((1e-3, "mm in a column that is headed m"), (1e3, "m in a column that is headed mm")):
                factors = np.ones(3)
                factors[list(columns)] = factor
                other = read_so(factors)[0]
                if other * _BETTER < rms and other < _ROUGH * extents(factors * measured).max():
                    raise InputError(
                        f"{name} of the points fit if they are multiplied by {factor:g}, such as {unit}: the points "
                        f"then lie {other:.3g} mm from their surfaces (root mean square), and {rms:.3g} mm as they are"
                    )
    if mirrored < _NEARER * rms and nearer * _NEARER < off:
        yield (
            f"a mirror image of the points fits the surfaces as well ({mirrored:.3g} mm, root mean square), and is "
            f"nearer to the `point` of the planes ({nearer:.3g} mm) than the points as they are ({off:.3g} mm). "
            f"If the file is wrong, {sign}. Points on an opposite surface would decide"
        )


def _fit(nominal: Sought, points: Array, surface: Index, to_part: Array) -> tuple[float, float]:
    """Return the root mean square distance of points from their surfaces, and how far those of planes are off."""
    placed = poses.apply(to_part, points)
    distance = nominal.quick(placed[None], surface)[0]
    return float(np.sqrt((distance**2).mean())), nominal.off_centre(placed, surface)
