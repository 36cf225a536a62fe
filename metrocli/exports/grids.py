"""Interpolate curves on the even grids that controls require."""

from __future__ import annotations

import numpy as np

from metrocli.exports.error_tables import Array, Curve

_EVEN = 1e-6
"""Largest distance [mm] of positions from an even grid"""


def evenly(curve: Curve, most: int) -> Curve | None:
    """Return a curve on the coarsest even grid that contains all its positions.

    Returns None if this grid needs more than `most` points.
    """
    start, end = curve.positions[0], curve.positions[-1]
    if len(curve.positions) < 2:
        return curve
    first = round((end - start) / float(np.diff(curve.positions).min()))
    for count in range(max(first, 1), most):
        if _meets(curve.positions, start, (end - start) / count):
            grid = np.linspace(start, end, count + 1)
            return Curve(grid, curve.at(grid))
    return None


def _meets(positions: Array, start: float, step: float) -> bool:
    steps = (positions - start) / step
    return bool(np.abs(steps - np.round(steps)).max() * step < _EVEN)
