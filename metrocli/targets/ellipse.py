"""An ellipse in an image."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Ellipse:
    """An ellipse in an image; pixel (0, 0) is the centre of the first pixel."""

    u: float
    v: float
    long: float
    """Longer semi-axis in pixels."""
    short: float
    angle: float = 0.0
    """Direction of the longer semi-axis in radians, from u towards v."""

    @property
    def centre(self) -> tuple[float, float]:
        """The centre (u, v) in pixels."""
        return self.u, self.v

    @property
    def shape(self) -> Array:
        """The lower triangular matrix W (2, 2) that maps offsets from the centre to the unit circle."""
        cos, sin, a, b = np.cos(self.angle), np.sin(self.angle), self.long**-2.0, self.short**-2.0
        uu, uv, vv = a * cos * cos + b * sin * sin, (a - b) * cos * sin, a * sin * sin + b * cos * cos
        r = np.sqrt(vv)
        # W'W is the quadratic form of the ellipse; a triangle leaves out the turn
        # of the circle, which no grey value shows
        return np.array([[np.sqrt(max(uu - uv * uv / vv, 1e-300)), 0.0], [uv / r, r]])
