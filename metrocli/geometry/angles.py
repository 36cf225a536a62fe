"""Angles on the circle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def wrapped(angle: Array | float) -> Array:
    """Return an angle [rad] within -pi ... pi."""
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)), dtype=float)
