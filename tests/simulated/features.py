"""Points near ideal features, by plain formulas."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from metrocli.tasks.shared.features.ideal import IdealFeature

Array = npt.NDArray[np.float64]
AXES = (np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0.36, 0.48, 0.8]))


def cloud(
    shape: IdealFeature,
    number: int,
    form: float,
    rng: np.random.Generator,
    axis: Array | None = None,
    radius: float = 30.0,
    half_angle: float = 0.3,
    flat: bool = False,
) -> Array:
    """Points (n, 3) evenly within a zone of twice `form` about a feature at a place drawn at random."""
    across, along = rng.uniform(0, 2 * np.pi, number), rng.uniform(-40, 40, number)
    off, other = form * rng.uniform(-1, 1, (2, number))
    round_, edge = np.column_stack([np.cos(across), np.sin(across)]), radius + off
    if shape is IdealFeature.PLANE:
        points = np.column_stack([rng.uniform(-50, 50, (number, 2)), off])
    elif shape is IdealFeature.LINE:
        points = np.column_stack([off, other, along])
    elif shape is IdealFeature.CIRCLE:
        points = np.column_stack([edge[:, None] * round_, 0 * other if flat else other])
    elif shape is IdealFeature.SPHERE:
        unit = rng.normal(size=(number, 3))
        points = edge[:, None] * unit / np.linalg.norm(unit, axis=1)[:, None]
    else:
        slope = np.tan(half_angle) if shape is IdealFeature.CONE else 0.0
        points = np.column_stack([(edge + slope * along)[:, None] * round_, along])
    direction = rng.normal(size=3) if axis is None else axis
    frame = np.linalg.qr(np.column_stack([direction, rng.normal(size=(3, 2))]))[0][:, [1, 2, 0]]
    return np.asarray(points @ frame.T + rng.uniform(-300, 300, 3) * (1 if not flat else 0))
