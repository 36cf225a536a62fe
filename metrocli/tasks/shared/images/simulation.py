"""Simulated image measurements: the image points that the camera model predicts for a given truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.lens import ideal_point, image_point
from metrocli.table import Table
from metrocli.tasks.shared.images.target_list import Targets

if TYPE_CHECKING:
    from metrocli.table import Values

_MARGIN = 2.0
"""Least distance of a target from the border of the image [px]"""

_ASTRAY = 1e-6
"""Largest distance in the plane Z = 1 between a point and the ray of its image; beyond it the lens model folds over"""


@dataclass(frozen=True)
class Shown:
    """A camera with its true parameters, the targets in front of it, and its images."""

    lens: Mapping[str, float]
    image_size: tuple[int, int]
    images: tuple[str, ...]
    to_camera: Array
    """Pose that takes targets into the camera's frame, for each image (images, 6)"""
    targets: Targets
    convention: str = "forward"
    conditions: Mapping[str, Array] = field(default_factory=dict)
    """Time and temperature of each image, (images,)"""


def true_targets(listed: Targets, rng: np.random.Generator) -> Targets:
    """Return the true targets: the listed places with normal errors of the listed standard deviations."""
    return replace(
        listed, points=listed.points + rng.normal(0.0, 1.0, listed.points.shape) * np.nan_to_num(listed.sigma)
    )


@dataclass(frozen=True)
class Sights:
    """Exact image points of the targets inside each image, before noise is added."""

    view: Index
    target: Index
    uv: Array
    """Image coordinates (2, n) px"""


def sights(shown: Shown, only: Callable[[int], list[int]] | None = None) -> Sights:
    """Return the image points of the targets inside each image.

    `only` returns the targets that an image shows; None: all. Raises InputError if no target is inside any image.
    """
    views, targets, points = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)], [np.zeros((0, 2))]
    for i in range(len(shown.images)):
        chosen = np.arange(len(shown.targets.names)) if only is None else np.array(only(i), dtype=np.intp)
        uv, inside = _projected(shown, i, chosen)
        views.append(np.full(int(inside.sum()), i))
        targets.append(chosen[inside])
        points.append(uv[inside])
    if sum(map(len, views)) == 0:
        raise InputError("simulation: no target is inside any image; check the poses and the distance")
    return Sights(np.concatenate(views), np.concatenate(targets), np.concatenate(points).T)


def sightings_table(shown: Shown, seen: Sights, sigma: float, rng: np.random.Generator) -> Table:
    """Return the table of observations with normal noise `sigma` [px] and the conditions of the images."""
    u, v = seen.uv + rng.normal(0.0, sigma, seen.uv.T.shape).T
    columns: dict[str, Values] = {
        "image": np.array(shown.images)[seen.view],
        "target": np.array(shown.targets.names)[seen.target],
        "u": u,
        "v": v,
    }
    columns |= {name: values[seen.view] for name, values in shown.conditions.items()}
    units = {"u": "px", "v": "px", "t": "s", "temp": "degC"}
    return Table(columns, {name: unit for name, unit in units.items() if name in columns})


def _projected(shown: Shown, image: int, chosen: Index) -> tuple[Array, Mask]:
    """Return image points (n, 2) and whether the image of the whole target, radius included, is inside the image."""
    points = poses.apply(shown.to_camera[image], shown.targets.points[chosen])
    front = points[:, 2] > 0
    z = np.where(front, points[:, 2], 1.0)
    x, y = points[:, 0] / z, points[:, 1] / z
    u, v = _distorted(shown, x, y)
    size = (
        max(shown.lens.get("f", 0.0), shown.lens.get("fx", 0.0)) * np.nan_to_num(shown.targets.radius[chosen]) / z
        + _MARGIN
    )
    w, h = shown.image_size
    inside = front & (u > size) & (u < w - 1 - size) & (v > size) & (v < h - 1 - size)
    inside[inside] = _mapped(shown, x[inside], y[inside], u[inside], v[inside])
    return np.column_stack([u, v]), inside


def _mapped(shown: Shown, x: Array, y: Array, u: Array, v: Array) -> Mask:
    """Return whether the image of each point is real.

    The lens polynomial folds over far outside the image, so that points out of sight are mapped back into it.
    """
    back_x, back_y = ideal_point(shown.lens, u, v, shown.convention)
    return np.hypot(back_x - x, back_y - y) < _ASTRAY


def _distorted(shown: Shown, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the image points u, v [px] of ideal points x, y in the plane Z = 1; a backward lens is iterated."""
    if shown.convention == "forward":
        return image_point(shown.lens, x, y)
    u, v = image_point(
        {name: value for name, value in shown.lens.items() if name[0] not in "kps" or name == "skew"}, x, y
    )
    for _ in range(50):
        back_x, back_y = ideal_point(shown.lens, u, v, "backward")
        fx, fy = shown.lens.get("f", shown.lens.get("fx", 1.0)), shown.lens.get("f", shown.lens.get("fy", 1.0))
        u, v = u + fx * (x - back_x), v + fy * (y - back_y)
    return u, v
