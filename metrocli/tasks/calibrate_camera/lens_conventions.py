"""A calibrated lens in the other distortion convention, in mm and balanced, and how much of the image is covered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.instruments import camera
from metrocli.instruments.lenses.conventions import Photogrammetric, converted, photogrammetric
from metrocli.instruments.lenses.distortion import PRISM, RATIONAL, TILT
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.shared.images.camera_parameters import unit_of

_Row = tuple[str, str, float, float, str, float, float]
_COLUMNS = ("form", "parameter", "value", "std", "unit", "residual_rms [px]", "residual_largest [px]")


def conventions_table(
    problem: CameraProblem, settings: CameraSettings, solution: Solution, covariance: Covariance
) -> Table:
    """Return the lens in both distortion conventions and, if the pixel size is known, in mm.

    `residual_rms` and `residual_largest` [px] are the errors of a conversion over the image.
    """
    values = solution.blocks[camera.LENS].named()
    std = dict(zip(values, np.sqrt(np.diag(covariance.of(camera.LENS))).tolist(), strict=True))
    rows: list[_Row] = [
        (problem.convention, name, value, std[name], unit_of(name), 0.0, 0.0) for name, value in values.items()
    ]
    if problem.convention != "fisheye":
        name_of_other = "backward" if problem.convention == "forward" else "forward"
        other = converted(values, problem.convention, problem.image_size)
        rows += [
            (name_of_other, name, value, std.get(name, float("nan")), unit_of(name), other.rms, other.largest)
            for name, value in other.values.items()
        ]
    if settings.pixel_size is not None:
        rows += _in_mm(problem, settings.pixel_size, values, std)
    form = photogrammetric_form(problem, settings, solution)
    if form is not None:
        rows += _form_rows(form, covariance)
    return Table.of_rows(_COLUMNS, rows)


def photogrammetric_form(
    problem: CameraProblem, settings: CameraSettings, solution: Solution
) -> Photogrammetric | None:
    """Return the balanced photogrammetric form in mm, with distortion zero at the radius R0.

    None without a pixel size, and for a lens that has no such form: backward, or with rational or prism terms.
    """
    values, pixel = solution.blocks[camera.LENS].named(), settings.pixel_size
    if pixel is None or problem.convention != "forward" or any(values.get(name) for name in (*RATIONAL, *PRISM, *TILT)):
        return None
    r0 = settings.reference_radius
    if r0 is None:
        r0 = pixel * float(np.hypot(*problem.image_size)) / 3
    return photogrammetric(values, pixel, problem.image_size, r0)


def form_covariance(form: Photogrammetric, covariance: Covariance) -> Array:
    """Return the covariance of the photogrammetric form's parameters, in their order."""
    matrix: Array = form.by_lens @ covariance.of(camera.LENS) @ form.by_lens.T
    return matrix


def _in_mm(problem: CameraProblem, pixel: float, values: dict[str, float], std: dict[str, float]) -> list[_Row]:
    """Return focal lengths and principal point in mm; the principal point counts from the centre of the image."""
    w, h = problem.image_size
    form = f"{problem.convention}, mm"
    rows: list[_Row] = []
    for name, centre in (("f", 0.0), ("fx", 0.0), ("fy", 0.0), ("cx", (w - 1) / 2), ("cy", (h - 1) / 2)):
        if name in values:
            label = f"{name} from image centre" if centre else name
            rows.append((form, label, (values[name] - centre) * pixel, std[name] * pixel, "mm", 0.0, 0.0))
    return rows


def _form_rows(form: Photogrammetric, covariance: Covariance) -> list[_Row]:
    label = f"photogrammetric, R0 = {form.reference_radius:.4g} mm"
    std = np.sqrt(np.diag(form_covariance(form, covariance))).tolist()
    return [
        (label, name, value, spread, unit, 0.0, 0.0)
        for name, value, spread, unit in zip(form.names, form.values.tolist(), std, form.units, strict=True)
    ]


_CELLS = 10
_DIRECTIONS = 32


def coverage(uv: Array, image_size: Sequence[int], centre: tuple[float, float]) -> dict[str, float]:
    """Return which share of the image the points (2, n) [px] cover, in three measures.

    `coverage_cells` is the share of a 10 x 10 grid of cells that contain a point. `coverage_hull` is the area of the
    points' convex hull over that of the image. `coverage_radius` is the distance of the farthest point from `centre`,
    the principal point, over that of the farthest corner.
    """
    w, h = image_size
    cx, cy = centre
    inside = (uv[0] >= 0) & (uv[0] < w) & (uv[1] >= 0) & (uv[1] < h)
    cells = np.unique((uv[:, inside] / np.array([[w], [h]]) * _CELLS).astype(int), axis=1)
    corner = max(np.hypot(cx - x, cy - y) for x in (0, w - 1) for y in (0, h - 1))
    return {
        "coverage_cells": cells.shape[1] / _CELLS**2,
        "coverage_hull": hull_area(uv) / (w * h),
        "coverage_radius": float(np.hypot(uv[0] - cx, uv[1] - cy).max() / corner),
    }


def hull_area(uv: Array) -> float:
    """Return the area of the convex hull of image points (2, n), by the monotone chain of Andrew (1979)."""
    points = np.unique(_outer(uv.T), axis=0)
    hull: list[Array] = []
    for ordered in (points, points[::-1]):
        side: list[Array] = []
        for point in ordered:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= 0:
                side.pop()
            side.append(point)
        hull += side[:-1]
    x, y = np.array(hull).T if hull else np.zeros((2, 1))
    return float(abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2)


def _outer(points: Array) -> Array:
    """Return the points that can be corners of the hull, (m, 2) of (n, 2).

    Points inside the polygon of the farthest points in 32 directions are left out: they are most, and sorting is slow.
    """
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    corners = points[(points @ np.stack([np.cos(angle), np.sin(angle)])).argmax(axis=0)]
    inside = np.ones(len(points), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if (a != b).any():
            inside &= (b[0] - a[0]) * (points[:, 1] - a[1]) > (b[1] - a[1]) * (points[:, 0] - a[0])
    return np.concatenate([corners, points[~inside]])


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
