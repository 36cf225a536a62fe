"""A calibrated lens in other forms: the other distortion convention, mm, and the balanced photogrammetric form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.solution import Solution
from metrocli.instruments import camera
from metrocli.instruments.conventions import Photogrammetric, converted, photogrammetric
from metrocli.instruments.lens import PRISM, RATIONAL
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.calibrate_camera.settings import Camera
from metrocli.tasks.shared.images.camera_parameters import unit_of

if TYPE_CHECKING:
    from metrocli.table import Values

_Row = tuple[str, str, float, float, str, float, float]
_COLUMNS = ("form", "parameter", "value", "std", "unit", "residual_rms", "residual_largest")


def conventions_table(problem: Problem, settings: Camera, solution: Solution, covariance: Covariance) -> Table:
    """Return the lens in both distortion conventions and, if the pixel size is known, in mm.

    `residual_rms` and `residual_largest` [px] are the errors of a conversion over the image.
    """
    values = solution.blocks[camera.LENS].named()
    std = dict(zip(values, np.sqrt(np.diag(covariance.of(camera.LENS))).tolist(), strict=True))
    other = converted(values, problem.convention, problem.image_size)
    name_of_other = "backward" if problem.convention == "forward" else "forward"
    rows: list[_Row] = [
        (problem.convention, name, value, std[name], unit_of(name), 0.0, 0.0) for name, value in values.items()
    ]
    rows += [
        (name_of_other, name, value, std.get(name, float("nan")), unit_of(name), other.rms, other.largest)
        for name, value in other.values.items()
    ]
    if settings.pixel_size is not None:
        rows += _in_mm(problem, settings.pixel_size, values, std)
    form = photogrammetric_form(problem, settings, solution)
    if form is not None:
        rows += _form_rows(form, covariance)
    columns: dict[str, Values] = {
        label: np.array(column) for label, column in zip(_COLUMNS, zip(*rows, strict=True), strict=True)
    }
    return Table(columns, {"residual_rms": "px", "residual_largest": "px"})


def photogrammetric_form(problem: Problem, settings: Camera, solution: Solution) -> Photogrammetric | None:
    """Return the balanced photogrammetric form in mm, with distortion zero at the radius R0.

    None without a pixel size, and for a lens that has no such form: backward, or with rational or prism terms.
    """
    values, pixel = solution.blocks[camera.LENS].named(), settings.pixel_size
    if pixel is None or problem.convention != "forward" or any(values.get(name) for name in (*RATIONAL, *PRISM)):
        return None
    r0 = settings.reference_radius
    if r0 is None:
        r0 = pixel * float(np.hypot(*problem.image_size)) / 3
    return photogrammetric(values, pixel, problem.image_size, r0)


def form_covariance(form: Photogrammetric, covariance: Covariance) -> Array:
    """Return the covariance of the photogrammetric form's parameters, in their order."""
    matrix: Array = form.by_lens @ covariance.of(camera.LENS) @ form.by_lens.T
    return matrix


def _in_mm(problem: Problem, pixel: float, values: dict[str, float], std: dict[str, float]) -> list[_Row]:
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
