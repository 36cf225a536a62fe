"""What the numbers of coordinates can hold: deviations below it are rounding, not noise."""

from __future__ import annotations

import math

import numpy as np

from metrocli.arrays import Array

_STEPS = 16
"""Deviations up to so many steps of a double are rounding: a transformation has about as many operations"""


def rounding_of(*coordinates: Array) -> float:
    """Return the size of deviations that rounding makes in coordinates of this size, nan ones left out."""
    return _STEPS * float(np.finfo(float).eps) * max(float(np.nanmax(np.abs(each))) for each in coordinates)


def without_rounding(values: Array, rounding: float) -> Array:
    """Return values to the last decimal that is larger than their rounding."""
    if not rounding > 0:
        return values
    # adding 0 turns -0 into 0
    return np.asarray(np.round(values, -math.ceil(math.log10(rounding))) + 0.0)
