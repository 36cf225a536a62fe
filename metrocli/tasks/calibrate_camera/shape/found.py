"""The shape of a lens that an adjustment found: its table, its size over the image, and its derivatives."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import LensShape
from metrocli.instruments.lenses.conventions import image_grid
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.shape.spline import SHAPE
from metrocli.tasks.shared.images.settings import SPLINE

TABLE = "lens_shape"


def link_of(problem: CameraProblem) -> LensShape | None:
    """Return the link of the shape in a calibration; None without one."""
    return next((link for link in problem.images.chain.links if isinstance(link, LensShape)), None)


def by_shape(link: LensShape, uv: Array) -> Array:
    """Return the derivatives of image points (2, n) by the unknowns of the shape, u of all before v of all."""
    half = len(link.to_coefficients) // 2
    at = link.knots.basis(uv)
    return np.concatenate([at @ link.to_coefficients[:half], at @ link.to_coefficients[half:]])


def shape_table(problem: CameraProblem, solution: Solution) -> dict[str, Table]:
    """Return the coefficients of the shift [px] at their knots, with standard uncertainties; {} without a shape."""
    link = link_of(problem)
    if link is None:
        return {}
    n, places = link.to_coefficients, link.knots.places()
    shift = (n @ solution.blocks[SHAPE].values[0]).reshape(2, -1)
    std = np.sqrt(np.einsum("ka,ab,kb->k", n, solution.covariance_or_raise().of(SHAPE), n)).reshape(2, -1)
    columns = {"u [px]": places[:, 0], "v [px]": places[:, 1], "du [px]": shift[0], "dv [px]": shift[1]}
    return {TABLE: Table.of({**columns, "std_du [px]": std[0], "std_dv [px]": std[1]})}


def shape_rms(problem: CameraProblem, solution: Solution) -> float:
    """Return the root mean square shift over the image [px]; 0 without a shape."""
    link = link_of(problem)
    if link is None:
        return 0.0
    shift = by_shape(link, np.stack(image_grid(problem.image_size))) @ solution.blocks[SHAPE].values[0]
    return float(np.sqrt(2 * (shift**2).mean()))


def shape_notes(problem: CameraProblem, solution: Solution, model: str | None) -> list[str]:
    """Return how large the shape is, or that the model spline of the job has found no shape."""
    if link_of(problem) is not None:
        return [f"shape of the lens beside its base: {shape_rms(problem, solution):.2g} px (rms over the image)"]
    nothing = "the readings show no shape of the lens beside its base: the result is that of the base"
    return [nothing] if model == SPLINE else []
