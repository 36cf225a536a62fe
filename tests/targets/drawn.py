"""Crops with one blurred ellipse, drawn on a fine raster by counting: independent of the renderer and of the fit."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FINE = 16


def ellipse(
    rng: np.random.Generator,
    diameter: float,
    aspect: float,
    noise: float,
    light: float = 0.0,
    ink: float = 210,
    paper: float = 30,
) -> tuple[npt.NDArray[np.uint8], Array, float]:
    """Return a crop, the true centre and the angle; PSF 0.7 px, 8 bit; `light` is the relative change across the target."""
    side = int(diameter + 26) // 2 * 2
    centre, angle = side / 2 - 0.5 + rng.uniform(-0.5, 0.5, 2), rng.uniform(0, np.pi)
    at = (np.arange(side * FINE) + 0.5) / FINE - 0.5
    du, dv = at - centre[0], (at - centre[1])[:, None]
    along, across = du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)
    fine = ((along * along + (across / aspect) ** 2) < diameter**2 / 4).astype(np.float32)
    soft = cv2.GaussianBlur(fine, (0, 0), 0.7 * FINE).reshape(side, FINE, side, FINE).mean((1, 3))
    grey = (paper + (ink - paper) * soft) * (1 + light * (np.arange(side) - centre[0]) / diameter)
    grey = grey + noise * rng.standard_normal(grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), centre, angle
